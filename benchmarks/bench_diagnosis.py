"""Time of a diagnosis as recordings and arms grow, on one core. ``python -m benchmarks.bench_diagnosis``.

Arms with Coulomb friction on one joint and a joint torque offset on another, recorded by the project's own simulator
with realistic noise, validated on the last third. Processor seconds of the diagnosis alone, reading and kernels' first
compilation left out (told apart as `first`).
"""

from __future__ import annotations

import argparse
import os
import sys
import time

import numpy as np

from elastic_arm.dynamics import build_model
from elastic_arm.effects import Active, parse
from elastic_arm.excitation import MotionLimits, random_trajectories
from elastic_arm.gap.diagnosis import Question, diagnose
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot, load_robot
from elastic_arm.robot.synthetic import random_arm
from elastic_arm.sensors import Sensors
from elastic_arm.simulation import simulate

ONE_CORE = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
TARGET = "20 s at n = 3: at most 15 s"


def arm_of(n: int) -> Robot:
    """The arm of the package for three joints, a random one otherwise."""
    return load_robot(None) if n == 3 else random_arm(n, np.random.default_rng(n))


def recording(robot: Robot, seconds: float) -> Recording:
    """One recording of the arm with two effects."""
    rng = np.random.default_rng(0)
    motion = random_trajectories(build_model(robot), MotionLimits.of(robot), 1, rng=rng)[0]
    first, last = robot.joint_names[0], robot.joint_names[-1]
    effects: list[Active] = [
        parse(f"coulomb_friction:{last}:torque=2.0,side=motor", robot),
        parse(f"joint_torque_offset:{first}:offset=1.0", robot),
    ]
    return simulate(robot, motion, effects=effects, sensors=Sensors.real(), duration=seconds, rng=rng)


def report(n: int, seconds: float) -> None:
    """Print one line."""
    robot = arm_of(n)
    data = recording(robot, seconds)
    spent = []
    for _ in range(2):
        start = time.process_time()
        found = diagnose([data], Question(robot))
        spent.append(time.process_time() - start)
    causes = ", ".join(f"{c.effect} {c.joint}" for c in found.causes) or "–"
    print(
        f"  n = {n}, {seconds:4.0f} s: {spent[1]:7.2f} s  (first {spent[0]:7.2f} s)  {found.verdict}: {causes}",
        flush=True,
    )


def main() -> None:
    """Run and print."""
    if any(os.environ.get(name) != "1" for name in ONE_CORE):
        # Libraries read these when they are loaded, so begin again with them.
        os.execve(
            sys.executable, [sys.executable, "-m", "benchmarks.bench_diagnosis", *sys.argv[1:]], os.environ | ONE_CORE
        )
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, nargs="*", default=[5.0, 10.0, 20.0, 40.0])
    parser.add_argument("--joints", type=int, nargs="*", default=[2, 3, 6])
    arguments = parser.parse_args()
    print(f"one diagnosis, processor seconds, one core ({TARGET})")
    for seconds in arguments.seconds:
        report(3, seconds)
    for n in arguments.joints:
        if n != 3:
            report(n, 20.0)


if __name__ == "__main__":
    main()
