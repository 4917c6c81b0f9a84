"""The likelihood of the torques of a side under a description whose masses and gains are uncertain.

The likelihood of a hypothesis is that of the torques of the measured joints j under

    tau_j = (1 + g_j) Y_j(q, dq, ddq) pi + own_j + e_j,   e_j ~ N(0, v_j)
    pi_k ~ N(described, s_k² spread_k²),   g_j ~ N(0, 0.15²),   1/s_k² ~ gamma

The zero, friction and motor inertia own_j may have any size. The masses and inertias pi_k of each
body k and the gains g_j are integrated out (D. J. C. MacKay, Neural Computation 4 (1992) 415). s_k,
the deviation of body k from the description, is estimated: a body may be as drawn, or carry a
payload, a tool or another motor. Therefore the geometry decides, and a wrong mass or gain is not
mistaken for a wrong zero.

Torques enter through products of columns: another torque for the same motion costs only the
likelihood of these products.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Self

import numpy as np
from scipy.linalg import lapack

from elastic_arm.arrays import Indices, Mask
from elastic_arm.dynamics import Model, build_model
from elastic_arm.recording.inspection.side_motion import SideMotion, independent
from elastic_arm.recording.sides import Array
from elastic_arm.robot import Robot

# relative, of a body as drawn and of the arm's mean body; a tenth is the convention, and two
# degrees of freedom make tails in which payloads and tools lie
MASSES = 0.1
TAILS = 2.0
GAIN = 0.15  # of a torque constant, as the challenge's level `field` draws them


class Arm(NamedTuple):
    """The regressor Y(q, dq, ddq) (N, n, P) of the torques of a side, mean and spread of its
    parameters (P,), the body of each parameter (P,), and which are of the last link (P,)."""

    regressor: Callable[[Array, Array, Array], Array]
    mean: Array
    spread: Array
    body: Indices
    of_last_link: Mask

    @classmethod
    def of(cls, robot: Robot, side: str) -> Self:
        """Return the description of the torques of one side."""
        # A few thousand samples: compiling would take longer than all that is computed.
        n = robot.n
        model = build_model(robot, engine="numpy")

        def regressor(q: Array, dq: Array, ddq: Array) -> Array:
            if robot.elastic:
                q, dq, ddq = (np.tile(rate, 2) for rate in (q, dq, ddq))
            Y = model.regressor(q, dq, ddq)
            return Y[:, :n] + Y[:, n:] if robot.elastic and side == "motor" else Y[:, :n]

        spread, body = _spread(model)
        # The last body may be the rotor of the last joint, of which no parameter is a mass.
        masses = [k for k, one in enumerate(model.parameters) if one.name.endswith(".m")]
        return cls(regressor, model.Psi, spread, body, body == body[masses[-1]])

    def weight(self, motion: SideMotion) -> Array:
        """Return the described gravity (N, n), Nm."""
        still = np.zeros_like(motion.q)
        return self.regressor(motion.q, still, still) @ self.mean


def _spread(model: Model) -> tuple[Array, Indices]:
    """Return the scale of the mass, first moments and inertias of each body, (P,), and the number
    of the body; stiffness and damping have scale zero."""
    names = [parameter.name.rpartition(".") for parameter in model.parameters]
    mass = {owner: 0.0 for owner, *_ in names}
    inertia = dict(mass)
    for (owner, _, what), value in zip(names, model.Psi.tolist(), strict=True):
        mass[owner] += value if what == "m" else 0.0
        inertia[owner] += 0.5 * value if what in {"Ixx", "Iyy", "Izz"} else 0.0
    heavy = [owner for owner in mass if mass[owner]]
    mean_mass = float(np.mean([mass[owner] for owner in heavy]))
    mean_inertia = float(np.mean([inertia[owner] for owner in heavy]))
    sizes = []
    for (owner, *_), parameter in zip(names, model.parameters, strict=True):
        m = mass[owner] + mean_mass
        j = inertia[owner] + mean_inertia
        by_unit = {"kg": m, "kg m": np.sqrt(m * j), "kg m^2": j}
        sizes.append(by_unit.get(parameter.unit, 0.0))
    numbers = {owner: k for k, owner in enumerate(mass)}
    return np.array(sizes), np.array([numbers[owner] for owner, *_ in names])


class Fit(NamedTuple):
    """The likelihood of torques, and what goes with it."""

    likelihood: float  # its logarithm
    size: Array  # (Q,) of the columns
    squares: Array  # (m,) that are left
    scale2: Array  # (Q,) of the columns


class Products(NamedTuple):
    """Products of the columns of the measured joints (m joints), without the contributions of each
    joint alone.

    Columns are the parameters of the arm and the gains, in units of their spreads, (Q,); rows are
    the torques of all joints, the described gravity, and the described torque, (T,).
    """

    grams: Array  # (m, Q, Q) of the columns
    rights: Array  # (m, Q, T) of columns and rows
    powers: Array  # (m, T, T) of the rows
    columns: list[Array]  # (N, Q) of each joint
    rows: list[Array]  # (N, T) of each joint
    measured: list[int]
    body: Indices  # (Q,), -1 of gains
    samples: int

    @classmethod
    def of(
        cls,
        motion: SideMotion,
        arm: Arm,
        weight: Array | None = None,
        own: Sequence[Array] | None = None,
    ) -> Self:
        """Form the products.

        weight: described gravity (N, n) for torques that may lack it; own: :meth:`.SideMotion.own`
        of each measured joint, which follows from velocities and accelerations alone; None to form
        it.
        """
        if own is None:
            own = [motion.own(j) for j in motion.measured]
        Y = arm.regressor(*motion[:3])
        predicted = Y @ arm.mean
        weight = np.zeros_like(predicted) if weight is None else weight
        free = np.flatnonzero(arm.spread)
        m = len(motion.measured)
        columns = []
        rows = []
        for k, (j, basis) in enumerate(zip(motion.measured, own, strict=True)):
            gains = np.zeros((len(Y), m))
            gains[:, k] = GAIN * predicted[:, j]
            moved = Y[:, j, free] * arm.spread[free]
            both = np.column_stack([moved, gains, motion.torque, weight[:, j], predicted[:, j]])
            both -= basis @ (basis.T @ both)
            columns.append(both[:, : len(free) + m])
            rows.append(both[:, len(free) + m :])
        return cls(
            np.array([c.T @ c for c in columns]),
            np.array([c.T @ r for c, r in zip(columns, rows, strict=True)]),
            np.array([r.T @ r for r in rows]),
            columns,
            rows,
            motion.measured,
            np.concatenate([arm.body[free], np.full(m, -1)]),
            len(Y),
        )

    def coefficients(self, torques: Array, missing: Array | None = None) -> Array:
        """Return the coefficients (m, T) of the rows that the arm has to explain.

        torques: (n, n), the assumed torques in terms of the recorded ones; missing: (n,) share of
        the described gravity that each torque lacks.
        """
        n = torques.shape[1]
        found = np.zeros((len(self.measured), n + 2))
        found[:, :n] = torques[self.measured]
        found[:, n] = 0.0 if missing is None else missing[self.measured]
        found[:, n + 1] = -1.0
        return found

    def given(self) -> tuple[Fit, Array]:
        """Return the fit with the description, and the number of independent samples of each
        remainder (m,)."""
        n = self.rows[0].shape[1] - 2
        unit = np.eye(n)
        every = np.full(len(self.measured), float(self.samples))
        fit = self.fit(unit, every, None)
        joints = zip(self.rows, self.columns, self.coefficients(unit), strict=True)
        rests = [rows @ own - columns @ fit.size for rows, columns, own in joints]
        free = np.array([independent(rest, rest) for rest in rests])
        return self.fit(unit, free, fit), free

    def fit(
        self, torques: Array, free: Array, near: Fit | None, missing: Array | None = None
    ) -> Fit:
        """Return the logarithm of the likelihood of the torques.

        The noise of each joint and the deviation of each body from the description are estimated
        by expectation and maximisation.

        torques, missing: as in :meth:`coefficients`; free: number of independent samples of each
        joint's remainder, (m,); near: a similar fit from which the iteration starts.
        """
        coefficients = self.coefficients(torques, missing)
        grams = self.grams
        rights = np.einsum("jqt,jt->jq", self.rights, coefficients)
        power = np.einsum("js,jst,jt->j", coefficients, self.powers, coefficients)
        power = np.maximum(power, 1e-300)
        bodies = np.unique(self.body[self.body >= 0])
        belongs = (self.body[:, None] == bodies).astype(float)
        numbers = belongs.sum(axis=0)
        flat = grams.reshape(len(grams), -1)
        of_gains = self.body < 0
        squares = power if near is None else near.squares
        scale2 = np.where(of_gains, 1.0, MASSES**2) if near is None else near.scale2
        for _ in range(40):
            # Expectation: size of all columns under the present noise and deviations.
            weight = free / np.maximum(squares, 1e-12 * power)
            right = weight @ rights
            covariance, logdet = _covariance(weight, flat, scale2)
            size = covariance @ right
            # Maximisation: noise of the joints, and deviations of the bodies.
            left = power - 2.0 * rights @ size + (grams @ size) @ size
            left += flat @ covariance.ravel()
            second = (size**2 + np.diag(covariance)) @ belongs
            deviations = (TAILS * MASSES**2 + second) / (TAILS + numbers + 2.0)
            used = squares, scale2
            squares = np.maximum(left, 1e-12 * power)
            scale2 = np.where(of_gains, 1.0, belongs @ deviations)
            before = np.concatenate(used)
            change = np.abs(np.concatenate([squares, scale2]) - before)
            if np.all(change <= 0.01 * before):
                break
        squares, scale2 = used
        of_noise = free @ np.log(squares / self.samples)
        likely = -0.5 * float(of_noise + weight @ power - right @ covariance @ right)
        likely -= 0.5 * logdet
        of_bodies = scale2[~of_gains] @ belongs[~of_gains] / numbers
        gamma = (TAILS / 2.0 + 1.0) * np.log(of_bodies) + TAILS * MASSES**2 / 2.0 / of_bodies
        likely -= float(gamma.sum())
        return Fit(likely, size, squares, scale2)


def _covariance(weight: Array, flat: Array, scale2: Array) -> tuple[Array, float]:
    """Return the posterior covariance (Q, Q) of the columns, and ln of the determinant of its
    inverse in units of the prior.

    weight: (m,) of the joints; flat: (m, Q²) products; scale2: (Q,) prior variances.
    """
    std = np.sqrt(scale2)
    scales = np.outer(std, std)
    known = scales * (weight @ flat).reshape(scales.shape)
    known.flat[:: len(known) + 1] += 1.0  # the diagonal
    inverse, logdet = _inverse(known)
    return scales * inverse, logdet


def _inverse(matrix: Array) -> tuple[Array, float]:
    """Return the inverse of a positive definite matrix (Q, Q), and ln of its determinant."""
    factor, _ = lapack.dpotrf(matrix, lower=1)
    half, _ = lapack.dpotri(factor, lower=1)
    inverse = half + half.T  # LAPACK's lower half and zeros above it
    np.fill_diagonal(inverse, np.diag(half))
    logdet = 2.0 * float(np.sum(np.log(np.diag(factor))))
    return inverse, logdet
