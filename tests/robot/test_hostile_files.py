"""Arm files, overlays, URDFs, maps and trajectories that are hostile or broken: one line each, at
once."""

import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from elastic_arm.errors import ElasticArmError
from elastic_arm.evidence.priors import read_priors
from elastic_arm.excitation import load_trajectory
from elastic_arm.recording import load_channels
from elastic_arm.recording.foreign.arrays import load_array_map
from elastic_arm.robot import load_robot, to_urdf
from elastic_arm.robot.loading import NOMINAL_ARM
from elastic_arm.robot.urdf import parse_urdf

READERS: dict[str, Callable[[Path], object]] = {
    "arm": load_robot,
    "channel map": load_channels,
    "mapping": load_array_map,
    "trajectory": load_trajectory,
    "priors": lambda file: read_priors(file, ["joint_torque_gain"]),
}
BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [{','.join(['*' + chr(97 + i)] * 9)}]\n" for i in range(12)
)
MERGES = "a: &a {x: 1}\n" + "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} {{<<: [{','.join(['*' + chr(97 + i)] * 9)}]}}\n"
    for i in range(12)
)
TEXTS: dict[str, bytes] = {
    "a date that is none": b"name: 2001-99-99\njoints: {}",
    "an integer of 5000 digits": b"name: " + b"9" * 5000,
    "a number that is none": b"name: 0x_\njoints: 0b_",
    "a time of many parts": b"name: 1" + b":59" * 2000,
    "a truth that is none": b"name: !!bool perhaps",
    "a key that is no truth": b"!!bool perhaps: 1",
    "an empty integer": b"name: !!int ''",
    "a date by its tag": b"name: !!timestamp {=: {=: x}}",
    "an integer of 5000 hexadecimal digits": b"name: 0x" + b"f" * 5000,
    "a number of many parts": b"name: 1" + b":59" * 400 + b".5",
    "deep lists": b"joints: " + b"[" * 900 + b"]" * 900,
    "deep fields": b"joints: " + b"{a: " * 900 + b"}" * 900,
    "aliases": BOMB.encode(),
    "merges": MERGES.encode(),
    "an alias of itself": b"joints: &a [*a]",
    "a merge of itself": b"joints: &a\n  <<: *a\n",
    "UTF-32": "name: arm".encode("utf-32"),
    "UTF-16": "name: arm".encode("utf-16"),
    "bytes": bytes(range(256)),
    "a NUL": b"name: a\0b",
    "lists as keys": b"? [1, 2]\n: 3\njoints: {? {a: b} : c}",
    "numbers as keys": (
        b"1: 2\n2.5: 3\nnull: 4\ntrue: 5\njoints: {1: {2: 3}, null: 5}\ntimes: {1: 2}"
    ),
    "a tag of Python": b"joints: !!python/object/apply:os.system ['true']",
    "an unknown tag": b"joints: !foo bar",
    "several documents": b"a: 1\n---\nb: 2\n",
    "defaults of the wrong kind": b"defaults: 5\njoints: {a: {link: 3}, b: [1], c: null}",
    "nothing": b"",
}


def quickly(work: Callable[[], object]) -> str:
    """Return the one line of the refusal, which must come at once."""
    begin = time.process_time()
    with pytest.raises(ElasticArmError) as caught:
        work()
    assert time.process_time() - begin < 5.0
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 2300
    return str(caught.value)


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("name", TEXTS)
def test_hostile_yaml_is_refused_at_once(tmp_path: Path, reader: str, name: str) -> None:
    """Whoever reads it, and whatever YAML makes of it."""
    file = tmp_path / "a.yaml"
    file.write_bytes(TEXTS[name])
    assert str(file) in quickly(lambda: READERS[reader](file))


@pytest.mark.parametrize("reader", READERS)
def test_pipes_devices_folders_and_nul_are_refused(tmp_path: Path, reader: str) -> None:
    """Nothing waits for a pipe, or reads a device without end."""
    os.mkfifo(tmp_path / "pipe.yaml")
    (tmp_path / "zero.yaml").symlink_to("/dev/zero")
    (tmp_path / "log.yaml").symlink_to("/proc/kmsg")
    (tmp_path / "large.yaml").touch()
    os.truncate(tmp_path / "large.yaml", 10**10)
    for name in ("pipe.yaml", "zero.yaml", "log.yaml", "a\0b.yaml", "x" * 300, ".", "large.yaml"):
        quickly(lambda name=name: READERS[reader](tmp_path / name))  # type: ignore[misc]


