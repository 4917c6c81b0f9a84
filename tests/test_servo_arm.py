"""The servo arm of docs/servo_arm.md, run as it stands there, and its recordings made anew."""

import json
import runpy
import shutil
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.recording.foreign.array_files import load_arrays
from elastic_arm.robot.mjcf import read_mjcf
from tests.helpers.pages import run_page

pytest.importorskip("pyarrow")
pytestmark = pytest.mark.slow(20)

ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "examples" / "servo_arm"


@pytest.mark.nightly
def test_the_commands_of_the_page_lead_to_the_corrected_arm(tmp_path: Path) -> None:
    """Late commands and the elbow's friction are found and no more; with them MuJoCo's servos err
    as encoders do.

    Runge-Kutta reads delays half a time step ahead: the file states 20.5 ms for commands that are
    20 ms late.
    """
    page = (ROOT / "docs" / "servo_arm.md").read_text()
    shutil.copytree(EXAMPLE / "dataset", tmp_path / "dataset")
    shutil.copy(EXAMPLE / "arm.xml", tmp_path)
    printed = run_page(page, tmp_path)
    assert "no faults found" in printed and "commands come at 50 Hz" in printed
    assert printed.index("scale: no torque was recorded") < printed.index("explained:")
    found = json.loads((tmp_path / "diagnosis" / "diagnosis.json").read_text())
    causes = {(one["effect"], one["joint"]): one["parameters"] for one in found["causes"]}
    assert found["verdict"] == "explained"
    assert set(causes) == {("command_delay", None), ("coulomb_friction", "elbow")}
    assert causes["command_delay", None]["delay"]["value"] == pytest.approx(0.02, abs=5e-4)
    assert causes["coulomb_friction", "elbow"]["torque"]["value"] == pytest.approx(0.2, rel=0.1)
    corrected = read_mjcf(tmp_path / "diagnosis" / "arm_corrected.xml")
    pan = corrected.joints[0].controller
    assert (pan.kp, pan.delay) == (pytest.approx(18.6, rel=0.02), pytest.approx(0.0205, abs=2e-4))
    replays = json.loads((tmp_path / "replay" / "replay.json").read_text())["replays"]
    before, after = (one["closed_loop_position"] for one in replays)
    assert min(before.values()) > 0.015 and max(after.values()) < 6e-4
    assert (
        found["closed_loop"]["elbow"]["corrected"]
        < 6e-4
        < found["closed_loop"]["elbow"]["described"]
    )


def test_the_recordings_of_the_page_are_those_that_its_script_makes(tmp_path: Path) -> None:
    """make.py makes the committed dataset again, to a code of the encoders."""
    runpy.run_path(str(EXAMPLE / "make.py"))["main"](tmp_path)
    own, made = (
        load_arrays(folder / "data" / "chunk-000") for folder in (EXAMPLE / "dataset", tmp_path)
    )
    assert set(own) == set(made)
    for name, values in own.items():
        np.testing.assert_allclose(values, made[name], rtol=0, atol=1.01 * 2 * np.pi / 2**12)
