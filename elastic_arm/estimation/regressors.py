"""Columns of a regression from effects: the compiler of laws for identification and diagnosis.

A law is an expression. Its derivatives by the linear parameters are columns of the residuals link,
drive and motor; nonlinear parameters are arguments of the columns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from operator import add
from typing import Any

import casadi as ca
import numpy as np

from elastic_arm.arrays import Array, Indices
from elastic_arm.codegen import kernels
from elastic_arm.codegen.recursion import Recursion
from elastic_arm.effects import SymbolicMotion
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect import Effect
from elastic_arm.effects.motion import Contribution
from elastic_arm.effects.parameters import Parameter
from elastic_arm.effects.regressor import MotionSignals
from elastic_arm.estimation.motion import CompletedMotion, rates_of
from elastic_arm.estimation.smoother import Smoother

INPUTS = (
    "x", "dx", "ddx", "tau_J", "tau_m", "dtau_J", "dtau_m", "progress", "elapsed", "friction_link",
    "friction_motor", "wound", "loaded", "r", "dr", "kp", "kd", "fed", "stall", "sign_link",
    "sign_motor",
)  # fmt: skip
SIGNS = ("sign_link", "sign_motor")
# those that follow from the motion alone, whatever the numbers of the arm
MOTION = ("x", "dx", "ddx", "progress", "elapsed", *SIGNS)


@dataclass(frozen=True)
class Signals(MotionSignals):
    """Arguments of the laws at the recording's rate; `values` by the names of :data:`INPUTS`."""

    # the same up to the first sample; None where the motion that came before is not known
    before: Signals | None = None
    # (n,) rad/s for link and motor side, below which a velocity has no sign
    standstill: tuple[Array, Array] | None = None

    @staticmethod
    def of(
        motion: CompletedMotion,
        standstill: tuple[Array, Array],
        *,
        elastic: bool = True,
        cutoff: float = np.inf,
        predicted: bool = False,
        smoother: Smoother | None = None,
        made: Mapping[str, Array] | None = None,
        near: Signals | None = None,
    ) -> Signals:
        """Take the signals from motion over a stretch of time.

        standstill: (n,) rad/s for link and motor side, below which a velocity has no sign; elastic:
        whether the arm has transmissions; x is then [q, theta], otherwise [q]; cutoff: Hz up to
        which accelerations are motion rather than noise; predicted: whether torques are those that
        the model predicts; smoother: what the residuals have passed, where it takes a part of their
        band: signs pass it, too; made: "kp", "kd", "fed", "stall" (N, n) of the controllers, where
        torques are made of commands; near: those of the stretch with other numbers of the arm:
        where the motion is the same, its signs are.
        """
        rates = [rates_of(motion.t, torque) for torque in (motion.tau_J, motion.tau_m)]
        before = None
        if motion.before is not None:
            before = Signals.of(
                motion.before, standstill, elastic=elastic, cutoff=cutoff, smoother=smoother
            )
        values = _values(motion, standstill, rates, elastic=elastic)
        if near is not None and near.has_motion(values, standstill):
            values |= near.alike(values)
        elif smoother is not None:
            sides = (motion.dq, standstill[0]), (motion.dtheta, standstill[1])
            signs = (smoother.sign(motion.t, *side) for side in sides)
            values |= zip(SIGNS, signs, strict=True)
        values |= made or {}
        return Signals(motion.t, values, cutoff, predicted, before=before, standstill=standstill)

    def alike(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """Return its signs, and what other signals of the same motion have in common with it: one
        array in memory for both."""
        common = {
            name: own
            for name, own in self.values.items()
            if name in values and np.array_equal(own, values[name])
        }
        return common | {name: self.values[name] for name in SIGNS}

    def shares_motion(self, other: Signals) -> bool:
        """Whether it has the same motion as other signals, in the same memory."""
        return all(self.values[name] is other.values[name] for name in MOTION)

    def has_motion(self, values: Mapping[str, Array], standstill: tuple[Array, Array]) -> bool:
        """Whether the velocities of other signals, and those without a sign, are the same."""
        if self.standstill is None:
            return False
        pairs = (values["dx"], self.values["dx"]), *zip(standstill, self.standstill, strict=True)
        return all(np.array_equal(*pair) for pair in pairs)

    @staticmethod
    def of_samples(
        motion: CompletedMotion, standstill: tuple[Array, Array], *, elastic: bool = True
    ) -> Signals:
        """Take the signals from samples in any order: rates of torques are zero.

        standstill: (n,) rad/s for link and motor side, below which a velocity has no sign; elastic:
        whether the arm has transmissions; x is then [q, theta], otherwise [q].
        """
        rates = [np.zeros_like(motion.tau_J), np.zeros_like(motion.tau_m)]
        return Signals(motion.t, _values(motion, standstill, rates, elastic=elastic))

    @cached_property
    def arrays(self) -> list[Array]:
        """The arguments in the order of :data:`INPUTS`.

        Friction and command are left out where they were not given.
        """
        none = np.zeros(self.values["tau_J"].shape)
        # Every column that is made of them would copy what is not in one piece.
        return [np.ascontiguousarray(self.values.get(name, none)) for name in INPUTS]

    @cached_property
    def between(self) -> Array:
        """The arguments side by side (N', …) in the middle of each step.

        They begin where the motion is known.
        """
        stacked = np.hstack(self.arrays)
        if self.before is not None:
            stacked = np.vstack([np.hstack(self.before.arrays), stacked])
        stacked[:-1] = 0.5 * (stacked[:-1] + stacked[1:])
        return stacked

    def with_torques(self, tau_J: Array, tau_m: Array) -> Signals:
        """Return the signals of the same motion with other torques (N, n) Nm."""
        rates = {"dtau_J": rates_of(self.t, tau_J), "dtau_m": rates_of(self.t, tau_m)}
        return replace(self, values={**self.values, "tau_J": tau_J, "tau_m": tau_m, **rates})

    def wound_by(self, deflection: Array) -> Signals:
        """Return the signals with deflections (N, n) rad of springs under the load."""
        return replace(
            self, values={**self.values, "wound": deflection, "loaded": np.ones((len(self.t), 1))}
        )

    def with_model_torques(
        self, load: Array, drive: Array, clear: Array, noise: Mapping[str, Array]
    ) -> Signals:
        """Return the signals with what regressors of whole effects take besides.

        load, drive, clear: (N, n) Nm, as of :attr:`model_torques`; noise: variances (n,) of the
        recorded torques' white noise, Nm², by name.
        """
        return replace(
            self, model_torques={"tau_J": load, "tau_m": drive, "clear": clear}, torque_noise=noise
        )

    def curved(self, k: int) -> Signals:
        """Return the signals with L sin(k pi t / L) instead of t.

        L is the length of the recording.
        """
        share = self.values["progress"] + 0.5
        # t / share is L, and sin(k pi share) / share finite where both vanish.
        return replace(
            self,
            values={
                **self.values,
                "elapsed": self.values["elapsed"] * k * np.pi * np.sinc(k * share),
            },
        )

    def with_friction(self, link: Array, motor: Array) -> Signals:
        """Return the signals with what friction effects of both sides resist with, (N, n) Nm."""
        return replace(self, values={**self.values, "friction_link": link, "friction_motor": motor})


def _values(
    motion: CompletedMotion,
    standstill: tuple[Array, Array],
    rates: Sequence[Array],
    *,
    elastic: bool,
) -> dict[str, Array]:
    begin, end = motion.span or (motion.t[0], motion.t[-1])
    # A single sample is the begin of its recording.
    length = end - begin if end > begin else 1.0
    values = {
        "x": motion.coordinates("", elastic=elastic),
        "dx": motion.coordinates("d", elastic=elastic),
        "ddx": motion.coordinates("dd", elastic=elastic),
        "tau_J": motion.tau_J,
        "tau_m": motion.tau_m,
        "dtau_J": rates[0],
        "dtau_m": rates[1],
        "sign_link": np.tanh(motion.dq / standstill[0]),
        "sign_motor": np.tanh(motion.dtheta / standstill[1]),
        "wound": motion.theta - motion.q,
        "loaded": np.zeros((len(motion.t), 1)),
        "progress": ((motion.t - begin) / length - 0.5)[:, None],
        "elapsed": (motion.t - begin)[:, None],
    }
    if motion.r is not None:
        values |= {"r": motion.r, "dr": rates_of(motion.t, motion.r)}
    return {name: np.ascontiguousarray(v) for name, v in values.items()}


@dataclass(frozen=True, eq=False)
class Entries:
    """Columns of the residuals at the recording's rate, of which only some entries are not null."""

    values: Array  # (N, m) of these entries
    # rows, columns: (m,) where they stand
    rows: Indices
    columns: Indices
    shape: tuple[int, int]  # numbers of rows, 3 n, and of columns, k

    @staticmethod
    def of(columns: Array) -> Entries:
        """Take columns (N, 3 n, k) apart."""
        rows, numbers = np.nonzero(columns.any(axis=0))
        return Entries(
            columns[:, rows, numbers], rows, numbers, (columns.shape[1], columns.shape[2])
        )

    @staticmethod
    def side_by_side(each: Sequence[Entries]) -> Entries:
        """Return the columns of several, which have the same rows, one after the other."""
        if len(each) == 1:
            return each[0]
        counts = [one.shape[1] for one in each]
        begins = np.cumsum([0, *counts])
        columns = [one.columns + begin for one, begin in zip(each, begins, strict=False)]
        return Entries(
            np.hstack([one.values for one in each]),
            np.concatenate([one.rows for one in each]),
            np.concatenate(columns),
            (each[0].shape[0], int(begins[-1])),
        )

    def dense(self) -> Array:
        """Return the columns (N, 3 n, k); each row of a column stands in memory as a whole."""
        out = np.zeros((*self.shape[::-1], len(self.values)))
        out[self.columns, self.rows] = self.values.T
        return out.T

    def combined(self, transform: Array) -> Array:
        """Return columns (N, R, k) of combinations (R, 3 n) of the rows; each row of a column
        stands in memory as a whole."""
        out = np.zeros((self.shape[1], len(transform), len(self.values)))
        for values, row, column in zip(self.values.T, self.rows, self.columns, strict=True):
            for to in np.flatnonzero(transform[:, row]):
                out[column, to] += transform[to, row] * values
        return out.T

    def weighted(self, coefficients: Array) -> Array:
        """Return the sum (N, 3 n) of the columns times coefficients (k,)."""
        out = np.zeros((self.shape[0], len(self.values)))
        for values, row, column in zip(self.values.T, self.rows, self.columns, strict=True):
            out[row] += coefficients[column] * values
        return out.T


@dataclass(frozen=True)
class Term:
    """An effect whose columns are wanted."""

    # effect, joints: what, and the indices of the joints at which its law is evaluated and summed
    effect: Effect
    joints: Sequence[int]
    choices: Mapping[str, Any]  # what was chosen of the effect's choices, by name
    # parameters by which the law is differentiated; without any the law itself is the one column
    linear: Sequence[Parameter]
    # values of `linear` and of parameters that are neither linear nor searched, by name: one set of
    # columns for each point
    points: Sequence[Mapping[str, Any]]
    searched: Sequence[Parameter] = ()  # parameters that are arguments of the columns


class CompiledColumns:
    """Compiled columns of effects.

    terms: the effects; several of them only without internal states; engine: "numpy" for many
    effects that are evaluated a few times; entries that are null with the arm's numbers are left
    out. None for code that is compiled once for all arms of a shape and runs over long recordings.
    """

    def __init__(
        self, terms: Sequence[Term], equations: ArmEquations, engine: str | None = "numpy"
    ) -> None:
        self._equations = equations
        n = equations.robot.n
        sizes = dict.fromkeys(("x", "dx", "ddx"), equations.dof) | dict.fromkeys(
            ("progress", "elapsed", "loaded"), 1
        )
        symbols = {name: ca.SX.sym(name, sizes.get(name, n)) for name in INPUTS}
        searched = [p for term in terms for p in term.searched]
        arguments = {p.name: ca.SX.sym(p.name, p.size) for p in searched}
        signs = {side: symbols[f"sign_{side}"] for side in ("link", "motor")}
        known = {name: symbol for name, symbol in symbols.items() if not name.startswith("sign")}
        motion = SymbolicMotion(equations, **known, sign=lambda side, i: signs[side][i])
        states = {name: ca.SX.sym(name) for term in terms for name in term.effect.states}
        argument = _stacked(arguments, "searched")
        state = _stacked(states, "state")
        self._scan: Recursion | None = None
        self._moved_states = False
        blocks = []
        self.bends = False
        for term in terms:
            numbers = {
                p.name: arguments.get(p.name, ca.SX.sym(p.name, p.size))
                for p in term.effect.parameters
            }
            values = {**numbers, **term.choices, **states}
            contribution = reduce(add, (term.effect.law(motion, i, values) for i in term.joints))
            rows = _derivatives(term, contribution, numbers)
            # An exact conversion of its coefficient makes a law linear.
            bent = [numbers[p.name] for p in term.linear if p.from_coefficient is None]
            self.bends |= bool(bent) and ca.depends_on(rows, ca.vertcat(*bent))
            blocks.append(_columns(term, rows, numbers))
            if term.effect.states:
                self._scan = _recursion(contribution, states, symbols, argument, equations)
                self._moved_states |= any(
                    ca.depends_on(one, equations.Psi) for one in contribution.rates.values()
                )
        columns = ca.horzcat(*blocks)
        several = sum(p.size for p in searched) > 1 and not states
        self.quadratic = several and ca.is_linear(ca.jacobian(ca.vec(columns), argument), argument)
        self._shape = (int(columns.shape[0]), int(columns.shape[1]))
        self._arguments = sum(p.size for p in searched)
        self.follows_load = ca.depends_on(columns, symbols["wound"])
        others = [symbol for name, symbol in symbols.items() if name not in MOTION]
        moved = ca.depends_on(columns, ca.vertcat(*others, equations.Psi))
        self.of_motion = not states and not moved
        self._compile(columns, symbols, argument, state, engine)

    def at(self, equations: ArmEquations) -> CompiledColumns | None:
        """Return them for the same arm with other numbers.

        None where the numbers are constants of the compiled code.
        """
        left_out = self._equations.nominal == 0.0
        if self._moved_states or equations.nominal[left_out].any():
            return None
        moved = copy(self)
        moved._equations = equations
        return moved

    def _compile(
        self,
        columns: ca.SX,
        symbols: Mapping[str, ca.SX],
        argument: ca.SX,
        state: ca.SX,
        engine: str | None,
    ) -> None:
        """Compile the entries that are not null, and remember where they belong."""
        Psi = self._equations.Psi
        numbers = ca.DM(self._equations.nominal)
        known = ca.vec(ca.substitute(columns, Psi, numbers) if engine == "numpy" else columns)
        kept = [int(k) for k in known.sparsity().row() if not known[int(k)].is_zero()]
        flat = ca.vec(ca.cse(columns))
        self.places: Indices = np.array(kept, dtype=int)
        function = ca.Function(
            "columns",
            [*symbols.values(), argument, state, self._equations.Psi],
            [ca.vertcat(*(flat[k] for k in kept), ca.SX(0, 1))],
            [*INPUTS, "searched", "state", "Psi"],
            ["columns"],
        )
        self._kernel = (
            kernels.compile(function, engine, shared=("searched", "Psi")) if kept else None
        )

    @property
    def acts(self) -> bool:
        """Whether any entry of the columns is not null."""
        return len(self.places) > 0

    def __call__(
        self, signals: Signals, searched: Sequence[float] = (), start: float = 0.0
    ) -> Array:
        """Evaluate the columns (N, 3 n, k); arguments as in :meth:`entries`."""
        return self.entries(signals, searched, start).dense()

    def entries(
        self, signals: Signals, searched: Sequence[float] = (), start: float = 0.0
    ) -> Entries:
        """Evaluate the entries of the columns that are not null.

        start: of all internal states, where the motion before the first sample is not known.
        """
        N = len(signals.t)
        rows, count = self._shape
        column, row = np.divmod(self.places, rows)
        if self._kernel is None:
            return Entries(np.zeros((N, 0)), row, column, (rows, count))
        argument = np.asarray(searched, dtype=float) if self._arguments else np.zeros(1)
        states = (
            np.zeros((N, 1))
            if self._scan is None
            else _states(self._scan, signals, argument, start)
        )
        values = self._kernel(*signals.arrays, argument, states, self._equations.nominal)
        return Entries(np.asarray(values), row, column, (rows, count))

    def entries_at(self, signals: Signals, points: Sequence[Sequence[float]]) -> Entries:
        """Return those at several points of the searched numbers, side by side.

        Of a law without internal states; what does not depend on these numbers is evaluated once.
        """
        if len(points) == 1 or self._kernel is None or not self._arguments:
            return Entries.side_by_side([self.entries(signals, point) for point in points])
        rows, count = self._shape
        column, row = np.divmod(self.places, rows)
        arguments = np.asarray(points, dtype=float)
        states = np.zeros((len(signals.t), 1))
        arrays = (*signals.arrays, arguments[0], states, self._equations.nominal)
        values = self._kernel.at_each("searched", arguments, *arrays)
        begins = count * np.arange(len(points))
        return Entries(
            values.reshape(-1, len(signals.t)).T,
            np.tile(row, len(points)),
            np.add.outer(begins, column).ravel(),
            (rows, count * len(points)),
        )


def _stacked(symbols: Mapping[str, ca.SX], name: str) -> ca.SX:
    """Stack symbols to one column, a stand-in where there are none."""
    return ca.vertcat(*symbols.values()) if symbols else ca.SX.sym(name, 1)


def _derivatives(term: Term, contribution: Contribution, numbers: Mapping[str, ca.SX]) -> ca.SX:
    """Return the derivatives (3 n, k) of one effect by its linear parameters; the effect itself
    without any."""
    rows = ca.vertcat(contribution.link, contribution.drive, contribution.motor)
    return (
        ca.jacobian(rows, ca.vertcat(*(numbers[p.name] for p in term.linear)))
        if term.linear
        else rows
    )


def _columns(term: Term, rows: ca.SX, numbers: Mapping[str, ca.SX]) -> ca.SX:
    """Return the columns (3 n, k) of one effect."""
    sets = []
    for point in term.points:
        found = rows
        if point:
            symbols = ca.vertcat(*(numbers[name] for name in point))
            values = np.concatenate(
                [np.atleast_1d(np.asarray(value, dtype=float)) for value in point.values()]
            )
            found = ca.substitute(found, symbols, ca.DM(values))
        sets.append(found)
    return ca.horzcat(*sets)


def _recursion(
    contribution: Contribution,
    states: Mapping[str, ca.SX],
    symbols: Mapping[str, ca.SX],
    argument: ca.SX,
    equations: ArmEquations,
) -> Recursion:
    """Return one step of the internal states: exact where their rate is linear in them over the
    step."""
    z = ca.vertcat(*states.values())
    rate = ca.vertcat(*(contribution.rates[name] for name in states))
    rate = ca.substitute(rate, equations.Psi, ca.DM(equations.nominal))
    h = ca.SX.sym("h")
    stiffness = ca.diag(ca.jacobian(rate, z)) * h
    # (exp(s) - 1) / s, with its limit at 0.
    factor = ca.if_else(
        ca.fabs(stiffness) < 1e-8,
        1.0,
        ca.expm1(stiffness) / (stiffness + (ca.fabs(stiffness) < 1e-8)),
    )
    arguments = ca.vertcat(*symbols.values())
    constants = ca.vertcat(argument, h)
    return Recursion(ca.Function("step", [z, arguments, constants], [z + h * factor * rate]))


def _states(scan: Recursion, signals: Signals, searched: Array, start: float) -> Array:
    """Run the internal states (N, s) over the samples, by the exponential Euler rule."""
    h = float(signals.t[1] - signals.t[0])
    start = start if signals.before is None else 0.0
    return scan.run(signals.between, np.append(searched, h), start)[-len(signals.t) :]
