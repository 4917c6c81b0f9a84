"""Recordings of different arms, or of one that was changed between them, are said to be that."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from elastic_arm.diagnosis import Diagnosis, Question, diagnose
from elastic_arm.effects.text import known_effects
from elastic_arm.recording import Recording
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from tests.helpers.realistic_arms import imprecise, ordinary_faults, record

ROBOT = load_robot()
FRICTION = known_effects(("coulomb_friction", "viscous_friction"), ROBOT)

pytestmark = pytest.mark.slow(60)


def diagnosed(identify: Sequence[Recording], validate: Recording) -> Diagnosis:
    return diagnose(identify, Question(ROBOT, given=FRICTION, refit=True), [validate])


def said(found: Diagnosis) -> list[str]:
    """Return the notes on different arms."""
    return [note for note in found.notes if "different arms" in note]


def test_friction_that_was_changed_between_recordings_is_named() -> None:
    """5 Nm more dry friction in the second recording: no effect explains both, and what differs is named."""
    rng = np.random.default_rng(71)
    robot, faults = imprecise(ROBOT, rng), ordinary_faults(ROBOT.n, rng)
    more = [
        Fault(f.effect, f.joint, {"torque": f.parameters["torque"] + 5.0})
        if (f.effect, f.joint) == ("coulomb_friction", 1)
        else f
        for f in faults
    ]
    first, judge = record(robot, faults, (12.0, 6.0), rng)
    (second,) = record(robot, more, (12.0,), rng)
    found = diagnosed([first, second], judge)
    assert found.verdict == "unknown"
    (note,) = said(found)
    assert "coulomb_friction of joint_2 differs" in note and found.notes[0] == note


def test_an_effect_that_is_withheld_makes_no_mixture() -> None:
    """What one arm lacks in all recordings is no difference between them."""
    rng = np.random.default_rng(72)
    robot = imprecise(ROBOT, rng)
    drag = Fault("oil_drag", 1, {"coefficient": 15.0}, side="motor")
    first, second, judge = record(robot, [*ordinary_faults(ROBOT.n, rng), drag], (8.0, 8.0, 6.0), rng)
    found = diagnosed([first, second], judge)
    assert found.verdict == "unknown" and not said(found)