@pytest.mark.parametrize(
    "value", ["x", None, [1], {"a": 1}, True, 10**400, "1e5", [[True]], [[["x"]]], float("nan")]
)
@pytest.mark.parametrize("field", ["omega", "a", "q0", "duration", "joints"])
def test_trajectories_with_wrong_types_are_refused(
    tmp_path: Path, field: str, value: object
) -> None:
    """Every field, with every kind of value that is not its own."""
    content = {
        "schema": "elastic_arm/trajectory/1",
        "omega": 1.0,
        "a": [[1.0]],
        "b": [[1.0]],
        "q0": [0.0],
    }
    content |= {"duration": 10.0, "ramp": 1.0, "joints": ["a"], field: value}
    file = tmp_path / "a.yaml"
    file.write_text(yaml.safe_dump(content))
    kept = (
        (field in ("omega", "duration") and value == "1e5")
        or (field == "joints" and value is None)
        or (field == "q0" and value == [1])
    )
    if not kept:
        quickly(lambda: load_trajectory(file))


def test_a_path_with_a_nul_within_a_file_is_refused(tmp_path: Path) -> None:
    """An overlay that names a URDF so is refused as any missing file."""
    file = tmp_path / "a.yaml"
    file.write_text('urdf: "a\\0b.urdf"\n')
    assert "contains a NUL" in quickly(lambda: load_robot(file))


def chain(count: int, kind: str = "fixed") -> str:
    """A URDF of so many joints in a row, the last one revolute."""
    links = "".join(f"<link name='l{i}'/>" for i in range(count + 2))
    joints = "".join(
        f"<joint name='j{i}' type='{kind}'><parent link='l{i}'/><child link='l{i + 1}'/></joint>"
        for i in range(count)
    )
    return f"<robot name='r'>{links}{joints}</robot>"


ENTITIES = "".join(f"<!ENTITY e{i + 1} '{f'&e{i};' * 10}'>" for i in range(12))
URDFS: dict[str, bytes] = {
    "3000 fixed joints": chain(3000).encode(),
    "300 fixed joints in a row": chain(300).encode(),
    "100 joints in a row": chain(100, "revolute").encode(),
    "an unknown encoding": b"<?xml version='1.0' encoding='foo'?><robot name='r'/>",
    "a wide encoding that is none": b"<?xml version='1.0' encoding='utf-32'?><robot name='r'/>",
    "UTF-32": to_urdf(load_robot()).replace("utf-8", "utf-32").encode("utf-32"),
    "entities": f"<!DOCTYPE r [<!ENTITY e0 'x'>{ENTITIES}]><robot name='&e12;'/>".encode(),
    "an external entity": (
        b"<!DOCTYPE r [<!ENTITY e SYSTEM 'file:///etc/passwd'>]><robot name='r'>&e;</robot>"
    ),
    "deep elements": b"<robot name='r'>" + b"<a>" * 100_000 + b"</a>" * 100_000 + b"</robot>",
    "nothing": b"",
    "a NUL": b"<robot name='\0'/>",
    "numbers that overflow": chain(1)
    .replace(
        "<link name='l0'/>",
        "<link name='l0'><inertial><mass value='1e999'/>"
        "<inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial>"
        "</link>",
    )
    .encode(),
}


@pytest.mark.parametrize("name", URDFS)
def test_hostile_urdfs_are_refused_at_once(tmp_path: Path, name: str) -> None:
    """Encodings, entities, depth and size end in one line, from a file and from a bag's text
    alike."""
    file = tmp_path / "a.urdf"
    file.write_bytes(URDFS[name])
    assert str(file) in quickly(lambda: load_robot(file))
    quickly(lambda: parse_urdf(URDFS[name]))


def test_anchors_of_a_sane_file_are_read(tmp_path: Path) -> None:
    """An arm file may use aliases: they are bounded, not forbidden."""
    content = yaml.safe_load(NOMINAL_ARM.read_text())
    content["joints"][1]["link"] = content["joints"][0]["link"]  # dumped as an alias
    file = tmp_path / "a.yaml"
    file.write_text(yaml.safe_dump(content))
    assert "*id001" in file.read_text()
    assert load_robot(file).joints[1].link.mass == load_robot().joints[0].link.mass


@pytest.mark.parametrize("reader", READERS)
def test_a_field_that_is_given_twice_is_refused(tmp_path: Path, reader: str) -> None:
    """YAML would take the last one in silence; the same value again is no contradiction."""
    file = tmp_path / "a.yaml"
    file.write_text("name: a\nname: a\nx: {ratio: 80, unit: rad, ratio: 100}\n")
    assert "line 3: 'ratio' is given twice" in quickly(lambda: READERS[reader](file))
    file.write_text("name: a\nname: a\n")
    assert "twice" not in quickly(lambda: READERS[reader](file))
