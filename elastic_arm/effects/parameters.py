"""The parameters of an effect: numbers with unit and plausible range, and choices."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Any, Literal

from elastic_arm.errors import EffectError
from elastic_arm.formatting import JointUnits


class Role(Enum):
    """How the diagnosis gets at a parameter.

    LINEAR: its column is the law's derivative at no effect. PHASE: with the linear parameter named
    first, the law is linear in (amplitude cos phase, amplitude sin phase). SEARCHED: only by trying
    values.
    """

    LINEAR = "linear"
    PHASE = "phase"
    SEARCHED = "searched"


class Scale(Enum):
    """Whether a parameter's values are at equal distances or at equal ratios."""

    LINEAR = "linear"
    LOG = "log"


@dataclass(frozen=True)
class Parameter:
    """A number in a law; an EffectError if its entries contradict each other."""

    # name, unit, meaning: as in `diagnosis.json` ("1" for a ratio); what it is, in a few words
    name: str
    unit: str
    # low, high: plausible range: what an engineer would believe of an industrial arm
    low: float
    high: float
    role: Role = Role.LINEAR  # how it is found
    # its value for no effect; None where the effect vanishes through another parameter alone
    neutral: float | None = None
    default: float | tuple[float, ...] | None = (
        None  # taken when it is not given; None where it must be
    )
    meaning: str = ""
    size: int = 1  # number of components: 3 for a vector
    above: float = -math.inf  # physical bound: values must be larger
    # what a real arm has at least: who states the effect may not go below it. A fit may, and so
    # shows that the nominal arm has too much of it
    least: float = -math.inf
    # exact value for the coefficient of its column; None for `neutral + coefficient`
    from_coefficient: Callable[[float], float] | None = None
    # whether it is a whole number, such as a number of waves a turn: whole values are tried, and
    # none between
    integer: bool = False
    scale: Scale | None = (
        None  # of the values tried; None for LOG where the whole range is positive, else LINEAR
    )
    tried: int = (
        7  # how many values of it alone are tried first: more where the law changes fast with it
    )
    inverse: bool = (
        False  # whether the effect grows as the value falls, as the stiffness of what gives way
    )
    # range from which the blind challenge draws it; None for the default, or the plausible range
    # without one
    draw: tuple[float, float] | None = None
    # what of the joint's motion bounds it, whatever the arm does: how far its "deflection", or the
    # "error" of its controller, is for the most part, the "torque" that it takes, or nothing
    bounded_by: Literal["", "deflection", "error", "torque"] = ""

    def __post_init__(self) -> None:
        self._check_range()
        if self.scale is Scale.LOG and self.low <= 0.0:
            raise self._wrong(
                f"its scale is logarithmic, but its range starts at {self.low:g}",
                "Use Scale.LINEAR.",
            )
        if self.scale is None:
            object.__setattr__(self, "scale", Scale.LOG if self.low > 0.0 else Scale.LINEAR)
        if self.integer and (self.role is not Role.SEARCHED or self.size != 1):
            raise self._wrong(
                "an integer can only be searched", "Give it role=Role.SEARCHED and size=1."
            )
        if self.role is Role.PHASE and self.size != 1:
            raise self._wrong("a phase is a single number", "Set its size to 1.")
        if self.role is Role.LINEAR and self.neutral is None and self.default is None:
            raise self._wrong(
                "it is linear but has no value of no effect", "Give neutral, usually 0.0."
            )
        if self.default is not None:
            self.checked(self.default, "the default")

    def _check_range(self) -> None:
        if not self.name.isidentifier():
            raise EffectError(
                f"a parameter is named {self.name!r}",
                "Use a valid variable name: letters, digits, _.",
            )
        if self.size < 1:
            raise self._wrong(f"it has {self.size} components", "Give a size of at least 1.")
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise self._wrong(
                f"its range is {self.low:g} to {self.high:g}",
                "Give a finite low below a finite high.",
            )
        if self.above >= self.high:
            raise self._wrong(
                f"it must be above {self.above:g}, which is the end of its range", "Lower `above`."
            )
        if self.draw is not None and not self.draw[0] <= self.draw[1]:
            raise self._wrong(
                f"draw is {self.draw[0]:g} to {self.draw[1]:g}", "Give the lower end first."
            )

    def _wrong(self, problem: str, remedy: str) -> EffectError:
        return EffectError(f"parameter {self.name}: {problem}", remedy)

    @property
    def logarithmic(self) -> bool:
        """Whether values are spread over its range at equal ratios."""
        return self.scale is Scale.LOG

    @property
    def component_names(self) -> list[str]:
        """Names of its components: its own, with axis or number for a vector."""
        if self.size == 1:
            return [self.name]
        return [f"{self.name}_{'xyz'[k] if self.size == 3 else k}" for k in range(self.size)]

    def unit_at(self, joint: str | None, units: JointUnits) -> str:
        """Return its unit on a joint of an arm; a phase is an angle everywhere."""
        return self.unit if self.role is Role.PHASE else units.at(joint, self.unit)

    def start(self) -> float | tuple[float, ...]:
        """Return its default, else its value of no effect, else the middle of its range."""
        middle = math.sqrt(self.low * self.high) if self.logarithmic else (self.low + self.high) / 2
        value = next(v for v in (self.default, self.neutral, middle) if v is not None)
        return (value,) * self.size if self.size > 1 and not isinstance(value, tuple) else value

    def value_of(self, coefficient: float) -> float:
        """Return the parameter's value for the coefficient that a fit gave its column."""
        if self.from_coefficient is not None:
            try:
                return self.from_coefficient(coefficient)
            except ZeroDivisionError:
                # As of the torque of a joint for which the model predicts none: all of it would be
                # the sensor's gain.
                return math.inf
        return (self.neutral or 0.0) + coefficient

    def checked(self, value: Any, of: str) -> float | tuple[float, ...]:
        """Return `value` as a number, or a tuple for a vector.

        An EffectError where it makes no sense.
        """
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
            raise EffectError(
                f"{of}: {self.name} is {value!r}", f"It must be above {self.above:g}{unit}."
            )
        return numbers[0] if self.size == 1 else numbers


