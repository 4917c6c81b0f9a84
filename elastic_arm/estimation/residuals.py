"""Where the gap lies: three residuals a joint, the noise of each, and what of them is more than noise.

Rows are ordered equation by equation: [link of all joints, drive of all joints, motor of all joints].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics import Model
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.band import Band, LowPass
from elastic_arm.estimation.observation import Observation
from elastic_arm.estimation.smoother import Motion

Array = NDArray[np.float64]

SIDES = ("link", "drive", "motor")
STIFF = 12.0  # Hz, up to which the deflection behind a single encoder follows the load
PADDING = 500  # samples
NOISE_FREQUENCIES = 400
# Poses at which the inertia is looked up for the way of encoder noise into the residuals.
POSES = 12
# Part of the torque channels' noise that every equation is given on its own: without it, exact encoders would make the
# difference of two equations that share a torque sensor exact too, and rounding in the filters would look like physics.
FLOOR = 0.1


@dataclass(frozen=True)
class Layout:
    """Which equations the recorded channels allow, as combinations of the full three.

    Parameters
    ----------
    n
        Joints.
    transform : (R n, 3 n)
        From the full rows to those that hold no missing channel.
    sides
        Name of each row block.
    """

    n: int
    transform: Array
    sides: tuple[str, ...]

    @staticmethod
    def of(motion: Motion, n: int) -> Layout:
        """Find the usable equations; without joint torque sensors the drive's law stands in for them."""
        one, zero = np.eye(n), np.zeros((n, n))
        has_link, has_motor = motion.q is not None, motion.theta is not None
        blocks: dict[str, Array] = {}
        if motion.tau_J is not None:
            rows = {"link": has_link, "drive": has_link and has_motor, "motor": has_motor and motion.tau_m is not None}
            blocks = {side: np.hstack([one if s == side else zero for s in SIDES]) for side in SIDES if rows[side]}
        else:
            if has_link and has_motor:
                blocks["link"] = np.hstack([one, -one, zero])
                if motion.tau_m is not None:
                    blocks["motor"] = np.hstack([zero, one, one])
            else:
                # One encoder alone: the arm as a whole, its springs bridged.
                blocks["motor"] = np.hstack([one, zero, one])
        return Layout(n, np.vstack(list(blocks.values())), tuple(blocks))

    @property
    def rows(self) -> int:
        """Number of residuals."""
        return len(self.sides) * self.n


@dataclass(frozen=True)
class CompletedMotion:
    """Motion with every channel, (N, n) each; what was not recorded is stood in for by what no usable row sees."""

    t: Array
    q: Array
    dq: Array
    ddq: Array
    theta: Array
    dtheta: Array
    ddtheta: Array
    tau_J: Array
    tau_m: Array

    def __len__(self) -> int:
        return len(self.t)


def completed(motion: Motion, model: Model) -> CompletedMotion:
    """Fill in missing channels by what cancels from the usable rows."""
    K, D = drive_constants(model)
    link, motor = (motion.q, motion.dq, motion.ddq), (motion.theta, motion.dtheta, motion.ddtheta)
    q, dq, ddq = (own if own is not None else other for own, other in zip(link, motor, strict=True))
    if motion.q is None and model.robot.elastic and q is not None and dq is not None and ddq is not None:
        wound = _deflection(model, motion.t, q, dq, ddq)
        q, dq, ddq = q - wound[0], dq - wound[1], ddq - wound[2]
    theta, dtheta, ddtheta = (own if own is not None else other for own, other in zip(motor, link, strict=True))
    if q is None or dq is None or ddq is None or theta is None or dtheta is None or ddtheta is None:
        raise DiagnosisError("the recording holds no positions", "Record /motor_states or /joint_states with positions")
    tau_J = motion.tau_J if motion.tau_J is not None else K * (theta - q) + D * (dtheta - dq)
    tau_m = motion.tau_m if motion.tau_m is not None else np.zeros_like(tau_J)
    return CompletedMotion(motion.t, q, dq, ddq, theta, dtheta, ddtheta, tau_J, tau_m)


