"""The motion and the torques of each side of a recording, smoothed in the same way.

Friction then reverses as gradually as in the smoothed torque.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np
from scipy.signal import fftconvolve, savgol_coeffs, savgol_filter

from elastic_arm.arrays import median_step
from elastic_arm.recording.inspection.plausibility import is_motion
from elastic_arm.recording.inspection.report import FEWEST
from elastic_arm.recording.made_torque import joints_with_duty, with_made_torque
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, Samples
from elastic_arm.robot import Robot

ENOUGH = 5000  # samples that are looked at; bounds the time
RANK = 1e-9  # of the largest singular value; numerical
TURNOVER = 0.01  # rad/s within which friction turns over; convention
# of places in the window; their number is numerical
SMOOTHING = np.convolve(savgol_coeffs(21, 3), savgol_coeffs(21, 3))
SIDES = {"tau_J": "link", "tau_m": "motor"}


class SideMotion(NamedTuple):
    """Motion and torques (N, n) of a side, the joints with a measured torque, and the width of the
    smoothing window in seconds."""

    q: Array
    dq: Array
    ddq: Array
    torque: Array
    measured: list[int]
    window: float
    of_duty: bool = False  # whether described electrics make the torques of a recorded duty

    def moved(self, turn: Callable[[Array], Array]) -> Self:
        """Return the motion with other angles."""
        return self._replace(q=turn(self.q), dq=turn(self.dq), ddq=turn(self.ddq))

    def every(self, step: int) -> Self:
        """Return every `step`-th sample."""
        return self.moved(lambda rate: rate[::step])._replace(torque=self.torque[::step])

    def own(self, j: int, *more: Array) -> Array:
        """Return an orthonormal basis (N, r) of the zero, friction and motor inertia of a joint,
        and of further columns.

        The dry friction is smoothed in the same way as the torques.
        """
        ahead = self.window * np.linspace(-0.5, 0.5, len(SMOOTHING))
        speeds = self.dq[:, j, None] + self.ddq[:, j, None] * ahead
        friction = np.tanh(speeds / TURNOVER) @ SMOOTHING
        columns = [np.ones(len(friction)), friction, self.dq[:, j], self.ddq[:, j], *more]
        scaled = np.column_stack(
            [column / max(float(np.linalg.norm(column)), 1e-300) for column in columns]
        )
        basis, sizes, _ = np.linalg.svd(scaled, full_matrices=False)
        return basis[:, sizes > RANK * sizes[0]]


Motions = list[tuple[str, SideMotion]]  # with the sides whose torques they hold


def together(motions: Motions) -> Iterator[tuple[str, SideMotion]]:
    """Yield each side with all its motions as one."""
    for side in SIDES.values():
        own = [motion for name, motion in motions if name == side]
        if not own:
            continue
        every = max(1, sum(len(motion.q) for motion in own) // ENOUGH)
        q, dq, ddq, torque = (
            np.concatenate(parts)[::every] for parts in list(zip(*own, strict=True))[:4]
        )
        measured = sorted(set.intersection(*(set(motion.measured) for motion in own)))
        of_duty = any(motion.of_duty for motion in own)
        if len(q) >= FEWEST:  # fewer are left if there are holes everywhere
            yield side, SideMotion(q, dq, ddq, torque, measured, own[0].window, of_duty)


def side_motions(recording: Recording, robot: Robot) -> Iterator[tuple[str, SideMotion]]:
    """Yield the sides with torques and their motion; nothing if the arm does not move.

    The described electrics make the torques of a recorded duty.

    Raises a RobotError if the description states no electrics of a joint whose duty was recorded.
    """
    recording = recording.select(robot.joint_names)
    of_duty = bool(joints_with_duty(recording))
    if of_duty:
        recording = with_made_torque(replace(recording, reference=None), robot)
    samples = recording.samples()
    position = samples.q if samples.q is not None else samples.theta
    # 1.0 s; the ends that differentiation spoils take 0.2 s
    if (
        position is None
        or len(samples) < FEWEST
        or samples.t[-1] < 1.0
        or not is_motion(samples.t, position)
    ):
        return
    for channel, side in SIDES.items():
        if getattr(samples, channel) is not None:
            motion = _motion(samples, position, channel)
            yield side, motion._replace(of_duty=of_duty and side == "motor")


def _motion(samples: Samples, position: Array, channel: str) -> SideMotion:
    step = median_step(samples.t)
    # 0.1 s over which all is smoothed: gravity changes more slowly
    width = max(round(0.1 / step) // 2 * 2 + 1, 5)

    def smooth(values: Array) -> Array:
        """Smooth as well as a derivative needs it, of motion and torques alike."""
        once = savgol_filter(values, width, 3, axis=0)
        return savgol_filter(once, width, 3, axis=0)

    # Over numbers of samples, and of the times at these: some may be missing.
    q = smooth(position)
    t = smooth(samples.t[:, None])
    slope = np.gradient(t, axis=0)
    dq = np.gradient(q, axis=0) / slope
    ddq = (_bend(q) - dq * _bend(t)) / slope**2
    # Across a hole there is no derivative.
    holes = np.zeros(len(position), np.bool_)
    for row in np.flatnonzero(np.diff(samples.t) > 2.5 * step).tolist():
        holes[max(row - width, 0) : row + width + 2] = True
    rows = np.flatnonzero(~holes)[width:-width]
    rows = rows[:: max(1, len(rows) // ENOUGH)]
    torque = smooth(getattr(samples, channel))
    lacking = [(channel, j) in samples.lacking for j in range(position.shape[1])]
    # 1e-9 Nm; what changes less is none
    measured = np.flatnonzero((np.ptp(torque, axis=0) > 1e-9) & ~np.array(lacking)).tolist()
    window = 2 * (width - 1) * step
    return SideMotion(q[rows], dq[rows], ddq[rows], torque[rows], measured, window)


def _bend(values: Array) -> Array:
    """Return the second differences (N, k) of values; zero at the ends."""
    return np.pad(np.diff(values, n=2, axis=0), [(1, 1), (0, 0)])


def independent(one: Array, other: Array) -> float:
    """Return the number of independent samples to which two series (N,) correspond.

    It follows from their autocorrelations (M. S. Bartlett, Journal of the Royal Statistical Society
    98 (1935) 536).
    """
    alike = [
        fftconvolve(each, each[::-1])[len(each) :] / max(float(each @ each), 1e-300)
        for each in (one, other)
    ]
    return len(one) / max(1.0, 1.0 + 2.0 * float(alike[0] @ alike[1]))
