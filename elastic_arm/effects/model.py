"""What an effect is.

An effect is one thing: a law, its parameters, its words. The law says what it adds to the three residuals of a joint
(:class:`~elastic_arm.effects.motion.Contribution`) as an expression; the simulator adds the same expression to the
equations of motion. What differs between kinds of effects is only how they enter a simulated arm:

- :class:`Effect`: through its law, in the equations;
- :class:`SensorEffect`: in what the sensors make of the truth;
- :class:`StructuralEffect`: by what the arm is made of.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

import casadi as ca

from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.errors import EffectError
from elastic_arm.robot import Robot
from elastic_arm.sensors import Sensors

Value = float | tuple[float, ...] | tuple[str, ...] | str
Law = Callable[[SymbolicMotion, int, Mapping[str, Any]], Contribution]


class Role(Enum):
    """How the diagnosis gets at a parameter.

    LINEAR: its column is the law's derivative at no effect. PHASE: with the linear parameter named first, the law is
    linear in (amplitude cos phase, amplitude sin phase). SEARCHED: only by trying values.
    """

    LINEAR = "linear"
    PHASE = "phase"
    SEARCHED = "searched"


class Scope(Enum):
    """On which joints an effect can sit."""

    EACH = "each joint"
    LAST = "the last joint"
    ARM = "the whole arm"
    EACH_OR_ARM = "each joint, or all alike"


@dataclass(frozen=True)
class Parameter:
    """A number in a law.

    Parameters
    ----------
    name, unit, meaning
        As in `diagnosis.json`; what it is, in a few words.
    low, high
        Plausible range: what an engineer would believe of an industrial arm.
    role
        How it is found.
    neutral
        Its value for no effect; None where the effect vanishes through another parameter alone.
    default
        Taken when it is not given; None where it must be.
    size
        Number of components: 3 for a vector.
    above
        Physical bound: values must be larger.
    least
        What a real arm has at least: who states the effect may not go below it. A fit may, and so shows that the
        nominal arm has too much of it.
    from_coefficient
        Exact value for the coefficient of its column; None for `neutral + coefficient`.
    """

    name: str
    unit: str
    low: float
    high: float
    role: Role = Role.LINEAR
    neutral: float | None = None
    default: float | tuple[float, ...] | None = None
    meaning: str = ""
    size: int = 1
    above: float = -math.inf
    least: float = -math.inf
    from_coefficient: Callable[[float], float] | None = None

    def value_of(self, coefficient: float) -> float:
        """Return the parameter's value for the coefficient that a fit gave its column."""
        if self.from_coefficient is not None:
            return self.from_coefficient(coefficient)
        return (self.neutral or 0.0) + coefficient

    def checked(self, value: Any, of: str) -> float | tuple[float, ...]:
        """Return `value` as a number, or a tuple of them for a vector; EffectError where it makes no sense."""
        numbers = tuple(value) if isinstance(value, list | tuple) else (value,)
        what = "a number" if self.size == 1 else f"{self.size} numbers"
        unit = f" in {self.unit}" if self.unit != "1" else ""
        try:
            numbers = tuple(float(v) for v in numbers)
        except (TypeError, ValueError):
            numbers = ()
        if len(numbers) != self.size or not all(math.isfinite(v) for v in numbers):
            raise EffectError(f"{of}: {self.name} is {value!r}", f"Give {what}{unit}.")
        if any(v <= self.above for v in numbers):
            raise EffectError(f"{of}: {self.name} is {value!r}", f"It must be above {self.above:g}{unit}.")
        return numbers[0] if self.size == 1 else numbers


@dataclass(frozen=True)
class Choice:
    """Something about an effect that is no number: the side it acts on, the channels it delays."""

    name: str
    values: tuple[str, ...]
    default: str | tuple[str, ...]
    several: bool = False

    def checked(self, value: Any, of: str) -> str | tuple[str, ...]:
        """Return the choice, a tuple where several may be made; EffectError where there is no such choice."""
        chosen = (value,) if isinstance(value, str) else tuple(value)
        wrong = [v for v in chosen if v not in self.values]
        if wrong or not chosen or (len(chosen) > 1 and not self.several):
            raise EffectError(f"{of}: {self.name} is {value!r}", f"Choose {self._offer()}.")
        return tuple(v for v in self.values if v in chosen) if self.several else chosen[0]

    def combinations(self) -> Iterator[str | tuple[str, ...]]:
        """Return the single choices, and all together where several may be made."""
        for value in self.values:
            yield (value,) if self.several else value
        if self.several:
            yield self.values

    def _offer(self) -> str:
        return ("any of " if self.several else "one of ") + ", ".join(self.values)


