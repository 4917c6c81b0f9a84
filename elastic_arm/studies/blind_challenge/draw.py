"""One hidden arm: its random draw, and the folder of its recordings.

The seed determines, in this order, description, true numbers, sensors, two motions, effects,
joints, forms, and sizes.
"""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from elastic_arm.arrays import Array
from elastic_arm.effects import Catalogue
from elastic_arm.errors import SimulationError
from elastic_arm.output_files import write_result
from elastic_arm.recording import write_recording
from elastic_arm.robot import Robot, load_robot, save_robot, to_urdf
from elastic_arm.robot.saving import robot_to_dict
from elastic_arm.sensors import Sensors
from elastic_arm.simulation import SimulationSettings
from elastic_arm.simulation.simulator import Simulator
from elastic_arm.studies.blind_challenge.effect_sampling import (
    SampledEffect,
    instance_of,
    model_of,
    sample_effect,
    sample_foreign,
    sized_foreign,
)
from elastic_arm.studies.blind_challenge.hidden_arms.base_arms import (
    as_urdf,
    encoder_zeros,
    imprecise,
    industrial_arm,
    joint_sizes,
    mounted,
    ordinary_faults,
    without_drives,
)
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import KNOWN, SENSOR_EFFECTS, Fault
from elastic_arm.studies.blind_challenge.hidden_arms.further_laws import FOREIGN
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import RATE, HiddenArm, altered
from elastic_arm.studies.blind_challenge.hidden_arms.motion import (
    HiddenMotion,
    TrueChannels,
    random_motion,
    random_points,
)
from elastic_arm.studies.blind_challenge.hidden_arms.realistic_sensors import (
    BOTH,
    DIFFERENCED,
    LINK,
    MEASURED,
    MISSING,
    RealisticSensors,
    measure_realistically,
)
from elastic_arm.studies.blind_challenge.information import (
    SCALING,
    EffectDraft,
    SizedEffect,
    Sizing,
)
from elastic_arm.studies.blind_challenge.levels import (
    CHANGE_FLOORS,
    FLOORS,
    FOREIGN_FLOORS,
    Floor,
    Level,
)

Run = Callable[[HiddenMotion, Sequence[Fault]], TrueChannels]

LOWEST = 10.0
HIGHEST = 300.0
NOISE = 0.26  # Nm, of the torque channels of a large joint
SMALLEST_JOINT = 0.25  # on which effects of torques are drawn: no wrist that carries a kilogram
LARGEST = 30.0  # floors that an effect of no catalogue may have; of a drive that saturates:
DEEPEST = 0.6
# Nm s/rad, of an exact arm with what scales friction: of dry friction that may be an offset
VISCOUS = (5.0, 20.0)
IDEAL_BITS = 40
PLACES = 5  # draws of an effect, until one acts: the zero of a vertical axis does not
NOTHING = 1e-6  # standard deviations: what moves the residuals by less does not act
MODEL_DISTANCE = 1e3  # bounds, of what a poorer model lacks: it has the size that it has


@dataclass(frozen=True)
class Request:
    """The arm to be drawn."""

    name: str
    effects: tuple[str, ...]  # ids, in the catalogue or not; empty for an arm without effects
    seed: tuple[int, ...]
    seconds: tuple[float, ...]  # duration of each bag
    ratio: tuple[float, float] = (LOWEST, HIGHEST)  # range of sizes over their bounds


@dataclass(frozen=True)
class Arm:
    """The truth of one hidden arm."""

    name: str
    model: str  # of the diagnosis
    level: str
    joints: tuple[str, ...]
    faults: tuple[Fault, ...]  # effects of the catalogue beyond the ordinary ones
    foreign: tuple[Fault, ...]  # effects outside the catalogue
    # friction and calibration of every arm of the level, which are not causes
    ordinary: tuple[Fault, ...]
    # further effects of every arm of the level, which may be named
    conditions: tuple[Fault, ...]
    # true numbers, as imperfections: what, joint, value
    numbers: tuple[tuple[str, int, float], ...]
    sensors: RealisticSensors
    multiple: tuple[float, ...]  # size of each effect over its bound
    # smallest detectable size, with everything ordinary marginalised
    bound: tuple[float | None, ...]
    share: tuple[float, ...]  # share of each effect in the sum of all excesses
    visible: bool  # whether all effects are detectable in theory
    since: int = 0  # first bag that has the effects


