"""Time of a diagnosis as recordings and arms grow. ``python -m benchmarks.bench_diagnosis
[--threads 2]``.

Arms with Coulomb friction on one joint and a joint torque offset on another, recorded by the
project's own simulator with realistic noise, and judged on another motion, half as long. Processor
seconds of the diagnosis alone on one core, on several of them elapsed ones, too; a second time,
with the laws derived (`first`: the first time). Then a search that finds no explanation, as the
friction is not in the catalogue. Last, a realistic arm: every number of its description a little
wrong, and ten causes to find, with and without ``--refit --with coulomb_friction --with
viscous_friction``; 20 s to fit and 20 s to judge.
"""

import argparse
import math
import os
import sys
import time

import numpy as np

from elastic_arm.codegen.parallel import threads
from elastic_arm.diagnosis import Priors, Question, diagnose
from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS, EffectInstance, parse
from elastic_arm.effects.text import known_effects
from elastic_arm.equations.robot_at import nearest_robot
from elastic_arm.evidence.numbers import numbers_of
from elastic_arm.excitation import MotionLimits, Shape, random_trajectories
from elastic_arm.memory import keep_memory
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot, load_robot
from elastic_arm.sensors import Sensors
from elastic_arm.simulation import SimulationSettings, simulate
from tests.helpers.random_arms import random_arm

ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
FRICTION = ("coulomb_friction", "stribeck_friction", "load_dependent_friction", "viscous_friction")
SHORTEST = 5.0  # s, of what judges
TARGET = "20 s at n = 3: at most 15 s"
TEN_TARGET = "40 s in all: at most 15 s at n = 3, 30 s at n = 6"
# Of the causes that sit on the first, the middle and the last joint; {0}, {1}, {2} are their names.
TEN_CAUSES = (
    "coulomb_friction:{0}:torque=6.0,side=motor",
    "coulomb_friction:{1}:torque=8.0,side=motor",
    "coulomb_friction:{2}:torque=4.0,side=motor",
    "viscous_friction:{0}:coefficient=8.0,side=motor",
    "viscous_friction:{1}:coefficient=12.0,side=motor",
    "viscous_friction:{2}:coefficient=5.0,side=motor",
    "joint_torque_offset:{0}:offset=5.0",
    "motor_torque_offset:{1}:offset=-5.0",
    "torque_ripple:{0}:amplitude=2.0,order=2",
    "transmission_error:{2}:amplitude=1e-4,order=2",
)
SPREAD = 0.8  # largest deviation of a number of the arm, in standard deviations of its prior


def arm_of(n: int) -> Robot:
    """The arm of the package for three joints, a random one otherwise."""
    return load_robot(None) if n == 3 else random_arm(n, np.random.default_rng(n))


def recordings(robot: Robot, seconds: float) -> list[Recording]:
    """Two recordings of the arm with two effects: one to fit, one of another motion, half as long,
    to judge."""
    rng = np.random.default_rng(0)
    first, last = robot.joint_names[0], robot.joint_names[-1]
    effects: list[EffectInstance] = [
        parse(f"coulomb_friction:{last}:torque=2.0,side=motor", robot),
        parse(f"joint_torque_offset:{first}:offset=1.0", robot),
    ]
    made = []
    for duration in (seconds, max(0.5 * seconds, SHORTEST)):
        shape = Shape(period=min(10.0, duration), periods=math.ceil(duration / 10.0))
        motion = random_trajectories(
            build_model(robot), MotionLimits.of(robot), 1, rng=rng, shape=shape
        )[0]
        made.append(
            simulate(
                robot,
                motion,
                SimulationSettings(effects=effects, sensors=Sensors.real()),
                duration=duration,
                rng=rng,
            )
        )
    return made


