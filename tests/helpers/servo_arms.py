"""Servo arms in MuJoCo, recorded by commands and positions alone: the arm of examples/servo_arm and
what is changed."""

import runpy
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from elastic_arm.mujoco.recorder import record_commands
from elastic_arm.recording import Recording
from elastic_arm.robot.mjcf import MjcfArm, open_mjcf

EXAMPLE = Path(__file__).parents[2] / "examples" / "servo_arm"


@cache
def _script() -> dict[str, Any]:
    return runpy.run_path(str(EXAMPLE / "make.py"))


def servo_arm(changes: Mapping[str, str] | None = None) -> MjcfArm:
    """Return the arm of the example with pieces of its text replaced."""
    text = (EXAMPLE / "arm.xml").read_text()
    for stated, true in (changes or {}).items():
        assert stated in text
        text = text.replace(stated, true)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "arm.xml"
        path.write_text(text)
        return open_mjcf(path)


def recorded(
    arm: MjcfArm, rate: float, bits: int, *, seed: int = 0, seconds: float = 12.0, late: int = 0
) -> Recording:
    """Return a recording of commands, of which the arm gets each some samples late, and
    positions."""
    told = _script()["commands"](seconds, seed, rate)
    given = np.vstack([told[:1].repeat(late, axis=0), told[: len(told) - late]])
    found = record_commands(arm, given, rate=rate, bits=bits)
    return replace(found, reference=replace(found.reference, position=told), source=f"run_{seed}")
