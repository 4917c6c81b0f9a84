"""Find how an arm is mounted from its torques, if the description states another mounting.

    tau = tau(q, q', q'', gravity = 0) + G(q) gravity + F sign(q') + zero

A description rarely states whether the arm is mounted on a wall, upside down, or on its side. About
a wrong mounting, all other estimates are far from linear, and masses and gains would compensate for
it. Therefore the mounting is determined first.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import fdtrc

from elastic_arm.arrays import Array
from elastic_arm.effects import EffectInstance
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.library.base_tilt import TILT
from elastic_arm.estimation.motion import Motion
from elastic_arm.formatting import short_numbers
from elastic_arm.identification.verdict import MotionStatistics
from elastic_arm.recording.inspection.described_gravity import angle_between, is_turned
from elastic_arm.robot import Robot
from elastic_arm.robot.parts import placed

ENOUGH = 2000  # samples of a motion that are looked at; bounds the time
STRAIGHT = 1e-6  # of its size, by which gravity may be off straight down; numerical
# Probability that another direction explains so much more by chance. Masses that are off are no
# chance, and short motions take them for gravity: of 600 recordings of 5 s two had 7e-3 and 3e-4.
# True ones of 20 s have 1e-20.
CHANCE = 1e-5
# degree to which a mounting is known: masses are off, and what is compiled for an arm serves the
# next one
STEP = 1.0
# rad: nearer to upside down, which all signs together are, too, than to any side
OVERHEAD = 0.75 * np.pi
UNKNOWN_ANGLE = float(np.pi / np.sqrt(3.0))  # rad, of an angle that is uniform over a turn
WORDS = (
    "the torques show gravity of {} m/s², but the description has {}: the arm is"
    " mounted differently, and the rotation Rx({:.0f}°) Ry({:.0f}°) is assumed"
    " (base, in robot.yaml); a tilt relative to it was also identified"
)


@dataclass(frozen=True)
class Mounting:
    """A rotation of the base, as in the effect `base_tilt`."""

    x: float  # rad; turned by Rx(x) Ry(y) in the ground frame from where the description has it
    y: float
    shown: (
        Array  # (3,) m/s², gravity in the frame of the ground as described, as the torques show it
    )
    described: Array  # (3,) m/s²

    def of(self, robot: Robot) -> Robot:
        """Return the arm with this mounting."""
        return mounted(robot, self.x, self.y)

    @property
    def note(self) -> str:
        """The note for the reader."""
        shown = short_numbers(self.shown)
        described = short_numbers(self.described)
        note = WORDS.format(shown, described, np.degrees(self.x), np.degrees(self.y))
        overhead = angle_between(self.shown, self.described) >= OVERHEAD
        return f"{note}; slow torques of the wrong sign have the same effect" if overhead else note

    def tilted(self, x: float, y: float) -> tuple[float, float]:
        """Return both turns as one, rad: this one and a further Rx(x) Ry(y)."""
        return tilt_of(turned(self.x, self.y).T @ turned(x, y).T @ self.described)

    def tilted_by(self, deviations: tuple[float, float], x: float, y: float) -> tuple[float, float]:
        """Return the standard deviations of both turns as one, rad, from those of the further turns
        x and y.

        Near a base on its side a turn about the vertical is no tilt: gravity hardly shows it. Of an
        angle of which nothing is known the deviation is that of a uniform distribution.
        """
        down, *rates = _down_and_rates(x, y) @ turned(self.x, self.y)
        # What of gravity is across the y axis: its length falls as x rises, its angle is y.
        across = np.array([down[0], -down[2]])
        size = float(np.linalg.norm(across))
        along = across / size if size else np.array([0.0, 1.0])
        moved = np.array([[rate[0], -rate[2]] for rate in rates])
        by_x = down[1] * (moved @ along) - size * np.array(rates)[:, 1]
        by_y = moved @ [along[1], -along[0]]
        x_std, y_moved = (float(np.linalg.norm(by * deviations)) for by in (by_x, by_y))
        y_std = min(y_moved / size, UNKNOWN_ANGLE) if size else UNKNOWN_ANGLE
        return x_std, y_std


def states_tilt(instances: Iterable[EffectInstance]) -> bool:
    """Return whether a tilt of the base is among effects: then the mounting is not looked for."""
    return any(instance.effect.id == TILT for instance in instances)


def mounted(robot: Robot, x: float, y: float) -> Robot:
    """Return the arm with its base turned by Rx(x) Ry(y) in the ground frame, rad."""
    base = placed(turned(x, y)) @ robot.base_placement
    return robot.with_(base_placement=base, base_dh=None)


def turned(x: float, y: float) -> Array:
    """Return the rotation (3, 3) Rx(x) Ry(y)."""
    return Rotation.from_euler("XY", [x, y]).as_matrix()


def _down_and_rates(x: float, y: float) -> Array:
    """Return the direction of gravity in a base turned by Rx(x) Ry(y), and its derivatives by both
    (3, 3)."""
    sx, sy = np.sin([x, y])
    cx, cy = np.cos([x, y])
    return np.array([[sy * cx, -sx, -cy * cx], [-sy * sx, -cx, cy * sx], [cy * cx, 0.0, sy * cx]])


def tilt_of(gravity: Array) -> tuple[float, float]:
    """Return x, y, rad, of the rotation Rx(x) Ry(y) that gives the gravity vector `gravity`
    (3,)."""
    down = gravity / np.linalg.norm(gravity)
    return float(-np.arcsin(np.clip(down[1], -1.0, 1.0))), float(np.arctan2(down[0], -down[2]))


def other_mounting(robot: Robot, model: str, motions: Sequence[Motion]) -> Mounting | None:
    """Return the mounting of the arm if its torques exclude the described one, otherwise None.

    Torques are linear in the gravity vector: three columns, next to dry friction and a zero of each
    joint. The joints with the largest load decide. Another mounting is reported only if it explains
    them far better, more than chance allows, and better than channels with the wrong sign or
    springs.
    """
    described = np.asarray(robot.gravity, dtype=float)
    turning = [not joint.prismatic for joint in robot.joints]
    size = float(np.linalg.norm(described))
    # Turns are those of gravity straight down.
    if not (size and motions and any(turning)) or described[2] > -(1.0 - STRAIGHT) * size:
        return None
    longest = max(motions, key=len)
    torques = _torques(robot, model, longest)
    if torques is None:
        return None
    measured, moved, pull, joints, springs = (each[:, turning] for each in torques)
    coefficients, left = _least_squares(np.concatenate([pull, joints], axis=2), measured - moved)
    # Each joint has its own friction and zero: what they leave of it does not depend on the others.
    stands = _left_by_joint(joints, measured - moved - pull @ described)
    reversed_ = _left_by_joint(joints, -measured - moved - pull @ described)
    sprung = _left_by_joint(
        np.concatenate([joints, springs], axis=2), measured - moved - pull @ described
    )
    before = float(stands.sum())
    if float(np.min([stands, reversed_, sprung], axis=0).sum()) < left:
        return None
    shown = coefficients[:3]
    if not is_turned(shown, described, left, before):
        return None
    if _chance(before, left, longest, joints.shape[1:]) > CHANCE:
        return None
    x, y = (np.radians(STEP * round(np.degrees(angle) / STEP)) for angle in tilt_of(shown))
    return Mounting(float(x), float(y), shown, described)


def _torques(robot: Robot, model: str, motion: Motion) -> tuple[Array, ...] | None:
    """Return torques (N, n), those of the motion, gravity columns, friction and zero, and springs
    (N, n, k).

    None if the motion lacks torques or angles of all joints.
    """
    every = slice(0, None, max(1, len(motion) // ENOUGH))
    n = robot.n
    chosen = motion[every]
    torques = described_torques(robot, model, chosen)
    if torques is None:
        return None
    links = chosen.q if chosen.q is not None else chosen.theta
    motors = chosen.dtheta if robot.elastic and chosen.dtheta is not None else chosen.dq
    rates = motors if motors is not None else chosen.dtheta
    assert links is not None and rates is not None
    friction = np.sign(rates)[:, :, None] * np.eye(n)
    joints = np.concatenate([friction, np.broadcast_to(np.eye(n), friction.shape)], axis=2)
    return *torques, joints, links[:, :, None] * np.eye(n)


def described_torques(
    robot: Robot, model: str, motion: Motion
) -> tuple[Array, Array, Array] | None:
    """Return recorded torques (N, n), and of the described arm those of the motion and of gravity
    (N, n, 3) in its three directions.

    None if the motion lacks torques or angles of all joints.
    """
    sides = [(motion.q, motion.dq, motion.ddq), (motion.theta, motion.dtheta, motion.ddtheta)]
    recorded: list[Any] = [side for side in sides if all(rate is not None for rate in side)]
    torque = motion.tau_m if motion.tau_m is not None else motion.tau_J
    if torque is None or not recorded or motion.lacking:
        return None
    # Links stand in for their motors, and the other way about: a deflection hardly turns what
    # gravity pulls at.
    taken = (recorded[0], recorded[-1]) if robot.elastic else recorded[:1]
    x, dx, ddx = (np.hstack(rates) for rates in zip(*taken, strict=True))
    motors = motion.tau_m is not None
    moved, pull = ArmEquations(robot, model).moved_and_pulled(x, dx, ddx, motors=motors)
    return torque, moved, pull


def _chance(before: float, left: float, motion: Motion, laws: tuple[int, ...]) -> float:
    """Return the probability by the F test that a wrong direction of gravity reduces the remainder
    as much.

    Errors are correlated as long as the motion is: a joint has two independent samples per swing.
    """
    statistics = MotionStatistics()
    statistics.add(motion)
    joints, coefficients = laws
    freedom = joints * statistics.effective_samples - coefficients - 3
    if freedom <= 0 or left <= 0:
        return float(freedom <= 0)
    return float(fdtrc(3, freedom, (before - left) / 3 / (left / freedom)))


def _left_by_joint(columns: Array, target: Array) -> Array:
    """Return the sum of squares (n,) of the torque (N, n) of each joint that friction and zero (N,
    n, m) do not explain."""
    return np.array(
        [_least_squares(columns[:, [j]], target[:, [j]])[1] for j in range(target.shape[1])]
    )


def _least_squares(columns: Array, target: Array) -> tuple[Array, float]:
    """Return the coefficients (m,) of columns (N, n, m), and the remaining sum of squares."""
    flat = columns.reshape(-1, columns.shape[2])
    wanted = target.ravel()
    found = np.asarray(np.linalg.lstsq(flat, wanted, rcond=None)[0], dtype=np.float64)
    return found, float(np.sum((wanted - flat @ found) ** 2))
