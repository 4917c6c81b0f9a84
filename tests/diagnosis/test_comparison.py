"""A real and a simulated recording of the same commands: where they differ, and which effect is in
which."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from elastic_arm.app import app
from elastic_arm.cli import diagnose as command
from elastic_arm.excitation import Shape, random_trajectories
from elastic_arm.recording import Recording, write_recording
from tests.helpers.candidates import candidates
from tests.helpers.gap_recordings import LIMITS, MODEL, record

pytestmark = pytest.mark.slow(10)

FEW = ("coulomb_friction", "viscous_friction", "payload")


def compared(folder: Path, real: Recording, simulated: Recording) -> tuple[dict[str, object], str]:
    """Run `diagnose real --against simulated`, and return comparison.json and what is printed."""
    for name, recording in (("real", real), ("simulated", simulated)):
        write_recording(folder / name, recording)
    words = [
        "diagnose",
        folder / "real",
        "--against",
        folder / "simulated",
        "--no-propose",
        "--out",
        folder / "out",
    ]
    with candidates(command, *FEW):
        result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    assert "effects by recording" in (folder / "out" / "report.html").read_text()
    return json.loads((folder / "out" / "comparison.json").read_text()), result.stdout


def test_an_effect_of_one_recording_is_told_from_one_of_both(tmp_path: Path) -> None:
    """Dry friction of the real arm, viscous friction of the simulated one, and a load of both are
    told apart."""
    (motion,) = random_trajectories(
        MODEL, LIMITS, 1, rng=np.random.default_rng(3), shape=Shape(5, 6.0, 1.0)
    )
    load = "payload:mass=0.5,position=0/0/0.1"
    real = record(motion, load, "coulomb_friction:joint_2:torque=13.9", seed=1)
    simulated = record(motion, load, "viscous_friction:joint_1:coefficient=60", seed=2)
    found, printed = compared(tmp_path, real, simulated)
    where = {(e["effect"], e["joint"]): e["where"] for e in found["effects"]}  # type: ignore[attr-defined]
    assert where["coulomb_friction", "joint_2"] == "real"
    assert where["viscous_friction", "joint_1"] == "simulated"
    assert where["payload", "joint_3"] == "both"
    assert len(where) == 3
    (payload,) = (e for e in found["effects"] if e["effect"] == "payload")  # type: ignore[attr-defined]
    assert payload["agrees"]
    assert "coulomb friction, joint_2: in the real recording only" in " ".join(printed.split())
    torque = found["channels"]["tau_m"]["joint_2"]  # type: ignore[index]
    assert 10.0 < torque["rms"] < 16.0
