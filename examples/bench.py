"""Known changes added to recordings of real robots, and what the diagnosis says of them.

    python -m examples.bench DATA --out bench.csv [--only REGEX] [--jobs 2] [--arms runs/bench_arms]

DATA has a folder for each robot. Each change is added numerically to the torques of all its
recordings, at 3, 1 and 0.3 times what a workshop would notice (`NOTICED`), and the altered
recordings are asked as `benchmarks.judge` does. Every answer is judged against that to the
recordings as they are: what they have already is allowed, and the size that is to be found is
theirs and the change together, of which an effect that was named before has to show half or more.
"""

import argparse
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, savgol_filter, sosfiltfilt

from benchmarks.judge import ANY, ROBOTS, UNKNOWN, Arm, judge, share, summary
from elastic_arm.dynamics import build_model
from elastic_arm.recording import Recording, Side, read_recording, write_recording
from elastic_arm.robot import Inertia, Robot, load_robot

# What a workshop would notice. T is the largest torque of the joint in the recordings, m the mass
# of the arm's links.
NOTICED = {
    "coulomb_friction": (0.05, "T"),
    "viscous_friction": (0.05, "T at the joint's largest speed"),
    "torque_offset": (0.05, "T"),
    "torque_gain": (0.10, "of the recorded torque"),
    "time_delay": (0.005, "s, of all torques"),
    "joint_spring": (
        0.05,
        "T at the largest angle from where it is relaxed, the middle of the motion",
    ),
    "base_tilt": (0.02, "rad about x"),
    "joint_zero": (0.02, "rad"),
    "payload": (0.03, "m, 0.05 m along z of the last link's frame"),
    "load": (0.06, "m, at the centre of mass of a link in the middle"),
}
TIMES = (3.0, 1.0, 0.3)
ASKED = ("kr300_6", "lwr4", "gen3", "ur5e")
SMOOTH = 10.0  # Hz, up to which accelerations are taken from recorded angles
STILL = 0.01  # of a joint's largest speed, over which dry friction turns over


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
        angles = next(
            side for side in self.recording.measured().values() if side.position is not None
        )
        side = getattr(self.recording, self.name)
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

    def with_torque(self, torque: np.ndarray) -> Recording:
        """Return the recording with other torques."""
        side: Side = getattr(self.recording, self.name)
        return replace(self.recording, **{self.name: replace(side, effort=torque)})

    def taken(self, robot: Robot) -> np.ndarray:
        """Return the torques (N, n) that an arm takes for this motion, Nm."""
        model, motion = build_model(robot, "mod3"), (self.q, self.dq, self.ddq)
        if robot.elastic:
            both = model.inverse_dynamics(*(np.hstack([v, v]) for v in motion))
            return both[:, : robot.n] + both[:, robot.n :]
        return model.inverse_dynamics(*motion)


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
        self.robot, self.motions = robot, [Motion(one, robot) for one in recordings]
        self.peak = np.max([np.abs(m.torque).max(axis=0) for m in self.motions], axis=0)
        self.fastest = np.max([np.abs(m.dq).max(axis=0) for m in self.motions], axis=0)
        low, high = (f([f(m.q, axis=0) for m in self.motions], axis=0) for f in (np.min, np.max))
        self.middle, self.reach = 0.5 * (low + high), 0.5 * (high - low)
        self.mass = sum(joint.link.mass for joint in robot.joints)
        self.channel = "joint_torque" if self.motions[0].name == "link" else "motor_torque"

    def changed(self, effect: str, times: float, j: int) -> tuple[list[Recording], dict[str, Any]]:
        """Return the recordings with an effect of so many times what is noticed, and the effect as
        the truth has it."""
        size, T = NOTICED[effect][0] * times, float(self.peak[j])
        joint: str | None = self.robot.joint_names[j]
        if effect == "coulomb_friction":
            parameters: dict[str, Any] = {"torque": size * T}
            add = lambda m: size * T * np.tanh(m.dq[:, j] / (STILL * self.fastest[j]))  # noqa: E731
        elif effect == "viscous_friction":
            parameters = {"coefficient": size * T / self.fastest[j]}
            add = lambda m: size * T / self.fastest[j] * m.dq[:, j]  # noqa: E731
        elif effect == "torque_offset":
            parameters = {"offset": size * T}
            add = lambda m: size * T  # noqa: E731
        elif effect == "torque_gain":
            parameters = {"gain": 1.0 + size}
            add = lambda m: size * m.torque[:, j]  # noqa: E731
        elif effect == "joint_spring":
            stiffness = size * T / self.reach[j]
            parameters = {"stiffness": stiffness}
            add = lambda m: stiffness * (m.q[:, j] - self.middle[j])  # noqa: E731
        elif effect == "time_delay":
            late = [
                np.stack([np.interp(m.t - size, m.t, one) for one in m.torque.T], axis=1)
                for m in self.motions
            ]
            recordings = [
                m.with_torque(torque) for m, torque in zip(self.motions, late, strict=True)
            ]
            return recordings, _truth(effect, ANY, {"delay": size})
        else:
            return self._of_another_arm(effect, size, j)
        recordings = []
        for motion in self.motions:
            torque = motion.torque.copy()
            torque[:, j] += add(motion)
            recordings.append(motion.with_torque(torque))
        named = (
            effect.replace("torque_", f"{self.channel}_")
            if effect.startswith("torque_")
            else effect
        )
        return recordings, _truth(named, joint, parameters)

    def _of_another_arm(
        self, effect: str, size: float, j: int
    ) -> tuple[list[Recording], dict[str, Any]]:
        """Return the recordings of an arm that is not as described."""
        joint: str | None = self.robot.joint_names[j]
        if effect == "base_tilt":
            turn = np.array(
                [[1, 0, 0], [0, np.cos(size), -np.sin(size)], [0, np.sin(size), np.cos(size)]]
            )
            gravity = turn.T @ np.asarray(self.robot.gravity)
            joint, parameters, arm = None, {"x": size}, self.robot.with_(gravity=gravity)
        elif effect == "joint_zero":
            parameters, arm = {"offset": size}, self.robot
        else:
            link = self.robot.joints[j].link
            position = np.array([0.0, 0.0, 0.05]) if effect == "payload" else np.asarray(link.com)
            parameters = {"mass": size * self.mass}
            arm = with_mass(self.robot, j, size * self.mass, position)
        recordings = []
        for motion in self.motions:
            moved = motion
            if effect == "joint_zero":  # what is read is the true angle and the offset
                moved = Motion(motion.recording, self.robot)
                moved.q[:, j] -= size
            change = moved.taken(arm) - motion.taken(self.robot)
            recordings.append(motion.with_torque(motion.torque + change))
        return recordings, _truth(effect, joint, parameters)


