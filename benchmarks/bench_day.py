"""Seconds and memory over the length of a recording and its standstill. ``python -m
benchmarks.bench_day``.

The arm of the package with dry friction on one joint. First one motion and then standstill, through
``identify`` and ``diagnose``; then work: motions of half a minute with rests between them,
``--standing`` of the time. Each case runs in a process of its own; its columns are processor
seconds, those over the first case's, and the most memory that it took. Work of more than ten
minutes is ten minutes of it again and again.
"""

import argparse
import heapq
import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_diagnosis import arm_of
from elastic_arm.dynamics import build_model
from elastic_arm.effects import parse
from elastic_arm.excitation import MotionLimits, Shape, random_trajectories
from elastic_arm.recording import Recording, write_recording
from elastic_arm.recording.storage.stream_writer import StreamWriter
from elastic_arm.recording.topics import type_of
from elastic_arm.recording.writing import _streams
from elastic_arm.robot import Robot, save_robot
from elastic_arm.sensors import Sensors
from elastic_arm.simulation import SimulationSettings, simulate

Array = NDArray[np.float64]
LAW = "coulomb_friction:joint_2"
TRUE = 10.0
BLOCK = 600.0  # s of work that longer work repeats
START = "from elastic_arm.app import main; main()"
RESULTS = "diagnosis.json", "identification.json", "history.json"


class Work:
    """Motions of some seconds, each from where the one before began, with rests between them."""

    def __init__(self, robot: Robot, seconds: float, moving: float, standing: float) -> None:
        shape = Shape(5, moving - 2.0, 1.0)
        count = max(1, round(seconds * (1.0 - standing) / moving))
        self.cycle = seconds / count
        found = random_trajectories(
            build_model(robot, "mod3"),
            MotionLimits.of(robot),
            min(count, 8),
            rng=np.random.default_rng(3),
            shape=shape,
        )
        self.motions = [found[k % len(found)] for k in range(count)]

    def evaluate(self, t: Array) -> tuple[Array, Array, Array]:
        """Return q, dq and ddq (N, n) at times t (N,)."""
        home = self.motions[0].q0
        parts = [np.zeros((len(t), len(home))) for _ in range(3)]
        which = np.minimum(t // self.cycle, len(self.motions) - 1).astype(int)
        for k in np.unique(which):
            own = which == k
            for all_of, one in zip(
                parts, self.motions[k].evaluate(t[own] - k * self.cycle), strict=True
            ):
                all_of[own] = one
            parts[0][own] += home - self.motions[k].q0
        return parts[0], parts[1], parts[2]


def recorded(folder: Path, robot: Robot, work: Work, seconds: float) -> Path:
    """Write the recording of some work, and of the first of it a second one: the earlier recording
    of a history."""
    settings = SimulationSettings(
        effects=[parse(f"{LAW}:torque={TRUE}", robot)], sensors=Sensors.real()
    )
    block = simulate(
        robot, work, settings, duration=min(seconds, BLOCK), rng=np.random.default_rng(0)
    )
    save_robot(robot, folder / "arm.yaml")
    write_recording(folder / "before", block)
    with StreamWriter(folder / "run", "lz4", flush_every=np.inf, sync_every=np.inf) as writer:
        for k in range(max(1, round(seconds / BLOCK))):
            later = moved(block, round((k + 1) * min(seconds, BLOCK) * 1e9))
            streams = _streams(later, {})
            for stream in streams:
                writer.add_topic(stream.topic, type_of(stream.topic))
            messages = heapq.merge(*(stream.messages() for stream in streams))
            for stamp, topic, data in messages:
                writer.write(topic, data, stamp)
    return folder / "run"


def moved(recording: Recording, by_ns: int) -> Recording:
    """Return a recording at later times."""
    sides = {
        name: replace(side, stamp_ns=side.stamp_ns + by_ns)
        for name, side in recording.sides().items()
        if side
    }
    return replace(recording, **sides)


def measured(command: str, bag: Path, out: Path) -> tuple[float, float, str]:
    """Run a command on a bag; return its processor seconds, its gigabytes, and the friction that it
    found."""
    results = ["--out", str(out), "--force"]
    options = {
        "bag check": [],
        "diagnose": ["--no-propose", *results],
        "identify": ["--with", LAW, *results],
        "history": [str(bag.parent / "before"), "--with", LAW, *results],
    }
    arm = ["--robot", str(bag.parent / "arm.yaml")]
    words = ["-c", START, *command.split(), str(bag), *arm, *options[command]]
    with subprocess.Popen(
        [sys.executable, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    seconds = usage.ru_utime + usage.ru_stime
    return (
        seconds,
        usage.ru_maxrss / 1e6,
        found_in(out) if process.returncode == 0 else f"exit status {process.returncode}",
    )


def found_in(folder: Path) -> str:
    """Return the friction that a result states."""
    file = next((folder / name for name in RESULTS if (folder / name).exists()), None)
    if file is None:
        return ""
    result = json.loads(file.read_text(encoding="utf-8"))
    if file.name == RESULTS[2]:
        sizes = [
            f"{v['value']:.4f} ± {v['std']:.2g} Nm"
            for one in result["numbers"]
            for v in one["values"]
        ]
        return f"{result['verdict']} {'; '.join(sizes)}"
    if file.name == RESULTS[0]:
        causes = [f"{c['effect']}:{c['joint']} {c['parameters']}" for c in result["causes"]]
        return f"{result['verdict']} {'; '.join(causes)}"
    one = next(e for e in result["estimates"] if e["name"].startswith(LAW))
    return f"{one['value']:.4f} ± {one['std']:.2g} Nm, {one['verdict']}"


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--motion", type=float, default=20.0, help="s of motion before the standstill"
    )
    parser.add_argument(
        "--rest", type=float, nargs="*", default=(0.0, 30.0, 60.0, 300.0), help="s of standstill"
    )
    parser.add_argument(
        "--work", type=float, nargs="*", default=(60.0, 600.0, 3600.0), help="s of work"
    )
    parser.add_argument(
        "--standing", type=float, nargs="*", default=(0.0, 0.5, 0.95), help="share of the work"
    )
    parser.add_argument("--joints", type=int, default=3, help="of the arm")
    parser.add_argument(
        "--commands", nargs="*", default=("bag check", "identify", "diagnose", "history")
    )
    asked = parser.parse_args()
    robot = arm_of(asked.joints)
    motion = Work(robot, asked.motion, asked.motion, 0.0)
    cases = [
        (f"{asked.motion:g} s of motion + {rest:g} s of rest", motion, asked.motion + rest)
        for rest in asked.rest
    ]
    for seconds in asked.work:
        works = [
            (f"{seconds:g} s of work, {s:.0%} rest", Work(robot, min(seconds, BLOCK), 30.0, s))
            for s in asked.standing
        ]
        cases += [(name, work, seconds) for name, work in works]
    first: dict[str, float] = {}
    for name, work, seconds in cases:
        with tempfile.TemporaryDirectory() as folder:
            bag = recorded(Path(folder), robot, work, seconds)
            out = Path(folder) / "out"
            for command in asked.commands:
                elapsed, memory, found = measured(command, bag, out)
                ratio = elapsed / first.setdefault(command, elapsed)
                print(
                    f"{name:38} {command:9} {elapsed:7.1f} s {ratio:6.2f} {memory:6.2f} GB "
                    f" {found}",
                    flush=True,
                )
                shutil.rmtree(out, ignore_errors=True)


if __name__ == "__main__":
    main()
