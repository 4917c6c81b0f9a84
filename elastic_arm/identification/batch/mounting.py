"""How an arm is mounted as its torques show it, where its description has it mounted otherwise.

A description rarely states how the arm was mounted: on a wall, upside down, on its side. About a wrong mounting all
else is far from linear, and masses and gains of a calibration stand in for it. So it is looked for first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from elastic_arm.arrays import Array
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.estimation.motion import Motion
from elastic_arm.identification.verdict import MotionStatistics
from elastic_arm.recording.inspection.described_gravity import LEFT, OVERHEAD, SIZE, TURNED, angle_between
from elastic_arm.robot import Robot

ENOUGH = 2000  # samples of a motion that are looked at; bounds the time
STRAIGHT = 1e-6  # of its size, by which gravity may be off straight down; numerical
# Probability that another direction explains so much more by chance. Masses that are off are no chance, and short
# motions take them for gravity: of 600 recordings of 5 s two had 7e-3 and 3e-4. True ones of 20 s have 1e-20.
CHANCE = 1e-5
STEP = 1.0  # degree to which a mounting is known: masses are off, and what is compiled for an arm serves the next one


@dataclass(frozen=True)
class Mounting:
    """A base that is turned, as the effect `base_tilt` has it."""

    # x, y: rad; turned by Rx(x) Ry(y) in the ground frame from where the description has it. About the vertical
    # nothing shows.
    x: float
    y: float
    # shown, described: (3,), Gravity in the frame of the ground as described, m/s², as the torques show it and as
    # described
    shown: Array
    described: Array

    @property
    def rotation(self) -> Array:
        """The turn (3, 3) in the ground frame."""
        return about_x(self.x) @ about_y(self.y)

    def of(self, robot: Robot) -> Robot:
        """Return the arm as it is mounted."""
        turn = np.eye(4)
        turn[:3, :3] = self.rotation
        return robot.with_(base_placement=turn @ robot.base_placement, base_dh=None)

    @property
    def note(self) -> str:
        """What the reader should know of it."""
        shown, stated = (" ".join(f"{value:.3g}" for value in each) for each in (self.shown, self.described))
        turn = f"Rx({np.degrees(self.x):.0f}°) Ry({np.degrees(self.y):.0f}°)"
        note = (
            f"the torques show gravity of {shown} m/s², where the description has {stated}: the arm is mounted "
            f"otherwise, and is taken for turned by {turn} (base, in robot.yaml), its tilt from there identified, too"
        )
        overhead = angle_between(self.shown, self.described) >= OVERHEAD
        return f"{note}; slow torques of the wrong sign look the same" if overhead else note

    def tilted(self, x: float, y: float) -> tuple[float, float]:
        """Return both turns as one, rad: that of the arm as mounted by a further Rx(x) Ry(y), and this one."""
        return tilt_of(self.rotation.T @ (about_x(x) @ about_y(y)).T @ self.described)

    @property
    def undone(self) -> tuple[float, float]:
        """The tilt x, y, rad, under which the arm as mounted would feel gravity as described."""
        return tilt_of(self.rotation @ self.described)


def about_x(angle: float) -> Array:
    """Return the rotation (3, 3) about x."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def about_y(angle: float) -> Array:
    """Return the rotation (3, 3) about y."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def tilt_of(gravity: Array) -> tuple[float, float]:
    """Return x, y, rad, with Rx(x) Ry(y) the turn under which gravity straight down is felt as `gravity` (3,)."""
    down = gravity / np.linalg.norm(gravity)
    return float(-np.arcsin(np.clip(down[1], -1.0, 1.0))), float(np.arctan2(down[0], -down[2]))


def other_mounting(robot: Robot, model: str, motions: Sequence[Motion]) -> Mounting | None:
    """Return how the arm is mounted, where its torques exclude what is described; None where they do not.

    Torques are linear in gravity, whatever its direction: three columns, beside dry friction and a zero of each joint.
    The joints that carry most decide. Only where another direction explains them far better, by more than chance, and
    better than channels of the wrong sign or springs would, the arm is called mounted otherwise.
    """
    described, turning = np.asarray(robot.gravity, dtype=float), [not joint.prismatic for joint in robot.joints]
    size = float(np.linalg.norm(described))
    # Turns are those of gravity straight down.
    if not (size and motions and any(turning)) or described[2] > -(1.0 - STRAIGHT) * size:
        return None
    longest = max(motions, key=len)
    found = _torques(robot, model, longest)
    if found is None:
        return None
    measured, moved, pull, joints, springs = (each[:, turning] for each in found)
    coefficients, left = _least_squares(np.concatenate([pull, joints], axis=2), measured - moved)
    # Each joint has its own friction and zero: what they leave of it does not depend on the others.
    stands, reversed_ = (_left_by_joint(joints, sign * measured - moved - pull @ described) for sign in (1.0, -1.0))
    sprung = _left_by_joint(np.concatenate([joints, springs], axis=2), measured - moved - pull @ described)
    before = float(stands.sum())
    if float(np.min([stands, reversed_, sprung], axis=0).sum()) < left:
        return None
    shown = coefficients[:3]
    length = float(np.linalg.norm(shown))
    if (
        angle_between(shown, described) <= TURNED
        or not SIZE[0] * size <= length <= SIZE[1] * size
        or left >= LEFT * before
        or _chance(before, left, longest, joints.shape[1:]) > CHANCE
    ):
        return None
    x, y = (np.radians(STEP * round(np.degrees(angle) / STEP)) for angle in tilt_of(shown))
    return Mounting(float(x), float(y), shown, described)


def _torques(robot: Robot, model: str, motion: Motion) -> tuple[Array, ...] | None:
    """Return torques (N, n), those of the motion, what gravity pulls, friction and zero, and springs (N, n, k).

    None where the motion holds no torques or angles of all joints.
    """
    link, motor = _side(motion.q, motion.dq, motion.ddq), _side(motion.theta, motion.dtheta, motion.ddtheta)
    torque = motion.tau_m if motion.tau_m is not None else motion.tau_J
    recorded = [side for side in (link, motor) if side is not None]
    if torque is None or not recorded or motion.lacking:
        return None
    every, n = slice(0, None, max(1, len(motion) // ENOUGH)), robot.n
    # Links stand in for their motors, and the other way about: a deflection hardly turns what gravity pulls at.
    sides = (recorded[0], recorded[-1]) if robot.elastic else recorded[:1]
    x, dx, ddx = (np.hstack([side[k] for side in sides])[every] for k in range(3))
    moved, pull = ArmEquations(robot, model).moved_and_pulled(x, dx, ddx, motors=motion.tau_m is not None)
    friction = np.sign(dx[:, -n:])[:, :, None] * np.eye(n)
    joints = np.concatenate([friction, np.broadcast_to(np.eye(n), friction.shape)], axis=2)
    return torque[every], moved, pull, joints, x[:, :n, None] * np.eye(n)


def _side(*channels: Array | None) -> list[Array] | None:
    """Return the angle of one side and its rates; None where it was not recorded."""
    found = [channel for channel in channels if channel is not None]
    return found if len(found) == len(channels) else None


def _chance(before: float, left: float, motion: Motion, laws: tuple[int, ...]) -> float:
    """Return the probability that gravity of no other direction leaves so much less, by the F test.

    Errors last as long as the motion does: a joint's samples are worth two independent ones a swing.
    """
    statistics = MotionStatistics()
    statistics.add(motion)
    joints, coefficients = laws
    freedom = joints * statistics.effective_samples - coefficients - 3
    if freedom <= 0 or left <= 0:
        return float(freedom <= 0)
    return float(fdtrc(3, freedom, (before - left) / 3 / (left / freedom)))


def _left_by_joint(columns: Array, target: Array) -> Array:
    """Return the sum of squares (n,) that friction and zero (N, n, m) of each joint leave of its torque (N, n)."""
    lone = [_least_squares(columns[:, [j]], target[:, [j]])[1] for j in range(target.shape[1])]
    return np.array(lone)


def _least_squares(columns: Array, target: Array) -> tuple[Array, float]:
    """Return the coefficients (m,) of columns (N, n, m), and the sum of squares that they leave."""
    flat, wanted = columns.reshape(-1, columns.shape[2]), target.ravel()
    found = np.asarray(np.linalg.lstsq(flat, wanted, rcond=None)[0], dtype=np.float64)
    return found, float(np.sum((wanted - flat @ found) ** 2))
