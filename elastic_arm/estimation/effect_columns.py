"""The contribution of each effect of the catalogue to the residuals of a recording, as columns of a
regression.

A law is an expression of the catalogue. Its derivatives by the linear parameters are the columns;
nonlinear parameters are arguments of the columns and are searched.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.catalogue import Catalogue
from elastic_arm.effects.effect import ControllerEffect, Effect, EffectInstance, Scope, SensorEffect
from elastic_arm.effects.parameters import Parameter, Role
from elastic_arm.effects.regressor import Regressor
from elastic_arm.errors import EffectError
from elastic_arm.estimation.regressors import CompiledColumns, Entries, Signals, Term
from elastic_arm.robot import Robot
from elastic_arm.sensors import Sensors

WIDTHS = (1.0, 0.1)  # of the starts between which a column is taken as linear
# The channels of a recording that sensors make.
SENSED = {
    "link_encoder": "q",
    "motor_encoder": "theta",
    "joint_torque": "tau_J",
    "motor_torque": "tau_m",
}
# units of what a torque sensor reads too much: of its gain, its zero, its drift
READINGS = ("1", "Nm", "Nm/s")


Compiled = dict[tuple[type, Effect, Any], CompiledColumns]


@lru_cache(maxsize=4)
def compiled_of(robot: Robot, model: str) -> Compiled:
    """Return what was compiled of the effects of an arm in a variant of the model; of the last arms
    that were looked at."""
    return {}


@dataclass(frozen=True, eq=False)
class Feature:
    """One effect at one place in one choice, ready to be evaluated."""

    # effect, joint, choices: what, where (None for the whole arm), and which of its choices
    effect: Effect
    joint: str | None
    choices: Mapping[str, Any]
    equations: ArmEquations = field(repr=False)  # of the model that lacks it
    # the friction that it scales, where it does: effects as their laws, and the values of all their
    # parameters
    friction: tuple[tuple[Feature, tuple[float, ...]], ...] = field(default=(), repr=False)
    # what was compiled of effects, also for the arm with other numbers
    shared: Compiled = field(default_factory=dict, repr=False)

    @cached_property
    def key(self) -> tuple[str, str | None, tuple[Any, ...]]:
        """What distinguishes it from other features."""
        return self.effect.id, self.joint, tuple(sorted(self.choices.items()))

    @cached_property
    def linear(self) -> tuple[Parameter, ...]:
        """Parameters that are coefficients of columns."""
        return tuple(p for p in self.effect.parameters if p.role is Role.LINEAR)

    @cached_property
    def phase(self) -> Parameter | None:
        """The phase beside the first linear parameter, if there is one."""
        return next((p for p in self.effect.parameters if p.role is Role.PHASE), None)

    @cached_property
    def searched(self) -> tuple[Parameter, ...]:
        """Parameters that are arguments of the columns."""
        return tuple(p for p in self.effect.parameters if p.role is Role.SEARCHED)

    @property
    def fixed(self) -> bool:
        """Whether the coefficient of its one column is 1: no parameter acts linearly."""
        return not self.linear

    @property
    def count(self) -> int:
        """Number of columns."""
        if self.phase:
            return 2
        return 1 if self.fixed else sum(p.size for p in self.linear)

    def unit(self, parameter: Parameter) -> str:
        """Return the unit of one of its parameters at its joint."""
        return parameter.unit_at(self.joint, self.equations.robot.units)

    @property
    def sides(self) -> tuple[str, ...]:
        """The equations in which it shows."""
        return self.effect.sides_of(self.choices) if self.effect.sides_of else self.effect.sides

    @cached_property
    def sensed(self) -> frozenset[str]:
        """The channels that a sensor's effect changes; none for an effect of the arm.

        A link encoder is seen beside the motor encoder.
        """
        if isinstance(self.effect, ControllerEffect):
            return frozenset({"r"})
        if not isinstance(self.effect, SensorEffect):
            return frozenset()
        found = _changed_channels(self.effect, self.joint, self.choices, self.equations.robot.n)
        return frozenset(found | ({"theta"} if "q" in found else set()))

    @property
    def read_torque(self) -> str | None:
        """The torque channel whose reading it shifts, as a wrong zero does, or None."""
        first = next((p.unit for p in self.effect.parameters if p.role is Role.LINEAR), None)
        added = self.joint is not None and first in READINGS
        return next(iter(self.sensed & {"tau_J", "tau_m"}), None) if added else None

    @cached_property
    def _compiled(self) -> CompiledColumns:
        kind = type(self), self.effect, self.key
        known = self.shared[kind].at(self.equations) if kind in self.shared else None
        if known is None:
            self.shared[kind] = known = self._compile()
        return known

    def _compile(self) -> CompiledColumns:
        joints = [self._joint] if self._joint is not None else range(self.equations.robot.n)
        term = Term(self.effect, joints, self.choices, self.linear, self._points, self.searched)
        return CompiledColumns([term], self.equations)

    @property
    def _joint(self) -> int | None:
        """Index of the joint at which the law is evaluated; None for all, one after the other."""
        robot = self.equations.robot
        if self.joint is not None:
            return robot.joint_names.index(self.joint)
        return None if self.effect.scope is Scope.EACH_OR_ARM else robot.n - 1

    @property
    def _points(self) -> list[dict[str, Any]]:
        """Parameters at which the law is differentiated: for a sine and a cosine at two phases."""
        neutral = {
            p.name: np.full(p.size, p.neutral if p.neutral is not None else p.default)
            for p in self.linear
        }
        return (
            [neutral]
            if self.phase is None
            else [{**neutral, self.phase.name: phi} for phi in (0.0, np.pi / 2)]
        )

    @property
    def quadratic(self) -> bool:
        """Whether its columns are polynomials of second degree in several searched numbers."""
        return self._compiled.quadratic

    @property
    def bends(self) -> bool:
        """Whether its law is not linear in its sizes, so that columns are of first order."""
        return (
            bool(self.linear)
            and self.phase is None
            and (self.effect.regressor is not None or self._compiled.bends)
        )

    @property
    def acts(self) -> bool:
        """Whether the law adds anything to the residuals of this model."""
        try:
            return self._compiled.acts
        except EffectError:
            return False

    @property
    def rows(self) -> list[int]:
        """Which residuals, of link, drive and motor side of all joints, its law adds to."""
        return np.unique(self._compiled.places % (3 * self.equations.robot.n)).tolist()

    @property
    def follows_load(self) -> bool:
        """Whether its law takes the deflection under the load.

        The drive carries a part of the load by this law.
        """
        return self._compiled.follows_load

    @property
    def of_motion(self) -> bool:
        """Whether its columns follow from the motion alone, whatever the numbers of the arm."""
        if self.friction or self.read_torque is not None:
            return False
        return self._compiled.of_motion

    def columns(
        self, signals: Signals, searched: Sequence[float] = (), start: float = 0.0
    ) -> Array:
        """Evaluate the columns (N, 3 n, count).

        start: of all internal states, where the motion before the first sample is not known.
        """
        return self.entries(signals, searched, start).dense()

    def entries(
        self, signals: Signals, searched: Sequence[float] = (), start: float = 0.0
    ) -> Entries:
        """Evaluate the entries of the columns that are not null.

        start: of all internal states, where the motion before the first sample is not known.
        """
        return self._compiled.entries(self._with_friction(signals), searched, start)

    def entries_at(
        self, signals: Signals, points: Sequence[Sequence[float]], starts: Sequence[float]
    ) -> Entries:
        """Return those at several points of the searched numbers, side by side.

        starts: of all internal states, one a point.
        """
        if self.effect.states:
            each = zip(points, starts, strict=True)
            return Entries.side_by_side([self.entries(signals, *one) for one in each])
        return self._compiled.entries_at(self._with_friction(signals), points)

    def _with_friction(self, signals: Signals) -> Signals:
        """Return the signals with the friction that it scales."""
        if not self.friction:
            return signals
        torques = sum(
            feature.entries(signals, values).weighted(np.ones(1))
            for feature, values in self.friction
        )
        link, _, motor = np.split(torques, 3, axis=1)
        return signals.with_friction(link, motor)

    def parameters(
        self, coefficients: Sequence[float], searched: Sequence[float] = ()
    ) -> dict[str, Any]:
        """Return the effect's parameters for the coefficients of its columns."""
        found = {}
        if self.phase is not None:
            sine, cosine = coefficients
            found[self.linear[0].name] = float(np.hypot(sine, cosine))
            found[self.phase.name] = float(np.arctan2(cosine, sine))
        else:
            found |= _spread(self.linear, coefficients, lambda p, c: p.value_of(c))
        return found | _spread(self.searched, searched, lambda p, c: c)

    def whole(self) -> Feature:
        """Return the feature whose column is the effect itself: its regressor, or its law."""
        kind = Whole if self.effect.regressor is None else OwnRegressor
        return kind(
            self.effect, self.joint, self.choices, self.equations, self.friction, self.shared
        )

    @property
    def by_size(self) -> Feature:
        """The feature whose columns are derivatives by the sizes.

        It is itself, or the feature of which it is the whole.
        """
        return self

    def at(self, equations: ArmEquations) -> Feature:
        """Return the feature of the same arm with other numbers; its columns stay compiled."""
        return replace(self, equations=equations)

    def scales(self, other: Feature) -> bool:
        """Whether another effect is friction that this one scales."""
        alike = self.joint == other.joint and set(self.sides) & set(other.sides)
        return self.effect.scales_friction and other.effect.friction and bool(alike)


