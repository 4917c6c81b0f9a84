"""Zeros of sensors that are set anew at each start: those of each recording beside the first one's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.diagnosis import Diagnosis, Question, diagnose
from elastic_arm.effects.text import known_effects
from elastic_arm.recording import Recording
from elastic_arm.robot import load_robot
from tests.helpers.realistic_arms import imprecise, ordinary_faults, record

ROBOT = load_robot()
FRICTION = known_effects(("coulomb_friction", "viscous_friction"), ROBOT)


def shifted(recording: Recording, encoder: float = 0.0, torque: float = 0.0) -> Recording:
    """Return a recording with another zero of the link encoder of joint 2, rad, and of joint 1's torque sensor, Nm."""
    link = recording.link
    assert link is not None and link.position is not None
    sensed = None if link.effort is None else link.effort + np.array([torque, 0.0, 0.0])
    return replace(recording, link=replace(link, position=link.position + np.array([0.0, encoder, 0.0]), effort=sensed))


def without_torque_sensor(recording: Recording) -> Recording:
    """Return a recording of encoders and motor torques alone."""
    assert recording.link is not None
    return replace(recording, link=replace(recording.link, effort=None))


def differences(found: Diagnosis) -> dict[tuple[str, str, str], tuple[float, float]]:
    """Return by how much each zero differs from that of the first recording, and its standard deviation."""
    return {
        (one.what, one.joint, one.recording): (one.value, one.std)
        for one in found.imperfections
        if one.recording is not None
    }


def assert_known(found: Diagnosis, true: dict[tuple[str, str, str], float], stds: dict[str, float]) -> None:
    """Every difference, those that are none as well, comes out within its deviation, which is small."""
    known = differences(found)
    assert {(what, source) for what, _, source in known} == {(w, s) for w in stds for s in ("run_1", "run_2")}
    apart = {place: (value - true.get(place, 0.0)) / std for place, (value, std) in known.items()}
    assert max(map(abs, apart.values())) < 3.5 and np.mean(np.square(list(apart.values()))) < 2.0, apart
    assert all(std < stds[what] for (what, _, _), (_, std) in known.items())


@pytest.mark.slow
def test_zeros_of_each_recording_are_no_cause_and_come_out_within_their_deviations() -> None:
    """The link encoder reads 40 urad more in the second run, a torque sensor 3 Nm more in the third, which judges."""
    rng = np.random.default_rng(51)
    true = imprecise(ROBOT, rng)
    first, second, judge = record(true, ordinary_faults(ROBOT.n, rng), (12.0, 12.0, 8.0), rng)
    recordings = [first, shifted(second, encoder=4e-5)]
    found = diagnose(recordings, Question(ROBOT, refit=True, given=FRICTION), [shifted(judge, torque=3.0)])
    assert found.verdict == "none" and not found.causes
    changed = {
        ("encoder_offset_difference", "joint_2", "run_1"): 4e-5,
        ("joint_torque_offset_difference", "joint_1", "run_2"): 3.0,
    }
    assert_known(
        found,
        changed,
        {
            "encoder_offset_difference": 3e-7,
            "joint_torque_offset_difference": 0.02,
            "motor_torque_offset_difference": 0.02,
        },
    )
    (note,) = [note for note in found.notes if "joint_torque_offset_difference" in note]
    assert "joint_1 is in run_2, less the first recording's, " in note and "beyond what is ordinary" in note


@pytest.mark.slow
def test_without_a_torque_sensor_zeros_of_each_recording_are_no_cause() -> None:
    """Zeros 0.1 mrad apart wind a stiff drive by torques that no cause is asked to explain."""
    rng = np.random.default_rng(52)
    true = imprecise(ROBOT, rng)
    recorded = record(true, ordinary_faults(ROBOT.n, rng), (12.0, 12.0, 8.0), rng)
    first, second, judge = map(without_torque_sensor, recorded)
    recordings = [first, shifted(second, encoder=6e-5)]
    found = diagnose(recordings, Question(ROBOT, refit=True, given=FRICTION), [shifted(judge, encoder=-4e-5)])
    assert found.verdict == "none" and not found.causes
    changed = {
        ("encoder_offset_difference", "joint_2", "run_1"): 6e-5,
        ("encoder_offset_difference", "joint_2", "run_2"): -4e-5,
    }
    assert_known(found, changed, {"encoder_offset_difference": 4e-7, "motor_torque_offset_difference": 0.03})
