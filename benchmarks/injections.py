"""Known changes added to recordings of real robots, and what the diagnosis says of them.

    python -m benchmarks.injections [--out runs/injections.csv] [--only REGEX] [--rounds 1]
    [--seed 720110] [--jobs 1] [--arms runs/injections_arms] [--data ../shared/data]

Each change is one effect of the catalogue at one joint, of 1, 2 or 5 times what a workshop would
notice (`CHANGES`). It is added to the recorded torques of all recordings of a robot, or taken from
its description: masses, rotors and the gains of a servo. Joint and size are drawn. The unchanged
recordings are asked first, and their answer is the base: a change is drawn at a joint at which the
base does not name its effect, and is left out where no such joint is left.

A change is named where a cause, or an alternative of 5 % or more, is its effect at its joint. A
false cause has 0.9 or more and is neither the change nor in the base. A size is that of the change
and of what the base has there. Of a clipped torque, which no effect of the catalogue describes,
`unknown` is right. Every question is answered by `benchmarks.judge`, in a process of its own. Rows
and answers are kept: the command continues where it was interrupted.
"""

import argparse
import json
import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, savgol_filter, sosfiltfilt

from benchmarks.bench_servo_xl330 import FITTED, JUDGED, described, recorded
from benchmarks.judge import (
    ANY,
    DECLARED,
    FAILED,
    INSIDE,
    REFUSED,
    ROBOTS,
    ROOT,
    SYNONYMS,
    UNKNOWN,
    Arm,
    judge,
    share,
)
from elastic_arm.arrays import Array
from elastic_arm.dynamics import build_model
from elastic_arm.recording import Recording, Side, read_recording, write_recording
from elastic_arm.robot import Inertia, Robot, load_robot, save_robot

TIMES = (1.0, 2.0, 5.0)
SEED = 720110
SMOOTH = 10.0  # Hz, up to which accelerations are taken from recorded angles
STILL = 0.01  # of a joint's largest speed, over which dry friction turns over
SLOW = 0.1  # of a joint's largest speed, over which the excess of friction at standstill vanishes
CARRIES = 0.3  # of the largest torque of the arm: joints of which a change of torque is drawn
MOVES = 0.05  # rad/s
SERVO_GAINS = (100, 400)  # in the register of the servo


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
        self.dq, self.ddq = (
            savgol_filter(self.q, 7, 3, deriv=k, delta=step, axis=0) for k in (1, 2)
        )
        self.torque = side.effort

    def with_torque(self, torque: Array) -> Recording:
        """Return the recording with other torques."""
        side: Side = getattr(self.recording, self.name)
        return replace(self.recording, **{self.name: replace(side, effort=torque)})

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
        low, high = (f([f(m.q, axis=0) for m in self.motions], axis=0) for f in (np.min, np.max))
        self.middle = 0.5 * (low + high)
        self.reach = 0.5 * (high - low)
        self.seconds = max(float(m.t[-1] - m.t[0]) for m in self.motions)
        self.mass = sum(joint.link.mass for joint in robot.joints)
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
        joint = {"tilt": None, "delay": ANY}.get(name, self.robot.joint_names[j])
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


def truth_of(effect: str, joint: str | None, sizes: Mapping[str, float]) -> dict[str, Any]:
    """Return an effect as the judge takes it."""
    return {"effect": effect, "joint": joint, "parameters": dict(sizes), "phases": []}


def with_base(name: str, change: float, value: float) -> float:
    """Return the number of an effect that is there, and a change of it."""
    return change * value if name in ("gain", "inertia") else change + value


# --- What the base has
# --------------------------------------------------------------------------------------------------


def said(base: Mapping[str, Any]) -> list[tuple[str, str | None]]:
    """Return all that an answer names: causes, and their alternatives of 5 % or more."""
    found = [(c["effect"], c["joint"]) for c in base["causes"]]
    others = (a for c in base["causes"] for a in c["alternatives"])
    return found + [(a["effect"], a["joint"]) for a in others if a["confidence"] >= DECLARED]


def same(effect: str) -> set[str]:
    """Return the effects that count as one with an effect."""
    groups = [{one, other} for one, other in SYNONYMS.items() if effect in (one, other)]
    return set().union({effect}, *groups)


