"""What of corrected servo arms is nearer: closed loop and scales of torque, on arms of fresh seeds.

    python -m benchmarks.bench_servo_correction --seed 515151 --level servo [--only payload]

An arm of the challenge's level for each effect that it has, and one without. Printed of each: the
closed-loop error of each joint on the recording that judges, mrad: described → found → written →
alone (true arm), where "found" are the causes and numbers of the diagnosis before they are refined
in closed loop, and "alone" is the written MJCF as it is loaded, or the description where none is
written; processor seconds of diagnosis and correction; and what was said. At the end: at how
many joints the written arm is nearer than the described one, its errors over those of the true arm,
and z = (value - truth) / std of each joint's `torque_scale`.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.cli.diagnose import correct
from elastic_arm.cli.mujoco.corrected import Correction
from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.corrected_robot import repaired_robot
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.effects import EFFECTS
from elastic_arm.errors import RobotError
from elastic_arm.mujoco.closed_loop import with_controllers
from elastic_arm.mujoco.judgement import Judging, closed_loop
from elastic_arm.mujoco.recorder import record_commands
from elastic_arm.mujoco.refinable import with_refined
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot, load_robot
from elastic_arm.robot.mjcf import MjcfArm, open_mjcf
from elastic_arm.studies.blind_challenge.draw import Request
from elastic_arm.studies.blind_challenge.levels import LEVELS
from elastic_arm.studies.blind_challenge.servo_arms import ServoArm, drawn, mjcf, opened

FAR = 5.0  # deviations, beyond which an estimate is wrong


@dataclass(frozen=True)
class Outcome:
    """An arm that was diagnosed and corrected."""

    name: str
    said: str
    errors: dict[str, Array]  # (n,) rad, of "described", "found", "written", "alone", "true"
    scales: Array  # (n, 3) value, deviation and truth of the scale of torque
    seconds: tuple[float, float]  # of the processor, of diagnosis and correction


def outcome(folder: Path, level: str, seed: int, kind: str | None) -> Outcome:
    """Draw an arm, diagnose and correct it."""
    of = LEVELS[level]
    number = (None, *of.effects, *of.foreign).index(kind)
    name = f"{level}_{seed}_{number:02d}_{kind or 'clean'}"
    request = Request(name, () if kind is None else (kind,), (seed, number), of.seconds)
    one = drawn(folder, request, of)
    true = opened(one.true, folder / "true.xml", one.step)
    base = folder / "arm.xml"
    fit, judge = (record_commands(true, told, rate=one.rate, bits=of.bits) for told in one.commands)
    base.write_text(mjcf(one.stated, one.step))
    robot = load_robot(base)
    return corrected(name, one, robot, base, true, fit, judge, folder)


def corrected(
    name: str,
    one: ServoArm,
    robot: Robot,
    base: Path,
    true: MjcfArm,
    fit: Recording,
    judge: Recording,
    folder: Path,
) -> Outcome:
    """Diagnose and correct an arm."""
    begin = time.process_time()
    found = diagnose([fit], Question(robot, refit=True), [judge])
    diagnosed = time.process_time()
    correction = Correction(base, None, None, EFFECTS)
    written = correct(found, robot, folder, correction, [judge], [fit])
    seconds = diagnosed - begin, time.process_time() - diagnosed
    file = correction.path(folder)
    alone = file if file is not None and file.exists() else base
    errors = {"alone": played(open_mjcf(alone), judge), "true": played(true, judge)}
    arms = {"described": robot, "found": repaired_robot(robot, found), "written": written.robot}
    models = {kind: robot if arm is None else arm for kind, arm in arms.items()}
    errors |= {kind: error_of(correction, arm, folder, judge) for kind, arm in models.items()}
    causes = [f"{cause.effect}:{cause.joint or 'all'}" for cause in found.causes]
    said = f"{found.verdict}: {', '.join(causes) or 'no cause'}"
    back = () if written.choice is None else written.choice.taken_back
    said += f"; taken back: {', '.join(back)}" if back else ""
    found = with_refined(found, written.refined)
    return Outcome(name, said, errors, scales_of(found, one), seconds)


def error_of(correction: Correction, robot: Robot, folder: Path, judge: Recording) -> Array:
    """Return the errors (n,) of an arm by the file that is written of it; NaN where none is."""
    try:
        correction.write(robot, folder)
        file = correction.path(folder)
        assert file is not None
        return played(with_controllers(open_mjcf(file), robot), judge)
    except (RobotError, FileNotFoundError, ValueError):
        return np.full(robot.n, np.nan)


def played(arm: MjcfArm, judge: Recording) -> Array:
    """Return the errors (n,) of a model."""
    found = closed_loop(arm, [Judging(judge)], late=0.1)
    assert found is not None
    return found.errors


def scales_of(found: Diagnosis, one: ServoArm) -> Array:
    """Return value, deviation and truth (n, 3) of the scales of torque."""
    rows = []
    for name, stated, true in zip(found.joints, one.stated, one.true, strict=True):
        estimate = found.torque_scale.get(name)
        value, std = (np.nan, np.nan) if estimate is None else (estimate.value, estimate.std)
        rows.append((value, std, true.servo["kp"] / stated.servo["kp"]))
    return np.array(rows, dtype=float)


def lines(one: Outcome) -> Sequence[str]:
    """Return what is printed of an arm."""
    rows = [f"{one.name}  {one.said}  ({one.seconds[0]:.1f} + {one.seconds[1]:.1f} s)"]
    for k, (value, std, truth) in enumerate(one.scales):
        kinds = ("described", "found", "written", "alone")
        sizes = " → ".join(f"{1e3 * one.errors[kind][k]:7.2f}" for kind in kinds)
        rows.append(
            f"  joint_{k + 1}  {sizes} ({1e3 * one.errors['true'][k]:5.2f})"
            f"   scale {value:.3f} ± {std:.3f} ({truth:.3f}, z {(value - truth) / std:+.1f})"
        )
    return rows


def summary(outcomes: Sequence[Outcome]) -> str:
    """Return the counts over all arms."""
    described = np.concatenate([one.errors["described"] for one in outcomes])
    written = np.concatenate([one.errors["written"] for one in outcomes])
    alone = np.concatenate([one.errors["alone"] for one in outcomes])
    true = np.concatenate([one.errors["true"] for one in outcomes])
    ratio = written / true
    scales = np.concatenate([one.scales for one in outcomes])
    z = np.abs((scales[:, 0] - scales[:, 2]) / scales[:, 1])
    seconds = np.array([one.seconds for one in outcomes])
    return (
        f"{np.sum(written < described)} of {len(written)} joints nearer than described;"
        f" error over the true arm's: median {np.median(ratio):.2f}, 90 %"
        f" {np.quantile(ratio, 0.9):.2f}, largest {ratio.max():.2f}\n"
        f"{np.sum(alone > described)} of {len(alone)} joints of the MJCF alone further than"
        " described\n"
        f"torque_scale: |z| median {np.median(z):.2f}, 90 % {np.quantile(z, 0.9):.2f},"
        f" {np.sum(z > FAR)} of {len(z)} beyond {FAR:g}\n"
        f"processor seconds an arm: {seconds[:, 0].mean():.1f} + {seconds[:, 1].mean():.1f}"
    )


def arm_options(doc: str | None, seed: int) -> argparse.ArgumentParser:
    """Return the options that choose arms: level, seed, effects."""
    parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    parser.add_argument("--level", choices=("servo", "position"), default="servo")
    parser.add_argument("--seed", type=int, default=seed)
    parser.add_argument("--only", action="append", help="an effect, or 'clean'; may be repeated")
    return parser


def arms_of(asked: argparse.Namespace) -> Iterator[tuple[Path, str | None]]:
    """Yield a folder for each arm that is asked for, and its effect; None of the clean one."""
    with tempfile.TemporaryDirectory() as temporary:
        for kind in asked.only or ["clean", *LEVELS[asked.level].effects]:
            own = Path(temporary) / kind
            own.mkdir()
            yield own, None if kind == "clean" else kind


def main() -> None:
    """Print a table of each arm, and the counts."""
    asked = arm_options(__doc__, 515151).parse_args()
    outcomes = []
    for folder, effect in arms_of(asked):
        found = outcome(folder, asked.level, asked.seed, effect)
        print("\n".join(lines(found)), flush=True)
        outcomes.append(found)
    print(summary(outcomes))


if __name__ == "__main__":
    main()
