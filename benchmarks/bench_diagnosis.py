"""Processor time and memory of a diagnosis. ``python -m benchmarks.bench_diagnosis [--only six]``.

Each row of the table is a process of its own with one numeric thread. Printed are the processor
seconds of the call, without imports and the reading of the bags (of `readme`: the whole command),
the peak memory of the process, and the ratio of the seconds to one dense `numpy.linalg.lstsq` of
all columns of the fitted recordings (parameters of the arm, dry and viscous friction of each
joint) in the same run. The ratio holds on other machines. What has not ended after `--limit`
seconds is stopped. A first run also fills the cache of compiled kernels: run twice.
"""

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.diagnosis import Priors, Question, diagnose
from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS, EffectInstance, parse
from elastic_arm.equations.robot_at import nearest_robot
from elastic_arm.evidence.numbers import numbers_of
from elastic_arm.excitation import MotionLimits, Shape, random_trajectories
from elastic_arm.memory import keep_memory
from elastic_arm.mujoco.recorder import record_commands
from elastic_arm.recording import Recording, Side, read_recording, write_recording
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.robot import Robot, load_robot, save_robot
from elastic_arm.sensors import Sensors
from elastic_arm.simulation import SimulationSettings, simulate
from elastic_arm.studies.blind_challenge import servo_arms
from elastic_arm.studies.blind_challenge.campaign import recorded
from elastic_arm.studies.blind_challenge.draw import Request, bags_of, description_path
from elastic_arm.studies.blind_challenge.hidden_arms.realistic_sensors import MOTOR
from elastic_arm.studies.blind_challenge.levels import FIELD
from tests.helpers import six_axes
from tests.helpers.random_arms import random_arm

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
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
README = "coulomb_friction:joint_2:torque=13.9"


@dataclass(frozen=True)
class Case:
    """Files of a row: the arm, bags to fit and bags that judge."""

    robot: str
    fitted: list[str]
    judged: list[str]

    @classmethod
    def written(
        cls, folder: Path, robot: Robot | Path, recordings: Sequence[Recording], fitted: int
    ) -> "Case":
        """Write the recordings, of which the first are fitted, and the arm if it is no file."""
        path = folder / "robot.yaml" if isinstance(robot, Robot) else robot
        if isinstance(robot, Robot):
            save_robot(robot, path)
        bags = [str(folder / f"run_{k}") for k in range(len(recordings))]
        for bag, recording in zip(bags, recordings, strict=True):
            write_recording(bag, recording)
        return cls(str(path), bags[:fitted], bags[fitted:])


@dataclass(frozen=True)
class Row:
    """A row of the table with what is to be reached."""

    words: str
    seconds: float
    gigabytes: float | None
    make: Callable[[Path], Case]
    call: Callable[[Case], str]


def arm_of(n: int) -> Robot:
    """The arm of the package for three joints, a random one otherwise."""
    return load_robot(None) if n == 3 else random_arm(n, np.random.default_rng(n))


def simulated(
    robot: Robot, effects: Sequence[EffectInstance], durations: Sequence[float], seed: int
) -> list[Recording]:
    """Return recordings of random motions at 1 kHz with realistic sensors."""
    rng = np.random.default_rng(seed)
    settings = SimulationSettings(effects=effects, sensors=Sensors.real())
    found = []
    for duration in durations:
        shape = Shape(period=10.0, periods=round(duration / 10.0))
        (motion,) = random_trajectories(
            build_model(robot), MotionLimits.of(robot), 1, rng=rng, shape=shape
        )
        found.append(simulate(robot, motion, settings, duration=duration, rng=rng))
    return found


def two_causes(seconds: float) -> Callable[[Path], Case]:
    """Dry friction of one joint and an offset of another; judged on half as long a motion."""

    def make(folder: Path) -> Case:
        robot = arm_of(3)
        texts = ("coulomb_friction:joint_3:torque=2.0,side=motor", "joint_torque_offset:joint_1")
        effects = [parse(texts[0], robot), parse(f"{texts[1]}:offset=1.0", robot)]
        runs = simulated(robot, effects, (seconds, 0.5 * seconds), 0)
        return Case.written(folder, robot, runs, 1)

    return make


def ten_causes(folder: Path) -> Case:
    """Two runs of 20 s of an arm whose every number is off, with ten effects."""
    nominal = arm_of(3)
    rng = np.random.default_rng(3)
    sides = ("link", "drive", "motor")
    numbers = numbers_of(nominal, (), 1000.0, Priors(), (), np.full(nominal.n, 100.0), None, sides)
    robot = nearest_robot(nominal, numbers, rng.uniform(-SPREAD, SPREAD, len(numbers)))
    effects = [parse(text.format(*robot.joint_names), robot) for text in TEN_CAUSES]
    runs = simulated(robot, effects, (20.0, 20.0), 3)
    return Case.written(folder, nominal, runs, 1)


