"""Known changes to the recordings of a robot, or to its description.

A change is one effect of the catalogue, of a size in units of what a workshop would notice
(`CHANGES`). It is added to the recorded torques by its law, written here once more, or by the
inverse dynamics of a changed arm on the smoothed motion.

    python -m benchmarks.known_changes    # lists them
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import butter, savgol_filter, sosfiltfilt

from benchmarks.judge import ANY
from elastic_arm.arrays import Array
from elastic_arm.dynamics import build_model
from elastic_arm.recording import Recording, Side
from elastic_arm.robot import Inertia, Robot

SMOOTH = 10.0  # Hz, up to which accelerations are taken from recorded angles
STILL = 0.01  # of a joint's largest speed, over which dry friction turns over
SLOW = 0.1  # of a joint's largest speed, over which the excess of friction at standstill vanishes
CARRIES = 0.3  # of the largest torque of the arm: joints of which a change of torque is drawn
MOVES = 0.05  # rad/s


class Motion:
    """The motion and the torques of one recording.

    Parameters
    ----------
    recording
        As it was recorded: one side has the torques.
    robot
        Whose joints are taken.
    """

    def __init__(self, recording: Recording, robot: Robot) -> None:
        self.recording = recording.select(robot.joint_names)
        self.name = next(
            name for name, side in self.recording.measured().items() if side.effort is not None
        )
        side = getattr(self.recording, self.name)
        sides = (side, *self.recording.measured().values())
        angles = next(one for one in sides if one.position is not None)
        self.t = side.stamp_ns * 1e-9
        assert angles.position is not None and side.effort is not None
        beside = angles.stamp_ns * 1e-9
        q = np.stack(
            [np.interp(self.t, beside, joint) for joint in np.unwrap(angles.position, axis=0).T],
            axis=1,
        )
        even = np.linspace(self.t[0], self.t[-1], len(self.t))
        q = np.stack([np.interp(even, self.t, joint) for joint in q.T], axis=1)
        step = even[1] - even[0]
        sos = butter(4, min(SMOOTH, 0.4 / step), fs=1.0 / step, output="sos")
        self.q = sosfiltfilt(sos, q, axis=0)
        self.dq = savgol_filter(self.q, 7, 3, deriv=1, delta=step, axis=0)
        self.ddq = savgol_filter(self.q, 7, 3, deriv=2, delta=step, axis=0)
        self.torque = side.effort

    def with_torque(self, torque: Array) -> Recording:
        """Return the recording with other torques."""
        side: Side = getattr(self.recording, self.name)
        changed: dict[str, Any] = {self.name: replace(side, effort=torque)}
        return replace(self.recording, **changed)

    def taken(self, robot: Robot, q: Array | None = None, moving: float = 1.0) -> Array:
        """Return the torques (N, n) that an arm takes for this motion, Nm.

        `q` replaces the angles; where `moving` is zero the arm stands at each of them.
        """
        motion = (self.q if q is None else q, moving * self.dq, moving * self.ddq)
        model = build_model(robot, "mod3")
        if robot.elastic:
            both = model.inverse_dynamics(*(np.hstack([v, v]) for v in motion))
            return both[:, : robot.n] + both[:, robot.n :]
        return model.inverse_dynamics(*motion)


@dataclass(frozen=True)
class Place:
    """A joint of the recordings of a robot, and the size of a change there."""

    bench: "Bench"
    j: int
    size: float  # in the unit of the change

    @property
    def torque(self) -> float:
        """The size times the joint's largest torque, Nm."""
        return self.size * float(self.bench.peak[self.j])

    @property
    def fastest(self) -> float:
        """Largest speed of the joint, rad/s."""
        return float(self.bench.fastest[self.j])

    @property
    def stiffness(self) -> float:
        """Of a spring that has the torque at the largest angle from the middle, Nm/rad."""
        return self.torque / float(self.bench.reach[self.j])

    def angle(self, motion: Motion) -> Array:
        """Angles of the joint from the middle of its motion (N,)."""
        return np.asarray(motion.q[:, self.j] - self.bench.middle[self.j])

    def speed(self, motion: Motion) -> Array:
        """Speeds of the joint (N,)."""
        return np.asarray(motion.dq[:, self.j])

    def sign(self, motion: Motion) -> Array:
        """Their signs, gradual about standstill (N,)."""
        return np.tanh(self.speed(motion) / (STILL * self.fastest))

    def stribeck(self, motion: Motion) -> Array:
        """Excess of dry friction near standstill (N,), Nm."""
        slow = np.exp(-((self.speed(motion) / (SLOW * self.fastest)) ** 2))
        return np.asarray(self.torque * slow * self.sign(motion))

    def asymmetric(self, motion: Motion) -> Array:
        """What dry and viscous friction of equal parts has more in the positive direction (N,)."""
        both = 0.5 + 0.5 * np.abs(self.speed(motion)) / self.fastest
        return np.asarray(self.torque * both * self.sign(motion) ** 2)

    def unweighed(self, motion: Motion) -> Array:
        """Minus the share of the described weight (N,), Nm."""
        return -self.size * motion.taken(self.bench.robot, moving=0.0)[:, self.j]

    def clipped(self, motion: Motion) -> Array:
        """What a limit of the torque below its largest takes off (N,), Nm."""
        most = (1.0 - self.size) * self.bench.peak[self.j]
        recorded = motion.torque[:, self.j]
        return np.asarray(np.clip(recorded, -most, most) - recorded)

    def ripple(self, motion: Motion) -> Array:
        """One period a turn of the rotor (N,), Nm."""
        gear = self.bench.robot.joints[self.j].transmission
        assert gear is not None
        return np.asarray(-self.torque * np.sin(gear.r_tot * motion.q[:, self.j]))


