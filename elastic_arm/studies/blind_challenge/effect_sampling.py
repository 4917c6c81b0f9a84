"""Random effects of the challenge: place, form and size.

Effects of a catalogue are drawn from the ranges in their files, others from the forms below.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_arm.effects import Catalogue, Effect, EffectInstance, Parameter, Role, Scope
from elastic_arm.effects.effect import MODELS
from elastic_arm.robot import Robot
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault, variation
from elastic_arm.studies.blind_challenge.hidden_arms.further_laws import FOREIGN

COMMON = 0.25  # share of effects of one joint or all that all joints have


def model_of(effects: Sequence[str], catalogue: Catalogue) -> str:
    """Return the model against which an arm with these effects is diagnosed.

    It is the richest that lacks one of them.
    """
    lacking = (catalogue[e].lacked_by for e in effects if e in catalogue)
    return next((models[-1] for models in lacking if models != MODELS), MODELS[-1])


def combines(effect: Effect) -> bool:
    """Whether an effect can be as small as one likes: it has a value of no effect."""
    return bool(effect.magnitude) and effect.parameter(effect.magnitude[0]).neutral is not None


def true_parameters(fault: Fault, effect: Effect) -> dict[str, Any]:
    """Return a fault's parameters as the effect's file names them, vectors whole.

    Nothing of the engine's own.
    """
    found = {}
    for p in effect.parameters:
        names = p.component_names
        if all(name in fault.parameters for name in names):
            values = tuple(fault.parameters[name] for name in names)
            found[p.name] = values[0] if p.size == 1 else values
    return found


def instance_of(fault: Fault, effect: Effect, robot: Robot) -> EffectInstance:
    """Return a fault as the suite's own simulator takes it."""
    given = {"side": fault.side, "channels": fault.channels, **fault.choices}
    chosen = {c.name: given[c.name] for c in effect.choices if given.get(c.name)}
    joint = None if fault.joint is None else robot.joint_names[fault.joint]
    return EffectInstance(effect, joint, {**true_parameters(fault, effect), **chosen})


@dataclass(frozen=True)
class SampledEffect:
    """An effect without its size."""

    effect: Effect  # what
    fault: Fault  # with all its parameters but the size
    # of the size's components, of length 1; a sign where the size is one number
    direction: tuple[float, ...]

    @property
    def _size(self) -> Parameter:
        return self.effect.parameter(self.effect.magnitude[0])

    def sized(self, amount: float) -> Fault:
        """Return the effect with so much of it, 0 for none."""
        sizes = [self.effect.parameter(name) for name in self.effect.magnitude]
        components = [(name, p) for p in sizes for name in p.component_names]
        values = {
            name: 1.0 / amount if p.inverse else (p.neutral or 0.0) + part * amount
            for (name, p), part in zip(components, self.direction, strict=True)
        }
        return replace(
            self.fault,
            parameters={k: float(v) for k, v in {**values, **self.fault.parameters}.items()},
        )

    def limits(self) -> tuple[float, float]:
        """Return the smallest and largest plausible amount."""
        p = self._size
        neutral = self._size.neutral or 0.0
        if p.inverse:
            low, high = p.draw or (p.low, p.high)
            return 1.0 / high, 1.0 / low
        if p.draw is not None:
            return abs(p.draw[0] - neutral), abs(p.draw[1] - neutral)
        if neutral:
            return 1e-9, abs((p.high if self.direction[0] > 0 else p.low) - neutral)
        return (p.low if p.low > 0.0 else 1e-12), p.high

    def typical(self) -> float:
        """Return an amount to begin with."""
        low, high = self.limits()
        if self._size.neutral:
            return 0.1 * high
        return float(np.sqrt(low * high)) if low > 1e-9 else 1e-3 * high


def sample_effect(effect: Effect, n: int, rng: np.random.Generator) -> SampledEffect:
    """Draw where an effect sits, its form, and its parameters other than the size."""
    joint = (
        None
        if effect.scope in (Scope.ARM, Scope.LAST)
        else int(rng.integers(n - (effect.scope is Scope.BUT_LAST)))
    )
    if effect.scope is Scope.EACH_OR_ARM and rng.random() < COMMON:
        joint = None
    choices: dict[str, Any] = {}
    for choice in effect.choices:
        value = str(rng.choice(choice.values))
        choices[choice.name] = (value,) if choice.several else value
    direction = _direction([effect.parameter(name) for name in effect.magnitude], rng)
    others = {**_others(effect, rng), **variation(effect.id, rng)}
    side = choices.pop("side", "motor")
    channels = choices.pop("channels", ())
    return SampledEffect(
        effect, Fault(effect.id, joint, others, side, channels, choices), direction
    )


