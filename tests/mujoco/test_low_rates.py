"""Commanded arms whose motion reaches beyond an eighth of a low sample rate, and limits of torque
that a motion reaches."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")

from elastic_arm.arrays import Array
from elastic_arm.diagnosis import Question
from elastic_arm.diagnosis.preparation import prepare
from elastic_arm.equations.numbers import SCALE
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.mujoco.recorder import record_commands
from elastic_arm.robot.mjcf import MjcfArm, open_mjcf

ARM = """<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="RK4"/><worldbody>
<body name="base"><body name="a"><joint name="j1" axis="0 0 1" armature="0.02"/>
<inertial pos="0 0.02 0.08" mass="0.5" diaginertia="1e-3 1e-3 3e-4"/>
<body name="b" pos="0 0 0.15"><joint name="j2" axis="0 1 0" armature="0.02"/>
<inertial pos="0 0.01 0.1" mass="0.4" diaginertia="1e-3 1e-3 3e-4"/>
<body name="c" pos="0 0 0.2"><joint name="j3" axis="0 1 0" armature="0.02"/>
<inertial pos="0 0 0.08" mass="0.3" diaginertia="5e-4 5e-4 1e-4"/>
</body></body></body></body></worldbody><actuator>
<position joint="j1" kp="20" kv="0.3" forcerange="-LIMIT LIMIT"/>
<position joint="j2" kp="20" kv="0.3" forcerange="-LIMIT LIMIT"/>
<position joint="j3" kp="20" kv="0.3" forcerange="-LIMIT LIMIT"/></actuator></mujoco>"""


def arm(folder: Path, limit: float) -> MjcfArm:
    """Return an arm of three servos with a limit of torque, Nm."""
    file = folder / "arm.xml"
    file.write_text(ARM.replace("LIMIT", f"{limit:g}"))
    return open_mjcf(file)


def commands(rate: float) -> Array:
    """Return commands (N, 3) rad of 12 s."""
    t = np.arange(round(12.0 * rate))[:, None] / rate
    slow = np.sin(2 * np.pi * np.array([0.31, 0.43, 0.53]) * t)
    fast = np.sin(2 * np.pi * np.array([1.1, 0.9, 1.3]) * t)
    faster = np.sin(2 * np.pi * 2.2 * t + np.arange(3))
    return np.array([0.0, 0.5, 0.7]) + 0.5 * slow + 0.3 * fast + 0.2 * faster


def linearised(own: MjcfArm, rate: float) -> Linearisation:
    """Return the residuals of the true arm, recorded at the rate of its commands."""
    first = record_commands(own, commands(rate), rate=rate)
    second = record_commands(own, commands(rate)[::-1].copy(), rate=rate)
    problem = prepare([first], [second], Question(own.robot)).problem
    return Linearisation(problem, np.zeros(len(problem.numbers)), ())


def test_the_true_arm_leaves_noise_at_a_low_rate(tmp_path: Path) -> None:
    """A smoother that takes a part of the residuals' band takes another one of products of the
    motion than of torques."""
    white = linearised(arm(tmp_path, 100.0), 30.0).data.white
    assert float(np.mean(white**2)) < 0.1


def test_a_gain_does_not_act_beyond_the_limit(tmp_path: Path) -> None:
    """The column of a gain is the derivative of the residuals where the limit is reached often."""
    own = arm(tmp_path, 1.5)
    here = linearised(own, 100.0)
    numbers = here.problem.numbers
    (k,) = (k for k, p in enumerate(numbers) if (p.what, p.joint) == (SCALE, "j2"))
    step = np.eye(len(numbers))[k] * 0.02
    ahead, behind = (replace(here, values=sign * step) for sign in (1.0, -1.0))
    slope = (behind.data.y[0] - ahead.data.y[0])[:, 1] / 0.04
    column = here.plain_numbers[0][:, 1, k]
    assert float(np.corrcoef(slope, column)[0, 1]) > 0.99
    assert float(slope @ column / (column @ column)) == pytest.approx(1.0, abs=0.05)
