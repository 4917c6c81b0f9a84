"""Servo arms in MuJoCo, recorded by commands and positions alone: the arm of examples/servo_arm and
what is changed."""

import copy
import runpy
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from elastic_arm.mujoco.closed_loop import StartState, servo_motion
from elastic_arm.mujoco.recorder import record_commands
from elastic_arm.recording import Recording, Side
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
    arm: MjcfArm, rate: float, bits: int, *, seed: int = 0, seconds: float = 8.0, late: int = 0
) -> Recording:
    """Return a recording of commands, of which the arm gets each some samples late, and
    positions."""
    told = _script()["commands"](seconds, seed, rate)
    given = np.vstack([told[:1].repeat(late, axis=0), told[: len(told) - late]])
    found = record_commands(arm, given, rate=rate, bits=bits)
    return replace(found, reference=replace(found.reference, position=told), source=f"run_{seed}")


def switched_off(
    arm: MjcfArm, off: float, on: float, *, seed: int = 0, seconds: float = 12.0
) -> Recording:
    """Return a recording at 50 Hz and 12 bits whose drives have no torque from `off` to `on` s.

    Between the parts the arm goes on from where it was, at rest.
    """
    rate = 50.0
    every = round(1.0 / (rate * float(arm.model.opt.timestep)))
    told = _script()["commands"](seconds, seed, rate)
    model = copy.copy(arm.model)
    model.actuator_gainprm[:] = 0.0
    model.actuator_biasprm[:] = 0.0
    loose = replace(arm, model=model)
    ends = [round(rate * edge) for edge in (0.0, off, min(on, seconds), seconds)]
    angles = told[:1]
    for one, (begin, end) in zip((arm, loose, arm), pairwise(ends), strict=True):
        if end > begin:
            commands = np.repeat(told[begin:end], every, axis=0)
            part = servo_motion(one, StartState.at_rest(angles[-1]), commands)
            angles = np.vstack([angles, part[every - 1 :: every]])
    code = 2.0 * np.pi / 2**12
    stamps = np.round(1e9 * np.arange(len(told)) / rate).astype(np.int64)
    measured = Side(stamps, position=code * np.round(angles[:-1] / code))
    reference = Side(stamps, position=told)
    return Recording(arm.robot.joint_names, link=measured, reference=reference, source="off")