@dataclass(frozen=True, eq=False)
class Whole(Feature):
    """A feature whose one column is the law itself, at given values of all its parameters."""

    def whole(self) -> Feature:
        """Return itself."""
        return self

    @property
    def by_size(self) -> Feature:
        """The feature of which it is the whole."""
        return Feature(
            self.effect, self.joint, self.choices, self.equations, self.friction, self.shared
        )

    @cached_property
    def linear(self) -> tuple[Parameter, ...]:
        """None: all are arguments."""
        return ()

    @cached_property
    def phase(self) -> Parameter | None:
        """None: it is an argument too."""
        return None

    @cached_property
    def searched(self) -> tuple[Parameter, ...]:
        """All parameters."""
        return self.effect.parameters


@dataclass(frozen=True, eq=False)
class OwnRegressor(Whole):
    """A whole effect by the regressor of its file; at given parameters its size is known."""

    @cached_property
    def _regressor(self) -> Regressor:
        assert self.effect.regressor is not None
        return self.effect.regressor(self.equations)

    @property
    def quadratic(self) -> bool:
        """False: nothing is known of its regressor."""
        return False

    @property
    def of_motion(self) -> bool:
        """False, for the same reason."""
        return False

    @property
    def acts(self) -> bool:
        """Whether the arm has what the effect acts in."""
        return self._regressor.acts

    def entries(
        self, signals: Signals, searched: Sequence[float] = (), start: float = 0.0
    ) -> Entries:
        """Return what the effect adds to the residuals, as entries of one column."""
        robot = self.equations.robot
        joints = range(robot.n) if self.joint is None else [robot.joint_names.index(self.joint)]
        values = {**self.choices, **self.parameters((), searched), "joints": joints}
        return Entries.of(self._regressor.residuals(signals, values)[:, :, None])

    def entries_at(
        self, signals: Signals, points: Sequence[Sequence[float]], starts: Sequence[float]
    ) -> Entries:
        """Return those at several values of its parameters, side by side."""
        return Entries.side_by_side([self.entries(signals, point) for point in points])