@dataclass(frozen=True)
class Change:
    """An effect, the size that a workshop would notice, and what it adds to the joint's torque."""

    effect: str  # of the catalogue; `torque_` stands for that of the recorded side
    size: float
    unit: str  # T is the largest torque of the joint, m the mass of the arm's links
    added: Callable[[Place, Motion], Any] | None = None  # (N,) Nm; None of `Bench.whole`
    sizes: Callable[[Place], dict[str, float]] = lambda place: {}


CHANGES = {
    "dry": Change(
        "coulomb_friction", 0.05, "T",
        lambda at, m: at.torque * at.sign(m), lambda at: {"torque": at.torque},
    ),
    "viscous": Change(
        "viscous_friction", 0.05, "T at the largest speed",
        lambda at, m: at.torque / at.fastest * at.speed(m),
        lambda at: {"coefficient": at.torque / at.fastest},
    ),
    "stribeck": Change(
        "stribeck_friction", 0.05, "T", Place.stribeck, lambda at: {"torque": at.torque}
    ),
    "asymmetric": Change("asymmetric_friction", 0.05, "T", Place.asymmetric),
    "by_load": Change(
        "load_dependent_friction", 0.05, "of the torque",
        lambda at, m: at.size * np.abs(m.torque[:, at.j]) * at.sign(m),
        lambda at: {"coefficient": at.size},
    ),
    "ripple": Change("torque_ripple", 0.02, "T", Place.ripple, lambda at: {"amplitude": at.torque}),
    "offset": Change(
        "torque_offset", 0.05, "T", lambda at, m: at.torque, lambda at: {"offset": at.torque}
    ),
    "gain": Change(
        "torque_gain", 0.10, "of the torque",
        lambda at, m: at.size * m.torque[:, at.j], lambda at: {"gain": 1.0 + at.size},
    ),
    "drift": Change(
        "torque_drift", 0.05, "T over the longest recording",
        lambda at, m: at.torque / at.bench.seconds * (m.t - m.t[0]),
        lambda at: {"rate": at.torque / at.bench.seconds},
    ),
    "spring": Change(
        "joint_spring", 0.05, "T at the largest angle",
        lambda at, m: at.stiffness * at.angle(m), lambda at: {"stiffness": at.stiffness},
    ),
    "counterbalance": Change(
        "counterbalance", 0.05, "T at the largest angle, growing with its square",
        lambda at, m: at.torque * (at.angle(m) / at.bench.reach[at.j]) ** 2,
    ),
    "unweighed": Change(
        "gravity_compensation", 0.10, "of the weight", Place.unweighed,
        lambda at: {"share": at.size},
    ),
    "clipped": Change("clipped_torque", 0.10, "T below the largest torque", Place.clipped),
    "delay": Change(
        "time_delay", 0.005, "s, of all torques", sizes=lambda at: {"delay": at.size}
    ),
    "payload": Change(
        "payload", 0.03, "m, 5 cm along z of the last link",
        sizes=lambda at: {"mass": at.size * at.bench.mass},
    ),
    "load": Change(
        "load", 0.06, "m, at the centre of a middle link",
        sizes=lambda at: {"mass": at.size * at.bench.mass},
    ),
    "tilt": Change("base_tilt", 0.02, "rad about x", sizes=lambda at: {"x": at.size}),
    "zero": Change("joint_zero", 0.02, "rad", sizes=lambda at: {"offset": at.size}),
    # A link that is lighter in the description is one that carries a load at its centre.
    "lighter": Change("load", 0.4, "of a middle link's mass, in the description"),
}  # fmt: skip
# What no torque is recorded for is changed in the description of the servo, and in its commands.
SERVO_CHANGES = {
    "lighter": Change("payload", 0.4, "of the mass, in the description"),
    "rotor": Change("rotor_inertia_mismatch", 0.35, "of the inertia, in the description"),
    "softer": Change("position_gain", 0.3, "of the gain, in the description"),
    "late": Change("command_delay", 0.01, "s"),
    "zero": Change("joint_zero", 0.02, "rad"),
}


