"""All examples of real robots in one run, and the table of docs/real_robots.md.

    python examples/gallery.py DATA --out gallery [--only kuka_kr300 …] [--markdown docs/real_robots.md]

DATA has a folder for each robot, named as in `examples/`. Every example's `run.sh` is run in a folder of its own below
`--out`; the table is made of the `identification.json` and `diagnosis.json` that are there afterwards.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
BEGIN, END = "<!-- table: examples/gallery.py -->", "<!-- end of table -->"


def run(example: Path, data: Path, folder: Path) -> None:
    """Run one example in a folder of its own; what it prints goes to `run.log` there."""
    folder.mkdir(parents=True)
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    began = time.monotonic()
    with (folder / "run.log").open("w") as log:
        command = ["sh", str(example / "run.sh"), str(data)]
        code = subprocess.call(command, cwd=folder, stdout=log, stderr=log, env={**os.environ, "PATH": path})
    print(f"{example.name}: exit status {code}, {time.monotonic() - began:.0f} s, {folder / 'run.log'}", flush=True)


def rows(folder: Path) -> Iterator[list[str]]:
    """Yield the rows of the table for one example."""
    for file in sorted(folder.rglob("identification.json")):
        found = json.loads(file.read_text())
        for arms in (found["validation"] or {}).values():
            for arm in ("nominal", "identified"):
                for side, values in arms[arm].items():
                    yield [_case(folder, file), f"`identify`: {arm}, {side}", _numbers(values.values()), "", ""]
    for file in sorted(folder.rglob("diagnosis.json")):
        found = json.loads(file.read_text())
        causes = ", ".join(f"{c['effect']} {c['joint'] or ''}".strip() for c in found["causes"]) or "no cause"
        verdict = f"{found['verdict']}: {causes}"
        for when in ("before", "after"):
            for side in ("link", "drive", "motor"):
                rmse = [(place.get(side) or {}).get("rmse") for place in found["gap"][when].values()]
                if any(value is not None for value in rmse):
                    said = (_prediction(found, when), verdict if when == "after" else "")
                    yield [_case(folder, file), f"`{file.parent.name}`: {when}, {side}", _numbers(rmse), *said]


def _case(folder: Path, file: Path) -> str:
    return " / ".join([folder.name, *file.relative_to(folder).parts[:-2]])


def _numbers(values: Any) -> str:
    return " ".join("–" if value is None else f"{value:.3g}" for value in values)


def _prediction(found: dict[str, Any], when: str) -> str:
    """Return the largest prediction error over the joints at every horizon, or the reason why there is none."""
    prediction = found.get("prediction") or {}
    errors = prediction.get(when)
    if not errors:
        return prediction.get("reason") or "–"
    horizons = prediction["horizons_s"]
    largest = [max(size[k] for sides in errors.values() for size in sides.values()) for k in range(len(horizons))]
    return ", ".join(f"{1e3 * e:.3g} at {1e3 * h:.0f} ms" for h, e in zip(horizons, largest, strict=True))


def table(folders: list[Path]) -> str:
    """Return the table of all examples in Markdown."""
    head = ["robot", "model and side", "held-out rms a joint, Nm", "largest prediction error, mrad", "verdict"]
    lines = [head, ["---"] * len(head), *(row for folder in folders for row in rows(folder))]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    """Run the examples and print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder with a folder of recordings for each robot")
    parser.add_argument("--out", type=Path, default=Path("gallery"))
    parser.add_argument("--only", nargs="+", help="names of examples; all by default")
    parser.add_argument("--markdown", type=Path, help="page whose table is replaced")
    asked = parser.parse_args()
    examples = sorted(path.parent for path in HERE.glob("*/run.sh"))
    for example in examples:
        folder, data = asked.out / example.name, asked.data.resolve() / example.name
        if (asked.only is None or example.name in asked.only) and not folder.exists():
            if data.is_dir():
                run(example, data, folder)
            else:
                print(f"{example.name}: left out, as {data} is no folder", flush=True)
    text = table([asked.out / example.name for example in examples])
    if asked.markdown is None:
        print(text)
        return
    page = asked.markdown.read_text(encoding="utf-8")
    before, rest = page.split(BEGIN)
    asked.markdown.write_text(f"{before}{BEGIN}\n{text}\n{END}{rest.split(END)[1]}", encoding="utf-8")


if __name__ == "__main__":
    main()
