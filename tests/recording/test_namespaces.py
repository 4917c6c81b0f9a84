"""Bags of arms in namespaces: found by the suffix of their topics, chosen by name."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from elastic_arm.app import app
from elastic_arm.errors import RecordingError
from elastic_arm.recording import read_recording
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.storage.messages import read_messages
from elastic_arm.recording.storage.stream_writer import StreamWriter
from elastic_arm.recording.writing import write_recording
from tests.helpers.bags import two_sided


def bag_of(folder: Path, **arms: int) -> Path:
    """Write a bag of arms by namespace, each with the seed of its motion."""
    with StreamWriter(folder / "arms") as writer:
        for name, seed in arms.items():
            plain = folder / f"plain_{seed}"
            write_recording(plain, two_sided(np.random.default_rng(seed), 300))
            for message in read_messages(plain):
                topic = f"/{name}{message.topic}" if name else message.topic
                writer.add_topic(topic, message.type_name)
                writer.write(topic, message.data, message.log_ns)
    return folder / "arms"


def angles(folder: Path, seed: int) -> np.ndarray:
    link = read_recording(folder / f"plain_{seed}").link
    return link.position


def test_the_only_arm_of_a_bag_is_found_in_its_namespace(tmp_path: Path) -> None:
    """Topics below /left are read as those of the root are, URDF and all, and the source names the
    namespace."""
    bag = bag_of(tmp_path, left=1)
    recording = read_recording(bag)
    np.testing.assert_array_equal(recording.link.position, angles(tmp_path, 1))
    assert recording.motor is not None
    assert recording.source == f"{bag} (/left)"
    assert check_bag(bag).ok


@pytest.mark.parametrize("wanted", ["left", "/left", "/left/"])
def test_of_several_arms_one_is_chosen_by_its_namespace(tmp_path: Path, wanted: str) -> None:
    """Two arms in one bag are never mixed: without a choice it is refused, with one its samples
    alone are read."""
    bag = bag_of(tmp_path, left=1, right=2)
    with pytest.raises(
        RecordingError, match=r"contains 2 arms: /left, /right\. Choose one: --namespace"
    ):
        read_recording(bag)
    recording = read_recording(bag, namespace=wanted)
    np.testing.assert_array_equal(recording.link.position, angles(tmp_path, 1))
    with pytest.raises(
        RecordingError, match=r"no arm in the namespace /middle\. The namespaces are: /left, /right"
    ):
        read_recording(bag, namespace="middle")


def test_an_arm_without_a_namespace_comes_first(tmp_path: Path) -> None:
    """Where the contract's own names are in the bag they are read, as ever, and others on
    demand."""
    bag = bag_of(tmp_path, **{"": 1, "right": 2})
    recordings = [read_recording(bag, namespace=name) for name in (None, "/", "right")]
    for recording, seed in zip(recordings, (1, 1, 2), strict=True):
        np.testing.assert_array_equal(recording.link.position, angles(tmp_path, seed))


@pytest.mark.parametrize(
    ("command", "written", "offered"),
    [
        ("identify {} --namespace", "", ["left", "right"]),
        ("bag info {} --namespace", "ri", ["right"]),
        ("bag check {} --namespace", "x", []),
        ("bag replay {} --topic", "/left/j", ["/left/joint_states"]),
        ("bag replay {} --topic /a --topic", "/x", []),
    ],
)
def test_shells_complete_namespaces_and_topics(
    tmp_path: Path, command: str, written: str, offered: list[str]
) -> None:
    """`--namespace TAB` offers the arms of the bags before it, `--topic TAB` their topics, and
    nothing of what is no bag."""
    bag = bag_of(tmp_path, left=1, right=2)
    for path, expected in ((bag, offered), (tmp_path / "none", [])):
        environment = {
            "_ELASTIC_ARM_COMPLETE": "complete_fish",
            "_TYPER_COMPLETE_FISH_ACTION": "get-args",
            "_TYPER_COMPLETE_ARGS": f"elastic-arm {command.format(path)} {written}",
        }
        done = CliRunner().invoke(app, [], env=environment, prog_name="elastic-arm")
        assert [line.split("\t")[0] for line in done.stdout.split()] == expected