@dataclass(frozen=True)
class Drawn:
    """A drawn arm with its description, its motions, and its simulation."""

    arm: Arm
    description: Robot
    motions: tuple[HiddenMotion, ...]
    run: Run
    before: tuple[Fault, ...]  # faults in the bags without the effects


def draw(request: Request, level: Level, rng: np.random.Generator, catalogue: Catalogue) -> Drawn:
    """Draw one hidden arm of a level."""
    effects = request.effects
    n = int(rng.choice(level.joints))
    description = _description(level, n, rng)
    real = description if level.exact else imprecise(description, rng)
    sizes = joint_sizes(description)
    sides = str(rng.choice(sorted(level.sides_of(effects) or level.sides)))
    sensors = _exact_sensors(n, rng) if level.exact else _sensors(level, sides, sizes, rng)
    ordinary: list[Fault] = []
    if not level.exact:
        ordinary = ordinary_faults(sizes.tolist(), rng, torque_constant=level.torque_constant)
    if sensors.sides == BOTH and not level.exact:
        ordinary += encoder_zeros(n, rng)
    conditions = [_warming(j, level, rng) for j in range(n)] if level.warming else []
    motions = tuple(_motion(level, n, seconds, rng) for seconds in request.seconds)
    run = _mover(real, description, effects, catalogue)
    chosen: list[SizedEffect] = []
    model = model_of(effects, catalogue)
    if effects and model == "mod3":
        sizing = Sizing(
            real, sensors, level, motions[0], ordinary, lambda faults: run(motions[0], faults)
        )
        drawing = _Effects(request, level, sizes, sensors, catalogue, sizing, run, motions, rng)
        chosen = [one for effect in effects for one in drawing.sized(effect)]
    faults = [one.fault for one in chosen] or [Fault(effect, None) for effect in effects]
    since = int(rng.integers(1, len(motions))) if level.changing else 0
    before = (*conditions, *ordinary)
    if level.changing:
        faults = [_changed(fault, ordinary, catalogue) for fault in faults]
    for fault in faults:
        ordinary = _without(fault, ordinary)
        conditions = _without(fault, conditions)
        real = _as_described(real, description, fault)
    if level.torque_constant:
        conditions += [o for o in ordinary if o.effect == "motor_torque_gain"]
        ordinary = [o for o in ordinary if o.effect != "motor_torque_gain"]
    multiples = tuple(one.distance for one in chosen) or (MODEL_DISTANCE,) * len(faults)
    without_loads = [fault for fault in faults if fault.effect not in ("payload", "load")]
    arm = Arm(
        name=request.name,
        model=model,
        level=level.name,
        joints=description.joint_names,
        faults=tuple(f for f in faults if f.effect not in FOREIGN),
        foreign=tuple(f for f in faults if f.effect in FOREIGN),
        ordinary=tuple(ordinary),
        conditions=tuple(conditions),
        numbers=_numbers(altered(real, without_loads), description),
        sensors=sensors,
        multiple=multiples,
        bound=tuple(one.bound for one in chosen) or (None,) * len(faults),
        share=_shares([one.excess for one in chosen] or [1.0] * len(faults)),
        visible=min(multiples, default=np.inf) >= request.ratio[0],
        since=since,
    )
    return Drawn(arm, description, motions, _mover(real, description, effects, catalogue), before)


def _without(fault: Fault, others: Sequence[Fault]) -> list[Fault]:
    """Return faults without that of the same effect and joint."""
    return [one for one in others if (one.effect, one.joint) != (fault.effect, fault.joint)]


def _motion(level: Level, n: int, seconds: float, rng: np.random.Generator) -> HiddenMotion:
    kind = random_points if rng.random() < level.points else random_motion
    return kind(rng, n, seconds)


def _changed(fault: Fault, ordinary: Sequence[Fault], catalogue: Catalogue) -> Fault:
    """Return an effect with the ordinary size of the same effect added."""
    alike = (o for o in ordinary if (o.effect, o.joint) == (fault.effect, fault.joint))
    own = next((o.parameters for o in alike), {})
    parameters = dict(fault.parameters)
    for name in parameters.keys() & own.keys():
        neutral = catalogue[fault.effect].parameter(name).neutral or 0.0
        parameters[name] = parameters[name] + own[name] - neutral
    return replace(fault, parameters=parameters)


