"""The equations of a recording as a linear regression in base parameters: rows, sums of their
products, predictions.

With both encoders the rows are the two lines of (1), and a third where joint torque sensors exist::

    link    0     = M q'' + S theta'' + c + c1 + g + K (q - theta) + D (q' - theta')
    motor   tau_m = S' q'' + B theta'' + c2 + K (theta - q) + D (theta' - q')
    drive   tau_J = K (theta - q) + D (theta' - q')

Written so, the noises of the three are independent: encoders in the first, motor torque in the
second, joint torque in the third. The first two alone are (10). With the encoders of one side only,
theta = q, and what remains is

    joint   tau_J = M q'' + S q'' + c + c1 + g
    whole   tau_m = (M + S + S' + B) q'' + c + c1 + c2 + g

Without joint torque sensors the row `link` is homogeneous in masses and springs, so that the
smallest of them fit it best. `summed` regressions therefore put the sum of both lines in the place
of `motor`: there torque sets the scale of every mass, and no deflection is left. `link` then shows
how far the springs wind under that load. Its deflection is the difference of two encoders, whose
lag and offset beside each other may be columns of their own::

    link    0     = M q'' + S theta'' + c + c1 + g + K (q - theta) + D (q' - theta') + a q' + b
    motor   tau_m = M q'' + S theta'' + S' q'' + B theta'' + c + c1 + c2 + g

with a = K times the lag of the link encoder, b = K times its offset.
:mod:`elastic_arm.identification.deflection` weighs `link` by 1 / K.

These are the independent equations of :mod:`elastic_arm.estimation.equation_sets`. Laws beyond the
model add columns: what they add to the residuals of link, drive and motor side is carried over to
these rows.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_arm.arrays import Array, Indices, Mask
from elastic_arm.dynamics import Model
from elastic_arm.dynamics.composition import ARMATURE
from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.equation_sets import MOTOR, VOID, Channels, Equation, EquationSet
from elastic_arm.estimation.motion import Motion
from elastic_arm.formatting import JointUnits
from elastic_arm.identification.base_parameters import BaseParameters, find_base
from elastic_arm.identification.triangular import AT_ONCE, triangular

RANDOM_STATES = 200


@dataclass(frozen=True)
class Column:
    """A column beyond the model's own: one parameter of a law that is linear in it."""

    name: str  # of the parameter, e.g. `coulomb_friction:joint_2.torque`
    unit: str
    # motion -> (N, 3 n), what a unit of the parameter adds to the residuals of link, drive and
    # motor, Nm
    values: Callable[[Motion], Array]
    nominal: float = 0.0  # Value in the nominal arm
    least: float = -np.inf  # What a real arm has at least, such as no negative friction
    ordinary: float | None = (
        None  # Standard deviation of a prior about the nominal; None where it is free
    )
    sensor: bool = False  # Whether it is an error of a sensor
    dry: bool = False  # Whether it follows the sign of a velocity

    @property
    def place(self) -> str:
        """The common beginning of the names of all parameters of its law."""
        return self.name.rpartition(".")[0]


