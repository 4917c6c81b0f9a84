"""What each effect of the catalogue would add to the residuals of a recording, as columns of a regression.

A law is taken from the catalogue as an expression: its derivatives by the parameters that act linearly are the columns;
parameters that do not are arguments of the columns, and searched.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from elastic_arm.codegen import kernels
from elastic_arm.codegen.recursion import Recursion
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.effects.model import Effect, EffectInstance, Scope
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Parameter, Role
from elastic_arm.errors import EffectError
from elastic_arm.estimation.motion import CompletedMotion

Array = NDArray[np.float64]
INPUTS = ("x", "dx", "ddx", "tau_J", "tau_m", "dtau_J", "dtau_m", "sign_link", "sign_motor")


@dataclass(frozen=True)
class Signals:
    """Arguments of the laws at the recording's rate.

    Parameters
    ----------
    t
        (N,) s.
    values
        (N, …) each, by the names of :data:`INPUTS`.
    cutoff
        Hz up to which accelerations are motion rather than noise.
    """

    t: Array
    values: Mapping[str, Array]
    cutoff: float = np.inf

    @staticmethod
    def of(
        motion: CompletedMotion, standstill: tuple[Array, Array], *, elastic: bool = True, cutoff: float = np.inf
    ) -> Signals:
        """Take the signals from motion.

        Parameters
        ----------
        standstill
            (n,) rad/s for link and motor side, below which a velocity has no sign.
        elastic
            Whether the arm has transmissions; x is then [q, theta], otherwise [q].
        cutoff
            Hz up to which accelerations are motion rather than noise.
        """
        m = motion
        values = {
            "x": np.hstack([m.q, m.theta]) if elastic else m.q,
            "dx": np.hstack([m.dq, m.dtheta]) if elastic else m.dq,
            "ddx": np.hstack([m.ddq, m.ddtheta]) if elastic else m.ddq,
            "tau_J": m.tau_J,
            "tau_m": m.tau_m,
            "dtau_J": CubicSpline(m.t, m.tau_J)(m.t, 1),
            "dtau_m": CubicSpline(m.t, m.tau_m)(m.t, 1),
            "sign_link": np.tanh(m.dq / standstill[0]),
            "sign_motor": np.tanh(m.dtheta / standstill[1]),
        }
        return Signals(m.t, {name: np.ascontiguousarray(v) for name, v in values.items()}, cutoff)

    def arrays(self) -> list[Array]:
        """Return the arguments in the order of :data:`INPUTS`."""
        return [self.values[name] for name in INPUTS]


@dataclass(frozen=True, eq=False)
class Feature:
    """One effect at one place in one choice, ready to be evaluated.

    Parameters
    ----------
    effect, joint, choices
        What, where (None for the whole arm), and which of its choices.
    equations
        Of the model that lacks it.
    """

    effect: Effect
    joint: str | None
    choices: Mapping[str, Any]
    equations: ArmEquations = field(repr=False)

    @property
    def key(self) -> tuple[str, str | None, tuple[Any, ...]]:
        """What tells it from other features."""
        return self.effect.id, self.joint, tuple(sorted(self.choices.items()))

    @property
    def linear(self) -> tuple[Parameter, ...]:
        """Parameters that are coefficients of columns."""
        return tuple(p for p in self.effect.parameters if p.role is Role.LINEAR)

    @property
    def phase(self) -> Parameter | None:
        """The phase beside the first linear parameter, if there is one."""
        return next((p for p in self.effect.parameters if p.role is Role.PHASE), None)

    @property
    def searched(self) -> tuple[Parameter, ...]:
        """Parameters that are arguments of the columns."""
        return tuple(p for p in self.effect.parameters if p.role is Role.SEARCHED)

    @property
    def fixed(self) -> bool:
        """Whether the coefficient of its one column is 1: no parameter acts linearly."""
        return not self.linear

    @property
    def scalable(self) -> bool:
        """Whether a column of fixed coefficient may be scaled while its searched parameters are looked for."""
        return bool(self.searched)

    @property
    def count(self) -> int:
        """Number of columns."""
        return 2 if self.phase else (1 if self.fixed else sum(p.size for p in self.linear))

    @property
    def sides(self) -> tuple[str, ...]:
        """The equations in which it shows."""
        return self.effect.sides_of(self.choices) if self.effect.sides_of else self.effect.sides

    @cached_property
    def _law(self) -> _Compiled:
        return _compile(self)

    @property
    def acts(self) -> bool:
        """Whether the law adds anything to the residuals of this model."""
        try:
            return len(self._law.places) > 0
        except EffectError:
            return False

    def columns(self, signals: Signals, searched: Sequence[float] = ()) -> Array:
        """Evaluate the columns (N, 3 n, count) at values of the searched parameters."""
        law = self._law
        arguments = [*signals.arrays(), np.asarray(searched, dtype=float) if law.searched else np.zeros(1)]
        if law.rates is not None:
            arguments.append(law.states(signals, np.asarray(searched, dtype=float)))
        else:
            arguments.append(np.zeros((len(signals.t), 1)))
        values = law.kernel(*arguments)
        N, rows = len(signals.t), 3 * self.equations.robot.n
        out = np.zeros((N, rows * self.count))
        out[:, law.places] = values
        return out.reshape(N, self.count, rows).transpose(0, 2, 1)

    def parameters(self, coefficients: Sequence[float], searched: Sequence[float] = ()) -> dict[str, Any]:
        """Return the effect's parameters for the coefficients of its columns."""
        found: dict[str, Any] = {}
        if self.phase is not None:
            sine, cosine = coefficients
            found[self.linear[0].name] = float(np.hypot(sine, cosine))
            found[self.phase.name] = float(np.arctan2(cosine, sine))
        else:
            found |= _spread(self.linear, coefficients, lambda p, c: p.value_of(c))
        return found | _spread(self.searched, searched, lambda p, c: c)

    def whole(self) -> Feature:
        """Return the feature whose column is the law itself."""
        return Whole(self.effect, self.joint, self.choices, self.equations)

    def active(self, coefficients: Sequence[float], searched: Sequence[float] = ()) -> EffectInstance:
        """Return the effect as the simulator takes it."""
        return EffectInstance(self.effect, self.joint, {**self.parameters(coefficients, searched), **self.choices})


