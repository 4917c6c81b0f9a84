"""Messages in the order of their stamps: what reader and check make of every order they may come
in."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from elastic_arm.recording import Recording, load_channels, read_recording
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.reading import read_parts
from tests.helpers.bags import JOINT_STATE, JOINTS, joint_state, stamps, states, write_foreign

COUNT = 3000
TAKEN = stamps(COUNT)


def recorded(folder: Path, stamp_ns: np.ndarray, names: Sequence[str] = JOINTS) -> Path:
    """A bag of both sides whose messages arrive in turn, whatever their stamps are: the numbers
    tell which is which."""
    arrival = stamps(len(stamp_ns))
    both = [
        m for topic in ("/joint_states", "/motor_states") for m in states(topic, stamp_ns, names)
    ]
    return write_foreign(
        folder, [(t, k, int(arrival[i % len(arrival)]), d) for i, (t, k, _, d) in enumerate(both)]
    )


def rows(recording: Recording) -> np.ndarray:
    """The numbers of the messages that became samples."""
    return np.rint(recording.motor.position[:, 0]).astype(int)


def codes(bag: Path) -> set[str]:
    """What the check says of stamps."""
    known = {"out_of_order", "clock_set_back", "duplicate", "stray_stamps", "unusable", "gaps"}
    return {finding.code for finding in check_bag(bag).findings} & known


@pytest.mark.parametrize("block", [1, 3, 60, 500])
def test_messages_out_of_order_are_sorted(tmp_path: Path, block: int) -> None:
    """Pairs, or blocks, that overtook each other: no message is lost, and it is a note."""
    order = np.arange(COUNT).reshape(-1, 2, block)[:, ::-1].ravel()
    bag = recorded(tmp_path / "bag", TAKEN[order])
    recording = read_recording(bag)
    np.testing.assert_array_equal(recording.motor.stamp_ns, TAKEN)  # type: ignore[union-attr]
    np.testing.assert_array_equal(rows(recording)[order], np.arange(COUNT))
    assert codes(bag) == {"out_of_order"}
    assert any("arrived after later ones" in note for note in recording.notes)


@pytest.mark.parametrize("back", [0.5, 0.5003, 0.08, 2.0, 3600.0])
def test_a_clock_that_was_set_back_is_named_as_that(tmp_path: Path, back: float) -> None:
    """The later samples run on from where it was, none is lost."""
    set_back = TAKEN - np.where(np.arange(COUNT) > 1800, round(1e9 * back), 0)
    bag = recorded(tmp_path / "bag", set_back)
    recording = read_recording(bag)
    assert codes(bag) == {"clock_set_back"}
    np.testing.assert_array_equal(recording.motor.stamp_ns, TAKEN)  # type: ignore[union-attr]
    np.testing.assert_array_equal(rows(recording), np.arange(COUNT))
    assert any(
        f"the clock was set back by {back:.4g} s after 1.800000 s" in note
        for note in recording.notes
    )


def test_a_clock_set_back_while_nothing_came_leaves_a_hole_of_a_second(tmp_path: Path) -> None:
    """A driver that starts anew has moved its arm meanwhile: both sides go on a second later,
    whenever they arrived."""
    later = np.arange(COUNT) > 1800
    messages = []
    for topic, late in (("/joint_states", 0), ("/motor_states", 40_000_000)):
        arrival = TAKEN + later * (5_000_000_000 + late)
        both = states(topic, TAKEN - later * 3_600_000_000_000, JOINTS)
        messages += [(t, k, int(arrival[i]), data) for i, (t, k, _, data) in enumerate(both)]
    bag = write_foreign(tmp_path / "bag", messages)
    recording = read_recording(bag)
    for side in recording.measured().values():
        np.testing.assert_array_equal(side.stamp_ns, TAKEN + later * 1_000_000_000)
    assert codes(bag) == {"clock_set_back", "gaps"}


def test_parts_of_a_long_bag_after_a_clock_was_set_back_count_as_later(tmp_path: Path) -> None:
    """No sample is lost of the parts that follow, which the clock stamps as those before, and a
    note tells it."""
    back = [0, 600_000_000_000, 600_000_000_000]
    thirds = [taken - by for taken, by in zip(np.split(TAKEN, 3), back, strict=True)]
    bags = [recorded(tmp_path / f"bag_{k}", third) for k, third in enumerate(thirds)]
    whole = Recording.joined([part for part, _ in read_parts(bags, most=1)])
    np.testing.assert_array_equal(rows(whole), np.tile(np.arange(COUNT // 3), 3))
    assert whole.duration == pytest.approx(COUNT * 1e-3 + 1.0, abs=0.01)
    assert any("the clock was set back" in note for note in whole.notes)


def test_a_stamp_far_from_all_others_is_left_out(tmp_path: Path) -> None:
    """One message from the far future costs that message alone."""
    wild = TAKEN.copy()
    wild[100] += 10**12
    bag = recorded(tmp_path / "bag", wild)
    np.testing.assert_array_equal(rows(read_recording(bag)), np.delete(np.arange(COUNT), 100))
    assert codes(bag) == {"stray_stamps"}


def test_of_messages_with_one_stamp_one_is_taken(tmp_path: Path) -> None:
    """Where two differ that is a warning, as it may be two publishers."""
    twice = TAKEN.copy()
    twice[77] = twice[76]
    bag = recorded(tmp_path / "bag", twice)
    np.testing.assert_array_equal(rows(read_recording(bag)), np.delete(np.arange(COUNT), 77))
    (finding,) = [
        f for f in check_bag(bag).findings if f.code == "duplicate" and f.topic == "/motor_states"
    ]
    assert (
        finding.severity == "warning" and "repeats 1 stamps, first that of 0.076" in finding.message
    )


def test_equal_stamps_are_said_to_be_equal_and_arrival_is_believed(tmp_path: Path) -> None:
    """Nobody stamped the messages: the error says so; with the times of arrival, by option or map,
    all is in order."""
    bag = recorded(tmp_path / "bag", np.full(COUNT, TAKEN[0]))
    with pytest.raises(RecordingError, match=f"all {COUNT} header stamps are equal.*time: arrival"):
        read_recording(bag)
    assert codes(bag) == {"unusable"}
    np.testing.assert_array_equal(read_recording(bag, arrival=True).motor.stamp_ns, TAKEN)  # type: ignore[union-attr]
    file = tmp_path / "map.yaml"
    motor = "{position: {topic: /motor_states}, effort: {topic: /motor_states}}"
    file.write_text(
        "time: arrival\njoints:\n" + "".join(f"  {joint}: {{motor: {motor}}}\n" for joint in JOINTS)
    )
    np.testing.assert_array_equal(rows(read_recording(bag, file)), np.arange(COUNT))
    assert check_bag(bag, load_channels(file)).usable


@pytest.mark.parametrize("late_ns", [0, 300_000])
def test_half_messages_of_one_arm_are_joined(tmp_path: Path, late_ns: int) -> None:
    """Two publishers of some joints each, stamped alike or apart: one recording of all joints, for
    reader and check."""
    parts = [
        (
            topic,
            JOINT_STATE,
            int(t) + late,
            joint_state(int(t) + late, names, [1e-9 * (t + late - TAKEN[0])] * n),
        )
        for topic in ("/joint_states", "/motor_states")
        for names, n, late in ((JOINTS[:1], 1, 0), (JOINTS[1:], 2, late_ns))
        for t in TAKEN
    ]
    bag = write_foreign(tmp_path / "bag", sorted(parts, key=lambda message: message[2]))
    recording = read_recording(bag)
    assert (
        recording.joints == JOINTS
        and recording.motor is not None
        and recording.motor.position is not None
    )
    seconds = 1e-9 * (recording.motor.stamp_ns - TAKEN[0])
    np.testing.assert_allclose(
        recording.motor.position, np.tile(seconds[:, None], 3), rtol=0, atol=1e-9
    )
    assert len(seconds) >= COUNT - 1
    assert check_bag(bag).usable and any("which are merged" in note for note in recording.notes)
    file = tmp_path / "map.yaml"
    file.write_text(
        "joints:\n"
        + "".join(f"  {j}: {{motor: {{position: {{topic: /motor_states}}}}}}\n" for j in JOINTS)
    )
    mapped = read_recording(bag, file)
    np.testing.assert_allclose(mapped.motor.position, recording.motor.position, rtol=0, atol=1e-9)
    assert len(mapped.notes) == (late_ns > 0) and "duplicate" not in {
        f.code for f in check_bag(bag, load_channels(file)).findings
    }


@pytest.mark.parametrize("bad", JOINTS)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_number_that_is_none_in_half_a_message_is_named(
    tmp_path: Path, bad: str, value: float
) -> None:
    """In whichever half it is, and though the halves are brought to one time."""
    halves = [
        (
            int(t) + late,
            (
                "/motor_states",
                JOINT_STATE,
                int(t) + late,
                joint_state(int(t) + late, names, numbers),
            ),
        )
        for t in TAKEN
        for names, late in ((JOINTS[:1], 0), (JOINTS[1:], 300_000))
        if (numbers := [value if name == bad and t == TAKEN[900] else 0.1 for name in names])
    ]
    bag = write_foreign(tmp_path / "bag", [message for _, message in sorted(halves)])
    (finding,) = [finding for finding in check_bag(bag).findings if finding.severity == "error"]
    assert finding.code == "nan" and f"position of {bad} is {value} at 0.9" in finding.message


def test_a_second_publisher_of_positions_alone_is_left_out(tmp_path: Path) -> None:
    """Its messages lack what the arm's have; one of other joints is joined, whatever it fills."""
    given = states("/motor_states", TAKEN)
    other = [
        (topic, kind, t + 400_000, joint_state(t + 400_000, JOINTS, [0.0] * 3))
        for topic, kind, t, _ in given
    ]
    bag = write_foreign(tmp_path / "bag", sorted(given + other, key=lambda message: message[2]))
    file = tmp_path / "map.yaml"
    file.write_text(
        "joints:\n"
        + "".join(f"  {j}: {{motor: {{effort: {{topic: /motor_states}}}}}}\n" for j in JOINTS)
    )
    for recording in (read_recording(bag), read_recording(bag, file)):
        np.testing.assert_array_equal(recording.motor.stamp_ns, TAKEN)  # type: ignore[union-attr]
        assert any("effort empty, which others fill" in note for note in recording.notes)
    (finding,) = [
        finding for finding in check_bag(bag).findings if finding.code == "second_publisher"
    ]
    assert finding.severity == "warning" and f"{COUNT} of {2 * COUNT} messages" in finding.message


def test_messages_of_a_gripper_are_no_fault(tmp_path: Path) -> None:
    """What the reader sets aside the check sets aside: one note, no number that is none."""
    gripper = states("/motor_states", TAKEN + 300_000, ["finger"])
    both = sorted(states("/motor_states", TAKEN) + gripper, key=lambda message: message[2])
    report = check_bag(write_foreign(tmp_path / "bag", both))
    assert report.usable and not [
        finding for finding in report.findings if "finite" in finding.message
    ]