def with_mass(robot: Robot, j: int, mass: float, position: np.ndarray) -> Robot:
    """Return an arm with a point mass fixed to a link, at a position in its frame."""

    def about(m: float, r: np.ndarray) -> np.ndarray:
        return np.asarray(m * (r @ r * np.eye(3) - np.outer(r, r)))

    link = robot.joints[j].link
    com = (link.mass * np.asarray(link.com) + mass * position) / (link.mass + mass)
    inertia = (
        np.asarray(link.inertia)
        + about(link.mass, np.asarray(link.com) - com)
        + about(mass, position - com)
    )
    joints = list(robot.joints)
    joints[j] = replace(joints[j], link=Inertia(link.mass + mass, com, inertia))
    return robot.with_(joints=tuple(joints))


def _truth(effect: str, joint: str | None, parameters: dict[str, Any]) -> dict[str, Any]:
    return {"effect": effect, "joint": joint, "parameters": parameters, "phases": []}


def place(effect: str, bench: Bench, rng: np.random.Generator) -> int:
    """Return the joint of a change: one that moves, and of torques one that carries something."""
    n = bench.robot.n
    if effect in ("payload", "base_tilt", "time_delay"):
        return n - 1
    if effect == "load":
        return n // 2 - 1
    carries = bench.peak >= 0.3 * bench.peak.max()
    return int(rng.choice(np.flatnonzero(carries & (bench.fastest > 0.05))))


