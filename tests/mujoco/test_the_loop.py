"""The loop closes: a MuJoCo arm with a payload, friction and a delay that its MJCF lacks, corrected and replayed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from elastic_arm.app import app
from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.dynamics import build_model
from elastic_arm.excitation import MotionLimits, liveliest, random_trajectories
from elastic_arm.mujoco import record
from elastic_arm.recording import write_recording
from elastic_arm.robot import load_robot
from elastic_arm.robot.mjcf import open_mjcf
from tests.helpers.mujoco_arms import MODELS

pytest.importorskip("mujoco")
pytest.importorskip("lxml")
pytestmark = pytest.mark.slow(seconds=90)

DELAY = 0.03
LOAD = '<body name="load" pos="0.02 0.03 0.1"><geom type="sphere" size="0.001" mass="1.5" contype="0"/></body>'


def write_models(folder: Path) -> tuple[Path, Path]:
    """Write the plain MJCF, with torque sensors, and the true one."""
    sensors = "".join(f'<jointactuatorfrc joint="joint{k}"/>' for k in range(1, 8))
    plain = (MODELS / "arm.xml").read_text().replace("</mujoco>", f"  <sensor>{sensors}</sensor>\n</mujoco>")
    true = plain.replace('file="hand.xml"', 'file="true_hand.xml"')
    for joint, loss in (("joint3", 2.0), ("joint4", 2.5)):
        # A real drive's dry friction turns over with the velocity.
        written = f'<joint name="{joint}" frictionloss="{loss}" solreffriction="0.002 1" '
        true = true.replace(f'<joint name="{joint}"', written)
    late = f'<jointactuatorfrc joint="joint2" delay="{DELAY}" nsample="40"/>'
    true = true.replace('<jointactuatorfrc joint="joint2"/>', late)
    hand = (MODELS / "hand.xml").read_text()
    files = {"plain.xml": plain, "true.xml": true, "hand.xml": hand}
    files["true_hand.xml"] = hand.replace('<body name="left"', f'{LOAD}<body name="left"')
    for name, text in files.items():
        (folder / name).write_text(text)
    return folder / "plain.xml", folder / "true.xml"


def run(*arguments: object) -> dict[str, object]:
    """Run `elastic-arm …` and return the JSON that it prints."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    found: dict[str, object] = json.loads(result.stdout)
    return found


def test_a_corrected_mjcf_predicts_as_well_as_the_true_one(tmp_path: Path) -> None:
    """The prediction error of the corrected MJCF is within 10 % of that of the true one; the plain one's is far off."""
    plain, true = write_models(tmp_path)
    robot = open_mjcf(plain).robot
    limits = MotionLimits.of(robot, velocity=1.5, acceleration=5.0)
    motions = random_trajectories(build_model(robot), limits, 40, rng=np.random.default_rng(1))
    rng = np.random.default_rng(2)
    for name, motion in zip(("fit", "judge", "held_out"), liveliest(motions, 3), strict=True):
        recording = record(
            open_mjcf(true), motion, nominal=robot, rate=500.0, torque_noise=0.15, encoder_noise=2e-5, rng=rng
        )
        write_recording(tmp_path / name, recording)
    found = run(
        "diagnose", tmp_path / "fit", "--validate", tmp_path / "judge", "--robot", plain, "--no-propose",
        "--replay", "--out", tmp_path / "diagnosis", "--json",
    )  # fmt: skip
    assert found["verdict"] == "explained", found["notes"]
    causes = {(cause["effect"], cause["joint"]): cause["parameters"] for cause in found["causes"]}
    # A payload is a change of the last link: which of the two it is called, the recording alone cannot tell.
    (load,) = set(causes) & {("payload", "joint7"), ("link_inertia_mismatch", "joint7")}
    others = {("coulomb_friction", "joint3"), ("coulomb_friction", "joint4"), ("time_delay", "joint2")}
    assert set(causes) == {load, *others}
    assert causes["coulomb_friction", "joint3"]["torque"]["value"] == pytest.approx(2.0, rel=0.05)
    assert causes["time_delay", "joint2"]["delay"]["value"] == pytest.approx(DELAY, rel=0.1)
    true_values = {
        (load, "mass"): 1.5, (("coulomb_friction", "joint3"), "torque"): 2.0,
        (("coulomb_friction", "joint4"), "torque"): 2.5, (("time_delay", "joint2"), "delay"): DELAY,
    }  # fmt: skip
    for (cause, name), value in true_values.items():
        if cause[0] != "link_inertia_mismatch":
            assert abs(causes[cause][name]["value"] - value) < 3.0 * causes[cause][name]["std"], cause
    corrected = tmp_path / "diagnosis" / "plain_corrected.xml"
    masses = [load_robot(path).joints[-1].link.mass for path in (corrected, plain)]
    assert masses[0] - masses[1] == pytest.approx(1.5, rel=0.02)
    models = [word for path in (plain, corrected, true) for word in ("--robot", path)]
    replays = run("replay", tmp_path / "held_out", *models, "--window", 0.1, "--out", tmp_path / "replay", "--json")
    off, after, best = (
        {
            name: np.sqrt(np.mean(np.square(list(one["open_loop"][name].values()))))
            for name in ("position", "velocity", "torque")
        }
        for one in replays["replays"]
    )
    for name in best:
        assert after[name] < 1.1 * best[name], (name, after, best)
        assert off[name] > 5.0 * best[name]
    assert (tmp_path / "replay" / "report.html").stat().st_size > 10000
    beside = json.loads((tmp_path / "diagnosis" / "replay.json").read_text())["replays"]
    assert [Path(one["model"]).name for one in beside] == ["plain.xml", "plain_corrected.xml"]
    before, corrected_torque = (one["open_loop"]["torque"] for one in beside)
    assert all(5.0 * corrected_torque[joint] < error for joint, error in before.items() if error > 1.0)
    report = (tmp_path / "diagnosis" / "report.html").read_text()
    assert "How far each model is from the recording" in report and "plain_corrected.xml" in report


@pytest.mark.slow(seconds=30)
def test_dry_friction_alone_is_explained_beside_coarse_encoders(tmp_path: Path) -> None:
    """The noise of the motors' angles is that of all accelerations: what it leaves at heavy joints is no gap."""
    plain, robot = MODELS / "arm.xml", open_mjcf(MODELS / "arm.xml").robot
    text = plain.read_text()
    for joint in ("joint3", "joint4"):
        text = text.replace(
            f'<joint name="{joint}"', f'<joint name="{joint}" frictionloss="2" solreffriction="0.002 1"'
        )
    (tmp_path / "true.xml").write_text(text)
    (tmp_path / "hand.xml").write_text((MODELS / "hand.xml").read_text())
    limits, rng = MotionLimits.of(robot, velocity=1.5, acceleration=5.0), np.random.default_rng(1)
    motions = liveliest(random_trajectories(build_model(robot), limits, 40, rng=rng), 2)
    noise = {"torque_noise": 0.15, "encoder_noise": 2e-5}
    recorded = [
        record(open_mjcf(tmp_path / "true.xml"), m, nominal=robot, rate=500.0, rng=rng, **noise) for m in motions
    ]
    found = diagnose(recorded[:1], Question(robot), recorded[1:])
    assert found.verdict == "explained"
    assert {(cause.effect, cause.joint) for cause in found.causes} == {
        ("coulomb_friction", j) for j in ("joint3", "joint4")
    }
    for cause in found.causes:
        assert cause.parameters["torque"].value == pytest.approx(2.0, abs=4.0 * cause.parameters["torque"].std)
