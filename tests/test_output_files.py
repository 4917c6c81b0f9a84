"""Results are written wholly or not at all, and a YAML file of the suite that is cut off is no
result."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.errors import ElasticArmError, OutputError, RobotError
from elastic_arm.output_files import write_result
from elastic_arm.robot import load_robot
from elastic_arm.robot.saving import robot_to_dict, save_robot

ROOT = Path(__file__).parents[1]


def test_a_write_that_fails_leaves_what_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk and an interrupt keep the earlier result, its rights, and leave nothing beside
    it."""
    file = tmp_path / "result.json"
    write_result(file, "earlier")
    file.chmod(0o640)

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    def interrupted(_: int) -> None:
        raise KeyboardInterrupt

    for failure, error in ((full, OutputError), (interrupted, KeyboardInterrupt)):
        monkeypatch.setattr(os, "fsync", failure)
        with pytest.raises(error):
            write_result(file, "later")
        assert file.read_text() == "earlier" and list(tmp_path.iterdir()) == [file]
    monkeypatch.undo()
    assert (
        write_result(file, "later").read_text() == "later" and file.stat().st_mode & 0o777 == 0o640
    )


def test_links_and_devices_are_written_through(tmp_path: Path) -> None:
    """A link stays a link, and what is no file takes the bytes as they are."""
    (tmp_path / "link").symlink_to("real")
    write_result(tmp_path / "link", "text")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "real").read_text() == "text"
    write_result("/dev/null", "text")
    with pytest.raises(OutputError, match="cannot be written: Is a directory"):
        write_result(tmp_path, "text")


def test_a_name_that_is_no_text_goes_into_a_result(tmp_path: Path) -> None:
    """Its bytes are written out."""
    name = os.fsdecode(b"caf\xe9")
    assert write_result(tmp_path / "a", f"of {name}").read_text() == r"of caf\udce9"


def test_a_description_that_is_cut_off_anywhere_is_refused(tmp_path: Path) -> None:
    """Of every cut of a robot.yaml none is read as a whole one; the whole one is, and says the
    same."""
    robot = load_robot()
    save_robot(robot, tmp_path / "robot.yaml")
    text = (tmp_path / "robot.yaml").read_text()
    assert robot_to_dict(load_robot(tmp_path / "robot.yaml")) == robot_to_dict(robot)
    for cut in np.unique(np.linspace(0, len(text) - 2, 200).astype(int)):
        (tmp_path / "cut.yaml").write_text(text[:cut])
        with pytest.raises(RobotError):
            load_robot(tmp_path / "cut.yaml")


@pytest.mark.parametrize("name", ["arm.urdf.xacro", "arm.sdf", "arm.xml", "arm.world"])
def test_other_descriptions_name_what_makes_one(tmp_path: Path, name: str) -> None:
    """A xacro by its command, an SDF by what converts it."""
    (tmp_path / name).write_text("<sdf/>")
    with pytest.raises(RobotError) as told:
        load_robot(tmp_path / name)
    assert ("> arm.urdf" if "xacro" in name else "sdf2urdf") in told.value.remedy


@pytest.mark.parametrize("written", ["-inf", "inf", "-Infinity"])
def test_a_limit_without_end_is_none(tmp_path: Path, written: str) -> None:
    """In a URDF and in an overlay."""
    body = (
        '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"'
        ' iyz="0"/></inertial>'
    )
    limit = f'<limit lower="{written}" upper="3.0" velocity="{written}" effort="5"/>'
    joint = (
        '<joint name="j" type="revolute"><parent link="b"/><child link="l"/><axis xyz="0 1'
        f' 0"/>{limit}</joint>'
    )
    (tmp_path / "a.urdf").write_text(
        f'<robot name="x"><link name="b"/><link name="l">{body}</link>{joint}</robot>'
    )
    (limits,) = [joint.limits for joint in load_robot(tmp_path / "a.urdf").joints]
    assert (limits.position_min, limits.position_max, limits.velocity, limits.torque) == (
        None,
        3.0,
        None,
        5.0,
    )
    (tmp_path / "o.yaml").write_text(
        f"urdf: a.urdf\nlimits: {{j: {{position_max: {written}, torque: 4.0}}}}\n"
    )
    (limits,) = [joint.limits for joint in load_robot(tmp_path / "o.yaml").joints]
    assert (limits.torque, limits.position_max) == (4.0, None)


def test_errors_of_other_kinds_are_raised_as_asked(tmp_path: Path) -> None:
    """The kind of the caller, with its remedy."""
    (tmp_path / "file").write_text("")
    with pytest.raises(RobotError, match="Give a folder") as told:
        write_result(tmp_path / "file" / "a", json.dumps({}), RobotError, "Give a folder")
    assert isinstance(told.value, ElasticArmError)
