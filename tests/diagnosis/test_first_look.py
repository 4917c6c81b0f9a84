"""What a diagnosis shows before its search, and in which order it reports its stages."""

from pathlib import Path
from typing import Any

import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.first_look import FirstLook
from elastic_arm.evidence.watch import Stage, Watch
from elastic_arm.robot import load_robot
from tests.diagnosis.test_dry_friction import DRY, URDF, VISCOUS, recording


def test_gap_and_friction_are_shown_before_the_first_cause(tmp_path: Path) -> None:
    """The first look has the friction within its deviations; stages never step back."""
    (tmp_path / "pendulum.urdf").write_text(URDF)
    robot = load_robot(tmp_path / "pendulum.urdf")
    seen: list[Any] = []

    def say(words: str, stage: Stage, done: float = 0.0) -> None:
        seen.append((stage.value, done))

    watch = Watch(say, show=seen.append)
    diagnose([recording(1)], Question(robot), [recording(2)], watch=watch)
    (look,) = (one for one in seen if isinstance(one, FirstLook))
    stages = [one for one in seen if not isinstance(one, FirstLook)]
    assert stages == sorted(stages)
    assert seen.index(look) < seen.index((Stage.CAUSES.value, 0.0))
    place = "joint_1", "motor"
    assert look.described[place] > 3.0 * look.noise[place]
    assert look.fitted[place] < 0.5 * look.described[place]
    dry = look.friction[place]["coulomb_friction"]["torque"]
    viscous = look.friction[place]["viscous_friction"]["coefficient"]
    assert dry.value == pytest.approx(DRY, rel=0.1)
    assert viscous.value == pytest.approx(VISCOUS, abs=5.0 * viscous.std)