def is_named(base: Mapping[str, Any], effect: str, joint: str | None) -> bool:
    """Whether an answer names an effect at a joint."""
    return any(e in same(effect) and joint in (ANY, j) for e, j in said(base))


def against(arm: Arm, base: Mapping[str, Any]) -> Arm:
    """Return a question with what the unchanged recordings have: it is allowed, and a number that
    the base has there is a part of the size."""
    allowed = [[one, joint] for effect, joint in said(base) for one in sorted(same(effect))]
    found = []
    for truth in arm.truth:
        sizes = dict(truth["parameters"])
        for one in base.get("imperfections", ()):
            if [one["what"], one["joint"]] == [truth["effect"], truth["joint"]]:
                sizes = {name: with_base(name, v, one["value"]) for name, v in sizes.items()}
        found.append(truth | {"parameters": sizes})
    return replace(arm, truth=found, allowed=allowed)


# --- The questions
# --------------------------------------------------------------------------------------------------

SERVO = "xl330"
ASKED = (
    SERVO,
    "gen3",
    "kr300_3",
    "kr300_6",
    "lwr4",
    "ur5e",
)  # of the last one the log is simulated


def unchanged(key: str, data: Path, arms: Path) -> Arm | None:
    """Return the question of the unchanged recordings of a robot; None where they are missing."""
    servo = key == SERVO
    folder = data / ("servo_xl330" if servo else ROBOTS[key].folder)
    if not folder.is_dir():
        print(f"{key}: left out, as {folder} is not a folder", flush=True)
        return None
    if servo:
        logs = [(gain, motion) for motion in (*FITTED, JUDGED) for gain in SERVO_GAINS]
        bags = [f"bags/{key}_{gain}_{motion}" for gain, motion in logs]
        for bag, log in zip(bags, logs, strict=True):
            if not (arms / bag).is_dir():
                write_recording(arms / bag, recorded(folder, *log))
        robot = arms / "robots" / f"{key}.xml"
        robot.parent.mkdir(parents=True, exist_ok=True)
        described(robot)
        fitted = len(FITTED) * len(SERVO_GAINS)
    else:
        bags = ROBOTS[key].bags(arms, data)
        robot = folder / ROBOTS[key].robot
        fitted = ROBOTS[key].fitted
    return Arm(
        f"{key}_unchanged", key, "unchanged", bags[:fitted], bags[fitted:], complete=False,
        robot=str(robot.resolve()), refit=True,
    )  # fmt: skip


def injections(
    plain: Arm, base: Mapping[str, Any], arms: Path, rounds: int, seed: int, only: str
) -> Iterator[Arm]:
    """Draw the changes of a robot, write what is not there yet, and yield what is asked of them."""
    bags = (*plain.fit, *plain.judge)
    recordings = [read_recording(arms / bag) for bag in bags]
    robot = load_robot(plain.robot)
    servo = plain.level == SERVO
    bench: Any = (ServoBench if servo else Bench)(robot, recordings)
    changes = SERVO_CHANGES if servo else CHANGES
    for number, (name, change) in enumerate(changes.items()):
        rng = np.random.default_rng([seed, number, *plain.level.encode()])
        sizes = rng.permutation(TIMES)
        effect = bench.named(change.effect)
        free = [j for j in bench.joints(name) if not is_named(base, effect, place(name, robot, j))]
        if not free:
            print(f"{plain.level} {name}: no joint where the base does not name it", flush=True)
            continue
        for k in range(rounds):
            times = float(sizes[k % len(sizes)])
            j = int(rng.choice(free))
            title = f"{plain.level}_{name}_{robot.joint_names[j]}_{times:g}"
            if re.search(only, title):
                yield injection(replace(plain, name=title), bench, name, times, j, arms)


def place(name: str, robot: Robot, j: int) -> str | None:
    """Return the joint at which a change is to be named."""
    return {"tilt": None, "delay": ANY}.get(name, robot.joint_names[j])


