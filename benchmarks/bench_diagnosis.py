"""Time of a diagnosis as recordings and arms grow, on one core. ``python -m benchmarks.bench_diagnosis``.

Arms with Coulomb friction on one joint and a joint torque offset on another, recorded by the project's own simulator
with realistic noise, and judged on another motion, half as long. Processor seconds of the diagnosis alone, a second
time, with the laws derived (`first`: the first time). Last, what takes longest: a search that finds no explanation, as
the friction is not in the catalogue.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time

import numpy as np

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS, EffectInstance, parse
from elastic_arm.excitation import MotionLimits, Shape, random_trajectories
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot, load_robot
from elastic_arm.robot.synthetic import random_arm
from elastic_arm.sensors import Sensors
from elastic_arm.simulation import simulate

ONE_CORE = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
FRICTION = ("coulomb_friction", "stribeck_friction", "load_dependent_friction", "viscous_friction")
SHORTEST = 5.0  # s, of what judges
TARGET = "20 s at n = 3: at most 15 s"


def arm_of(n: int) -> Robot:
    """The arm of the package for three joints, a random one otherwise."""
    return load_robot(None) if n == 3 else random_arm(n, np.random.default_rng(n))


def recordings(robot: Robot, seconds: float) -> list[Recording]:
    """Two recordings of the arm with two effects: one to fit, one of another motion, half as long, to judge."""
    rng = np.random.default_rng(0)
    first, last = robot.joint_names[0], robot.joint_names[-1]
    effects: list[EffectInstance] = [
        parse(f"coulomb_friction:{last}:torque=2.0,side=motor", robot),
        parse(f"joint_torque_offset:{first}:offset=1.0", robot),
    ]
    made = []
    for duration in (seconds, max(0.5 * seconds, SHORTEST)):
        shape = Shape(period=min(10.0, duration), periods=math.ceil(duration / 10.0))
        motion = random_trajectories(build_model(robot), MotionLimits.of(robot), 1, rng=rng, shape=shape)[0]
        made.append(simulate(robot, motion, effects=effects, sensors=Sensors.real(), duration=duration, rng=rng))
    return made


def report(n: int, seconds: float, without: tuple[str, ...] = ()) -> None:
    """Print one line, of a diagnosis without these effects."""
    robot = arm_of(n)
    fitted, judged = recordings(robot, seconds)
    question = Question(robot, effects=tuple(e for e in EFFECTS.values() if e.id not in without))
    spent = []
    for _ in range(2):
        start = time.process_time()
        found = diagnose([fitted], question, [judged])
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
    print("the same, friction not in the catalogue")
    report(3, 20.0, FRICTION)


if __name__ == "__main__":
    main()