@dataclass(frozen=True)
class Confusion:
    """Another effect that a recording may not tell from this one: when, and which motion would."""

    effect: str
    when: str
    separated_by: str


@dataclass(frozen=True)
class Plant:
    """An arm about to be simulated, as effects find and change it.

    Parameters
    ----------
    robot, sensors
        The true arm and its sensors.
    bearings
        Whether its bearings tilt.
    laws
        Effects whose laws enter the equations.
    """

    robot: Robot
    sensors: Sensors
    bearings: bool = False
    laws: tuple[EffectInstance, ...] = ()


@dataclass(frozen=True)
class Effect:
    """An effect that acts through its law.

    Parameters
    ----------
    id
        As in the contract.
    formula
        The law as text.
    description
        What it is.
    signature
        What an engineer sees of it in a recording.
    law
        (motion, joint index, parameters and internal states by name) -> contribution.
    parameters, choices
        Its numbers, and what else has to be said.
    scope, sides, regime
        Where it shows.
    states
        Names of internal states; all start at zero.
    twist
        For a transmission error: (motion, joint index, parameters) -> e(theta) and its rate, which all laws of the
        joint then find in the deflection.
    confusions
        What it may be mistaken for.
    """

    id: str
    formula: str
    description: str
    signature: str
    law: Law
    parameters: tuple[Parameter, ...] = ()
    choices: tuple[Choice, ...] = ()
    scope: Scope = Scope.EACH
    sides: tuple[str, ...] = ()
    regime: str = "always"
    states: tuple[str, ...] = ()
    twist: Callable[[SymbolicMotion, int, Mapping[str, Any]], tuple[ca.SX, ca.SX]] | None = None
    sides_of: Callable[[Mapping[str, Any]], tuple[str, ...]] | None = None
    confusions: tuple[Confusion, ...] = ()

    def parameter(self, name: str) -> Parameter:
        """Return a parameter by name."""
        return next(p for p in self.parameters if p.name == name)

    @property
    def entries(self) -> tuple[Parameter | Choice, ...]:
        """All parameters and choices."""
        return (*self.parameters, *self.choices)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters and choices."""
        return tuple(entry.name for entry in self.entries)

    def enter(self, stage: Plant, active: EffectInstance) -> Plant:
        """Return the arm with the effect in it."""
        return replace(stage, laws=(*stage.laws, active))

    def candidates(self, robot: Robot) -> Iterator[EffectInstance]:
        """Return the effect at every place and in every choice, at no effect where it has such a value.

        Parameters without a neutral value stand at their default, or in the middle of their plausible range.
        """
        joints: list[str | None] = list(robot.joint_names)
        if self.scope is Scope.LAST:
            joints = joints[-1:]
        elif self.scope is Scope.ARM:
            joints = [None]
        elif self.scope is Scope.EACH_OR_ARM:
            joints = [None, *joints]
        for joint in joints:
            for chosen in _combinations(self.choices):
                yield EffectInstance(self, joint, {**{p.name: _start(p) for p in self.parameters}, **chosen})


@dataclass(frozen=True)
class SensorEffect(Effect):
    """An effect of what the sensors record; its law is written in recorded channels.

    Parameters
    ----------
    change
        (sensors, joint index, n, parameters) -> sensors.
    """

    change: Callable[[Sensors, int, int, Mapping[str, Any]], Sensors] = field(kw_only=True)

    def enter(self, stage: Plant, active: EffectInstance) -> Plant:
        """Return the arm with its sensors changed."""
        sensors, n = stage.sensors, stage.robot.n
        for i in active.joint_indices(stage.robot):
            sensors = self.change(sensors, i, n, active.parameters)
        return replace(stage, sensors=sensors)


@dataclass(frozen=True)
class StructuralEffect(Effect):
    """An effect of what the arm is made of.

    Parameters
    ----------
    change
        (stage, parameters) -> stage.
    """

    change: Callable[[Plant, Mapping[str, Any]], Plant] = field(kw_only=True)

    def enter(self, stage: Plant, active: EffectInstance) -> Plant:
        """Return the arm with its parts changed."""
        return self.change(stage, active.parameters)


@dataclass(frozen=True)
class EffectInstance:
    """An effect on an arm.

    Parameters
    ----------
    effect
        What acts.
    joint
        Name of the joint; None for the whole arm.
    parameters
        Every parameter and choice by name; those with a default may be left out.

    Raises
    ------
    EffectError
        If a parameter is unknown, missing, or makes no sense.
    """

    effect: Effect
    joint: str | None
    parameters: Mapping[str, Value] = field(default_factory=dict)

    def __post_init__(self) -> None:
        effect, given = self.effect, dict(self.parameters)
        unknown = [name for name in given if name not in effect.names]
        if unknown:
            valid = ", ".join(effect.names) or "none: it has no free parameter"
            raise EffectError(f"{effect.id} has no parameter {unknown[0]!r}", f"Its parameters: {valid}.")
        values: dict[str, Value] = {}
        for entry in effect.entries:
            value = given.get(entry.name, entry.default)
            if value is None:
                raise EffectError(
                    f"{effect.id} lacks its parameter {entry.name}",
                    f"Write it as {effect.id}:JOINT:{entry.name}=VALUE.",
                )
            values[entry.name] = entry.checked(value, effect.id)
        object.__setattr__(self, "parameters", values)

    @property
    def sides(self) -> tuple[str, ...]:
        """The equations in which it shows."""
        return self.effect.sides_of(self.parameters) if self.effect.sides_of else self.effect.sides

    @property
    def numbers(self) -> dict[str, Any]:
        """The parameters that are numbers."""
        return {p.name: self.parameters[p.name] for p in self.effect.parameters}

    def joint_indices(self, robot: Robot) -> tuple[int, ...]:
        """Return the joints it sits on: one, or all for an effect of the whole arm.

        Raises
        ------
        EffectError
            If the robot has no such joint, or the effect cannot sit there.
        """
        scope, names = self.effect.scope, robot.joint_names
        if self.joint is None:
            if scope in (Scope.ARM, Scope.EACH_OR_ARM):
                return tuple(range(robot.n))
            if scope is Scope.LAST:
                return (robot.n - 1,)
            raise EffectError(f"{self.effect.id} needs a joint", f"Name one of {', '.join(names)}.")
        if self.joint not in names:
            raise EffectError(f"{self.effect.id}: there is no joint {self.joint!r}", f"Use one of {', '.join(names)}.")
        if scope is Scope.ARM or (scope is Scope.LAST and self.joint != names[-1]):
            raise EffectError(
                f"{self.effect.id} cannot sit on {self.joint}",
                "Name no joint: it acts on the whole arm." if scope is Scope.ARM else f"It sits on {names[-1]}.",
            )
        return (names.index(self.joint),)

    def with_parameters(self, **parameters: Value) -> EffectInstance:
        """Return the effect with these parameters changed."""
        return replace(self, parameters={**self.parameters, **parameters})

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data, as in an arm file's `effects` list."""
        plain = {k: list(v) if isinstance(v, tuple) else v for k, v in self.parameters.items()}
        return {"effect": self.effect.id, "joint": self.joint, "parameters": plain}

    def __str__(self) -> str:
        values = ",".join(f"{k}={_text(v)}" for k, v in self.parameters.items())
        return ":".join(part for part in (self.effect.id, self.joint, values) if part)


def _text(value: Value) -> str:
    if isinstance(value, tuple):
        return ("+" if isinstance(value[0], str) else "/").join(_text(v) for v in value)
    return value if isinstance(value, str) else f"{value:.9g}"


def _start(parameter: Parameter) -> Value:
    middle = math.sqrt(parameter.low * parameter.high) if parameter.low > 0 else (parameter.low + parameter.high) / 2
    return next(v for v in (parameter.default, parameter.neutral, middle) if v is not None)


def _combinations(choices: tuple[Choice, ...]) -> Iterator[dict[str, Value]]:
    if not choices:
        yield {}
        return
    for value in choices[0].combinations():
        for rest in _combinations(choices[1:]):
            yield {choices[0].name: value, **rest}
