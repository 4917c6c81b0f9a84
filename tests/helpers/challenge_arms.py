"""Arms of the blind challenge, drawn and diagnosed one at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from elastic_arm.diagnosis import Diagnosis, DiagnosisSettings, Question, diagnose
from elastic_arm.effects import EFFECTS
from elastic_arm.effects.text import known_effects
from elastic_arm.recording import read_recording
from elastic_arm.robot import Robot, load_robot
from elastic_arm.studies.blind_challenge.draw import Request, description_path, record
from elastic_arm.studies.blind_challenge.levels import FIELD


def diagnosed_field_arm(
    folder: Path,
    effects: Sequence[str],
    seed: tuple[int, int],
    described: Callable[[Robot], Robot] = lambda robot: robot,
) -> tuple[dict[tuple[str, str], Mapping[str, Any]], Diagnosis]:
    """Return the true parameters of each effect by effect and joint, and what the diagnosis finds of the recordings.

    Parameters
    ----------
    folder
        Where the recordings go.
    effects, seed
        What is drawn.
    described
        Makes the description that the diagnosis is given of that of the arm.
    """
    bags = folder / "fit", folder / "judge"
    truth = record(folder, Request("arm", tuple(effects), seed, (20.0, 10.0)), FIELD, EFFECTS, bags)
    path = description_path(folder, "arm")
    assert path is not None
    robot = described(load_robot(path))
    settings = DiagnosisSettings()
    settings = replace(settings, priors=settings.priors.model_copy(update=FIELD.asked["priors"]))
    question = Question(robot, refit=True, given=known_effects(FIELD.asked["with"], robot), settings=settings)
    recordings = [read_recording(bag) for bag in bags]
    true = {
        (fault["effect"], robot.joint_names[-1 if fault["joint"] is None else fault["joint"]]): fault["parameters"]
        for fault in truth["faults"]
    }
    return true, diagnose(recordings[:1], question, recordings[1:])