def record(
    folder: Path,
    request: Request,
    level: Level,
    catalogue: Catalogue,
    bags: Sequence[Path] | None = None,
) -> dict[str, Any]:
    """Draw an arm, record it into a challenge with its description, and return its truth."""
    rng = np.random.default_rng(request.seed)
    drawn = draw(request, level, rng, catalogue)
    arm = drawn.arm
    description = drawn.description
    faults = (*arm.faults, *arm.foreign, *arm.conditions, *arm.ordinary)
    ratios = np.array(
        [joint.transmission.r_tot for joint in description.joints if joint.transmission]
    )
    bags = bags or bags_of(folder, request.name, len(request.seconds))
    for k, (bag, motion) in enumerate(zip(bags, drawn.motions, strict=True)):
        acting = faults if k >= arm.since else drawn.before
        course = drawn.run(motion, acting)
        recording = measure_realistically(course, arm.joints, acting, arm.sensors, ratios, rng)
        if not (bag / "metadata.yaml").is_file():
            shutil.rmtree(bag, ignore_errors=True)  # what a run that was broken off has left
            bag.parent.mkdir(parents=True, exist_ok=True)
            write_recording(bag, recording)
    if not level.exact:
        _write_description(folder / "robots", request.name, description, urdf=level.urdf)
    if arm.sensors.sides == LINK:
        path = folder / "channels" / f"{request.name}.yaml"
        # Without a map, the effort of a bag without motor states counts as the motors' torque.
        sides = {name: {"topic": "/joint_states"} for name in ("position", "effort")}
        content = {"defaults": {"link": sides}, "joints": {joint: {} for joint in arm.joints}}
        write_result(path, yaml.safe_dump(content))
    return asdict(arm)


def bags_of(folder: Path, name: str, count: int = 2) -> list[Path]:
    """Return the bags of an arm: the two of a diagnosis, or those of a history."""
    parts = ["identify", "validate"] if count == 2 else [f"{k:02d}" for k in range(count)]
    return [folder / "bags" / f"{name}_{part}" for part in parts]


def description_path(folder: Path, name: str) -> Path | None:
    """Return the file that describes an arm; None for the nominal one."""
    paths = (folder / "robots" / f"{name}.{suffix}" for suffix in ("yaml", "xml"))
    return next((path for path in paths if path.is_file()), None)


def channels_path(folder: Path, name: str) -> Path | None:
    """Return the channel map of an arm's bags; None where they need none."""
    path = folder / "channels" / f"{name}.yaml"
    return path if path.is_file() else None


def _description(level: Level, n: int, rng: np.random.Generator) -> Robot:
    description = (
        load_robot(None) if n == 3 else industrial_arm(n, rng, lift=bool(rng.random() < level.lift))
    )
    description = mounted(description, rng) if level.mountings else description
    return as_urdf(description) if level.urdf else description


def _mover(robot: Robot, description: Robot, effects: Sequence[str], catalogue: Catalogue) -> Run:
    """Return what moves the arm with some faults: the independent engine, where it has all of the
    effects.

    The suite's own simulator, which moves it otherwise, shares the law of a user's effect with the
    diagnosis and so flatters it; the score states that.
    """
    if all(
        effect in KNOWN or effect in FOREIGN or model_of([effect], catalogue) != "mod3"
        for effect in effects
    ):
        return lambda motion, faults: HiddenArm(robot, faults, geometry=description).run(motion)

    def simulated(motion: HiddenMotion, faults: Sequence[Fault]) -> TrueChannels:
        t = np.arange(round(motion.duration * RATE) + 1) / RATE
        reference = motion.evaluate(t)
        # The faults of sensors that the challenge's own sensors have act there.
        moved = [
            instance_of(f, catalogue[f.effect], robot)
            for f in faults
            if f.effect not in SENSOR_EFFECTS
        ]
        settings = SimulationSettings(effects=moved, sensors=Sensors.exact(), rate=RATE)
        q0 = reference[0][0]
        still = np.random.default_rng(0)
        simulator = Simulator(robot, settings, q0=q0, rng=still, duration=motion.duration)
        _, read = simulator.follow(*reference)
        return TrueChannels(t[1:-1], **{name: values[1:-1] for name, values in read.items()})

    return simulated