def cobot(seconds: float) -> Callable[[Path], Case]:
    """Angles and currents at 250 Hz of an arm whose URDF states no friction."""

    def make(folder: Path) -> Case:
        robot = folder / "robot.urdf"
        robot.write_text(six_axes.urdf())
        runs = []
        for seed in (1, 2):
            table = six_axes.table(seed, rate=250.0, seconds=seconds)
            t, q, dq, current = np.split(table, [1, 7, 13], axis=1)
            stamps = np.round(1e9 * t[:, 0]).astype(np.int64)
            torque = current * six_axes.TORQUE_CONSTANTS * six_axes.RATIO
            link = Side(stamps, q, dq)
            runs.append(Recording(six_axes.JOINTS, link, Side(stamps, effort=torque)))
        return Case.written(folder, robot, runs, 1)

    return make


def seven_joints(folder: Path) -> Case:
    """Three runs of the challenge's level `field`, motor side alone, one judges."""
    level = replace(FIELD, joints=(7,), sides=(MOTOR,))
    request = Request("seven", ("payload",), (720106, 0), (30.0, 30.0, 30.0))
    recorded(folder, request, level, EFFECTS)
    bags = [str(bag) for bag in bags_of(folder, request.name, 3)]
    return Case(str(description_path(folder, request.name)), bags[:2], bags[2:])


def servos(
    n: int, rates: Sequence[float], seconds: Sequence[float], bits: int, fitted: int
) -> Callable[[Path], Case]:
    """Commands and positions of servo arms that are off their description, one with a payload."""

    def make(folder: Path) -> Case:
        rng = np.random.default_rng([720107, n])
        stated: list[servo_arms.ServoJoint] = []
        while len(stated) < n:
            stated += servo_arms.described(rng)
        stated = stated[:n]
        built = servo_arms.ordinary(stated, rng)
        built[-1] = replace(built[-1], payload=0.3 * built[-1].mass)
        path = folder / "robot.xml"
        runs = []
        for rate, lasting in zip(rates, seconds, strict=True):
            step = 1.0 / rate / np.ceil(1.0 / (rate * servo_arms.STEP))
            told = servo_arms.commands(rate, lasting, n, rng)
            arm = servo_arms.opened(built, path, step)
            runs.append(record_commands(arm, told, rate=rate, bits=bits))
        path.write_text(servo_arms.mjcf(stated, step))
        return Case.written(folder, path, runs, fitted)

    return make


def readme(folder: Path) -> Case:
    """Two recordings as the README makes them."""
    robot = load_robot(None)
    runs = simulated(robot, [parse(README, robot)], (20.0, 20.0), 0)
    return Case.written(folder, robot, runs, 1)


def diagnosed(case: Case) -> str:
    """Diagnose and return what was found."""
    robot = load_robot(case.robot)
    fitted = [read_recording(bag) for bag in case.fitted]
    judged = [read_recording(bag) for bag in case.judged]
    with Measured():
        found = diagnose(fitted, Question(robot), judged)
    causes = [f"{cause.effect} {cause.joint or ''}".strip() for cause in found.causes]
    return f"{found.verdict}: {', '.join(causes)}"


def checked(case: Case) -> str:
    """Check the first bag and return the codes that were found."""
    robot = load_robot(case.robot)
    with Measured():
        report = check_bag(case.fitted[0], robot=robot)
    return ", ".join(finding.code for finding in report.findings)


def commanded(case: Case) -> str:
    """Run the command of the README, reports included."""
    with tempfile.TemporaryDirectory() as out, Measured(children=True):
        command = ["diagnose", *case.fitted, "--validate", *case.judged, "--out", f"{out}/found"]
        done = subprocess.run(
            [sys.executable, "-m", "elastic_arm", *command], capture_output=True, text=True
        )
    return done.stdout.splitlines()[0] if done.stdout else done.stderr.strip()


ROWS = {
    "two_20": Row("3 joints, 20 s, two causes", 3.0, 0.6, two_causes(20.0), diagnosed),
    "two_40": Row("3 joints, 40 s, two causes", 5.0, 0.6, two_causes(40.0), diagnosed),
    "ten": Row("3 joints, 2 × 20 s, ten causes", 10.0, 0.8, ten_causes, diagnosed),
    "six": Row("6 joints, 2 × 25 s, currents", 20.0, 1.0, cobot(25.0), diagnosed),
    "seven": Row("7 joints, 3 × 30 s", 40.0, 1.2, seven_joints, diagnosed),
    "servo": Row(
        "servo, 6 joints, 4 × 12 s",
        10.0,
        0.6,
        servos(6, (30.0, 50.0, 50.0, 50.0), (12.0,) * 4, 12, 3),
        diagnosed,
    ),
    "position": Row(
        "position, 5 joints, 16 + 10 s",
        20.0,
        1.0,
        servos(5, (500.0, 500.0), (16.0, 10.0), 17, 1),
        diagnosed,
    ),
    "check": Row("bag check, 6 joints, 20 s", 1.0, None, cobot(20.0), checked),
    "readme": Row("diagnose of the README", 6.0, None, readme, commanded),
}