def _deflection(model: Model, t: Array, q: Array, dq: Array, ddq: Array) -> tuple[Array, Array, Array]:
    """Deflection of the drives (N, n), and two derivatives, under the load that the arm would be if it were stiff.

    It stands in for the link encoder at low frequencies, where the load hardly depends on the deflection.
    """
    n = model.n
    K, D = drive_constants(model)
    load = model.inverse_dynamics(*(np.hstack([v, v]) for v in (q, dq, ddq)))[:, :n]
    padded = np.pad(load, ((PADDING, PADDING), (0, 0)), mode="reflect")
    f = np.fft.rfftfreq(len(padded), t[1] - t[0])[:, None]
    s = 2j * np.pi * f
    wound = np.fft.rfft(padded, axis=0) * np.exp(-0.5 * (f / STIFF) ** 2) / (K + s * D)
    kept = slice(PADDING, PADDING + len(load))
    found = [np.fft.irfft(wound * s**k, len(padded), axis=0)[kept] for k in range(3)]
    return found[0], found[1], found[2]


def drive_constants(model: Model) -> tuple[Array, Array]:
    """Return K (n,) Nm/rad and D (n,) Nm s/rad of the model; nothing for an arm without transmissions."""
    drives = [spring for spring in model.bodies.springs if spring.against is not None]
    if not drives:
        return np.zeros(model.n), np.zeros(model.n)
    return model.Psi[[spring.stiffness for spring in drives]], model.Psi[[spring.damping for spring in drives]]


def raw_residuals(model: Model, motion: CompletedMotion) -> Array:
    """Residuals (N, 3 n) Nm of completed motion at the recording's rate."""
    n = model.n
    if not model.robot.elastic:
        left = model.inverse_dynamics(motion.q, motion.dq, motion.ddq)
        return np.hstack([motion.tau_J - left, np.zeros_like(left), motion.tau_m - motion.tau_J])
    K, D = drive_constants(model)
    spring = K * (motion.theta - motion.q) + D * (motion.dtheta - motion.dq)
    left = model.inverse_dynamics(
        np.hstack([motion.q, motion.theta]),
        np.hstack([motion.dq, motion.dtheta]),
        np.hstack([motion.ddq, motion.ddtheta]),
    )
    # The left side of (1) holds the spring in both rows; the residuals have the sensor's torque in its place.
    link = motion.tau_J - (left[:, :n] + spring)
    motor = motion.tau_m - (left[:, n : 2 * n] - spring) - motion.tau_J
    return np.hstack([link, motion.tau_J - spring, motor])


@dataclass(frozen=True)
class NoiseModel:
    """Joint noise of all usable rows over frequency, from the noise of the channels.

    The noise of tau_J is common to the three equations (+, +, -), that of an encoder to those it enters.

    Parameters
    ----------
    f
        (F,) Hz, equally spaced from 0 to half the kept rate.
    covariance
        (F, R, R) complex, Nm²; white noise of 1 Nm a sample is the identity.
    rate
        Samples per second of the recording.
    """

    f: Array
    covariance: NDArray[np.complex128]
    rate: float

    def std(self, low_pass: LowPass) -> Array:
        """Return the standard deviation (R,) of each residual behind a low pass."""
        density = np.real(np.einsum("frr->fr", self.covariance)) * low_pass.gain(self.f)[:, None] ** 2
        width = self.f[1] - self.f[0]
        return np.sqrt(np.trapezoid(density, dx=width, axis=0) * 2.0 / self.rate)

    def whitener(self, f: NDArray[Any]) -> NDArray[np.complex128]:
        """Return W (F', R, R) with W covariance W^H = 1 at f (F',) Hz within the band."""
        index = np.clip(np.rint(f / (self.f[1] - self.f[0])).astype(int), 0, len(self.f) - 1)
        return self._whitener[index]

    @cached_property
    def _whitener(self) -> NDArray[np.complex128]:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance)), dtype=np.complex128)


