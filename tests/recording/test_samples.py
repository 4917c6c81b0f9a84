"""Both sides on one time base, and the parts of a recording."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from elastic_arm.errors import RecordingError
from elastic_arm.recording import Recording, Side
from elastic_arm.recording.spans import progression
from elastic_arm.recording.storage.mcap_scan import scan
from tests.helpers.bags import JOINTS, START_NS, side, stamps, two_sided


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(2)


def wave(stamp_ns: np.ndarray, hertz: float = 5.0) -> Side:
    """A slow sinusoid, sampled at `stamp_ns`."""
    angle = 2 * np.pi * hertz * ((stamp_ns - START_NS) * 1e-9)[:, None] + [0.0, 1.0, 2.0]
    return Side(stamp_ns, np.sin(angle), np.cos(angle), np.sin(2 * angle))


def test_equal_stamps_are_joined_exactly(rng: np.random.Generator) -> None:
    """With one clock tick for both sides nothing is interpolated."""
    recording = two_sided(rng, 100)
    samples = recording.samples()
    np.testing.assert_array_equal(samples.theta, recording.motor.position)
    np.testing.assert_array_equal(samples.tau_J, recording.link.effort)
    np.testing.assert_allclose(samples.t, np.arange(100) * 1e-3, rtol=0, atol=1e-12)
    assert samples.notes == ()


def test_lost_messages_are_left_out_of_both_sides(rng: np.random.Generator) -> None:
    """A sample that one side lost is left out of the other too, and counted."""
    link, motor = side(rng, stamps(1000)), side(rng, stamps(1000))
    samples = Recording(JOINTS, link.at(np.arange(1000) != 40), motor.at(np.arange(1000) != 70)).samples()
    keep = np.delete(np.arange(1000), [40, 70])
    np.testing.assert_array_equal(samples.q, link.position[keep])
    np.testing.assert_array_equal(samples.tau_m, motor.effort[keep])
    assert "2 samples" in samples.notes[0]


def test_stamps_apart_are_interpolated_to_the_link_side() -> None:
    """Half a sample apart, a 5 Hz motion at 1 kHz is met to the cubic spline's error, and the result says so."""
    link, motor = wave(stamps(2000)), wave(stamps(2000) + 500_000)
    samples = Recording(JOINTS, link, motor).samples()
    expected = wave(samples.stamp_ns)
    # (w h)^4 / 384 of the spline's error bound, h = 1 ms, w = 2 pi 10 Hz of the effort
    bound = 5 * (2 * np.pi * 10 * 1e-3) ** 4 / 384
    inner = slice(10, -10)  # the ends of the spline are worse
    for got, want in ((samples.theta, expected.position), (samples.tau_m, expected.effort)):
        assert np.abs(got - want)[inner].max() < bound
    assert "interpolated" in samples.notes[0]
    assert len(samples) == 1999  # the first link sample lies before the motor's first


def test_nothing_is_invented_in_a_gap() -> None:
    """Where the motor side has a hole, the link side's samples are left out."""
    hole = np.delete(stamps(1000) + 500_000, slice(400, 500))
    samples = Recording(JOINTS, wave(stamps(1000)), wave(hole)).samples()
    inside = (samples.stamp_ns > hole[399]) & (samples.stamp_ns < hole[400])
    assert not inside.any()
    assert len(samples) == 898


def test_sides_that_never_overlap_are_refused() -> None:
    """Two sides recorded one after the other are no recording."""
    with pytest.raises(RecordingError, match="do not overlap in time"):
        Recording(JOINTS, wave(stamps(100)), wave(stamps(100) + 10**12)).samples()


def test_an_empty_recording_has_no_samples() -> None:
    """Nothing recorded: said, with what to record."""
    with pytest.raises(RecordingError, match="Record /joint_states or /motor_states"):
        Recording(JOINTS).samples()


def test_parts_and_joints_can_be_taken(rng: np.random.Generator) -> None:
    """`between` cuts by time from the start, `select` orders the columns, both on all sides."""
    recording = two_sided(rng, 1000)
    part = recording.between(0.2, 0.5)
    np.testing.assert_array_equal(part.motor.stamp_ns, stamps(1000)[200:500])
    np.testing.assert_array_equal(part.link.velocity, recording.link.velocity[200:500])
    chosen = recording.select(["joint_3", "joint_1"])
    np.testing.assert_array_equal(chosen.motor.effort, recording.motor.effort[:, [2, 0]])
    with pytest.raises(RecordingError, match="has no joint joint_9; it has joint_1, joint_2, joint_3"):
        recording.select(["joint_9"])


RECORDS = st.lists(st.tuples(st.sampled_from([3, 4, 5, 5, 5, 5]), st.integers(1, 3), st.integers(0, 40)), max_size=300)


@given(RECORDS, st.integers(1, 30), st.integers(0, 60))
def test_every_record_is_found_once(kinds: list[tuple[int, int, int]], repeats: int, torn: int) -> None:
    """Any run of records, however often it repeats and wherever it is torn, is found whole, in order, and no more."""
    content, begins, others = b"", [], []
    for opcode, channel, extra in kinds * repeats:
        if opcode == 5:
            begins.append(len(content))
            body = channel.to_bytes(2, "little") + bytes(20 + extra)
        else:
            others.append((opcode, len(content) + 9))
            body = bytes(extra)
        content += bytes([opcode]) + len(body).to_bytes(8, "little") + body
    end = max(len(content) - torn, 0)
    ends = {begin: begin + 9 + int.from_bytes(content[begin + 1 : begin + 9], "little") for begin in begins}
    whole = [begin for begin in begins if ends[begin] <= end]
    found = scan(np.frombuffer(content, np.uint8), 0, end)
    assert found.messages.tolist() == whole
    assert [(r.opcode, r.begin) for r in found.others] == [o for o in others if o[1] <= found.end and o[1] <= end]


@given(st.lists(st.integers(0, 50), min_size=1, max_size=20))
def test_progressions_are_told_from_other_offsets(offsets: list[int]) -> None:
    """A slice stands for offsets only if it gives exactly them."""
    given_offsets = np.array(offsets, np.int64)
    result = progression(given_offsets)
    if isinstance(result, slice):
        np.testing.assert_array_equal(np.arange(51)[result], given_offsets)
    else:
        np.testing.assert_array_equal(result, given_offsets)
