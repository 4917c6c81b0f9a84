"""All examples of real robots in one run, and the tables of docs/results.

    python examples/gallery.py DATA --out gallery [--only kuka_kr300 …] [--tables docs/results]

DATA has a folder for each robot, named as in `examples/`. Every example's `run.sh` is run in a
folder of its own below `--out`, or taken as it is there if it ran to its end; the tables are made
of the `identification.json` and `diagnosis.json` that are there afterwards, and of the processor
time of each command in `times.tsv`. With `--tables`, they replace those of that folder, and a
picture of each robot's residuals goes to `docs/pictures/real_ROBOT.png`. Rows and pictures of
robots that have no results below `--out` stay as they are, so that robots can be run one after
another.
"""

import argparse
import csv
import json
import math
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from matplotlib.ticker import LogLocator, NullLocator

from elastic_arm.report.style import BLUE, GREEN, GREY, SKY, VERMILION, drawing

HERE = Path(__file__).resolve().parent
TIMES, ENDED = "times.tsv", "exit_status"
# Runs a command and notes its processor time beside the folder that it wrote to.
TIMED = """
import os, resource, subprocess, sys
code = subprocess.call(sys.argv[2:])
used = resource.getrusage(resource.RUSAGE_CHILDREN)
out = sys.argv[sys.argv.index("--out") + 1] if "--out" in sys.argv else ""
with open(sys.argv[1], "a") as file:
    print(os.path.abspath(out), round(used.ru_utime + used.ru_stime), sep="\\t", file=file)
sys.exit(code)
"""
# Points of a picture, in their order.
COLOURS = {
    "nominal": GREY,
    "identified": SKY,
    "robot.yaml": BLUE,
    "before": VERMILION,
    "after": GREEN,
}
# What `identify` has of a link encoder as a torque of the spring.
ENCODER = {"time_delay": "delay", "encoder_offset": "offset"}