@dataclass(frozen=True, eq=False)
class Whole(Feature):
    """A feature whose one column is the law itself, at given values of all its parameters."""

    def whole(self) -> Feature:
        """Return itself."""
        return self

    @property
    def linear(self) -> tuple[Parameter, ...]:
        """None: all are arguments."""
        return ()

    @property
    def phase(self) -> Parameter | None:
        """None: it is an argument too."""
        return None

    @property
    def searched(self) -> tuple[Parameter, ...]:
        """All parameters."""
        return self.effect.parameters


def _spread(parameters: Sequence[Parameter], values: Sequence[float], convert: Any) -> dict[str, Any]:
    found: dict[str, Any] = {}
    k = 0
    for p in parameters:
        part = [float(convert(p, float(v))) for v in values[k : k + p.size]]
        found[p.name] = part[0] if p.size == 1 else tuple(part)
        k += p.size
    return found


@dataclass(frozen=True)
class _Compiled:
    """A law as a kernel: its entries that are not null, and where they belong."""

    kernel: kernels.Kernel
    places: NDArray[np.intp]
    searched: int
    rates: Recursion | None = None

    def states(self, signals: Signals, searched: Array) -> Array:
        """Run the internal states (N, s) over the samples, by the exponential Euler rule."""
        h = float(signals.t[1] - signals.t[0])
        stacked = np.hstack(signals.arrays())
        # Over a step the rates are those of its middle.
        stacked[:-1] = 0.5 * (stacked[:-1] + stacked[1:])
        assert self.rates is not None
        return self.rates.run(stacked, np.append(searched, h))


