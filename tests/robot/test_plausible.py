"""Numbers of a description that no arm has: said by `describe` with the number, refused by
`excite`."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elastic_arm.robot import Robot, load_robot, plausible
from elastic_arm.robot.parts import Inertia, Limits
from elastic_arm.robot.plausible import Range, doubtful
from tests.helpers.command_line import refusal, run
from tests.helpers.random_arms import random_arm
from tests.helpers.shared_data import DATA, needs_data


def rigid(**changes: Any) -> Robot:
    """Return an arm of three joints with one joint changed."""
    robot = random_arm(3, np.random.default_rng(1), elastic=False)
    return robot.with_joint("joint_2", **changes)


@needs_data
def test_ordinary_arms_are_plausible() -> None:
    """The nominal arm, random ones, and those of makers."""
    assert not doubtful(load_robot())
    assert not doubtful(random_arm(7, np.random.default_rng(2)))
    for file in (
        "kuka_lwr4/kuka_lwr4.urdf",
        "ur5e_with_tool/ur5e.urdf",
        "kuka_kr300/kr300_6_rigid.yaml",
    ):
        assert not doubtful(load_robot(DATA / file))


@needs_data
@pytest.mark.parametrize(
    ("folder", "words"),
    [
        (
            "limits_in_degrees/deg_limits.urdf",
            ["-170 rad", "degrees taken as radians", "180 rad/s"],
        ),
        (
            "millimetres/gram_mm.urdf",
            ["2000 kg", "grams taken as kg", "100 m", "millimetres taken as metres"],
        ),
    ],
)
def test_wrong_units_are_said_and_refused(tmp_path: Path, folder: str, words: list[str]) -> None:
    """`describe` names each number; no motion is made of them."""
    file = DATA / "public_reports_2" / folder
    said = " ".join(run("describe", "--robot", file).stdout.split())
    assert all(word in said for word in words)
    assert words[0] in refusal("excite", "--robot", file, "--out", tmp_path / "traj.yaml")
    assert not (tmp_path / "traj.yaml").exists()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"limits": Limits(position_min=-90.0, position_max=45.0)},
            "position limit of -90 rad is more",
        ),
        ({"limits": Limits(position_min=-1e-3, position_max=1e-3)}, "range of 0.002 rad is less"),
        ({"limits": Limits(velocity=1e-4)}, "velocity limit of 0.0001 rad/s is less"),
        ({"limits": Limits(torque=1e6)}, "torque limit of 1e+06 Nm is more"),
        (
            {"limits": Limits(position_min=0.0, position_max=800.0), "prismatic": True},
            "800 m is more",
        ),
        ({"link": Inertia(2e3, np.zeros(3), 100.0 * np.eye(3))}, "mass of 2000 kg is more"),
        ({"link": Inertia(1e-7, np.zeros(3), 1e-9 * np.eye(3))}, "mass of 1e-07 kg is less"),
        (
            {"link": Inertia(2.0, np.array([80.0, 0.0, 0.0]), 0.1 * np.eye(3))},
            "centre of mass of 80 m",
        ),
        (
            {"link": Inertia(2.0, np.zeros(3), 2e4 * np.eye(3))},
            "inertia of 2e+04 kg m² at 2 kg implies a width",
        ),
        (
            {"link": Inertia(2.0, np.zeros(3), 1e-9 * np.eye(3))},
            "inertia of 1e-09 kg m² at 2 kg is implausibly small",
        ),
        ({"armature": 20480.0}, "armature of 2.048e+04 kg m² is more"),
    ],
)
def test_each_number_has_its_range(changes: dict[str, Any], words: str) -> None:
    """Too large and too small, of hinge and slide."""
    assert words in doubtful(rigid(**changes))[0]


def test_gravity_and_the_whole_arm_have_theirs() -> None:
    """mm/s² for gravity, and an arm of millimetres that is described in kilometres."""
    robot = rigid()
    assert "mm/s²" in doubtful(robot.with_(gravity=np.array([0.0, 0.0, -9810.0])))[-1]
    tiny = robot
    for joint in robot.joints:
        before = joint.before.copy()
        after = joint.after.copy()
        before[:3, 3] *= 1e-3
        after[:3, 3] *= 1e-3
        tiny = tiny.with_joint(joint.name, before=before, after=after)
    assert any("length of all links" in words for words in doubtful(tiny))


def test_what_is_not_stated_is_not_doubted() -> None:
    """Zero states nothing, and huge limits none; the table is that of the documentation."""
    joint = replace(rigid().joints[1], limits=Limits(position_min=-1e9, position_max=1e9))
    assert not doubtful(rigid(limits=joint.limits))
    page = " ".join((Path(__file__).parents[2] / "docs" / "recordings.md").read_text().split())
    for each in [one for one in vars(plausible).values() if isinstance(one, Range)]:
        assert f"{each.what} | {each.unit} | {each.least:g} to {each.most:.4g}" in page