def _changed_channels(
    effect: SensorEffect, joint: str | None, choices: Mapping[str, Any], n: int
) -> set[str]:
    """Return the channels whose sensors an effect changes."""
    exact = Sensors.exact()
    parameters = {p.name: _some_effect(p) for p in effect.parameters}
    changed = effect.change(
        exact, 0, n, EffectInstance(effect, joint, {**parameters, **choices}).parameters
    )
    return {
        channel
        for name, channel in SENSED.items()
        if getattr(changed, name) != getattr(exact, name)
    }


def torque_zeros(catalogue: Catalogue, robot: Robot) -> dict[str, str]:
    """Return "tau_J", "tau_m" -> the id of the effect that is a wrong zero of that channel."""
    found: dict[str, str] = {}
    for effect in catalogue.values():
        if (
            isinstance(effect, SensorEffect)
            and not effect.choices
            and effect.parameters[0].unit == "Nm"
        ):
            found |= dict.fromkeys(
                _changed_channels(effect, robot.joint_names[0], {}, robot.n), effect.id
            )
    return found


def _some_effect(parameter: Parameter) -> float | tuple[float, ...]:
    """Return a value that is not the one of no effect."""
    start = parameter.start()
    if parameter.neutral is None:
        return start
    return tuple(v + 1e-3 for v in start) if isinstance(start, tuple) else parameter.value_of(1e-3)


