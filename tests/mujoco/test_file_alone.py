"""The corrected MJCF as users load it: without the laws that only robot.yaml states."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import pytest

from elastic_arm.cli.mujoco.corrected import Correction, Written
from elastic_arm.effects import Catalogue
from elastic_arm.errors import RobotError
from elastic_arm.mujoco import Exported, attach
from elastic_arm.mujoco.closed_loop import with_controllers
from elastic_arm.mujoco.file_alone import unstated
from elastic_arm.mujoco.judgement import Judging, closed_loop
from elastic_arm.robot import Robot, with_joints_of
from elastic_arm.robot.mjcf import open_mjcf
from tests.helpers.servo_arms import EXAMPLE, recorded, servo_arm

BASE = EXAMPLE / "arm.xml"
BAND = 0.03  # rad


def loaded(robot: Robot) -> Robot:
    """Return an arm whose lift loses a tenth of its torque to friction."""
    law = {
        "effect": "load_dependent_friction",
        "joint": "lift",
        "parameters": {"coefficient": 0.1},
    }
    return robot.with_(effects=(*robot.effects, law))


def banded(robot: Robot) -> Robot:
    """Return an arm whose lift has a dead band."""
    return with_drives(robot, ("lift",), 1.0)


def stiff(robot: Robot) -> Robot:
    """Return an arm whose lift has a dead band and twice the gain, which its file alone has."""
    return with_drives(robot, ("lift",), 2.0)


def stiff_everywhere(robot: Robot) -> Robot:
    """Return an arm whose file alone is worse at every joint."""
    return with_drives(robot, robot.joint_names, 2.0)


def with_drives(robot: Robot, joints: Sequence[str], ratio: float) -> Robot:
    """Return an arm with a dead band and other gains at some joints."""
    for name in joints:
        drive = robot.joints[robot.joint_names.index(name)].controller
        assert drive is not None
        wanted = replace(drive.scaled(ratio), dead_band=BAND)
        robot = robot.with_joint(name, controller=wanted)
    return robot


def written(change: Callable[[Robot], Robot], folder: Path, *, refined: bool) -> Written:
    """Return what is written of a correction that is the true arm, and its file."""
    described = servo_arm().robot
    true = change(described)
    correction = Correction(BASE, None, None, Catalogue.default())
    assert isinstance(correction.write(true, folder), Exported)
    played = with_controllers(open_mjcf(folder / "arm_corrected.xml"), true)
    fit, judge = (Judging(recorded(played, 100.0, 17, seed=seed)) for seed in (0, 1))
    return correction.judged(
        described,
        lambda back: with_joints_of(true, described, back),
        described.joint_names,
        [judge],
        folder,
        caused=True,
        fitted=[fit] if refined else [],
    )


class Refined(NamedTuple):
    """A correction that was refined for its file, and the folder of the file."""

    done: Written
    folder: Path


@pytest.fixture(scope="module")
def refined(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Refined]:
    """Refine each arm once."""

    @cache
    def made(change: str) -> Refined:
        folder = tmp_path_factory.mktemp(change)
        arms = {"loaded": loaded, "banded": banded}
        return Refined(written(arms[change], folder, refined=True), folder)

    return made


@pytest.mark.parametrize("change", ["loaded", "banded"])
def test_the_numbers_of_a_file_are_refined_for_it_alone(
    refined: Callable[[str], Refined], change: str
) -> None:
    """The error of robot.yaml is small, that of the file alone below that of the description."""
    done = refined(change).done
    assert done.choice is not None and isinstance(done.file, Exported)
    lift = done.choice.errors["lift"]
    assert lift.alone is not None
    assert lift.corrected < 0.1 * lift.alone and lift.alone < 0.8 * lift.described
    (words,) = done.file.stand_ins
    what = "load dependent friction" if change == "loaded" else "dead band"
    assert words.startswith(f"The file cannot state {what} of lift.")
    assert done.kept_in_file == () and done.notes() == ()


def test_the_errors_are_those_of_the_file_that_is_written(
    refined: Callable[[str], Refined],
) -> None:
    """Opened and simulated as any other MJCF, the file has the errors that the result states; laws
    cannot act on it twice."""
    done, folder = refined("loaded")
    opened = open_mjcf(folder / "arm_corrected.xml")
    assert done.choice is not None and done.robot is not None
    true = loaded(servo_arm().robot)
    judge = Judging(recorded(with_controllers(servo_arm(), true), 100.0, 17, seed=1))
    played = closed_loop(opened, [judge])
    assert played is not None
    said = [one.alone for one in done.choice.errors.values()]
    np.testing.assert_allclose(played.errors, said, rtol=0.02)
    with pytest.raises(RobotError, match="refined without the laws"):
        attach(mujoco.MjModel.from_xml_path(str(folder / "arm_corrected.xml")), true)


def test_a_joint_whose_file_alone_moves_worse_keeps_the_description(tmp_path: Path) -> None:
    """Twice the gain is right with the dead band and wrong without: robot.yaml has both, the file
    neither."""
    done = written(stiff, tmp_path, refined=False)
    assert done.choice is not None and done.robot is not None and done.kept_in_file == ("lift",)
    lift = done.choice.errors["lift"]
    assert lift.corrected < 0.1 * lift.described and lift.alone == lift.described
    kept = open_mjcf(tmp_path / "arm_corrected.xml").robot.joints[1]
    described = servo_arm().robot.joints[1]
    assert kept.controller == described.controller
    assert done.robot.joints[1].controller != described.controller
    (note,) = done.notes()
    assert "move lift worse than the description" in note


def test_a_file_that_moves_worse_everywhere_is_not_written(tmp_path: Path) -> None:
    """The arm with its laws is written all the same."""
    done = written(stiff_everywhere, tmp_path, refined=False)
    assert not (tmp_path / "arm_corrected.xml").exists()
    assert isinstance(done.file, str)
    assert re.match(r"without .+, which an MJCF does not state, every joint would", done.file)
    assert "elastic-arm export" in done.file
    assert done.robot is not None and done.choice is not None
    assert all(one.alone is None for one in done.choice.errors.values())


def test_a_file_that_states_all_moves_as_the_arm(tmp_path: Path) -> None:
    """Without laws beside it there is nothing to refine, and both errors are one."""

    def rough(robot: Robot) -> Robot:
        kept = [one for one in robot.effects if one["joint"] != "elbow"]
        law = {
            "effect": "coulomb_friction",
            "joint": "elbow",
            "parameters": {"torque": 0.2},
        }
        return robot.with_(effects=(*kept, law))

    assert unstated(servo_arm(), rough(servo_arm().robot)) == {}
    done = written(rough, tmp_path, refined=True)
    assert done.choice is not None
    assert all(one.alone == one.corrected for one in done.choice.errors.values())