def injection(plain: Arm, bench: Any, name: str, times: float, j: int, arms: Path) -> Arm:
    """Return the question of one change; its files are written where they are not there yet."""
    file = arms / "arms" / f"{plain.name}.json"
    if not file.is_file():
        recordings, truth = bench.changed(name, times, j)
        bags = [f"bags/{plain.name}_{k}" for k in range(len(recordings))]
        for bag, recording in zip(bags, recordings, strict=True):
            shutil.rmtree(arms / bag, ignore_errors=True)  # what an interruption left
            write_recording(arms / bag, recording)
        robot = plain.robot
        description = bench.description(name, times, j)
        if description is not bench.robot:
            path = arms / "robots" / f"{plain.name}.yaml"
            path.parent.mkdir(parents=True, exist_ok=True)
            save_robot(description, path)
            robot = str(path.resolve())
        foreign = truth["effect"] == "clipped_torque"
        fitted = len(plain.fit)
        arm = replace(
            plain, kind=f"{times:g} times", fit=bags[:fitted], judge=bags[fitted:], robot=robot,
            truth=[] if foreign else [truth], verdicts=[UNKNOWN], complete=True,
        )  # fmt: skip
        file.write_text(json.dumps([asdict(arm)], indent=1))
    return Arm(**json.loads(file.read_text())[0])


# --- The command
# --------------------------------------------------------------------------------------------------


def answered(out: Path, name: str) -> dict[str, Any]:
    """Return a kept answer; without causes where there is none."""
    file = out.with_suffix(".answers") / f"{name}.json"
    if not file.is_file():
        return {"verdict": FAILED, "causes": []}
    return dict(json.loads(file.read_text()))


def tables(rows: Sequence[Mapping[str, str]]) -> str:
    """Return what came out by size, and by robot."""
    lines = [("", "named", "false cause at 0.9", "sizes within 1.96", "verdicts", "processor, s")]
    parts = [("kind", f"{times:g} times") for times in TIMES]
    parts += [("level", level) for level in dict.fromkeys(row["level"] for row in rows)]
    for column, value in (*parts, ("", "all")):
        some = [row for row in rows if not column or row[column] == value]
        z = [float(v) for row in some for v in row["z"].split("; ") if v]
        verdicts = Counter(row["verdict"] for row in some)
        lines.append(
            (
                value,
                share(row["right"] == "1" for row in some if row["truth"]),
                share(bool(row["false_causes"]) for row in some),
                share(abs(v) <= INSIDE for v in z),
                ", ".join(f"{count} {verdict}" for verdict, count in sorted(verdicts.items())),
                f"{sum(float(row['cpu_seconds']) for row in some):.0f}",
            )
        )
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(v.ljust(w) for v, w in zip(line, widths, strict=True)).rstrip() for line in lines
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the changes, ask all, and print the rows and the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/injections.csv"))
    parser.add_argument("--only", default="", help="regular expression that names of changes hold")
    parser.add_argument("--robots", nargs="*", default=ASKED, choices=ASKED, metavar="ROBOT")
    parser.add_argument("--rounds", type=int, default=1, help="changes of each effect of a robot")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--arms", type=Path, default=Path("runs/injections_arms"))
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data")
    asked = parser.parse_args(arguments)
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    (asked.arms / "arms").mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, str]] = []
    for key in asked.robots:
        plain = unchanged(key, asked.data, asked.arms)
        if plain is None:
            continue
        (asked.arms / "arms" / f"{plain.name}.json").write_text(json.dumps([asdict(plain)]))
        judge([plain], asked.arms, asked.out, 1)
        base = answered(asked.out, plain.name)
        if base["verdict"] in (FAILED, REFUSED):
            print(f"{key}: left out, as its unchanged recordings are {base['verdict']}", flush=True)
            continue
        drawn = injections(plain, base, asked.arms, asked.rounds, asked.seed, asked.only)
        questions = [against(arm, base) for arm in drawn]
        rows = judge(questions, asked.arms, asked.out, asked.jobs)
    changed = [row for row in rows if row["kind"] != "unchanged"]
    for row in changed:
        mark = {"1": "named", "0": "not named"}[row["right"]]
        print(f"{row['arm']}: {mark}; {row['verdict']}: {row['causes']}", end="")
        print(f"; false: {row['false_causes']}" if row["false_causes"] else "")
    print(tables(changed))


if __name__ == "__main__":
    main()