def has_columns(effect: Effect) -> bool:
    """Whether parameters of an effect act linearly, so that derivatives of its law are columns."""
    return any(p.role is not Role.SEARCHED for p in effect.parameters)


def _spread(
    parameters: Sequence[Parameter], values: Sequence[float], convert: Any
) -> dict[str, Any]:
    found = {}
    k = 0
    for p in parameters:
        part = [float(convert(p, float(v))) for v in values[k : k + p.size]]
        found[p.name] = part[0] if p.size == 1 else tuple(part)
        k += p.size
    return found


def starting_state(residual: Array, columns: Callable[[float], Array], size: float | None) -> float:
    """Return where internal states begin, by least squares on what a stretch leaves of the model.

    Gauss-Newton steps, beside a constant in each residual. What is left counts as noise, of which
    few samples are independent; a start is expected near zero.

    residual: (N, R) Nm; columns: start -> columns (N, R, k) with all states beginning there; size:
    coefficient of the first column; None for the one that fits best.
    """
    start = 0.0
    prior = 0.0
    for width in WIDTHS:
        low = max(-1.0, start - width)
        high = min(1.0, start + width)
        lowest = columns(low)[:, :, 0]
        highest = columns(high)[:, :, 0]
        between = 0.5 * (lowest + highest)
        change = (highest - lowest) / (high - low)
        if size is None:
            size = _scale(residual, between)
        rows = np.flatnonzero(np.abs(change).max(axis=0) > 1e-9 * np.abs(between).max())
        left, change = (
            v[:, rows] - v[:, rows].mean(axis=0) for v in (residual - size * between, size * change)
        )
        power = float(np.sum(change**2))
        if power == 0.0:
            return start
        # 0.5 is the standard deviation of an internal state, which stays within -1 and 1, where a
        # recording begins 20.0 samples of a residual's misfit that count as one independent one
        prior = 20.0 * float(np.mean(left**2)) / 0.5**2
        step = (float(np.sum(change * left)) - prior * (low + high) / 2) / (power + prior)
        start = float(np.clip((low + high) / 2 + step, -1.0, 1.0))
    return start


def _scale(residual: Array, column: Array) -> float:
    """Return the coefficient of a column (N, R) that fits residuals (N, R) best, beside a constant
    in each."""
    column = column - column.mean(axis=0)
    return float(np.sum(column * residual)) / max(float(np.sum(column**2)), 1e-300)