@dataclass(frozen=True)
class _Effects:
    """Draws the effects of one arm: where they sit, their form, and their sizes."""

    request: Request
    level: Level
    joints: Array  # sizes of the joints (n,)
    sensors: RealisticSensors
    catalogue: Catalogue
    sizing: Sizing
    run: Run
    motions: tuple[HiddenMotion, ...]
    rng: np.random.Generator

    def sized(self, effect: str) -> list[SizedEffect]:
        """Draw an effect where it acts, with its size; an exact arm gets the friction that it
        scales."""
        for _ in range(PLACES):
            fault, drawn = self._placed(effect)
            friction = []
            if self.level.exact and effect in SCALING:
                size = float(self.rng.uniform(*VISCOUS))
                own = Fault("viscous_friction", fault.joint, {"coefficient": size})
                self.sizing.add_friction([own])
                distance, excess = self.sizing.change(own)
                friction = [SizedEffect(own, distance, size / distance, excess)]
            wanted = float(np.exp(self.rng.uniform(*np.log(self.request.ratio))))
            one = self.sizing.sized(self._draft(fault, drawn), wanted)
            if one.distance > NOTHING and self._acts_in_both(one.fault):
                return [*friction, one]
        raise SimulationError(
            f"{effect} does not change one recording or both, for any draw",
            "Correct its law or the range of its size, or exclude it with --effect",
        )

    def _acts_in_both(self, fault: Fault) -> bool:
        """Whether an effect changes the torques of each motion by a tenth of what it does in the
        other, or more."""
        if fault.effect in SENSOR_EFFECTS or fault.effect in SCALING:
            return True
        most = []
        for motion in self.motions:
            changed = self.run(motion, (fault,))
            plain = self.run(motion, ())
            most.append(
                max(
                    np.abs(changed.tau_J - plain.tau_J).max(),
                    np.abs(changed.tau_m - plain.tau_m).max(),
                )
            )
        return bool(min(most) >= 0.1 * max(most))

    def _placed(self, effect: str) -> tuple[Fault, SampledEffect | None]:
        """Draw where an effect sits and its form: on a joint that is no small wrist where its size
        is a torque."""
        floor = _floor(effect)
        n = len(self.joints)
        suits = self.joints >= SMALLEST_JOINT if floor and floor.scaled else np.ones(n, dtype=bool)
        while True:
            drawn = (
                None if effect in FOREIGN else sample_effect(self.catalogue[effect], n, self.rng)
            )
            fault = (
                drawn.fault
                if drawn
                else sample_foreign(effect, n, min(self.request.seconds), self.rng)
            )
            # What sits on the last link alone has no choice of a joint.
            if fault.joint is None or suits[fault.joint] or effect == "loose_payload":
                break
        torque = "joint_torque" if self.sensors.sides == LINK else "motor_torque"
        if effect in SCALING:
            fault = replace(fault, side="motor")
        elif effect == "torque_drift" and self.sensors.sides != BOTH:
            fault = replace(fault, choices={"channel": torque})
        elif effect == "gravity_compensation" and self.sensors.sides != BOTH:
            fault = replace(fault, channels=(torque,))
        return fault, replace(drawn, fault=fault) if drawn else None

    def _draft(self, fault: Fault, drawn: SampledEffect | None) -> EffectDraft:
        """Return an effect without its size, with the range that it may have."""
        floor = _floor(fault.effect)
        low = 0.0
        if floor and not self.level.exact:
            scaled = floor.scaled and fault.joint is not None
            low = floor.amount * (float(self.joints[fault.joint]) if scaled else 1.0)
        if drawn is None:
            high = DEEPEST if fault.effect == "saturating_drive" else LARGEST * low
            return EffectDraft(
                lambda amount: sized_foreign(fault, amount, self.sizing.peak), low, high, low
            )
        least, most = drawn.limits()
        if self.level.exact:
            return EffectDraft(
                drawn.sized, least, most, float(np.clip(drawn.typical(), least, most))
            )
        high = max(least, most)
        return EffectDraft(drawn.sized, min(low, high), high, min(low, high))


def _floor(effect: str) -> Floor | None:
    return FLOORS.get(effect) or FOREIGN_FLOORS.get(effect) or CHANGE_FLOORS.get(effect)


def _shares(amounts: Sequence[float]) -> tuple[float, ...]:
    """Return the share of each of a sum; equal ones where nothing shows of any."""
    total = sum(amounts)
    return tuple(amount / total if total else 1.0 / len(amounts) for amount in amounts)


