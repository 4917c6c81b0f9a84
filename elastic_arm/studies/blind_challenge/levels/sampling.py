"""What the hidden arms of a level have: description, true numbers, sensors, motions, effects and sizes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_arm.effects import Catalogue
from elastic_arm.robot import Robot, load_robot
from elastic_arm.studies.blind_challenge.arm_sampling import SamplingRequest, shares
from elastic_arm.studies.blind_challenge.effect_sampling import model_of, sample_effect
from elastic_arm.studies.blind_challenge.hidden_arms.base_arms import (
    as_urdf,
    encoder_zeros,
    imprecise,
    industrial_arm,
    joint_sizes,
    ordinary_faults,
)
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from elastic_arm.studies.blind_challenge.hidden_arms.further_laws import FOREIGN
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import altered
from elastic_arm.studies.blind_challenge.hidden_arms.motion import MultiSine, random_motion
from elastic_arm.studies.blind_challenge.hidden_arms.realistic_sensors import (
    BOTH,
    DIFFERENCED,
    LINK,
    MEASURED,
    MISSING,
    RealisticSensors,
)
from elastic_arm.studies.blind_challenge.levels.foreign_sampling import sample_foreign, sized_foreign
from elastic_arm.studies.blind_challenge.levels.level import FLOORS, FOREIGN_FLOORS, ChallengeLevel
from elastic_arm.studies.blind_challenge.levels.sizing import EffectDraft, Sizing

Array = NDArray[np.float64]

NOISE = 0.26  # Nm, of the torque channels of a large joint
SMALLEST_JOINT = 0.25  # on which effects of torques are drawn: no wrist that carries a kilogram
LARGEST = 30.0  # floors that an effect of no catalogue may have; of a drive that saturates:
DEEPEST = 0.6


@dataclass(frozen=True)
class RealisticArm:
    """One hidden arm of a level: all that is drawn of it."""

    # name, model, level: Of its bags; what it is diagnosed against; its level
    name: str
    model: str
    level: str
    # faults, foreign: Effects of the catalogue beyond what is ordinary, and of no catalogue
    faults: tuple[Fault, ...]
    foreign: tuple[Fault, ...]
    # Friction and calibration of sensors that every arm of the level has; naming them as a cause is wrong
    ordinary: tuple[Fault, ...]
    # What is beyond ordinary sensors and friction on every arm of the level: naming it is not wrong
    conditions: tuple[Fault, ...]
    # True numbers of the arm, as `imperfections` of a diagnosis names them: (what, joint) and value
    numbers: tuple[tuple[str, int, float], ...]
    sensors: RealisticSensors  # their quality
    instruments: dict[str, float]  # what the score tables of them
    # multiple, bound, share: As of :class:`~elastic_arm.studies.blind_challenge.arm_sampling.ArmSpecification`, the
    # bound with everything ordinary marginalised
    multiple: tuple[float, ...] = ()
    bound: tuple[float | None, ...] = ()
    share: tuple[float, ...] = ()
    visible: bool = True  # whether theory lets an effect of no catalogue be seen

    def truth(self) -> dict[str, Any]:
        """Return it as plain data."""
        return asdict(self)

    @property
    def all_faults(self) -> tuple[Fault, ...]:
        """Everything that the arm has beyond its numbers."""
        return (*self.faults, *self.foreign, *self.conditions, *self.ordinary)


@dataclass(frozen=True)
class DrawnArm:
    """A drawn arm, with what its recording needs."""

    arm: RealisticArm  # the truth
    # description, robot: What the diagnosis is given, and the arm as it is
    description: Robot
    robot: Robot
    motions: tuple[MultiSine, MultiSine]  # of the recording that is fitted, and of the one that judges


def sample_realistic_arm(
    request: SamplingRequest, level: ChallengeLevel, rng: np.random.Generator, catalogue: Catalogue
) -> DrawnArm:
    """Draw one hidden arm of a level."""
    effects, seconds = request.effects, request.seconds
    n = int(rng.choice(level.joints))
    description = load_robot(None) if n == 3 else industrial_arm(n, rng)
    description = as_urdf(description) if level.urdf else description
    real, sizes = imprecise(description, rng), joint_sizes(description)
    sensors = _sensors(level, _sides(level, effects, rng), sizes, rng)
    ordinary = ordinary_faults(sizes.tolist(), rng, torque_constant=level.torque_constant)
    ordinary += encoder_zeros(n, rng) if sensors.sides == BOTH else []
    conditions = [_warming(j, level, rng) for j in range(n)] if level.warming else []
    motions = tuple(random_motion(rng, n, s) for s in seconds)
    sizing = Sizing(description, real, sensors, level, motions[0], ordinary) if effects else None
    chosen = []
    for effect in effects:
        assert sizing is not None
        draft = _draft(effect, sizes, min(seconds), sensors, catalogue, sizing.peak, rng)
        chosen.append(sizing.sized(draft, float(np.exp(rng.uniform(*np.log(request.ratio))))))
    faults = [one.fault for one in chosen]
    for fault in faults:
        ordinary = [o for o in ordinary if (o.effect, o.joint) != (fault.effect, fault.joint)]
        conditions = [c for c in conditions if (c.effect, c.joint) != (fault.effect, fault.joint)]
        real = _as_described(real, description, fault)
    if level.torque_constant:
        conditions += [o for o in ordinary if o.effect == "motor_torque_gain"]
        ordinary = [o for o in ordinary if o.effect != "motor_torque_gain"]
    multiples = tuple(one.distance for one in chosen)
    arm = RealisticArm(
        name=request.name,
        model=model_of([e for e in effects if e not in FOREIGN], catalogue),
        level=level.name,
        faults=tuple(f for f in faults if f.effect not in FOREIGN),
        foreign=tuple(f for f in faults if f.effect in FOREIGN),
        ordinary=tuple(ordinary),
        conditions=tuple(conditions),
        numbers=_numbers(altered(real, [f for f in faults if f.effect != "payload"]), description),
        sensors=sensors,
        instruments={"encoder_noise": sensors.link_step / np.sqrt(12)},
        multiple=multiples,
        bound=tuple(one.bound for one in chosen),
        share=shares([one.excess for one in chosen]),
        visible=min(multiples, default=np.inf) >= request.ratio[0],
    )
    return DrawnArm(arm, description, real, (motions[0], motions[1]))


def _draft(
    effect: str,
    sizes: Array,
    seconds: float,
    sensors: RealisticSensors,
    catalogue: Catalogue,
    peak: Callable[[], Array],
    rng: np.random.Generator,
) -> EffectDraft:
    """Draw an effect without its size, on a joint that is no small wrist where its size is a torque."""
    floor = FLOORS.get(effect) or FOREIGN_FLOORS[effect]
    suits = sizes >= SMALLEST_JOINT if floor.scaled else np.ones(len(sizes), dtype=bool)
    while True:
        if effect in FOREIGN:
            fault, drawn = sample_foreign(effect, len(sizes), seconds, rng), None
        else:
            drawn = sample_effect(catalogue[effect], len(sizes), rng)
            fault = drawn.fault
        # What sits on the last link alone has no choice of a joint.
        if fault.joint is None or suits[fault.joint] or effect == "loose_payload":
            break
    low = floor.amount * (float(sizes[fault.joint]) if floor.scaled and fault.joint is not None else 1.0)
    if drawn is None:
        high = DEEPEST if effect == "saturating_drive" else LARGEST * low
        return EffectDraft(lambda amount: sized_foreign(fault, amount, peak), low, high)
    drawn = replace(drawn, fault=_fitting(fault, sensors))
    high = max(drawn.limits())
    return EffectDraft(drawn.sized, min(low, high), high)


def _fitting(fault: Fault, sensors: RealisticSensors) -> Fault:
    """Return an effect on a channel that is recorded; friction changes on the side that has some."""
    if fault.effect == "thermal_friction":
        return replace(fault, side="motor")
    if fault.effect == "torque_drift" and sensors.sides != BOTH:
        return replace(fault, choices={"channel": "joint_torque" if sensors.sides == LINK else "motor_torque"})
    return fault


def _sides(level: ChallengeLevel, effects: Sequence[str], rng: np.random.Generator) -> str:
    """Draw what is recorded, of what shows all the effects; of all there is where nothing does."""
    return str(rng.choice(sorted(level.common_sides(effects) or level.sides)))


def _sensors(level: ChallengeLevel, sides: str, sizes: Array, rng: np.random.Generator) -> RealisticSensors:
    noise = tuple((NOISE * sizes * np.exp(rng.uniform(-0.4, 0.4))).tolist())
    corner = None if level.corner is None else float(np.exp(rng.uniform(*np.log(level.corner))))
    return RealisticSensors(
        torque_noise=noise,
        corner=corner,
        velocity=str(rng.choice([MISSING, DIFFERENCED, MEASURED])),
        apart=sides == BOTH and bool(rng.choice([False, True])),
        rate=float(rng.choice(level.rates)),
        sides=sides,
        drift=float(rng.uniform(0.0, level.drift)),
    )


def _warming(joint: int, level: ChallengeLevel, rng: np.random.Generator) -> Fault:
    return Fault("thermal_friction", joint, {"change": float(rng.uniform(-level.warming, level.warming))})


def _as_described(real: Robot, description: Robot, fault: Fault) -> Robot:
    """Return an arm that is as described in what an effect changes, so that the effect is the whole difference."""
    if fault.joint is None:
        return real
    joint, stated = real.joints[fault.joint], description.joints[fault.joint]
    gear = joint.transmission
    assert gear is not None and stated.transmission is not None
    if fault.effect == "link_inertia_mismatch":
        joint = replace(joint, link=stated.link)
    elif fault.effect == "rotor_inertia_mismatch":
        parts: dict[str, Any] = {name: part for name, (part, _) in stated.transmission.components.items()}
        joint = replace(joint, transmission=replace(gear, **parts))
    elif fault.effect in ("stiffness_mismatch", "damping_mismatch"):
        what = fault.effect.removesuffix("_mismatch")
        number = {what: getattr(stated.transmission, what)}
        joint = replace(joint, transmission=replace(gear, **number))
    joints = list(real.joints)
    joints[fault.joint] = joint
    return real.with_(joints=tuple(joints))


def _numbers(real: Robot, description: Robot) -> tuple[tuple[str, int, float], ...]:
    """Return what an arm's numbers are of those described: ratios, and distances of centres of mass, m."""
    found: list[tuple[str, int, float]] = []
    for j, (joint, stated) in enumerate(zip(real.joints, description.joints, strict=True)):
        own, given = joint.transmission, stated.transmission
        assert own is not None and given is not None
        found.append(("link_mass", j, joint.link.mass / stated.link.mass))
        shift = np.asarray(joint.link.com) - np.asarray(stated.link.com)
        found += [(f"link_com_{axis}", j, float(value)) for axis, value in zip("xyz", shift, strict=True)]
        found.append(("rotor_inertia", j, own.rotor.izz / given.rotor.izz))
        found += [(what, j, getattr(own, what) / getattr(given, what)) for what in ("stiffness", "damping")]
    return tuple(found)
