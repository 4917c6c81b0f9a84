"""The clock of a replay: due times and other speeds; and definitions of installed types."""

import pytest

from elastic_arm.nodes.recorder import installed_definition
from elastic_arm.nodes.replayer import Playback
from elastic_arm.recording import message_types
from elastic_arm.recording.message_types import parse_definition
from elastic_arm.recording.storage.messages import Message

SECOND = 1_000_000_000


def playback() -> Playback:
    """Ten messages a second apart, from 100 s on."""
    return Playback(iter([Message((100 + k) * SECOND, 0, "/a", "", bytes([k])) for k in range(10)]))


def test_messages_are_due_in_the_rhythm_of_their_recording() -> None:
    """The first is due at once, the next a second later, or half a second at twice the speed."""
    bag = playback()
    assert bag.wait(5.0, 1.0) == 0.0
    assert bag.take().data == b"\x00"
    assert bag.wait(5.25, 1.0) == pytest.approx(0.75)
    assert bag.wait(5.25, 2.0) == pytest.approx(0.375)
    assert bag.wait(5.625, 2.0) == pytest.approx(0.0)


@pytest.mark.parametrize("type_name", ["control_msgs/msg/JointTolerance", "trajectory_msgs/msg/JointTrajectory"])
def test_the_definition_of_an_installed_type_holds_all_that_it_is_made_of(type_name: str) -> None:
    """The text made of the installed files parses, and is what the library has for a type that it knows."""
    text, type_hash = installed_definition(type_name)
    assert type_hash.startswith("RIHS01_")
    fields = parse_definition(type_name, "ros2msg", text)
    assert type_name in fields
    if message_types.known(type_name):
        assert type_hash == message_types.definition(type_name)[1]
        known = message_types.typestore().fielddefs
        assert all(fields[name][1] == known[name][1] for name in fields)


def test_a_type_that_is_not_installed_has_no_definition() -> None:
    """Its messages are recorded all the same."""
    assert installed_definition("nowhere_msgs/msg/Nothing") == ("", "")