def ten_causes(nominal: Robot) -> list[Recording]:
    """Two recordings, 20 s each, of an arm that differs from its description everywhere and has ten
    effects."""
    rng = np.random.default_rng(nominal.n)
    sides = ("link", "drive", "motor")
    numbers = numbers_of(nominal, (), 1000.0, Priors(), (), np.full(nominal.n, 100.0), None, sides)
    robot = nearest_robot(nominal, numbers, rng.uniform(-SPREAD, SPREAD, len(numbers)))
    places = [nominal.joint_names[k] for k in (0, nominal.n // 2, -1)]
    effects = [parse(text.format(*places), robot) for text in TEN_CAUSES]
    shape = Shape(period=10.0, periods=2)
    motions = random_trajectories(
        build_model(robot), MotionLimits.of(robot), 2, rng=rng, shape=shape
    )
    sensors = Sensors.real()
    return [
        simulate(
            robot, m, SimulationSettings(effects=effects, sensors=sensors), duration=20.0, rng=rng
        )
        for m in motions
    ]


class Times:
    """Processor and elapsed seconds since it was made."""

    def __init__(self) -> None:
        self._processor, self._elapsed = time.process_time(), time.perf_counter()

    def __str__(self) -> str:
        processor, elapsed = (
            time.process_time() - self._processor,
            time.perf_counter() - self._elapsed,
        )
        return (
            f"{processor:7.2f} s"
            if threads() == 1
            else f"{processor:7.2f} s, {elapsed:7.2f} s elapsed"
        )


def report_ten(n: int) -> None:
    """Print two lines, of a realistic arm as it is described, and with the description counted as
    uncertain."""
    robot = arm_of(n)
    fitted, judged = ten_causes(robot)
    known = known_effects(("coulomb_friction", "viscous_friction"), robot)
    for refit, given in ((False, ()), (True, known)):
        times = Times()
        found = diagnose([fitted], Question(robot, refit=refit, given=given), [judged])
        spent = str(times)
        asked = "--refit --with" if refit else "as described"
        print(
            f"  n = {n}, {asked:14s}: {spent}  {found.verdict}, {len(found.causes)} causes",
            flush=True,
        )


def report(n: int, seconds: float, without: tuple[str, ...] = ()) -> None:
    """Print one line, of a diagnosis without these effects."""
    robot = arm_of(n)
    fitted, judged = recordings(robot, seconds)
    question = Question(robot, effects=tuple(e for e in EFFECTS.values() if e.id not in without))
    spent = []
    for _ in range(2):
        times = Times()
        found = diagnose([fitted], question, [judged])
        spent.append(str(times))
    causes = ", ".join(f"{c.effect} {c.joint}" for c in found.causes) or "–"
    print(
        f"  n = {n}, {seconds:4.0f} s: {spent[1]}  (first {spent[0]})  {found.verdict}: {causes}",
        flush=True,
    )


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, nargs="*", default=[5.0, 10.0, 20.0, 40.0])
    parser.add_argument("--joints", type=int, nargs="*", default=[2, 3, 6])
    parser.add_argument(
        "--ten", type=int, nargs="*", default=[3, 6], help="joints of the realistic arms"
    )
    parser.add_argument(
        "--threads", type=int, default=1, help="among which a diagnosis is shared out"
    )
    arguments = parser.parse_args()
    wanted = {"OMP_NUM_THREADS": str(arguments.threads), **ONE_THREAD}
    if any(os.environ.get(name) != number for name, number in wanted.items()):
        # Libraries read these when they are loaded, so begin again with them.
        os.execve(
            sys.executable,
            [sys.executable, "-m", "benchmarks.bench_diagnosis", *sys.argv[1:]],
            os.environ | wanted,
        )
    keep_memory()
    print(f"one diagnosis, processor seconds, {threads()} of the cores ({TARGET})")
    for seconds in arguments.seconds:
        report(3, seconds)
    for n in arguments.joints:
        if n != 3:
            report(n, 20.0)
    print("the same, friction not in the catalogue")
    report(3, 20.0, FRICTION)
    print(f"a realistic arm with ten causes ({TEN_TARGET})")
    for n in arguments.ten:
        report_ten(n)


if __name__ == "__main__":
    main()
