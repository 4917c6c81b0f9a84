"""Each fault of a bag is named with its place."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from elastic_arm.recording import Recording, read_recording, write_recording
from elastic_arm.recording.inspection import check
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.inspection.repair import repair_bag
from elastic_arm.recording.sides import Side
from tests.helpers.bags import (
    JOINT_STATE,
    JOINTS,
    both,
    codes,
    joint_state,
    side,
    stamps,
    states,
    two_sided,
    write_foreign,
)
from tests.helpers.random_arms import random_arm


def test_a_clean_bag_has_no_findings(tmp_path: Path, rng: np.random.Generator) -> None:
    """Nothing is found where nothing is wrong."""
    report = check_bag(write_recording(tmp_path / "bag", two_sided(rng, 3000)))
    assert report.findings == []
    assert report.ok


def test_messages_with_fewer_numbers_than_joints_are_looked_into(tmp_path: Path) -> None:
    """Where one message has two numbers for three joints the others' numbers are checked all the
    same."""
    messages = both(stamps(200))
    stamp = int(stamps(101)[-1])
    messages[100] = (
        "/joint_states",
        JOINT_STATE,
        stamp,
        joint_state(stamp, JOINTS, [1.0, 2.0], [1.0] * 3, [1.0] * 3),
    )
    messages[50] = (
        "/joint_states",
        JOINT_STATE,
        stamp - 50_000_000,
        joint_state(stamp - 50_000_000, JOINTS, [np.nan, 1.0, 2.0], [1.0] * 3, [1.0] * 3),
    )
    report = check_bag(write_foreign(tmp_path / "bag", messages))
    assert not report.ok
    assert any("position" in finding.message for finding in report.findings)


def test_gaps_rates_and_drift_are_found(tmp_path: Path, rng: np.random.Generator) -> None:
    """Lost samples, a change of rate, and clocks that drift apart are each warned of."""
    holed, skipping = (np.delete(stamps(2000), slice(500, 500 + count)) for count in (140, 10))
    mixed = np.concatenate([stamps(1000), stamps(1000, 2_000_000, int(stamps(1001)[-1]))])
    slow = stamps(5000) + (np.arange(5000) * 200).astype(np.int64)  # 200 us a second
    for name, link, motor, code in (
        ("holed", holed, holed, "gaps"),
        ("mixed", mixed, mixed, "mixed_rates"),
        ("drifting", stamps(5000), slow, "drift"),
    ):
        bag = write_recording(tmp_path / name, Recording(JOINTS, side(rng, link), side(rng, motor)))
        assert codes(bag) == {code}, name
    gap = next(f for f in check_bag(tmp_path / "holed").findings if f.code == "gaps")
    assert "about 140 samples lost" in gap.message
    assert gap.time == pytest.approx(0.499)
    bag = write_recording(
        tmp_path / "skipping", Recording(JOINTS, side(rng, skipping), side(rng, skipping))
    )
    few = next(f for f in check_bag(bag).findings if f.code == "gaps")
    assert few.severity == "note" and "about 10 samples lost" in few.message


@pytest.mark.parametrize("period_ns", [1_000_000_000_000, 1000])
def test_times_in_another_unit_are_warned_of(
    tmp_path: Path, rng: np.random.Generator, period_ns: int
) -> None:
    """A sample a quarter of an hour, or a million a second, are no recording of an arm's motion."""
    taken = stamps(500, period_ns)
    bag = write_recording(tmp_path / "bag", Recording(JOINTS, side(rng, taken), side(rng, taken)))
    report = check_bag(bag)
    assert not report.ok and "rate" in codes(bag)
    assert all("another unit" in f.message for f in report.findings if f.code == "rate")


def test_a_channel_that_some_joints_have_is_noted(tmp_path: Path, rng: np.random.Generator) -> None:
    """Link encoders at two of three joints are in order, and named; a channel that no joint has is
    warned of."""
    whole = two_sided(rng, 500)
    whole.link.position[:, 2] = np.nan
    whole.link.velocity[:, 2] = np.nan
    report = check_bag(write_recording(tmp_path / "some", whole))
    assert report.ok
    assert "/joint_states.position is missing for joint_3" in [
        finding.message for finding in report.findings
    ]
    whole.link.velocity[:] = np.nan
    assert codes(write_recording(tmp_path / "none", whole)) == {"nan_channel"}