@dataclass(frozen=True)
class Choice:
    """Something about an effect that is no number: the side it acts on, the channels it delays.

    Raises an EffectError if there is nothing to choose from, or the default is none of the values.
    """

    name: str
    values: tuple[str, ...]
    default: str | tuple[str, ...]
    several: bool = False

    def __post_init__(self) -> None:
        if not self.values or len(set(self.values)) < len(self.values):
            raise EffectError(
                f"choice {self.name}: its values are {self.values!r}", "Give each value once."
            )
        self.checked(self.default, "the default")

    def checked(self, value: Any, of: str) -> str | tuple[str, ...]:
        """Return the choice, a tuple where several may be made.

        An EffectError where there is no such choice.
        """
        chosen = (value,) if isinstance(value, str) else tuple(value)
        wrong = [v for v in chosen if v not in self.values]
        if wrong or not chosen or (len(chosen) > 1 and not self.several):
            offer = ("any of " if self.several else "one of ") + ", ".join(self.values)
            raise EffectError(f"{of}: {self.name} is {value!r}", f"Choose {offer}.")
        return tuple(v for v in self.values if v in chosen) if self.several else chosen[0]

    def combinations(self) -> Iterator[str | tuple[str, ...]]:
        """Return the single choices, and all together where several may be made."""
        for value in self.values:
            yield (value,) if self.several else value
        if self.several:
            yield self.values


def combinations(choices: tuple[Choice, ...]) -> Iterator[dict[str, Any]]:
    """Return every combination of choices by name."""
    if not choices:
        yield {}
        return
    for value in choices[0].combinations():
        for rest in combinations(choices[1:]):
            yield {choices[0].name: value, **rest}