class BaseRegression:
    """The rows of a recording's equations in base parameters.

    recorded: names of the recorded channels among q, theta, tau_J, tau_m: one set for all joints,
    or n sets; summed: see the module; it matters only with both encoders, motor torque and no joint
    torque sensor; encoder_columns: whether summed rows have columns for the lags and offsets of the
    link encoders.

    Raises an IdentificationError if the channels allow no equation.
    """

    def __init__(
        self,
        model: Model,
        recorded: Channels | Sequence[Channels],
        columns: Sequence[Column] = (),
        joints: Sequence[str] = (),
        *,
        summed: bool = False,
        encoder_columns: bool = False,
    ) -> None:
        self.model = model
        self.n = model.n
        self.elastic = model.robot.elastic
        self.columns = tuple(columns)
        self.equations = EquationSet.independent(
            recorded, self.n, elastic=self.elastic, summed=summed
        ).even()
        self.sides = self.equations.sides
        self.partial = len({equation for equation, _ in self.equations.entries}) > len(self.sides)
        self.summed = self.sides == ("link", "motor") and self.equations.equation(
            "motor"
        ).combination == (1, 0, 1)
        self.joints = tuple(joints) or tuple(f"joint_{i + 1}" for i in range(self.n))
        self.groups = tuple((side, joint) for side in self.sides for joint in self.joints)
        own = model.parameters
        wound = self.wound if self.summed and encoder_columns else ()
        self._encoders = _encoder_columns(self.joints, wound, model.robot.units)
        added = (*self._encoders, *self.columns)
        every: list[Any] = [*own, *added]
        self.names = tuple(one.name for one in every)
        self.units = tuple(one.unit for one in every)
        self.nominal: Array = np.array([one.nominal for one in every])
        self._springs = np.array(
            [k for k, p in enumerate(own) if p.name.rpartition(".")[2] in ("K", "D")], dtype=int
        )
        self._armatures = np.array(
            [k for k, p in enumerate(own) if p.name.endswith(f".{ARMATURE}")], dtype=int
        )
        self._own = len(own)
        phi = self._all_rows(self._random_motion(), np.arange(self._own), np.arange(len(added)))
        self.base: BaseParameters = find_base(
            phi.reshape(-1, phi.shape[-1]), self.names, self.units
        )

    def rows(self, motion: Motion) -> Array:
        """Return base columns of the regressor and the measured side, (groups, N, B + 1).

        Indices that contain the friction of a joint that sticks are zero.
        """
        wanted = self.base.columns
        own = wanted[wanted < self._own]
        extra = wanted[wanted >= self._own] - self._own
        rows = self._all_rows(motion, own, extra, beside=1)
        for k, side in enumerate(self.sides):
            rows[k * self.n : (k + 1) * self.n, :, -1] = self._measured(motion, side)
        for k, stuck in self._stuck(motion):
            rows[k, stuck] = 0.0
        return rows

    def counted(self, motion: Motion) -> Array:
        """Return the number of rows of each group, (groups,), without a joint that sticks."""
        counts = np.full(len(self.groups), float(len(motion)))
        for k, stuck in self._stuck(motion):
            counts[k] -= np.count_nonzero(stuck)
        return counts

    def _stuck(self, motion: Motion) -> Iterator[tuple[int, Mask]]:
        """Yield the groups that contain friction of joints that may stick, and where these stick,
        (N,)."""
        if motion.stuck is not None:
            for k, (equation, joint) in enumerate(self.equations.entries):
                if equation.combination[MOTOR]:
                    yield k, motion.stuck[:, joint]

    def information(self, motion: Motion) -> Array:
        """Return triangular factors (groups, B + 1, B + 1) of the rows of all groups.

        The rows of a long motion are never in memory all at once.
        """
        if "drive" in self.sides:
            assert self.drive_columns is not None  # an error where the description hides a spring
        factors = np.zeros((len(self.groups), 0, len(self.base) + 1))
        for start in range(0, max(len(motion), 1), AT_ONCE):
            rows = self.rows(motion[start : start + AT_ONCE])
            factors = triangular(np.concatenate([factors, rows], axis=1))
        return factors

    @cached_property
    def described(self) -> Array:
        """Base parameters (B,) of the description."""
        return self.base.T @ self.nominal

    @property
    def rigid(self) -> bool:
        """Whether every row is the torque of a joint of a rigid arm."""
        return set(self.sides) <= {"joint", "whole"}

    @property
    def wound(self) -> tuple[int, ...]:
        """Joints whose deflection both encoders measure."""
        rows = (
            [self.equations.of_joint("link", j) for j in range(self.n)]
            if "link" in self.sides
            else []
        )
        return tuple(j for j, equation in enumerate(rows) if equation.combination != VOID)

    @cached_property
    def drive_columns(self) -> list[tuple[int, int]]:
        """The base columns of K and D of joints whose deflection is measured."""
        place = {self.names[c]: k for k, c in enumerate(self.base.columns.tolist())}
        joints = [self.model.robot.joint_names[j] for j in self.wound]
        for name in (f"{joint}.{spring}" for joint in joints for spring in "KD"):
            if name not in place:
                raise IdentificationError(
                    f"{name} is lost numerically next to much larger numbers of the description",
                    "Check its lengths, ratios and gravity",
                )
        return [(place[f"{joint}.K"], place[f"{joint}.D"]) for joint in joints]

    def predict(self, motion: Motion, Psi_base: Array) -> dict[str, Array]:
        """Return right sides of all equations, side -> (N, n) Nm, for `Psi_base`.

        Zero where they contain the friction of a joint that sticks.
        """
        return self._by_side(self.rows(motion)[..., :-1] @ Psi_base)

    def left_out(self, motion: Motion) -> dict[str, Mask]:
        """Return where equations contain the friction of a joint that sticks, side -> (N, n)."""
        rows = np.zeros((len(self.groups), len(motion)), dtype=bool)
        for k, stuck in self._stuck(motion):
            rows[k] = stuck
        return self._by_side(rows)

    def _by_side(self, rows: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Return rows (groups, N) as side -> (N, n)."""
        return {side: rows[k * self.n : (k + 1) * self.n].T for k, side in enumerate(self.sides)}

    def by_joint(self, values: Array) -> dict[str, dict[str, float]]:
        """Return numbers (groups,) as equation -> joint -> number.

        Equations that a joint lacks are omitted.
        """
        found: dict[str, dict[str, float]] = {side: {} for side in self.sides}
        for (side, joint), value, live in zip(
            self.groups, values.tolist(), self.equations.live, strict=True
        ):
            if live:
                found[side][joint] = value
        return found

    def comparable(self, Psi_base: Array) -> Array:
        """Return factors (groups,) that make residuals of different parameters comparable.

        A homogeneous row is an equation for the measured deflection and is weighted by the nominal
        stiffness.
        """
        factors = np.ones(len(self.groups))
        if self.summed:  # the link's rows come first
            places = [K for K, _ in self.drive_columns]
            factors[list(self.wound)] = self.described[places] / Psi_base[places]
        return factors

    def measured(self, motion: Motion) -> dict[str, Array]:
        """Return the left sides of all equations, side -> (N, n) Nm."""
        return {side: self._measured(motion, side).T for side in self.sides}

    def _measured(self, motion: Motion, side: str) -> Array:
        channel = self.equations.equation(side).torque
        if channel is None:
            return np.zeros((self.n, len(motion)))
        values: Array = getattr(motion, channel)
        return values.T

    def laws(self, motion: Motion) -> Array:
        """Return columns (N, 3 n, k) of the laws beyond the model, for the residuals of link, drive
        and motor."""
        return self._stacked(self._both_sides(motion), self.columns)

    def _stacked(self, motion: Motion, columns: Sequence[Column]) -> Array:
        """Return columns (N, 3 n, k) for link, drive and motor residuals."""
        stacked = np.empty((len(motion), 3 * self.n, len(columns)))
        for k, column in enumerate(columns):
            stacked[:, :, k] = column.values(motion)
        return stacked

    def _all_rows(self, motion: Motion, own: Indices, extra: Indices, beside: int = 0) -> Array:
        """Return rows (groups, N, columns) of the model's parameters `own`, the columns `extra`,
        and `beside` zeros."""
        laws = motion.laws if motion.laws is not None else self.laws(motion)
        motion = self._both_sides(motion)
        if self._encoders:
            laws = np.concatenate([self._stacked(motion, self._encoders), laws], axis=2)
        x = self._coordinates(motion, "")
        dx = self._coordinates(motion, "d")
        ddx = self._coordinates(motion, "dd")
        phi = self.model.regressor(x, dx, ddx, columns=own)
        by_residual = (
            laws[:, :, extra].transpose(1, 0, 2).reshape(3, self.n, len(motion), len(extra))
        )
        width = len(own) + len(extra)
        rows = np.zeros((len(self.groups), len(motion), width + beside))
        for k, side in enumerate(self.sides):
            block = rows[k * self.n : (k + 1) * self.n]
            for equation, joints in self._alike(side):
                part = block[joints]
                self._fill_own(part[:, :, : len(own)], phi, (equation, joints), own)
                if len(extra):
                    combination = np.array(equation.combination, dtype=float)
                    part[:, :, len(own) : width] = np.tensordot(
                        combination, by_residual[:, joints], 1
                    )
                if not isinstance(joints, slice):  # of listed joints it is a copy
                    block[joints] = part
        return rows

    def _alike(self, side: str) -> list[tuple[Equation, slice | list[int]]]:
        """Return the different equations of one name, each with its joints; empty ones are
        omitted."""
        found: dict[Equation, list[int]] = {}
        for equation, joint in self.equations.entries:
            if equation.name == side and equation.combination != VOID:
                found.setdefault(equation, []).append(joint)
        return [
            (equation, slice(None) if len(joints) == self.n else joints)
            for equation, joints in found.items()
        ]

    def _fill_own(
        self,
        block: Array,
        phi: Array,
        of: tuple[Equation, slice | list[int]],
        own: Indices,
    ) -> None:
        """Add the model's columns to the rows of one equation and some joints."""
        by_line = phi.transpose(1, 0, 2)
        equation, joints = of
        link, motor, spring = equation.lines
        if link:
            block += by_line[: self.n][joints]
        if not motor and len(self._armatures):
            # A sensor behind the motor does not feel what spins with it.
            block[:, :, np.isin(own, self._armatures)] = 0.0
        if motor and self.elastic:
            block += by_line[self.n : 2 * self.n][joints]
        if spring:
            springs = np.flatnonzero(np.isin(own, self._springs))
            block[:, :, springs] -= by_line[: self.n, :, springs][joints]

    def _both_sides(self, motion: Motion) -> Motion:
        if motion.q is None:
            return replace(motion, q=motion.theta, dq=motion.dtheta, ddq=motion.ddtheta)
        if motion.theta is None or "joint" in self.sides or "whole" in self.sides:
            return replace(motion, theta=motion.q, dtheta=motion.dq, ddtheta=motion.ddq)
        return motion

    def _coordinates(self, motion: Motion, rate: str) -> Array:
        q = getattr(motion, rate + "q")
        theta = getattr(motion, rate + "theta")
        return np.hstack([q, theta]) if self.elastic else q

    def _random_motion(self) -> Motion:
        """Return random states: columns that are dependent at these are dependent at all states."""
        rng = np.random.default_rng(2024)
        shape = (RANDOM_STATES, self.n)
        q: Array = rng.uniform(-np.pi, np.pi, shape)
        dq, ddq, dtheta, ddtheta, tau_J, tau_m = rng.standard_normal((6, *shape))
        t: Array = np.linspace(0.0, 1.0, RANDOM_STATES)
        motion = Motion(t, q, dq, ddq, tau_J=tau_J, tau_m=tau_m)
        if "link" in self.sides:
            theta = q + 0.1 * rng.standard_normal(shape)
            both = np.isin(np.arange(self.n), self.wound)
            dtheta = np.where(both, dtheta, dq)
            ddtheta = np.where(both, ddtheta, ddq)
            motion = replace(motion, theta=np.where(both, theta, q), dtheta=dtheta, ddtheta=ddtheta)
        return motion


def _encoder_columns(
    joints: Sequence[str], wound: Sequence[int], units: JointUnits
) -> tuple[Column, ...]:
    """Return the columns of lags and offsets of the link encoders relative to the motor encoders,
    times the stiffness."""
    return tuple(
        Column(
            f"link_encoder:{joints[j]}.{what}",
            units.at(joints[j], unit),
            partial(_of_drive, j, what),
        )
        for j in wound
        for what, unit in (("K_delay", "Nm s/rad"), ("K_offset", "Nm"))
    )


def _of_drive(joint: int, what: str, motion: Motion) -> Array:
    """Return how much a unit of the parameter reduces the torque of the spring of one joint."""
    if motion.dq is None:
        raise IdentificationError("no link angles were recorded", "Record /joint_states.")
    samples, n = motion.dq.shape
    column = np.zeros((samples, 3 * n))
    # The deflection is recorded too large by lag times speed, and too small by a link angle
    # recorded too large.
    column[:, n + joint] = -motion.dq[:, joint] if what == "K_delay" else 1.0
    return column