def noise_model(
    model: Model, observation: Observation, layout: Layout, band: Band, *, floor: float = FLOOR
) -> NoiseModel:
    """Propagate the channels' noise into the usable residuals.

    Parameters
    ----------
    floor
        Share of the torque noise that each equation gets besides, 0 for the noise itself.
    """
    n = layout.n
    f = np.linspace(0.0, band.kept_rate / 2, NOISE_FREQUENCIES)
    s = 2j * np.pi * f[:, None, None]
    K, D = (np.diag(v) for v in drive_constants(model))
    one, zero = np.eye(n), np.zeros((n, n))
    ones = np.ones((len(f), 1, 1))
    drive = K + s * D
    torque = np.hstack([observation.torque_spectrum(c, f, n) for c in ("tau_J", "tau_m")])
    position = np.hstack([observation.position_spectrum(side, f) for side in ("link", "motor")])
    spectrum = np.hstack([torque, position])
    covariance = np.zeros((len(f), layout.rows, layout.rows), dtype=complex)
    poses = _inertias(model, observation)
    for M, S, B in poses:
        # Rows link, drive, motor of the full three; columns tau_J, tau_m, q, theta.
        rows = [
            [ones * one, ones * zero, -(s**2) * M, -(s**2) * S],
            [ones * one, ones * zero, drive, -drive],
            [ones * -one, ones * one, -(s**2) * S.T, -(s**2) * B],
        ]
        way = layout.transform @ np.concatenate([np.concatenate(row, axis=2) for row in rows], axis=1)
        covariance += (way * spectrum[:, None, :]) @ way.conj().transpose(0, 2, 1) / len(poses)
    level = np.max(torque.mean(axis=0)) if torque.any() else 0.0
    extra = floor**2 * level + 1e-8
    covariance = covariance + extra * np.eye(layout.rows)
    return NoiseModel(f, covariance, observation.rate)


def _inertias(model: Model, observation: Observation) -> list[tuple[Array, Array, Array]]:
    """Return M, S, B at poses along the motion: the way of the encoders' noise changes with the pose."""
    n = model.n
    motion = max(observation.pieces, key=len)
    position = motion.q if motion.q is not None else motion.theta
    assert position is not None
    poses = position[:: max(1, len(motion) // POSES)]
    if not model.robot.elastic:
        none = np.zeros((n, n))
        return [(M, none, none) for M in model.mass_matrix(poses)]
    whole = model.mass_matrix(np.hstack([poses, poses]))
    return [(m[:n, :n], m[:n, n:], m[n:, n:]) for m in whole]


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


def residuals(model: Model, observation: Observation, layout: Layout, band: Band) -> list[Stretch]:
    """Return the residuals of every stretch of a recording."""
    stretches = []
    for piece, calm in zip(observation.pieces, observation.quiet, strict=True):
        motion, quiet = completed(piece, model), completed(calm, model)
        full = raw_residuals(model, motion) @ layout.transform.T
        t = band.times(motion.t)
        first, last = np.searchsorted(t, [motion.t[0] + observation.margin, motion.t[-1] - observation.margin])
        kept = slice(int(first), int(last))
        stretches.append(Stretch(t[kept], band.apply(full)[kept], motion, quiet, kept))
    return [s for s in stretches if len(s.t) > band.kept_rate]


def block_means(squares: Sequence[Array], length: int) -> Array:
    """Return means (blocks, k) of consecutive blocks of `length` rows of each part."""
    blocks: list[Array] = []
    for part in squares:
        count = max(1, len(part) // length)
        blocks.extend(np.mean(piece, axis=0) for piece in np.array_split(part, count))
    return np.array(blocks)
