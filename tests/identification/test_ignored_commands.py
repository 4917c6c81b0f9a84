"""Drives that ignore their commands, as with torque switched off, are no property of the arm."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.words import summary
from elastic_arm.identification import identify
from elastic_arm.identification.batch.ignored_commands import ignoring, without_ignored_commands
from elastic_arm.recording import Recording, write_recording
from elastic_arm.recording.made_torque import with_made_torque
from elastic_arm.robot.mjcf import MjcfArm
from tests.helpers.command_line import run
from tests.helpers.servo_arms import EXAMPLE, recorded, servo_arm, switched_off

pytestmark = pytest.mark.usefixtures("compiled_here")
WEAK = {'joint="lift" forcerange="-4 4"': 'joint="lift" forcerange="-1.2 1.2"'}
STIFF = {'kp="17.8" kv="0.6" joint="lift"': 'kp="45" kv="1.5" joint="lift"'}
RUBBED = {
    'name="elbow" axis="0 1 0" armature="0.028" damping="0.05" frictionloss="0.05"': (
        'name="elbow" axis="0 1 0" armature="0.028" damping="0.05" frictionloss="0.4"'
    )
}


@pytest.fixture(scope="module")
def arm() -> MjcfArm:
    return servo_arm()


def stretches(recording: Recording, arm: MjcfArm) -> list[tuple[float, float]]:
    made = with_made_torque(recording, arm.robot)
    _, found = without_ignored_commands(made, arm.robot, "mod3")
    return [(one.begin, one.end) for one in found]


def test_torque_that_is_off_is_located_within_a_block(arm: MjcfArm) -> None:
    """In mid-run, and until the end."""
    ((begin, end),) = stretches(switched_off(arm, 5.0, 8.0), arm)
    assert (begin, end) == (pytest.approx(5.0, abs=0.4), pytest.approx(8.0, abs=0.4))
    ((begin, end),) = stretches(switched_off(arm, 8.0, 12.0), arm)
    assert (begin, end) == (pytest.approx(8.0, abs=0.4), pytest.approx(12.0, abs=0.4))


@pytest.mark.parametrize("true", [{}, WEAK, STIFF, RUBBED], ids=["clean", "weak", "stiff", "dry"])
def test_an_arm_that_follows_badly_does_not_ignore_its_commands(
    arm: MjcfArm, true: dict[str, str]
) -> None:
    """A saturation, another gain and friction leave the torque that commands make."""
    for late in (0, 4):
        assert stretches(recorded(servo_arm(true), 50.0, 12, late=late), arm) == []


def test_blocks_of_noise_and_of_half_the_torque_follow() -> None:
    """What is commanded acts; where nothing is commanded nothing can be ignored."""
    rng = np.random.default_rng(0)
    made = rng.normal(size=(60, 5, 2))
    assert ignoring(0.5 * made + 0.1 * rng.normal(size=made.shape), made) == []
    made[:20] = 0.0
    assert ignoring(made + 0.1 * rng.normal(size=made.shape), made) == []
    needed = made + 0.1 * rng.normal(size=made.shape)
    needed[40:50] -= made[40:50]
    assert ignoring(needed, made) == [(40, 50)]


@pytest.mark.slow(15)
def test_a_diagnosis_names_the_stretch_and_no_false_cause(arm: MjcfArm) -> None:
    """The verdict is unknown, the words say from when on; the rest is explained by its cause."""
    true = servo_arm(RUBBED)
    effects = ["coulomb_friction", "torque_saturation", "link_inertia_mismatch", "counterbalance"]
    fitted = switched_off(true, 6.0, 9.0)
    judge = recorded(true, 50.0, 12, seed=1)
    found = diagnose([fitted], Question(arm.robot, effects=effects), [judge])
    assert found.verdict == "unknown"
    sure = {(one.effect, one.joint) for one in found.causes if one.confidence > 0.9}
    assert sure <= {("coulomb_friction", "elbow")}
    assert {one.joint for one in found.events if one.ignored} == set(arm.robot.joint_names)
    said = summary(found)[0]
    assert said.startswith("unknown: off: no joint follows its commands from 6.0 to 9.0 s")
    written = found.to_dict()["events"]
    assert [one["ignored"] for one in written] == [True] * 3


@pytest.mark.slow(5)
def test_an_identification_leaves_the_stretch_out(arm: MjcfArm) -> None:
    """Friction comes out as without it, and a note says what is left out."""
    found = identify([switched_off(arm, 12.0, 15.0, seconds=16.0)], arm.robot)
    assert any("no joint follows its commands from 12.0 to 15.0 s" in note for note in found.notes)


@pytest.mark.slow(10)
def test_zeros_in_the_place_of_torques_do_not_hide_commands(arm: MjcfArm, tmp_path: Path) -> None:
    """As drivers without a torque send: torques are computed from commands, and the closed loop is
    judged."""
    run_0 = recorded(arm, 100.0, 14)
    assert run_0.link is not None and run_0.link.position is not None
    zeros = np.zeros_like(run_0.link.position)
    motor = replace(run_0.link, effort=zeros)
    write_recording(tmp_path / "run", replace(run_0, link=None, motor=motor))
    model = EXAMPLE / "arm.xml"
    found = run("identify", tmp_path / "run", "--robot", model, "--out", tmp_path / "identified")
    assert found.exit_code == 0, found.output
    written = json.loads((tmp_path / "identified" / "identification.json").read_text())
    assert max(one["described"] for one in written["closed_loop"].values()) < 1e-3
    assert any("is constant and treated as not recorded" in note for note in written["notes"])


@pytest.mark.slow(10)
def test_the_closed_loop_of_an_identification_leaves_the_stretch_out(
    arm: MjcfArm, tmp_path: Path
) -> None:
    """The described arm, which is the true one, moves as recorded: what it did not follow does not
    count."""
    write_recording(tmp_path / "run", switched_off(arm, 12.0, 15.0, seconds=15.0))
    model = EXAMPLE / "arm.xml"
    found = run("identify", tmp_path / "run", "--robot", model, "--out", tmp_path / "identified")
    assert found.exit_code == 0, found.output
    written = json.loads((tmp_path / "identified" / "identification.json").read_text())
    assert max(one["described"] for one in written["closed_loop"].values()) < 1e-3