class Measured:
    """Processor seconds of a block, and the peak memory of the process at its end, as a line of
    JSON."""

    def __init__(self, *, children: bool = False) -> None:
        self._who = resource.RUSAGE_CHILDREN if children else resource.RUSAGE_SELF

    def _seconds(self) -> float:
        used = resource.getrusage(self._who)
        return used.ru_utime + used.ru_stime

    def __enter__(self) -> None:
        self._begin = self._seconds()

    def __exit__(self, *error: object) -> None:
        used = {
            "seconds": self._seconds() - self._begin,
            "gigabytes": resource.getrusage(self._who).ru_maxrss * 1024 / 1e9,
        }
        print(json.dumps(used), flush=True)


def dense(case: Case) -> str:
    """Solve one dense least squares of all columns of the fitted recordings."""
    robot = load_robot(case.robot)
    model = build_model(robot)
    columns = []
    torques = []
    for bag in case.fitted:
        samples = read_recording(bag).samples()
        links = samples.q if samples.q is not None else samples.theta
        motors = samples.theta if samples.theta is not None else samples.q
        x = np.hstack([links, motors]) if robot.elastic else links
        dx = _rate(samples.t, x, 1)
        ddx = _rate(samples.t, x, 2)
        Y = model.regressor(x, dx, ddx)
        friction = [np.eye(x.shape[1]) * each[:, None] for each in (np.sign(dx), dx)]
        columns.append(np.concatenate([Y, *friction], axis=2).reshape(Y.shape[0] * Y.shape[1], -1))
        torques.append(columns[-1].sum(axis=1))
    A = np.concatenate(columns)
    b = np.concatenate(torques)
    with Measured():
        np.linalg.lstsq(A, b, rcond=None)
    return f"{A.shape[0]} × {A.shape[1]}"


def _rate(t: Array, x: Array, order: int) -> Array:
    """Return a derivative of positions; noise does not matter to the time of the solution."""
    for _ in range(order):
        x = np.gradient(x, t, axis=0)
    return x


def _child(kind: str, name: str, folder: Path, limit: float) -> dict[str, Any]:
    """Run a part of a row in a process of its own; one that was stopped has said nothing."""
    command = [sys.executable, "-m", "benchmarks.bench_diagnosis", "--limit", str(limit)]
    with subprocess.Popen(
        [*command, "--part", kind, name, str(folder)],
        env=os.environ | ONE_THREAD,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        lines = process.stdout.read().splitlines()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode == -signal.SIGXCPU:
        return {"seconds": limit, "gigabytes": used.ru_maxrss * 1024 / 1e9, "said": None}
    if process.returncode:
        raise SystemExit(f"{kind} {name} failed with status {process.returncode}")
    return {**json.loads(lines[-2]), "said": lines[-1]}


def part_of(kind: str, name: str, folder: Path, limit: float) -> None:
    """Make, answer or solve a row, in a process of its own."""
    row = ROWS[name]
    files = folder / "case.json"
    if kind == "make":
        with Measured():
            case = row.make(folder)
        files.write_text(json.dumps(vars(case)))
        print(f"{len(case.fitted)} and {len(case.judged)} recordings")
        return
    resource.setrlimit(resource.RLIMIT_CPU, (round(limit), round(limit) + 5))
    keep_memory()
    case = Case(**json.loads(files.read_text()))
    print((dense if kind == "dense" else row.call)(case))


def measured(name: str, limit: float) -> str:
    """Return a line of the table."""
    row = ROWS[name]
    with tempfile.TemporaryDirectory() as folder:
        _child("make", name, Path(folder), limit)
        used = _child("answer", name, Path(folder), limit)
        reference = _child("dense", name, Path(folder), limit)
    more = " " if used["said"] else ">"
    ratio = used["seconds"] / reference["seconds"]
    wanted = f"{row.seconds:.0f} s" + (f", {row.gigabytes} GB" if row.gigabytes else "")
    return (
        f"{name:8s} {row.words:31s} {more}{used['seconds']:6.1f} s {used['gigabytes']:5.2f} GB"
        f" {more}{ratio:5.0f} × lstsq of {reference['said']} ({reference['seconds']:.2f} s);"
        f" to reach {wanted}; {used['said'] or 'stopped'}"
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="*", choices=list(ROWS), default=list(ROWS))
    parser.add_argument("--limit", type=float, default=300.0, help="processor seconds of a row")
    parser.add_argument("--part", nargs=3, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.part:
        kind, name, folder = given.part
        part_of(kind, name, Path(folder), given.limit)
        return
    for name in given.only:
        print(measured(name, given.limit), flush=True)


if __name__ == "__main__":
    main()