def _exact_sensors(n: int, rng: np.random.Generator) -> RealisticSensors:
    """Draw sensors of a laboratory: half of them with noisy, quantised encoders and jittered
    stamps."""
    noise = (NOISE,) * n
    if rng.random() < 0.5:
        return RealisticSensors(noise, None, IDEAL_BITS, IDEAL_BITS, velocity=MEASURED, jitter=0.0)
    return RealisticSensors(
        noise,
        link_bits=int(rng.integers(20, 24)),
        encoder_noise=float(10 ** rng.uniform(-6, -5)),
        velocity=MEASURED,
        jitter=float(rng.choice([0.0, 2e-5])),
    )


def _sensors(level: Level, sides: str, sizes: Array, rng: np.random.Generator) -> RealisticSensors:
    return RealisticSensors(
        torque_noise=tuple((NOISE * sizes * np.exp(rng.uniform(-0.4, 0.4))).tolist()),
        corner=None if level.corner is None else float(np.exp(rng.uniform(*np.log(level.corner)))),
        velocity=str(rng.choice([MISSING, DIFFERENCED, MEASURED])),
        apart=sides == BOTH and bool(rng.choice([False, True])),
        rate=float(rng.choice(level.rates)),
        sides=sides,
        drift=float(rng.uniform(0.0, level.drift)),
        lost=float(rng.uniform(0.0, level.lost)) if rng.random() < 0.5 else 0.0,
    )


def _warming(joint: int, level: Level, rng: np.random.Generator) -> Fault:
    return Fault(
        "thermal_friction", joint, {"change": float(rng.uniform(-level.warming, level.warming))}
    )


def _as_described(real: Robot, description: Robot, fault: Fault) -> Robot:
    """Return an arm that is as described in what an effect changes, so that the effect is the whole
    difference."""
    if fault.joint is None:
        return real
    joint = real.joints[fault.joint]
    stated = description.joints[fault.joint]
    gear = joint.transmission
    assert gear is not None and stated.transmission is not None
    if fault.effect == "link_inertia_mismatch":
        joint = replace(joint, link=stated.link)
    elif fault.effect == "rotor_inertia_mismatch":
        parts: dict[str, Any] = {
            name: part for name, (part, _) in stated.transmission.components.items()
        }
        joint = replace(joint, transmission=replace(gear, **parts))
    elif fault.effect in ("stiffness_mismatch", "damping_mismatch"):
        what = fault.effect.removesuffix("_mismatch")
        number = {what: getattr(stated.transmission, what)}
        joint = replace(joint, transmission=replace(gear, **number))
    joints = list(real.joints)
    joints[fault.joint] = joint
    return real.with_(joints=tuple(joints))


def _numbers(real: Robot, description: Robot) -> tuple[tuple[str, int, float], ...]:
    """Return what an arm's numbers are of those described: ratios, and distances of centres of
    mass, m."""
    found: list[tuple[str, int, float]] = []
    for j, (joint, stated) in enumerate(zip(real.joints, description.joints, strict=True)):
        own = joint.transmission
        given = stated.transmission
        assert own is not None and given is not None
        found.append(("link_mass", j, joint.link.mass / stated.link.mass))
        shift = np.asarray(joint.link.com) - np.asarray(stated.link.com)
        found += [
            (f"link_com_{axis}", j, float(value)) for axis, value in zip("xyz", shift, strict=True)
        ]
        found.append(("rotor_inertia", j, own.rotor.izz / given.rotor.izz))
        found += [
            (what, j, getattr(own, what) / getattr(given, what))
            for what in ("stiffness", "damping")
        ]
    return tuple(found)


def _write_description(folder: Path, name: str, robot: Robot, *, urdf: bool) -> None:
    """Write an arm as an arm file, or as a URDF with gravity and drives in an overlay."""
    path = folder / f"{name}.yaml"
    if not urdf:
        save_robot(robot, path)
        return
    write_result(path.with_suffix(".urdf"), to_urdf(without_drives(robot)))
    fields = (
        "rotor",
        "wave_generator",
        "spline",
        "stiffness",
        "damping",
        "belt_ratio",
        "harmonic_drive_ratio",
    )
    stated = robot_to_dict(robot)["joints"]
    overlay = {
        "urdf": f"{name}.urdf",
        "gravity": [float(g) for g in robot.gravity],
        "transmissions": {
            joint["name"]: {k: joint[k] for k in (*fields, "bearing")} for joint in stated
        },
    }
    write_result(path, yaml.safe_dump(overlay, sort_keys=False))
