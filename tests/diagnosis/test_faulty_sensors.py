"""A sensor that is far off beside an effect that bends the model: its prior is not to hold it back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from elastic_arm.diagnosis import DiagnosisSettings, Question, diagnose
from elastic_arm.diagnosis.priors import Priors
from elastic_arm.effects import EFFECTS
from elastic_arm.effects.text import known_effects
from elastic_arm.recording import read_recording
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge.arm_sampling import SamplingRequest
from elastic_arm.studies.blind_challenge.levels.level import KNOWN_FRICTION, level_of, stated_priors
from elastic_arm.studies.blind_challenge.levels.recording import description_path, record_realistic_arm


@pytest.mark.slow
def test_an_offset_beside_a_spring_is_found_as_one_and_leaves_the_spring_its_size(tmp_path: Path) -> None:
    """Held by a prior of 0.5 Nm an offset of -23 Nm bent the masses: four springs and counterbalances stood for both.

    Arm 47 of the field level's seed 917001: motor side alone, seven joints.
    """
    level = level_of("field")
    assert level is not None
    request = SamplingRequest("arm", ("motor_torque_offset", "joint_spring"), (917001, 41), (20.0, 10.0))
    bags = tmp_path / "fit", tmp_path / "judge"
    truth = record_realistic_arm(tmp_path, bags, request, level, EFFECTS)
    path = description_path(tmp_path, "arm")
    assert path is not None
    robot = load_robot(path)
    settings = replace(DiagnosisSettings(), priors=Priors.model_validate(stated_priors("field")))
    given = known_effects(KNOWN_FRICTION, robot)
    recordings = [read_recording(bag) for bag in bags]
    found = diagnose(recordings[:1], Question(robot, refit=True, given=given, settings=settings), recordings[1:])
    assert found.verdict == "explained"
    causes = {(cause.effect, cause.joint): cause.parameters for cause in found.causes}
    true = {(f["effect"], robot.joint_names[f["joint"]]): f["parameters"] for f in truth["faults"]}
    assert causes.keys() == true.keys()
    for key, parameters in true.items():
        for name, value in parameters.items():
            estimate = causes[key][name]
            assert estimate.std is not None and isinstance(estimate.value, float)
            assert abs(estimate.value - value) < 3.0 * estimate.std
            assert estimate.std < 0.05 * abs(value)
