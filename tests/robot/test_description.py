"""The arm file: what it holds, what is refused and how, and that a saved arm loads to the same
arm."""

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from elastic_arm.errors import RobotError
from elastic_arm.robot import Inertia, Joint, Robot, load_robot, robot_to_dict, save_robot
from elastic_arm.robot.loading import NOMINAL_ARM
from tests.helpers.random_arms import random_arm


@pytest.fixture
def content() -> dict[str, Any]:
    return yaml.safe_load(NOMINAL_ARM.read_text(encoding="utf-8"))


def load(content: dict[str, Any], tmp_path: Path) -> Robot:
    path = tmp_path / "arm.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return load_robot(path)


def test_nominal_arm_is_the_papers() -> None:
    """Three elastic joints, 139 kg, reach of 1.5 m, r_tot = 363."""
    robot = load_robot()
    assert robot.elastic and robot.n == 3
    assert robot.joint_names == ("joint_1", "joint_2", "joint_3")
    assert robot.mass == pytest.approx(139.0, abs=1e-9)
    assert sum(abs(joint.dh.a) for joint in robot.joints) == pytest.approx(1.5)
    assert [joint.transmission.r_tot for joint in robot.joints] == [363.0] * 3


def test_right_angles_are_exact() -> None:
    """cos(pi/2) is 0, not 6e-17: a placement holds no rounding that would make false parameters."""
    for joint in load_robot().joints:
        rotation = joint.after[:3, :3]
        assert set(np.abs(rotation).ravel()) <= {0.0, 1.0}


def test_links_are_placed_by_their_rows() -> None:
    """after = Rz(offset) Tz(d) Tx(a) Rx(alpha), as in (3)."""
    joint = load_robot().joints[1]
    np.testing.assert_allclose(
        joint.after, [[0, -1, 0, 0], [1, 0, 0, -0.75], [0, 0, 1, -0.16], [0, 0, 0, 1]]
    )
    np.testing.assert_array_equal(joint.before, np.eye(4))


@pytest.mark.parametrize("r_tot", [5, 51, 128, 230, 363])
def test_studied_ratios_reach_every_joint(r_tot: float) -> None:
    """with_ratio splits r_tot as the arm file says and leaves everything else."""
    robot = load_robot().with_ratio(r_tot)
    assert [joint.transmission.r_tot for joint in robot.joints] == pytest.approx([r_tot] * 3)
    assert robot.joints[0].transmission.rotor.izz == load_robot().joints[0].transmission.rotor.izz


@pytest.mark.parametrize("r_tot", [0, 100])
def test_other_ratios_are_refused_with_the_known_ones(r_tot: float) -> None:
    """A ratio that the arm file does not split is an error that lists those it does."""
    with pytest.raises(RobotError, match="5, 51, 128, 230, 363"):
        load_robot().with_ratio(r_tot)


@pytest.mark.parametrize(
    "robot",
    [
        load_robot(),
        random_arm(7, np.random.default_rng(0)),
        random_arm(4, np.random.default_rng(1), elastic=False),
    ],
    ids=["arm file", "placed by matrices", "rigid"],
)
def test_a_saved_arm_loads_to_the_same_arm(robot: Robot, tmp_path: Path) -> None:
    """Every number comes back exactly, whether joints are placed by rows or by matrices."""
    save_robot(robot, tmp_path / "saved.yaml")
    again = load_robot(tmp_path / "saved.yaml")
    assert robot_to_dict(again) == robot_to_dict(robot)
    for joint, other in zip(robot.joints, again.joints, strict=True):
        np.testing.assert_array_equal(joint.before, other.before)
        np.testing.assert_array_equal(joint.after, other.after)
        np.testing.assert_array_equal(joint.link.inertia, other.link.inertia)


def test_effects_are_kept_as_plain_data(tmp_path: Path) -> None:
    """What an arm has beyond mod3 goes into its file and comes back."""
    effect = {
        "effect": "coulomb_friction",
        "joint": "joint_2",
        "parameters": {"torque": np.float64(13.9)},
    }
    robot = load_robot().with_(effects=(effect,))
    save_robot(robot, tmp_path / "saved.yaml")
    assert load_robot(tmp_path / "saved.yaml").effects == (
        {**effect, "parameters": {"torque": 13.9}},
    )


