"""What the hidden arms have: motions, sensors, effects, joints and sizes, each drawn from the arm's own seed.

Sizes are multiples of the smallest that theory allows to be detected on the arm's own motion (:mod:`.detectability`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from elastic_arm.effects import EFFECTS, Catalogue
from elastic_arm.robot import Robot
from elastic_arm.studies.blind_challenge.detectability import Detectability, EffectSignal, sized
from elastic_arm.studies.blind_challenge.effect_sampling import SampledEffect, model_of, sample_effect
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from elastic_arm.studies.blind_challenge.hidden_arms.further_laws import FOREIGN
from elastic_arm.studies.blind_challenge.hidden_arms.motion import MultiSine, random_motion
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel
from elastic_arm.studies.blind_challenge.simulated_arm import arm_maker

LOWEST, HIGHEST = 10.0, 300.0  # bounds
SPREAD = 2.0  # factor by which effects on one arm may differ from their common level
LEAST_SHARE = 0.03  # of the gap that each of several effects has, where sizes allow it: the contract counts from 0.01


@dataclass(frozen=True)
class ArmSpecification:
    """One hidden arm: what is to be recorded."""

    name: str  # of its bags
    model: str  # that it will be diagnosed against
    faults: tuple[Fault, ...]  # what it has; none for a clean arm
    instruments: SensorModel  # its sensors
    multiple: tuple[float, ...] = ()  # size of each fault over its bound
    # Smallest size that could be known on its own motion, in the unit of the size; None where it has no size
    bound: tuple[float | None, ...] = ()
    share: tuple[float, ...] = ()  # what each fault alone is of the sum of all faults' excesses

    def truth(self) -> dict[str, Any]:
        """Return it as plain data."""
        return asdict(self)


@dataclass(frozen=True)
class SamplingRequest:
    """Specification of one draw."""

    name: str  # of the item
    effects: tuple[str, ...]  # their ids
    seed: tuple[int, ...]  # of all that is drawn
    seconds: tuple[float, float]  # durations of what is fitted and of what judges
    ratio: tuple[float, float] = (LOWEST, HIGHEST)  # range of sizes over their bounds

    @property
    def of_catalogue(self) -> tuple[str, ...]:
        """Effects that a catalogue has."""
        return tuple(effect for effect in self.effects if effect not in FOREIGN)


def sample_arm(
    request: SamplingRequest, robot: Robot, rng: np.random.Generator, catalogue: Catalogue = EFFECTS
) -> tuple[ArmSpecification, tuple[MultiSine, MultiSine]]:
    """Draw one hidden arm and its two motions."""
    model = model_of(request.effects, catalogue)
    instruments = sample_sensors(rng)
    fitted, judging = (random_motion(rng, robot.n, s) for s in request.seconds)
    if not request.effects:
        return ArmSpecification(request.name, model, (), instruments), (fitted, judging)
    detectability = Detectability(robot, fitted, instruments, rng, arm_maker(robot, request.effects, catalogue))
    if model != "mod3":
        distance = detectability.signal((), model).distance
        faults = tuple(Fault(e, None) for e in request.effects)
        return ArmSpecification(request.name, model, faults, instruments, (distance,), (None,), (1.0,)), (
            fitted,
            judging,
        )
    drafts = [sample_effect(catalogue[effect], robot.n, rng) for effect in request.effects]
    level = np.exp(rng.uniform(*np.log(request.ratio)))
    wanted = [level * np.exp(rng.uniform(-1, 1) * np.log(SPREAD)) if len(drafts) > 1 else level for _ in drafts]
    friction, found = _friction_beside(drafts, catalogue, detectability, rng)
    if friction:
        make = arm_maker(robot, [*request.effects, *(f.effect for f in friction)], catalogue)
        detectability = Detectability(robot, fitted, instruments, rng, lambda faults: make((*friction, *faults)))
    amounts, signals = _balanced(drafts, [max(w, request.ratio[0]) for w in wanted], detectability)
    sizes = [*(f.parameters["torque"] for f in friction), *amounts]
    signals = [*found, *signals]
    item = ArmSpecification(
        request.name,
        model,
        (*friction, *(d.sized(a) for d, a in zip(drafts, amounts, strict=True))),
        instruments,
        tuple(s.distance for s in signals),
        tuple(a / s.distance for a, s in zip(sizes, signals, strict=True)),
        shares([s.excess for s in signals]),
    )
    return item, (fitted, judging)


def _friction_beside(
    drafts: Sequence[SampledEffect], catalogue: Catalogue, detectability: Detectability, rng: np.random.Generator
) -> tuple[list[Fault], list[EffectSignal]]:
    """Return the Coulomb friction that effects which scale friction need beside them, and its signals."""
    places = [(d.fault.joint, d.fault.side) for d in drafts if d.effect.scales_friction]
    taken = [(d.fault.joint, d.fault.side) for d in drafts if d.effect.friction]
    friction = []
    for joint, side in (place for place in places if place not in taken):
        size = catalogue["coulomb_friction"].parameters[0].example or (5.0, 20.0)
        friction.append(Fault("coulomb_friction", joint, {"torque": float(rng.uniform(*size))}, side))
    return friction, [detectability.signal([fault]) for fault in friction]


def _balanced(
    drafts: Sequence[SampledEffect], wanted: Sequence[float], detectability: Detectability
) -> tuple[list[float], list[EffectSignal]]:
    """Size effects; of several, enlarge those that would be lost in the gap that the others make."""
    found = [sized(draft, w, detectability) for draft, w in zip(drafts, wanted, strict=True)]
    for k, share in enumerate(shares([signal.excess for _, signal in found])):
        if share < LEAST_SHARE:
            _, signal = found[k]
            larger = signal.distance * float(np.sqrt(LEAST_SHARE / max(share, 1e-12)))
            found[k] = sized(drafts[k], larger, detectability)
    return [amount for amount, _ in found], [signal for _, signal in found]


def shares(amounts: Sequence[float]) -> tuple[float, ...]:
    """Return the share of each of a sum; equal ones where nothing shows of any."""
    total = sum(amounts)
    return tuple(amount / total if total else 1.0 / len(amounts) for amount in amounts)


def sample_sensors(rng: np.random.Generator) -> SensorModel:
    """Draw sensors: half of them with noisy, quantised encoders and jittered stamps."""
    if rng.random() < 0.5:
        return SensorModel()
    return SensorModel(
        encoder_noise=float(10 ** rng.uniform(-6, -5)),
        encoder_step=float(2 * np.pi / 2 ** rng.integers(20, 24)),
        jitter=float(rng.choice([0.0, 2e-5])),
    )