def prepared(data: Path, arms: Path, only: str) -> dict[str, tuple[Arm, list[Arm]]]:
    """Make the altered recordings that are not there yet; return each robot's own question and
    those of its changes."""
    (arms / "arms").mkdir(parents=True, exist_ok=True)
    found = {}
    for key in ASKED:
        one = ROBOTS[key]
        if not (data / one.folder).is_dir():
            print(f"{key}: left out, as {data / one.folder} is not a folder", flush=True)
            continue
        robot_file = (data / one.folder / one.robot).resolve()
        own = one.bags(arms, data)
        fit, held = own[: one.fitted], own[one.fitted :]
        plain = Arm(
            f"{key}_unchanged",
            key,
            "unchanged",
            fit,
            held,
            complete=False,
            robot=str(robot_file),
            refit=True,
        )
        asked, bench = [], None
        for effect in NOTICED:
            rng = np.random.default_rng([len(asked), *key.encode()])
            for times in TIMES:
                name = f"{key}_{effect}_{times:g}"
                file = arms / "arms" / f"{name}.json"
                if not file.is_file() and re.search(only, name):
                    robot = load_robot(robot_file)
                    bench = bench or Bench(robot, [read_recording(arms / bag) for bag in own])
                    recordings, truth = bench.changed(effect, times, place(effect, bench, rng))
                    bags = [f"bags/{name}_{k}" for k in range(len(own))]
                    for bag, recording in zip(bags, recordings, strict=True):
                        write_recording(arms / bag, recording)
                    fit, held = bags[: one.fitted], bags[one.fitted :]
                    arm = replace(
                        plain,
                        name=name,
                        kind=f"{times:g} times",
                        fit=fit,
                        judge=held,
                        truth=[truth],
                    )
                    file.write_text(json.dumps([asdict(replace(arm, complete=True))], indent=1))
                if file.is_file():
                    asked.append(Arm(**json.loads(file.read_text())[0]))
        (arms / "arms" / f"{plain.name}.json").write_text(json.dumps([asdict(plain)], indent=1))
        found[key] = plain, asked
    return found


def against(arm: Arm, before: Mapping[str, Any]) -> Arm:
    """Return an arm's question with what the recordings had before the change."""
    (truth,) = arm.truth
    allowed = [[c["effect"], c["joint"]] for c in before["causes"]]
    own = [
        c for c in (*before["causes"], *before.get("known", ())) if c["effect"] == truth["effect"]
    ]
    own = [c["parameters"] for c in own if truth["joint"] in (ANY, c["joint"])]
    named = ((i, next(iter(truth["parameters"]))) for i in before.get("imperfections", ()))
    own += [
        {name: i}
        for i, name in named
        if (i["what"], i["joint"]) == (truth["effect"], truth["joint"])
    ]
    sizes = dict(truth["parameters"])
    for name, change in truth["parameters"].items():
        if own and name in own[0]:
            there = own[0][name]["value"]
            sizes[name] = there * change if name == "gain" else there + change
    change = {k: v - 1.0 if k == "gain" else v for k, v in truth["parameters"].items()}
    found = truth | {"parameters": sizes, "change": change, "before": bool(own)}
    return replace(arm, truth=[found], allowed=allowed)


def by_effect(rows: Sequence[Mapping[str, str]]) -> str:
    """Return how often each change was named, by how many times what is noticed it is."""
    lines = [f"{'change':18} {'noticed':8} " + " ".join(f"{t:g} times".ljust(26) for t in TIMES)]
    for effect, (size, unit) in NOTICED.items():
        cells = []
        for times in TIMES:
            some = [r for r in rows if re.search(rf"_{effect}_{times:g}$", r["arm"])]
            cells.append(share(r["right"] == "1" for r in some).ljust(26))
        lines.append(f"{effect:18} {size:<8g} {' '.join(cells)} {unit}")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the changes, ask all, and print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path, help="folder with a folder of recordings for each robot")
    parser.add_argument("--out", type=Path, default=Path("runs/bench.csv"))
    parser.add_argument(
        "--only", default="", help="regular expression that the names of changes hold"
    )
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--arms", type=Path, default=Path("runs/bench_arms"), help="folder of the recordings"
    )
    asked = parser.parse_args(arguments)
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    everything = prepared(asked.data, asked.arms, asked.only)
    chosen = {
        key: [arm for arm in arms if re.search(asked.only, arm.name)]
        for key, (_, arms) in everything.items()
    }
    judge(
        [plain for key, (plain, _) in everything.items() if chosen[key]],
        asked.arms,
        asked.out,
        asked.jobs,
    )
    questions = []
    for key, arms in chosen.items():
        answer = asked.out.with_suffix(".answers") / f"{key}_unchanged.json"
        before = (
            json.loads(answer.read_text())
            if answer.is_file()
            else {"causes": [], "verdict": UNKNOWN}
        )
        questions += [against(arm, before) for arm in arms]
    rows = judge(questions, asked.arms, asked.out, asked.jobs)
    rows = [r for r in rows if r["kind"] != "unchanged"]
    print(summary(rows), by_effect(rows), sep="\n\n")


if __name__ == "__main__":
    main()