def test_an_unwritable_place_is_named(tmp_path: Path) -> None:
    """Saving into what is no folder says so."""
    (tmp_path / "nowhere").write_text("")
    with pytest.raises(RobotError, match="cannot be written"):
        save_robot(load_robot(), tmp_path / "nowhere" / "arm.yaml")


Edit = Callable[[dict[str, Any]], Any]


def joint(content: dict[str, Any]) -> dict[str, Any]:
    return content["joints"][1]


BAD: dict[str, tuple[Edit, str]] = {
    "missing field": (
        lambda c: joint(c)["link"].pop("mass"),
        r"joints\[1\]\.link\.mass: missing field.*Add mass",
    ),
    "missing part": (lambda c: joint(c).pop("link"), r"joints\[1\]\.link: missing field"),
    "half a transmission": (
        lambda c: joint(c).pop("stiffness"),
        r"joints\[1\]\.stiffness: missing field",
    ),
    "text for a number": (
        lambda c: joint(c)["link"].update(mass="heavy"),
        r"link\.mass: is the text 'heavy'",
    ),
    "yes for a number": (lambda c: joint(c)["link"].update(mass=True), r"link\.mass: is yes or no"),
    "number for a part": (lambda c: joint(c).update(rotor=3.0), r"joints\[1\]\.rotor"),
    "too short a vector": (lambda c: joint(c)["link"].update(com=[1.0, 2.0]), r"link\.com"),
    "unknown key": (
        lambda c: joint(c)["link"].update(mas=3.0),
        r"link\.mas: unknown key.*Remove mas",
    ),
    "unknown key at the top": (lambda c: c.update(gravitation=9.81), r"gravitation: unknown key"),
    "negative mass": (
        lambda c: joint(c)["link"].update(mass=-3.0),
        r"joints\[1\]\.link\.mass is -3",
    ),
    "negative rotor mass": (
        lambda c: joint(c)["rotor"].update(mass=-1.0),
        r"joints\[1\]\.rotor\.mass is -1",
    ),
    "triangle inequality": (
        lambda c: joint(c)["link"]["inertia"].update(xx=30.0),
        r"joints\[1\]\.link\.inertia violates the triangle",
    ),
    "triangle inequality of a rotor": (
        lambda c: joint(c)["rotor"].update(izz=1.0),
        r"joints\[1\]\.rotor\.inertia violates the triangle",
    ),
    "indefinite inertia": (
        lambda c: joint(c)["link"]["inertia"].update(xy=30.0),
        r"link\.inertia is not positive definite",
    ),
    "zero stiffness": (
        lambda c: joint(c).update(stiffness=0.0),
        r"joints\[1\]\.stiffness is 0, but must be positive",
    ),
    "negative stiffness": (
        lambda c: joint(c).update(stiffness=-2.0),
        r"joints\[1\]\.stiffness is -2",
    ),
    "zero bearing stiffness": (
        lambda c: joint(c)["bearing"].update(stiffness=0),
        r"joints\[1\]\.bearing\.stiffness",
    ),
    "negative damping": (lambda c: joint(c).update(damping=-1.0), r"joints\[1\]\.damping is -1"),
    "zero ratio": (lambda c: joint(c).update(belt_ratio=0), r"joints\[1\]\.belt_ratio is 0"),
    "zero studied ratio": (
        lambda c: c.update(total_ratios_studied={5: [0.0, 5.0]}),
        r"total_ratios_studied\[5\]",
    ),
    "unknown carrier": (
        lambda c: joint(c)["rotor"].update(carrier="link_9"),
        r"rotor\.carrier is 'link_9'.*link_1",
    ),
    "carrier too far": (
        lambda c: joint(c)["rotor"].update(carrier="base"),
        r"rotor\.carrier is 'base'",
    ),
    "same joint name": (
        lambda c: joint(c).update(name="joint_1"),
        "two joints are named 'joint_1'",
    ),
    "not a number": (
        lambda c: c.update(gravity=[0.0, 0.0, float("nan")]),
        r"gravity\[2\]: nan is not a finite",
    ),
    "infinite": (lambda c: joint(c)["dh"].update(a=float("inf")), r"dh\.a: inf is not a finite"),
    "no list of joints": (lambda c: c.update(joints="three"), "joints: is 'three', not a list"),
    "gravity of two numbers": (
        lambda c: c.update(gravity=[0.0, -9.81]),
        r"gravity\[2\]: missing entry.*all entries",
    ),
    "a joint that is no block": (
        lambda c: c.update(joints=[3]),
        r"joints\[0\]: is 3, not a block of fields",
    ),
    "no joints": (lambda c: c.update(joints=[]), r"joints: has 0 entries"),
    "unplaced joint": (lambda c: joint(c).pop("dh"), r"joints\[1\]\.dh: missing field"),
    "joint placed twice": (
        lambda c: joint(c).update(before=np.eye(4).tolist()),
        "conflicts with before or after",
    ),
    "skew placement": (
        lambda c: (
            joint(c).pop("dh"),
            joint(c).update(after=np.diag([2.0, 1.0, 1.0, 1.0]).tolist()),
        ),
        r"joints\[1\]\.after is not a rigid placement",
    ),
    "mass of no arm": (
        lambda c: joint(c)["link"].update(mass=1e200),
        r"link\.mass is 1e\+200, which is implausible",
    ),
    "stiffness of no arm": (
        lambda c: joint(c).update(stiffness=1e-300),
        r"\.stiffness is 1e-300, which is implausible",
    ),
    "damping of no arm": (
        lambda c: joint(c).update(damping=1e300),
        r"\.damping is 1e\+300, which is implausible",
    ),
    "ratio of no arm": (
        lambda c: joint(c).update(harmonic_drive_ratio=1e12),
        r"drive_ratio is 1e\+12, which is implausible for a transmission",
    ),
    "length of no arm": (
        lambda c: joint(c)["dh"].update(a=1e200),
        r"offset contains 1e\+200, which is implausible",
    ),
    "gravity of no arm": (
        lambda c: c.update(gravity=[0, 0, -1e200]),
        r"gravity contains 1e\+200, which is implausible",
    ),
    "limits crossed": (
        lambda c: joint(c).update(limits={"position_min": 1.0, "position_max": -1.0}),
        r"joints\[1\]\.limits\.position",
    ),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_arm_files_are_refused_by_field_and_reason(
    what: str, content: dict[str, Any], tmp_path: Path
) -> None:
    """The error names the file, the field and the reason, and ends with a remedy."""
    edit, message = BAD[what]
    changed = copy.deepcopy(content)
    edit(changed)
    with pytest.raises(RobotError, match=message) as caught:
        load(changed, tmp_path)
    assert str(tmp_path / "arm.yaml") in str(caught.value)
    assert caught.value.remedy


def test_a_mixture_of_elastic_and_rigid_joints_is_refused_by_name(
    content: dict[str, Any], tmp_path: Path
) -> None:
    """All joints have transmissions, or none has; the error names those without."""
    for name in ("rotor", "wave_generator", "spline", "stiffness", "damping", "bearing"):
        content["joints"][2].pop(name)
    for name in ("belt_ratio", "harmonic_drive_ratio"):
        content["joints"][2].pop(name)
    with pytest.raises(RobotError, match="joint_3 have no transmission"):
        load(content, tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "contains no fields"),
        ("- 1\n- 2\n", "contains no fields"),
        ("name: [1, 2\n", "line 2"),
        ("\udcff", "is not a text file"),
        (None, r"broken\.yaml: no such file"),
    ],
)
def test_files_that_are_no_arm_files_are_refused(
    text: str | None, message: str, tmp_path: Path
) -> None:
    """Missing and empty files, lists, bytes and broken YAML give an error with the file's name, and
    the line."""
    path = tmp_path / "broken.yaml"
    if text is not None:
        path.write_text(text, encoding="utf-8", errors="surrogateescape")
    with pytest.raises(RobotError, match=message):
        load_robot(path)


def test_numbers_in_scientific_notation_are_read(content: dict[str, Any], tmp_path: Path) -> None:
    """1e5, which YAML takes for text, is a number here."""
    content["joints"][1]["stiffness"] = "9e4"
    assert load(content, tmp_path).joints[1].transmission.stiffness == 90000.0


def test_an_arm_can_be_made_without_a_file() -> None:
    """Joints placed by matrices, without transmissions, make a rigid arm."""
    link = Inertia(1.0, np.array([0.0, 0.0, 0.1]), np.diag([0.02, 0.02, 0.01]))
    robot = Robot("one", (Joint("turn", "rod", link, before=np.eye(4)),))
    assert not robot.elastic and robot.link_names == ("rod",)


def test_a_described_arm_cannot_be_changed_in_place() -> None:
    """Arrays are read-only: who wants another arm makes one."""
    with pytest.raises(ValueError, match="read-only"):
        load_robot().joints[0].link.com[0] = 1.0
