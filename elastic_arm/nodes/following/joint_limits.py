"""Limits of position, velocity and acceleration."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.excitation.limits import DEFAULTS
from elastic_arm.nodes.following.splines import Row
from elastic_arm.robot import Robot

# Peaks of a motion that was planned at a limit exceed it by rounding and between samples: this
# share is no violation.
SLACK = 0.02
# Angle past a limit that counts as rounding, rad.
ANGLE_SLACK = 1e-3
# What no arm does, rad/s and rad/s²: limits where the description states none and none is to be
# assumed.
FASTEST = {"velocity": 100.0, "acceleration": 1e4}
_UNITS = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s²"}


@dataclass(frozen=True)
class Violation:
    """The worst violation of a limit."""

    problem: str  # in words, as what follows "a goal that"
    # how many times slower the motion would have to be; infinite where that does not help
    slower: float


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of all joints, (n,) each; angles without a limit are infinite."""

    joints: tuple[str, ...]  # their names
    # low, high, velocity, acceleration: rad, rad/s, rad/s²
    low: Array
    high: Array
    velocity: Array
    acceleration: Array
    # whether limits that the description does not state are those of the excitation's search, not
    # of any arm
    assumed: bool = False

    @classmethod
    def of(cls, robot: Robot, assumed: bool) -> Self:
        """Return the limits that `robot` states; missing ones are replaced by defaults."""

        def all_of(name: str, unlimited: float) -> Array:
            default = DEFAULTS[name] if assumed else unlimited
            stated = [getattr(joint.limits, name) for joint in robot.joints]
            return np.array([default if value is None else value for value in stated], dtype=float)

        low = all_of("position_min", -np.inf)
        high = all_of("position_max", np.inf)
        fastest = {name: all_of(name, unlimited) for name, unlimited in FASTEST.items()}
        return cls(robot.joint_names, low, high, **fastest, assumed=assumed)

    def violation(self, motion: Row, start: Array) -> Violation | None:
        """Return the worst violation of a limit by a motion, (N, n) each; None if all limits are
        observed.

        start: (n,) present position: an arm outside its range may move back into it.
        """
        past = np.maximum(
            motion.position - np.maximum(self.high, start),
            np.minimum(self.low, start) - motion.position,
        )
        if past.max() > ANGLE_SLACK:
            row, joint = divmod(int(np.argmax(past)), past.shape[1])
            angle = float(motion.position[row, joint])
            limit = float(self.high[joint] if angle > self.high[joint] else self.low[joint])
            return Violation(self._words("position", joint, angle, limit), np.inf)
        shares = {"velocity": _peak(motion.velocity) / self.velocity}
        shares["acceleration"] = _peak(motion.acceleration) / self.acceleration
        slower = {"velocity": float(shares["velocity"].max())}
        slower["acceleration"] = float(shares["acceleration"].max()) ** 0.5
        kind = max(slower, key=lambda name: slower[name])
        if max(float(share.max()) for share in shares.values()) <= 1.0 + SLACK:
            return None
        joint = int(np.argmax(shares[kind]))
        limit = float(getattr(self, kind)[joint])
        return Violation(
            self._words(kind, joint, float(shares[kind][joint]) * limit, limit), slower[kind]
        )

    def _words(self, kind: str, joint: int, value: float, limit: float) -> str:
        unit = _UNITS[kind]
        article = "an" if kind == "acceleration" else "a"
        where = f"beyond the limit of {limit:.3g} {unit}"
        return f"moves {self.joints[joint]} to {article} {kind} of {value:.3g} {unit}, {where}"


def _peak(values: Array) -> Array:
    return np.abs(values).max(axis=0)
