"""The first arm of docs/first_arm.md, run as it stands there."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.pages import run_page

pytestmark = pytest.mark.slow(10)

ROOT = Path(__file__).parents[1]
MASS, CENTRE, INERTIA, FRICTION, GRAVITY = 2.0, 0.15, 0.02, 0.3, 9.81
URDF = f"""<robot name="arm">
<link name="base"/>
<joint name="shoulder" type="revolute">
  <parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
  <limit lower="-7" upper="7" effort="50" velocity="10"/>
</joint>
<link name="upper"><inertial>
  <origin xyz="0 0 {CENTRE}"/><mass value="{MASS}"/>
  <inertia ixx="{INERTIA}" iyy="{INERTIA}" izz="0.003" ixy="0" ixz="0" iyz="0"/>
</inertial></link>
</robot>"""


def table(seed: int) -> np.ndarray:
    """Return time, angle and torque of a pendulum with dry friction, 10 s at 100 Hz, with noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 10.0, 1 / 100)
    w = 2 * np.pi * 0.2 * np.arange(1, 5)[:, None]
    a, b = rng.normal(size=(2, 4, 1)) * 0.5 / np.arange(1, 5)[:, None]
    sin, cos = np.sin(w * t), np.cos(w * t)
    q, dq, ddq = (
        x.sum(axis=0)
        for x in (a * sin + b * cos, w * (a * cos - b * sin), -(w**2) * (a * sin + b * cos))
    )
    inertia, weight = INERTIA + MASS * CENTRE**2, MASS * GRAVITY * CENTRE
    tau = inertia * ddq - weight * np.sin(q) + FRICTION * np.tanh(dq / 0.01)
    return np.column_stack(
        [t, q + 2e-5 * rng.normal(size=t.size), tau + 0.02 * rng.normal(size=t.size)]
    )


def test_the_commands_of_the_page_lead_to_the_friction(tmp_path: Path) -> None:
    """Every command ends without an error; the friction that the URDF lacks is found, and then
    nothing is left."""
    page = (ROOT / "docs" / "first_arm.md").read_text()
    header = re.search(r"```\n(time.*)\n", page)
    (tmp_path / "arm.urdf").write_text(URDF)
    for run in (1, 2):
        np.savetxt(
            tmp_path / f"run_{run}.csv", table(run), "%.7g", ",", header=header[1], comments=""
        )
    printed = run_page(page, tmp_path)
    assert printed.count("no faults found") == 1
    assert (tmp_path / "diagnosis" / "arm_corrected.urdf").exists()
    found = json.loads((tmp_path / "diagnosis" / "diagnosis.json").read_text())
    (cause,) = found["causes"]
    assert (found["verdict"], cause["effect"], cause["joint"]) == (
        "explained",
        "coulomb_friction",
        "shoulder",
    )
    size = cause["parameters"]["torque"]
    assert size["value"] == pytest.approx(FRICTION, abs=4 * size["std"])
    assert json.loads((tmp_path / "again" / "diagnosis.json").read_text())["verdict"] == "none"
