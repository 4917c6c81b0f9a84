"""Residuals of a recording: what the measured torques exceed the model by, three a joint.

Rows are ordered equation by equation: [link of all joints, drive of all joints, motor of all joints].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_opening, find_objects, label

from elastic_arm.dynamics import Model
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.equations import EquationSet
from elastic_arm.estimation.motion import CompletedMotion, completed, drive_constants
from elastic_arm.estimation.observation import Observation

Array = NDArray[np.float64]

SLOWEST = 5e-4  # rad/s: slower than this a joint counts as standing, whatever the noise
SLOW = 0.005  # of a joint's highest speed, below which it sticks if it is as slow for as long as STICKING
STICKING = 0.03  # s
LEAST_MOVING = 0.5  # of a stretch: the least that is left where rows are left out
MOST_STICKING = 0.3  # of a stretch; a joint that sticks longer is one that stands still
RANK = 0.05  # of the strongest: courses of friction that show less in the band are left in


def raw_residuals(model: Model, motion: CompletedMotion) -> Array:
    """Residuals (N, 3 n) Nm of completed motion at the recording's rate."""
    n = model.n
    if not model.robot.elastic:
        # A torque sensor at the joint does not feel the armature, which is in the motor's row.
        motor = armatures(model) * motion.ddq
        link = model.inverse_dynamics(motion.q, motion.dq, motion.ddq) - motor
        return np.hstack([motion.tau_J - link, np.zeros_like(link), motion.tau_m - motion.tau_J - motor])
    K, D = drive_constants(model)
    spring = K * (motion.theta - motion.q) + D * (motion.dtheta - motion.dq)
    left = model.inverse_dynamics(*(motion.coordinates(rate) for rate in ("", "d", "dd")))
    # The left side of (1) holds the spring in both rows; the residuals have the sensor's torque in its place.
    link = motion.tau_J - (left[:, :n] + spring)
    motor = motion.tau_m - (left[:, n : 2 * n] - spring) - motion.tau_J
    return np.hstack([link, motion.tau_J - spring, motor])


def armatures(model: Model) -> Array:
    """Return the armatures (n,) kg m² of an arm without transmissions; zero where its description states none."""
    found = np.zeros(model.n)
    for spin in model.bodies.spins:
        found[spin.gears[0][0]] += model.Psi[spin.parameter]
    return found


def predicted_torques(model: Model, motion: CompletedMotion) -> tuple[Array, Array]:
    """Return the joint torque and the motor torque (N, n) that the model predicts for a motion, Nm."""
    n, raw = model.n, raw_residuals(model, motion)
    load = motion.tau_J - raw[:, :n]
    return load, motion.tau_m - motion.tau_J - raw[:, 2 * n :] + load


@dataclass(frozen=True)
class Stretch:
    """Residuals of one stretch without holes, in the band, at the kept rate.

    Parameters
    ----------
    t
        (N',) s.
    values
        (N', R) Nm.
    motion
        The completed motion at the recording's rate that they were made of.
    quiet
        The same motion, smoothed further, for the columns of effects.
    kept
        Which of the rows that the band gives for the motion they are.
    """

    t: Array
    values: Array
    motion: CompletedMotion
    quiet: CompletedMotion
    kept: slice


def residuals(model: Model, observation: Observation, equations: EquationSet, band: Band) -> list[Stretch]:
    """Return the residuals of every stretch of a recording.

    Parameters
    ----------
    model
        The nominal model.
    observation
        The recording, smoothed.
    equations
        Usable equations, R rows.
    band
        In which the residuals are looked at.
    """
    stretches = []
    for piece, calm in zip(observation.pieces, observation.quiet, strict=True):
        motion, quiet = completed(piece, model), completed(calm, model)
        full = raw_residuals(model, motion) @ equations.transform.T
        t = band.times(motion.t)
        first, last = np.searchsorted(t, [motion.t[0] + observation.margin, motion.t[-1] - observation.margin])
        kept = slice(int(first), int(last))
        stretches.append(Stretch(t[kept], band.apply(full)[kept], motion, quiet, kept))
    return [s for s in stretches if len(s.t) > band.kept_rate]


