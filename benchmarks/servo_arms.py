"""Servo arms in MuJoCo for the judge: commands and positions alone, one thing withheld, all else
ordinarily off.

They are those of the challenge's levels `servo` (30 to 100 Hz and 12 bits) and `position` (250 to
500 Hz and 17 bits).

    python -m benchmarks.servo_arms FOLDER [SEED]
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from elastic_arm.studies.blind_challenge.draw import Request
from elastic_arm.studies.blind_challenge.levels import LEVELS
from elastic_arm.studies.blind_challenge.servo_arms import record_servos

SEEDS = {"servo": 720104, "position": 720105}


def drawn(arms: Path, level: str, seed: int | None = None) -> Iterator[dict[str, Any]]:
    """Draw and record the arms of a level; yield what is asked of each, as the judge takes it."""
    of = LEVELS[level]
    for number, kind in enumerate((None, None, *of.effects, *of.foreign)):
        name = f"{level}_{number:03d}_{kind or 'clean'}"
        effects = () if kind is None else (kind,)
        truth = record_servos(
            arms, Request(name, effects, (seed or SEEDS[level], number), of.seconds), of
        )
        yield {
            "name": name,
            "level": level,
            "kind": "clean" if kind is None else "foreign" if truth["foreign"] else "single",
            "truth": [
                {
                    "effect": one["effect"],
                    "joint": None if one["joint"] is None else truth["joints"][one["joint"]],
                    "parameters": one["parameters"],
                    "phases": [],
                }
                for one in truth["faults"]
            ],
            "fit": [f"bags/{name}_identify"],
            "judge": [f"bags/{name}_validate"],
            "robot": f"robots/{name}.xml",
            "refit": True,
            "verdicts": ["unknown"] if truth["foreign"] else ["none", "explained"],
        }


def main() -> None:
    """Draw and record the arms of both levels into a folder, and print what is withheld of each."""
    for level in SEEDS:
        for one in drawn(Path(sys.argv[1]), level, int(sys.argv[2]) if len(sys.argv) > 2 else None):
            print(one["name"], *(truth["joint"] or "all joints" for truth in one["truth"]))


if __name__ == "__main__":
    main()
