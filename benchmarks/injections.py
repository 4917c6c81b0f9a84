"""Known changes added to recordings of real robots, and what the diagnosis says of them.

    python -m benchmarks.injections [--out runs/injections.csv] [--only REGEX] [--robots NAME …]
    [--rounds 1] [--seed 720110] [--jobs 1] [--arms runs/injections_arms] [--data ../shared/data]

Each change is one effect at one joint, of 1, 2 or 5 times what a workshop would notice
(`benchmarks/known_changes.py`). Joint and size are drawn. The unchanged recordings are asked first,
and their answer is the base: a change is drawn at a joint at which the base does not name its
effect, and is left out where no such joint is left.

A change is named where a cause, or an alternative of 5 % or more, is its effect at its joint. A
false cause has 0.9 or more and is neither the change nor in the base. A size is that of the change
and of what the base has there. A clipped torque has no effect in the catalogue: nothing can be
named, and only false causes count. Every question is answered by `benchmarks.judge`, in a process
of its own. Rows and answers are kept: the command continues where it was interrupted.
"""

import argparse
import json
import re
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

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
from benchmarks.known_changes import CHANGES, SERVO_CHANGES, Bench, ServoBench, place_of
from elastic_arm.recording import read_recording, write_recording
from elastic_arm.robot import load_robot, save_robot

TIMES = (1.0, 2.0, 5.0)
SEED = 720110
SERVO = "xl330"
SERVO_GAINS = (100, 400)  # in the register of the servo
ASKED = (SERVO, "gen3", "kr300_3", "kr300_6", "lwr4", "ur5e")  # the log of the last is simulated


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


def with_base(name: str, change: float, value: float) -> float:
    """Return the number of an effect that is there, and a change of it."""
    return change * value if name in ("gain", "inertia") else change + value


# --- The questions
# --------------------------------------------------------------------------------------------------


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
        free = [
            j for j in bench.joints(name) if not is_named(base, effect, place_of(name, robot, j))
        ]
        if not free:
            print(f"{plain.level} {name}: no joint where it can be seen and is new", flush=True)
            continue
        for k in range(rounds):
            times = float(sizes[k % len(sizes)])
            j = int(rng.choice(free))
            title = f"{plain.level}_{name}_{robot.joint_names[j]}_{times:g}"
            if re.search(only, title):
                yield injection(replace(plain, name=title), bench, name, times, j, arms)


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


def mark(row: dict[str, str], arms: Path, out: Path) -> dict[str, str]:
    """Return a row that holds whether the change was named, whatever its size."""
    (arm,) = json.loads((arms / "arms" / f"{row['arm']}.json").read_text())
    answer = answered(out, row["arm"])
    named = [is_named(answer, truth["effect"], truth["joint"]) for truth in arm["truth"]]
    return row | {"right": str(int(all(named)))}


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
    changed = [mark(row, asked.arms, asked.out) for row in rows if row["kind"] != "unchanged"]
    for row in changed:
        named = "named" if row["right"] == "1" else "not named"
        false = f"; false: {row['false_causes']}" if row["false_causes"] else ""
        print(f"{row['arm']}: {named}; {row['verdict']}: {row['causes']}{false}")
    print(tables(changed))


if __name__ == "__main__":
    main()