def _direction(sizes: list[Parameter], rng: np.random.Generator) -> tuple[float, ...]:
    """Draw the direction of a size: a sign where its range lies on both sides of no effect."""
    count = sum(p.size for p in sizes)
    if count == 1:
        signed = sizes[0].neutral is not None and sizes[0].low < sizes[0].neutral < sizes[0].high
        return (float(rng.choice([-1.0, 1.0])) if signed else 1.0,)
    vector = rng.standard_normal(count)
    return tuple((vector / np.linalg.norm(vector)).tolist())


def _others(effect: Effect, rng: np.random.Generator) -> dict[str, float]:
    """Draw the parameters that are not the size; those that have a default and no range to draw
    from keep it."""
    found: dict[str, float] = {}
    for p in effect.parameters:
        if p.name in effect.magnitude or (p.role is Role.LINEAR and p.draw is None):
            continue
        if p.role is not Role.PHASE and p.draw is None and p.default is not None:
            values = np.broadcast_to(np.asarray(p.default, dtype=float), p.size)
        else:
            values = _drawn(p, rng)
        found |= {name: float(v) for name, v in zip(p.component_names, values, strict=True)}
    return found


def _drawn(p: Parameter, rng: np.random.Generator) -> NDArray[np.float64]:
    low, high = p.draw or (p.low, p.high)
    if p.integer:
        return rng.integers(int(np.ceil(low)), int(high) + 1, p.size).astype(float)
    if p.logarithmic:
        return np.exp(rng.uniform(np.log(low), np.log(high), p.size))
    return rng.uniform(low, high, p.size)


Form = Callable[[np.random.Generator, float], dict[str, float]]


def _phase(rng: np.random.Generator) -> float:
    return float(rng.uniform(-np.pi, np.pi))


def _while(rng: np.random.Generator, seconds: float) -> dict[str, float]:
    on = float(rng.uniform(0.15, 0.4) * seconds)
    return {"on": on, "off": on + float(rng.uniform(0.3, 0.5) * seconds)}


# Parameters other than the size of the effects of no catalogue, for a run of so many seconds.
FORMS: dict[str, Form] = {
    "dress_pack": lambda rng, _: {
        "rest": float(rng.uniform(-0.5, 0.5)),
        "slack": float(rng.uniform(0.1, 0.4)),
    },
    "periodic_disturbance": lambda rng, _: {
        "rate": 2 * np.pi * float(rng.uniform(0.3, 3.0)),
        "phase": _phase(rng),
    },
    "loose_payload": lambda rng, _: {
        "phase": _phase(rng),
        "relaxation": float(rng.uniform(0.05, 0.3)),
    },
    "cogging_cable": lambda rng, _: {"rate": float(rng.uniform(8, 25)), "phase": _phase(rng)},
    "gear_creep": lambda rng, _: {"relaxation": float(rng.uniform(0.5, 4.0))},
    "worn_zone": lambda rng, _: {
        "place": float(rng.uniform(-0.6, 0.6)),
        "width": float(rng.uniform(0.1, 0.3)),
    },
    "dragging_brake": _while,
}


def sample_foreign(effect: str, n: int, seconds: float, rng: np.random.Generator) -> Fault:
    """Draw where an effect of no catalogue sits, and its parameters other than the size."""
    joint = n - 1 if effect == "loose_payload" else int(rng.integers(n))
    return Fault(effect, joint, FORMS.get(effect, lambda *_: {})(rng, seconds))


def sized_foreign(fault: Fault, amount: float, peak: Callable[[], NDArray[np.float64]]) -> Fault:
    """Return an effect of no catalogue of that size.

    A drive saturates below the largest torques (n,) of peak.
    """
    size = {FOREIGN[fault.effect]: float(amount)}
    if fault.effect == "saturating_drive":
        size["limit"] = float((1.0 - amount) * peak()[fault.joint or 0])
    return replace(fault, parameters={**fault.parameters, **size})