class Bench:
    """Changes to the recordings of one robot.

    Parameters
    ----------
    robot
        Its description.
    recordings
        All that are asked together.
    """

    def __init__(self, robot: Robot, recordings: Sequence[Recording]) -> None:
        self.robot = robot
        self.motions = [Motion(one, robot) for one in recordings]
        self.peak = np.max([np.abs(m.torque).max(axis=0) for m in self.motions], axis=0)
        self.fastest = np.max([np.abs(m.dq).max(axis=0) for m in self.motions], axis=0)
        low = np.min([np.min(m.q, axis=0) for m in self.motions], axis=0)
        high = np.max([np.max(m.q, axis=0) for m in self.motions], axis=0)
        self.middle: Array = 0.5 * (low + high)
        self.reach: Array = 0.5 * (high - low)
        self.seconds: float = max(float(m.t[-1] - m.t[0]) for m in self.motions)
        self.mass: float = sum(joint.link.mass for joint in robot.joints)
        self.channel = "joint_torque" if self.motions[0].name == "link" else "motor_torque"

    def named(self, effect: str) -> str:
        """Return the effect of the recorded side."""
        short = effect in ("torque_gain", "torque_offset")
        return effect.replace("torque", self.channel) if short else effect

    def joints(self, name: str) -> list[int]:
        """Return the joints at which a change may be drawn."""
        if name in ("payload", "tilt", "delay"):
            return [self.robot.n - 1]
        if name == "by_load" and self.channel == "joint_torque":
            return []
        if name == "ripple" and not self.robot.elastic:
            return []
        chosen = self.peak >= CARRIES * self.peak.max()
        chosen &= self.fastest > MOVES
        if name in ("load", "lighter"):
            chosen[[0, -1]] = False
        return [int(j) for j in np.flatnonzero(chosen)]

    def changed(self, name: str, times: float, j: int) -> tuple[list[Recording], dict[str, Any]]:
        """Return the recordings with a change of so many times what is noticed, and the truth."""
        change = CHANGES[name]
        at = Place(self, j, times * change.size)
        recordings = []
        for motion in self.motions:
            if change.added is None:
                torque = self._whole(name, at, motion)
            else:
                torque = motion.torque.copy()
                torque[:, j] += change.added(at, motion)
            recordings.append(motion.with_torque(torque))
        joint = place_of(name, self.robot, j)
        return recordings, truth_of(self.named(change.effect), joint, change.sizes(at))

    def description(self, name: str, times: float, j: int) -> Robot:
        """Return the described arm, of which a change takes off a part."""
        return lessened(self.robot, name, 1.0 + times * CHANGES[name].size, j)

    def _whole(self, name: str, at: Place, motion: Motion) -> Array:
        """Return the torques (N, n) of a change that is not of one torque alone."""
        robot = self.robot
        if name == "delay":
            late = [np.interp(motion.t - at.size, motion.t, one) for one in motion.torque.T]
            return np.stack(late, axis=1)
        q = None
        arm = robot
        if name == "tilt":
            turn = np.array(
                [[1, 0, 0], [0, np.cos(at.size), -np.sin(at.size)],
                 [0, np.sin(at.size), np.cos(at.size)]]
            )  # fmt: skip
            arm = robot.with_(gravity=turn.T @ np.asarray(robot.gravity))
        elif name == "zero":  # what is read is the true angle and the offset
            q = motion.q.copy()
            q[:, at.j] -= at.size
        elif name in ("payload", "load"):
            centre = np.asarray(robot.joints[at.j].link.com)
            position = np.array([0.0, 0.0, 0.05]) if name == "payload" else centre
            arm = with_mass(robot, at.j, at.size * self.mass, position)
        return np.asarray(motion.torque + motion.taken(arm, q) - motion.taken(robot))