@dataclass(frozen=True)
class Sticking:
    """What is removed of the rows of a stretch.

    Parameters
    ----------
    moving
        (N', R) 0 for a row that is left out, else 1.
    friction
        Orthonormal (N', m) of each row that holds a sticking motor's friction: what it can be in the band, were it any
        torque while the joint sticks. Infinite prior variance: it is projected out of residuals and columns alike.
    """

    moving: Array
    friction: tuple[Array | None, ...]

    @classmethod
    def none(cls, stretch: Stretch, rows: int) -> Sticking:
        """Return what removes nothing."""
        return cls(np.ones((len(stretch.t), rows)), (None,) * rows)

    @classmethod
    def of(cls, stretch: Stretch, band: Band, layout: EquationSet) -> Sticking:
        """Return what is removed of a stretch.

        Where a joint sticks, all rows are left out; where that would leave less than half, those alone that hold the
        friction of its motor; and where these would be less than half, too, they are freed of the friction. A joint
        that hardly moves in the whole stretch does not count.

        Parameters
        ----------
        stretch
            Of residuals.
        band
            Its filter carries what sticks over to rows around.
        layout
            The usable equations.
        """
        sticks, stuck = stuck_rows(stretch, band, layout), _stuck(stretch)
        friction = [
            _friction(stretch, band, stuck[:, joint]) if column.mean() > 1.0 - LEAST_MOVING else None
            for column, (_, joint) in zip(sticks.T, layout.entries, strict=True)
        ]
        freed = np.array([basis is not None for basis in friction])
        return cls(np.where(sticks & ~freed, 0.0, 1.0), tuple(friction))

    def remove(self, values: Array) -> Array:
        """Return residuals or columns (N', R, …) without it."""
        out = values
        if not self.moving.all():
            out = np.asarray(values * self.moving.reshape(*self.moving.shape, *[1] * (values.ndim - 2)))
        elif any(basis is not None for basis in self.friction):
            out = values.copy()
        for row, basis in enumerate(self.friction):
            if basis is not None and out[:, row].any():
                out[:, row] -= basis @ (basis.T @ out[:, row])
        return out

    @property
    def share_left(self) -> float:
        """Share of the rows' degrees of freedom that are left."""
        lost = sum(0 if basis is None else basis.shape[1] for basis in self.friction)
        return float(self.moving.mean()) - lost / self.moving.size


def stuck_rows(stretch: Stretch, band: Band, layout: EquationSet) -> NDArray[np.bool_]:
    """Return the rows (N', R) of instants at which a joint sticks, as far as the band's filter carries it.

    All rows of an instant; where that would leave less than half of the stretch, those that hold the friction of the
    joint's motor.

    Parameters
    ----------
    stretch
        Of residuals.
    band
        Its filter carries what sticks over to rows around.
    layout
        The usable equations.
    """
    stuck = _stuck(stretch)
    together = _around(stretch, band, np.asarray(stuck.any(axis=1)))
    if together.mean() <= 1.0 - LEAST_MOVING:
        return np.repeat(together[:, None], layout.rows, axis=1)
    own = [_around(stretch, band, column) for column in stuck.T]
    holds = [equation.combination[2] != 0 for equation, _ in layout.entries]
    return np.stack([own[joint] & held for held, (_, joint) in zip(holds, layout.entries, strict=True)], axis=1)


def _stuck(stretch: Stretch) -> NDArray[np.bool_]:
    """Return where joints stick, (N, n) at the recording's rate."""
    t, speed = stretch.quiet.t, np.abs(stretch.quiet.dtheta)
    slow = speed < np.maximum(SLOW * speed.max(axis=0), 2.0 * SLOWEST)
    length = np.ones(max(1, round(STICKING / (t[1] - t[0]))))
    sticks = np.stack([binary_opening(column, length) for column in slow.T], axis=1)
    return np.asarray(sticks & (sticks.mean(axis=0) < MOST_STICKING))


def _around(stretch: Stretch, band: Band, stuck: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which instants (N',) the filter carries something to that sticks at some of (N,)."""
    t = stretch.quiet.t
    if stuck.any():
        around = round((0.5 * len(band.taps) / band.rate + STICKING) / (t[1] - t[0]))
        stuck = np.asarray(binary_dilation(stuck, iterations=around))
    return np.asarray(stuck[np.clip(np.searchsorted(t, stretch.t), 0, len(t) - 1)])


def _friction(stretch: Stretch, band: Band, stuck: NDArray[np.bool_]) -> Array | None:
    """Return an orthonormal basis (N', m) of the friction of a joint that sticks where `stuck` (N,), in the band."""
    step = float(stretch.quiet.t[1] - stretch.quiet.t[0])
    if not stuck.any():
        return None
    numbered, _ = label(binary_dilation(stuck, iterations=max(1, round(STICKING / step))))
    free = np.concatenate([_polynomials(len(stuck), piece[0], step, band) for piece in find_objects(numbered)], axis=1)
    shown = band.apply(free)[stretch.kept]
    left, singular, _ = np.linalg.svd(shown, full_matrices=False)
    basis = left[:, singular > RANK * singular[0]]
    return basis if basis.shape[1] else None


def _polynomials(length: int, piece: slice, step: float, band: Band) -> Array:
    """Return Legendre polynomials (length, m) over a piece, null outside; as many as the band resolves in it."""
    count = piece.stop - piece.start
    degree = min(count - 1, 2 + int(2.0 * band.cutoff * count * step))
    out = np.zeros((length, degree + 1))
    out[piece] = legvander(np.linspace(-1.0, 1.0, count), degree) if count > 1 else 1.0
    return out