def run(example: Path, data: Path, folder: Path) -> None:
    """Run one example in a folder of its own; what it prints goes to `run.log` there."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    shim, command = folder / "bin" / "elastic-arm", Path(sys.executable).parent / "elastic-arm"
    shim.parent.mkdir()
    (shim.parent / "timed.py").write_text(TIMED)
    timed = f'"{sys.executable}" "{shim.parent / "timed.py"}" "{folder.resolve() / TIMES}"'
    shim.write_text(f'#!/bin/sh\nexec {timed} "{command}" "$@"\n')
    shim.chmod(0o755)
    path = os.pathsep.join([str(shim.parent.resolve()), os.environ["PATH"]])
    began = time.monotonic()
    with (folder / "run.log").open("w") as log:
        command = ["sh", str(example / "run.sh"), str(data)]
        code = subprocess.call(
            command, cwd=folder, stdout=log, stderr=log, env={**os.environ, "PATH": path}
        )
    (folder / ENDED).write_text(f"{code}\n")
    print(
        f"{example.name}: exit status {code}, {time.monotonic() - began:.0f} s,"
        f" {folder / 'run.log'}",
        flush=True,
    )


def rows(folder: Path) -> Iterator[list[str]]:
    """Yield the rows of the table for one example."""
    times = _times(folder)
    if not _results(folder):
        yield [folder.name, "checks alone", "", "", "its run.sh makes no fit", ""]
    for file in _results(folder):
        found, seconds = json.loads(file.read_text()), times.get(file.parent.resolve(), "")
        for model, side, values in residuals(found):
            last = ["", "", seconds if model == "identified" else ""]
            if model in ("before", "after"):
                causes = ", ".join(map(_cause, found["causes"])) or "no cause"
                said = [f"{found['verdict']}: {causes}", seconds] if model == "after" else ["", ""]
                last = [_prediction(found, model), *said]
            yield [
                _case(folder, file),
                f"{_command(file)}: {model}, {side}",
                _numbers(values),
                *last,
            ]


def _results(folder: Path) -> list[Path]:
    """Return the results of an example: those of `identify`, then those of `diagnose`."""
    return [
        file
        for name in ("identification", "diagnosis")
        for file in sorted(folder.rglob(f"{name}.json"))
    ]


def _ended(folder: Path) -> bool:
    """Whether an example ran to its end."""
    status = folder / ENDED
    return status.exists() and status.read_text().strip() == "0"


def _command(file: Path) -> str:
    """Return what made a result."""
    return "identify" if file.name == "identification.json" else file.parent.name


def residuals(found: dict[str, Any]) -> Iterator[tuple[str, str, list[float | None]]]:
    """Yield model, side and held-out rms of every joint, Nm, of a result of `identify` or
    `diagnose`."""
    for arms in (found.get("validation") or {}).values():
        for arm in ("nominal", "identified", "consistent"):
            for side, values in arms.get(arm, {}).items():
                yield "robot.yaml" if arm == "consistent" else arm, side, list(values.values())
    for when, places in found.get("gap", {}).items():
        for side in ("link", "drive", "motor") if when in ("before", "after") else ():
            rms = [(place.get(side) or {}).get("rmse") for place in places.values()]
            if any(value is not None for value in rms):
                yield when, side, rms


def picture(folder: Path, path: Path) -> None:
    """Draw what each model of an example misses of the held-out torques, joint by joint, where it
    has any.

    Parameters
    ----------
    folder
        Of the example, with results.
    path
        Of the picture.
    """
    cases: dict[str, dict[str, list[float | None]]] = {}
    for file in _results(folder):
        for model, side, values in residuals(json.loads(file.read_text())):
            case = f"{_case(folder, file)}: {_command(file)}, {side} side"
            cases.setdefault(case, {})[model] = values
    if not cases:
        return
    with drawing(len(cases), 1, size=(7.0, 0.5 + 1.6 * len(cases))) as (figure, axes):
        for ax, (case, models) in zip(axes[:, 0], cases.items(), strict=True):
            width = 0.8 / len(models)
            for k, (model, values) in enumerate(models.items()):
                known = [
                    (joint, value)
                    for joint, value in enumerate(values, start=1)
                    if value is not None
                ]
                at = [joint + (k - 0.5 * (len(models) - 1)) * width for joint, _ in known]
                ax.plot(
                    at,
                    [value for _, value in known],
                    "o",
                    markersize=5,
                    label=model,
                    color=COLOURS[model],
                )
            ax.set(
                title=case,
                ylabel="rms, Nm",
                yscale="log",
                xticks=range(1, len(next(iter(models.values()))) + 1),
            )
            ax.yaxis.set(
                major_locator=LogLocator(subs=(1, 2, 5)),
                major_formatter="{x:g}",
                minor_locator=NullLocator(),
            )
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        axes[-1, 0].set_xlabel("joint")
        figure.savefig(path, dpi=80)


def _times(folder: Path) -> dict[Path, str]:
    """Return the processor time of the command that wrote to a folder, s."""
    file = folder / TIMES
    lines = file.read_text().splitlines() if file.exists() else []
    return {Path(out): seconds for out, seconds in (line.split("\t") for line in lines)}


def _cause(cause: dict[str, Any]) -> str:
    """Return a cause in words, with its confidence."""
    minor = ", minor" if cause["minor"] else ""
    return (
        f"{cause['effect']} {cause['joint'] or ''}".strip()
        + f" ({100 * cause['confidence']:.0f} %{minor})"
    )


def agreement(folder: Path) -> Iterator[list[str]]:
    """Yield the rows of the comparison of `identify` and `diagnose --refit` on the same recordings
    of one example."""
    for file in sorted(folder.rglob("diagnosis_refit/diagnosis.json")):
        other = file.parent.parent / "identified" / "identification.json"
        if not other.exists():
            continue
        found = json.loads(file.read_text())
        estimates = {e["name"]: e for e in json.loads(other.read_text())["estimates"]}
        for law in (*found["known"], *found["causes"]):
            for joint in [law["joint"]] if law["joint"] else found["noise"]:
                for parameter, two in law["parameters"].items():
                    one = _identified(estimates, law["effect"], joint, parameter)
                    if one is not None and two["std"]:
                        apart = abs(one["value"] - two["value"]) / math.hypot(
                            one["std"], two["std"]
                        )
                        values = [f"{v['value']:.4g} ± {v['std']:.2g}" for v in (one, two)]
                        what = f"{law['effect']} {joint}, {two['unit']}"
                        yield [_case(folder, file), what, *values, f"{apart:.1f}"]


def _identified(
    estimates: dict[str, Any], effect: str, joint: str, parameter: str
) -> dict[str, float] | None:
    """Return what `identify` has for a parameter of an effect at a joint; None where it has
    none."""
    if effect not in ENCODER:
        return estimates.get(f"{effect}:{joint}.{parameter}")
    torque, stiffness = (
        estimates.get(f"link_encoder:{joint}.K_{ENCODER[effect]}"),
        estimates.get(f"{joint}.K"),
    )
    if torque is None or stiffness is None or parameter != ENCODER[effect]:
        return None
    return {name: torque[name] / stiffness["value"] for name in ("value", "std")}


def _case(folder: Path, file: Path) -> str:
    return " / ".join([folder.name, *file.relative_to(folder).parts[:-2]])


def _numbers(values: Any) -> str:
    return " ".join("–" if value is None else f"{value:.3g}" for value in values)


def _prediction(found: dict[str, Any], when: str) -> str:
    """Return the largest prediction error over the joints at every horizon, or the reason why there
    is none."""
    prediction = found.get("prediction") or {}
    errors = prediction.get(when)
    if not errors:
        return prediction.get("reason") or "–"
    horizons = prediction["horizons_s"]
    sizes = [size for sides in errors.values() for size in sides.values()]
    known = [k for k in range(len(horizons)) if all(size[k] is not None for size in sizes)]
    each = [
        f"{1e3 * max(size[k] for size in sizes):.3g} at {1e3 * horizons[k]:.0f} ms" for k in known
    ]
    return ", ".join([*each, *(["beyond 1 rad later"] if len(known) < len(horizons) else [])])


TABLES = {
    "real_robots.csv": (
        [
            "robot",
            "model and side",
            "held-out rms a joint, Nm",
            "largest prediction error, mrad",
            "verdict",
            "s",
        ],
        rows,
    ),
    "real_robots_parameters.csv": (
        ["robot", "parameter", "identify", "diagnose --refit", "apart, deviations"],
        agreement,
    ),
}


def write_table(
    path: Path, head: list[str], folders: list[Path], rows_of: Callable[[Path], Iterator[list[str]]]
) -> None:
    """Write a table; rows of examples without results stay as they are."""
    before = (
        list(csv.reader(path.read_text(encoding="utf-8").splitlines())) if path.exists() else []
    )
    found = [head]
    for folder in folders:
        stated = (row for row in before[1:] if row[0].partition(" / ")[0] == folder.name)
        found += rows_of(folder) if _ended(folder) else stated
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(found)


def main() -> None:
    """Run the examples and print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder with a folder of recordings for each robot")
    parser.add_argument("--out", type=Path, default=Path("gallery"))
    parser.add_argument("--only", nargs="+", help="names of examples; all by default")
    parser.add_argument("--tables", type=Path, help="folder whose tables are replaced")
    asked = parser.parse_args()
    examples = sorted(path.parent for path in HERE.glob("*/run.sh"))
    names = [example.name for example in examples]
    if unknown := set(asked.only or ()) - set(names):
        parser.error(
            f"no example is called {', '.join(sorted(unknown))}. There are {', '.join(names)}."
        )
    if not asked.data.is_dir():
        parser.error(f"{asked.data} is not a folder")
    # Every example runs in a folder of its own, from which a relative path leads elsewhere.
    out = asked.out.resolve()
    for example in examples:
        folder, data = out / example.name, asked.data.resolve() / example.name
        if (asked.only is None or example.name in asked.only) and not _ended(folder):
            if data.is_dir():
                run(example, data, folder)
            else:
                print(f"{example.name}: left out, as {data} is not a folder", flush=True)
    folders = [out / example.name for example in examples]
    if asked.tables is None:
        for head, rows_of in TABLES.values():
            csv.writer(sys.stdout, lineterminator="\n").writerows(
                [head, *(r for f in folders for r in rows_of(f))]
            )
        return
    for folder in filter(_ended, folders):
        picture(folder, HERE.parent / "docs" / "pictures" / f"real_{folder.name}.png")
    for name, (head, rows_of) in TABLES.items():
        write_table(asked.tables / name, head, folders, rows_of)


if __name__ == "__main__":
    main()