class ServoBench:
    """Changes to the recordings of a servo: angles and commands.

    Parameters
    ----------
    robot
        Its description.
    recordings
        All that are asked together.
    """

    def __init__(self, robot: Robot, recordings: Sequence[Recording]) -> None:
        self.robot = robot
        self.recordings = recordings

    def named(self, effect: str) -> str:
        """Return the effect."""
        return effect

    def joints(self, name: str) -> list[int]:
        """Return its only joint."""
        return [0]

    def changed(self, name: str, times: float, j: int) -> tuple[list[Recording], dict[str, Any]]:
        """Return the recordings with a change of so many times what is noticed, and the truth."""
        change = SERVO_CHANGES[name]
        size = times * change.size
        truth = {
            "lighter": {},
            "rotor": {"inertia": 1.0 + size},
            "softer": {"gain": 1.0 + size},
            "late": {"delay": size},
            "zero": {"offset": size},
        }
        recordings = [self._one(recording, name, size) for recording in self.recordings]
        return recordings, truth_of(change.effect, self.robot.joint_names[j], truth[name])

    def description(self, name: str, times: float, j: int) -> Robot:
        """Return the described arm, of which a change takes off a part."""
        return lessened(self.robot, name, 1.0 + times * SERVO_CHANGES[name].size, j)

    def _one(self, recording: Recording, name: str, size: float) -> Recording:
        link = recording.link
        command = recording.reference
        assert link is not None and command is not None
        assert link.position is not None and command.position is not None
        if name == "zero":  # the servo follows its own reading
            link = replace(link, position=link.position + size)
            command = replace(command, position=command.position + size)
        if name == "late":  # the angles answer later
            link = replace(link, stamp_ns=link.stamp_ns + round(1e9 * size))
        return replace(recording, link=link, reference=command)


def lessened(robot: Robot, name: str, part: float, j: int) -> Robot:
    """Return a description with a number divided by a part; as it is where the change is none of
    the description."""
    joint = robot.joints[j]
    if name == "lighter":
        link = joint.link
        lighter = Inertia(link.mass / part, link.com, np.asarray(link.inertia) / part)
        return robot.with_joint(joint.name, link=lighter)
    if name == "rotor":
        assert joint.armature is not None
        return robot.with_joint(joint.name, armature=joint.armature / part)
    if name == "softer":
        assert joint.controller is not None
        softer = replace(joint.controller, kp=joint.controller.kp / part)
        return robot.with_joint(joint.name, controller=softer)
    return robot


def with_mass(robot: Robot, j: int, mass: float, position: Array) -> Robot:
    """Return an arm with a point mass fixed to a link, at a position in its frame."""

    def about(m: float, r: Array) -> Array:
        return np.asarray(m * (r @ r * np.eye(3) - np.outer(r, r)))

    link = robot.joints[j].link
    com = (link.mass * np.asarray(link.com) + mass * position) / (link.mass + mass)
    inertia = (
        np.asarray(link.inertia)
        + about(link.mass, np.asarray(link.com) - com)
        + about(mass, position - com)
    )
    heavier = Inertia(link.mass + mass, com, inertia)
    return robot.with_joint(robot.joints[j].name, link=heavier)


def truth_of(effect: str, joint: str | None, sizes: dict[str, float]) -> dict[str, Any]:
    """Return an effect as the judge takes it."""
    return {"effect": effect, "joint": joint, "parameters": sizes, "phases": []}


def place_of(name: str, robot: Robot, j: int) -> str | None:
    """Return the joint at which a change is to be named."""
    return {"tilt": None, "delay": ANY}.get(name, robot.joint_names[j])


def main() -> None:
    """Print the changes and the sizes that a workshop would notice."""
    for changes in (CHANGES, SERVO_CHANGES):
        for name, change in changes.items():
            print(f"{name:15} {change.effect:24} {change.size:g} {change.unit}")


if __name__ == "__main__":
    main()