def _compile(feature: Feature) -> _Compiled:
    equations, effect, n = feature.equations, feature.effect, feature.equations.robot.n
    sizes = dict.fromkeys(("x", "dx", "ddx"), equations.dof)
    symbols = {name: ca.SX.sym(name, sizes.get(name, n)) for name in INPUTS}
    motion = SymbolicMotion(
        equations,
        symbols["x"],
        symbols["dx"],
        symbols["ddx"],
        symbols["tau_J"],
        symbols["tau_m"],
        symbols["dtau_J"],
        symbols["dtau_m"],
        sign=lambda side, i: symbols[f"sign_{side}"][i],
    )
    numbers = {p.name: ca.SX.sym(p.name, p.size) for p in effect.parameters}
    states = {name: ca.SX.sym(name) for name in effect.states}
    contribution = _contribution(feature, motion, {**numbers, **feature.choices, **states})
    rows = ca.vertcat(contribution.link, contribution.drive, contribution.motor)
    columns = _columns(feature, rows, numbers)
    columns = ca.substitute(columns, equations.Psi, ca.DM(equations.nominal))
    columns = ca.cse(columns)
    searched = ca.vertcat(*(numbers[p.name] for p in feature.searched), ca.SX(0, 1))
    state = ca.vertcat(*states.values()) if states else ca.SX.sym("none", 1)
    flat = ca.vec(columns)
    places = np.array(flat.sparsity().row(), dtype=int)
    kept = [k for k in places if not flat[int(k)].is_zero()]
    argument = searched if searched.numel() else ca.SX.sym("none", 1)
    function = ca.Function(
        effect.id,
        [*symbols.values(), argument, state],
        [ca.vertcat(*(flat[int(k)] for k in kept), ca.SX(0, 1))],
        [*INPUTS, "searched", "state"],
        ["columns"],
    )
    kernel = kernels.compile(function, "numpy", shared=("searched",)) if kept else None
    rates = None
    if states:
        rates = _recursion(contribution, states, symbols, argument, equations)
    return _Compiled(kernel, np.array(kept, dtype=int), searched.numel(), rates)  # type: ignore[arg-type]


def _contribution(feature: Feature, motion: SymbolicMotion, values: Mapping[str, Any]) -> Contribution:
    effect, robot = feature.effect, motion.robot
    if feature.joint is not None:
        return effect.law(motion, robot.joint_names.index(feature.joint), values)
    if effect.scope is Scope.EACH_OR_ARM:
        total = motion.nothing()
        for i in range(robot.n):
            total = total + effect.law(motion, i, values)
        return total
    return effect.law(motion, robot.n - 1, values)


def _columns(feature: Feature, rows: Any, numbers: Mapping[str, Any]) -> Any:
    if feature.fixed:
        return rows
    linear = ca.vertcat(*(numbers[p.name] for p in feature.linear))
    neutral = np.concatenate(
        [np.full(p.size, p.neutral if p.neutral is not None else p.default) for p in feature.linear]
    )
    derivative = ca.substitute(ca.jacobian(rows, linear), linear, ca.DM(neutral))
    if feature.phase is None:
        return derivative
    phi = numbers[feature.phase.name]
    return ca.horzcat(
        ca.substitute(derivative[:, 0], phi, ca.DM(0.0)), ca.substitute(derivative[:, 0], phi, ca.DM(np.pi / 2))
    )


def _recursion(
    contribution: Contribution, states: Mapping[str, Any], symbols: Any, searched: Any, equations: Any
) -> Recursion:
    """One step of the internal states: exact where their rate is linear in them over the step."""
    z = ca.vertcat(*states.values())
    rate = ca.vertcat(*(contribution.rates[name] for name in states))
    rate = ca.substitute(rate, equations.Psi, ca.DM(equations.nominal))
    h = ca.SX.sym("h")
    stiffness = ca.diag(ca.jacobian(rate, z)) * h
    # (exp(s) - 1) / s, with its limit at 0.
    factor = ca.if_else(ca.fabs(stiffness) < 1e-8, 1.0, ca.expm1(stiffness) / (stiffness + (ca.fabs(stiffness) < 1e-8)))
    arguments, constants = ca.vertcat(*symbols.values()), ca.vertcat(searched, h)
    step = ca.Function("step", [z, arguments, constants], [z + h * factor * rate])
    return Recursion(step)