def test_jitter_alone_is_no_fault(tmp_path: Path, rng: np.random.Generator) -> None:
    """Stamps that jitter by a tenth of the interval are noted, not complained of."""
    jittered = stamps(3000) + rng.normal(scale=1e5, size=3000).astype(np.int64)
    bag = write_recording(
        tmp_path / "bag", Recording(JOINTS, side(rng, jittered), side(rng, jittered))
    )
    assert codes(bag) == set()


def test_missing_topics_are_named(tmp_path: Path) -> None:
    """A bag without joint states is refused, with what it holds instead and what to do."""
    bag = write_foreign(
        tmp_path / "bag", [(f"/arm{t}", k, s, d) for t, k, s, d in states("/joints", stamps(20))]
    )
    with pytest.raises(
        RecordingError, match=r"/arm/joints \(sensor_msgs/msg/JointState\).*--channels"
    ):
        read_recording(bag)
    assert "unusable" in codes(bag)


def test_unknown_joints_are_named(tmp_path: Path) -> None:
    """Joints that the robot does not have are named, with those that were recorded."""
    bag = write_foreign(tmp_path / "bag", both(stamps(100)))
    with pytest.raises(
        RecordingError,
        match="not recorded: joint elbow; the recorded joints are joint_1, joint_2, joint_3",
    ):
        read_recording(bag, joints=["joint_1", "elbow"])
    arm = random_arm(2, np.random.default_rng(0), elastic=False)
    named = [
        replace(joint, name=name)
        for joint, name in zip(arm.joints, ("joint_1", "elbow"), strict=True)
    ]
    (error,) = [
        f
        for f in check_bag(bag, robot=arm.with_(joints=tuple(named))).findings
        if f.severity == "error"
    ]
    assert "not recorded: joint elbow" in error.message


def test_a_field_filled_now_and_then_is_named(tmp_path: Path) -> None:
    """Effort in some messages only: two publishers; said with topic and field."""
    messages = both(stamps(50))
    messages[10] = (
        "/joint_states",
        JOINT_STATE,
        messages[10][2],
        joint_state(messages[10][2], JOINTS, [1, 2, 3]),
    )
    recording = read_recording(write_foreign(tmp_path / "bag", messages))
    assert "1 of 50 messages on /joint_states leave velocity, effort empty" in recording.notes[0]
    assert recording.link is not None and len(recording.link) == 49


def test_wrong_type_is_named(tmp_path: Path) -> None:
    """/joint_states of another type is refused by both names."""
    from elastic_arm.recording import message_types

    store = message_types.typestore()
    text = bytes(
        store.serialize_cdr(store.types["std_msgs/msg/String"]("x"), "std_msgs/msg/String")
    )
    bag = write_foreign(
        tmp_path / "bag",
        [("/joint_states", "std_msgs/msg/String", int(t), text) for t in stamps(5)],
    )
    with pytest.raises(
        RecordingError, match="has type std_msgs/msg/String, not sensor_msgs/msg/JointState"
    ):
        read_recording(bag)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("x.mcap", b"", "is empty"),
        ("x.mcap", b"no bag at all", "is not an MCAP file"),
        ("x.mcap", None, "does not exist"),
        ("x.db3", b"", "is empty"),
        ("x.db3", b"no bag at all", "is not an SQLite file"),
        ("x.db3", b"SQLite format 3\0 and no more", "is damaged"),
    ],
)
def test_what_is_no_bag_is_refused(
    tmp_path: Path, name: str, content: bytes | None, words: str
) -> None:
    """Empty, foreign, broken and missing files are each called what they are."""
    if content is not None:
        (tmp_path / name).write_bytes(content)
    for use in (read_recording, check_bag, repair_bag):
        with pytest.raises(RecordingError, match=words):
            use(tmp_path / name)


def test_a_long_bag_is_checked_in_parts_with_the_times_of_what_begins_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lost stretch in the third part is said once, at its time; that the arm rests in two parts
    is no finding."""
    t = np.arange(16000) * 5e-3
    position = np.where(t < 60.0, 0.0, 1.0 - np.cos(t - 60.0))[:, None] * [1.0, 0.5]
    there = (t < 50.0) | (t > 51.0)
    sides = [Side((t[there] * 1e9).astype(np.int64), position[there]) for _ in range(2)]
    bag = write_recording(tmp_path / "bag", Recording(("joint_1", "joint_2"), *sides))
    monkeypatch.setattr(check, "CHECKED", 8000)
    said = {finding.code: finding for finding in check_bag(bag).findings}
    assert "no_motion" not in said and "short" not in said
    assert said["gaps"].time == pytest.approx(50.0, abs=0.01) and said["gaps"].message.startswith(
        "from "
    )
    assert said["no_torque"].message.startswith("/motor_states")
