"""Seconds and memory over the length of a recording and its standstill. ``python -m benchmarks.bench_day``.

The arm of the package with dry friction on one joint. First one motion and then standstill, through ``identify`` and
``diagnose``; then work: motions of half a minute with rests between them, ``--standing`` of the time. Each case runs in
a process of its own; its columns are processor seconds, those over the first case's, and the most memory that it took.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics import build_model
from elastic_arm.effects import parse
from elastic_arm.excitation import MotionLimits, Shape, random_trajectories
from elastic_arm.recording import write_recording
from elastic_arm.robot import load_robot
from elastic_arm.sensors import Sensors
from elastic_arm.simulation import SimulationSettings, simulate

Array = NDArray[np.float64]
LAW, TRUE = "coulomb_friction:joint_2", 10.0
START = "from elastic_arm.app import main; main()"
RESULTS = "diagnosis.json", "identification.json"


class Work:
    """Motions of some seconds, each from where the one before began, with rests between them."""

    def __init__(self, seconds: float, moving: float, standing: float) -> None:
        robot = load_robot(None)
        shape = Shape(5, moving - 2.0, 1.0)
        count = max(1, round(seconds * (1.0 - standing) / moving))
        self.cycle = seconds / count
        found = random_trajectories(
            build_model(robot, "mod3"), MotionLimits.of(robot), min(count, 8), rng=np.random.default_rng(3), shape=shape
        )
        self.motions = [found[k % len(found)] for k in range(count)]

    def evaluate(self, t: Array) -> tuple[Array, Array, Array]:
        """Return q, dq and ddq (N, n) at times t (N,)."""
        home, parts = self.motions[0].q0, [np.zeros((len(t), 3)) for _ in range(3)]
        which = np.minimum(t // self.cycle, len(self.motions) - 1).astype(int)
        for k in np.unique(which):
            own = which == k
            for all_of, one in zip(parts, self.motions[k].evaluate(t[own] - k * self.cycle), strict=True):
                all_of[own] = one
            parts[0][own] += home - self.motions[k].q0
        return parts[0], parts[1], parts[2]


def recorded(folder: Path, work: Work, seconds: float) -> Path:
    """Write the recording of some work."""
    robot = load_robot(None)
    settings = SimulationSettings(effects=[parse(f"{LAW}:torque={TRUE}", robot)], sensors=Sensors.real())
    recording = simulate(robot, work, settings, duration=seconds, rng=np.random.default_rng(0))
    return write_recording(folder / "run", recording)


def measured(command: str, bag: Path, out: Path) -> tuple[float, float, str]:
    """Run a command on a bag; return its processor seconds, its gigabytes, and the friction that it found."""
    options = ["--no-propose"] if command == "diagnose" else ["--with", LAW]
    words = [
        "-c",
        "from elastic_arm.app import main; main()",
        command,
        str(bag),
        "--out",
        str(out),
        "--force",
        *options,
    ]
    with subprocess.Popen([sys.executable, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    seconds = usage.ru_utime + usage.ru_stime
    return seconds, usage.ru_maxrss / 1e6, found_in(out) if status == 0 else f"exit status {process.returncode}"


def found_in(folder: Path) -> str:
    """Return the friction that a result states."""
    file = next(folder / name for name in RESULTS if (folder / name).exists())
    result = json.loads(file.read_text(encoding="utf-8"))
    if file.name == RESULTS[0]:
        causes = [f"{c['effect']}:{c['joint']} {c['parameters']}" for c in result["causes"]]
        return f"{result['verdict']} {'; '.join(causes)}"
    one = next(e for e in result["estimates"] if e["name"].startswith(LAW))
    return f"{one['value']:.4f} ± {one['std']:.2g} Nm, {one['verdict']}"


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motion", type=float, default=20.0, help="s of motion before the standstill")
    parser.add_argument("--rest", type=float, nargs="*", default=(0.0, 30.0, 60.0, 300.0), help="s of standstill")
    parser.add_argument("--work", type=float, nargs="*", default=(60.0, 600.0, 3600.0), help="s of work")
    parser.add_argument("--standing", type=float, nargs="*", default=(0.0, 0.5, 0.95), help="share of the work")
    parser.add_argument("--commands", nargs="*", default=("identify", "diagnose"))
    asked = parser.parse_args()
    motion = Work(asked.motion, asked.motion, 0.0)
    cases = [(f"{asked.motion:g} s of motion + {rest:g} s of rest", motion, asked.motion + rest) for rest in asked.rest]
    for seconds in asked.work:
        cases += [(f"{seconds:g} s of work, {s:.0%} rest", Work(seconds, 30.0, s), seconds) for s in asked.standing]
    first: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, work, seconds in cases:
            bag, out = recorded(Path(folder), work, seconds), Path(folder) / "out"
            for command in asked.commands:
                elapsed, memory, found = measured(command, bag, out)
                ratio = elapsed / first.setdefault(command, elapsed)
                line = f"{name:38} {command:9} {elapsed:7.1f} s {ratio:6.2f} {memory:6.2f} GB  {found}"
                sys.stdout.write(line + "\n")
                sys.stdout.flush()
                shutil.rmtree(out, ignore_errors=True)
            shutil.rmtree(bag)


if __name__ == "__main__":
    main()
