"""Why a residual counts as unexplained, as `diagnose --explain` prints it."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.search_words import search_words
from elastic_arm.diagnosis.unknown_effects import KeptPower
from elastic_arm.recording import Recording
from elastic_arm.robot import load_robot
from tests.diagnosis.test_dry_friction import URDF, recording


def with_cable(seed: int) -> Recording:
    """A pendulum whose cable pulls by an odd law of the angle, which no effect has."""
    plain = recording(seed)
    assert plain.motor is not None
    q = plain.motor.position
    cable = 0.4 * np.abs(np.sin(2.3 * q + 0.4)) * np.exp(q)
    return replace(plain, motor=replace(plain.motor, effort=plain.motor.effort + cable))


def test_each_unexplained_place_has_its_reason_and_what_it_would_want(tmp_path: Path) -> None:
    (tmp_path / "pendulum.urdf").write_text(URDF)
    robot = load_robot(tmp_path / "pendulum.urdf")
    found = diagnose([with_cable(1)], Question(robot), [with_cable(2)])
    assert found.verdict == "unknown"
    assert found.context is not None
    reasons = found.context.reasons
    assert set(reasons) == {(one.joint, one.side) for one in found.unexplained}
    assert all(reasons.values())
    lines = search_words(found.context.explanation, reasons)
    (k,) = (k for k, line in enumerate(lines) if line.startswith("unexplained at joint_1, motor"))
    assert "nats" in lines[k + 1]


def test_the_words_name_the_limit_that_was_exceeded() -> None:
    fitted = KeptPower(0, 5.0, 2.0, True, 1.0, 4.0, False)
    judging = KeptPower(0, 1.0, 2.0, False, 9.0, 4.0, True)
    quiet = KeptPower(0, 1.0, 2.0, False, 3.0, 4.0, True)
    assert fitted.is_open and "fitted recordings exceeds the noise power by 5 " in fitted.words
    assert judging.is_open and "is 4" in judging.words
    assert not quiet.is_open
