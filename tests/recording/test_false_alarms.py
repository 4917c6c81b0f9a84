"""What is right is not warned of: reversals, standstill, torques of zero, seams; and what resembles
them is."""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.false_alarms import alarms
from elastic_arm.recording import Recording, load_channels, read_recording
from elastic_arm.recording.foreign.arrays import import_runs
from elastic_arm.recording.inspection.check import looked_through
from elastic_arm.recording.inspection.outliers import cleared
from elastic_arm.recording.inspection.report import Finding
from elastic_arm.recording.sides import Side
from tests.helpers.clean_recordings import clean_recordings
from tests.helpers.nightly import nightly
from tests.helpers.shared_data import DATA, needs_data

REPORTS = DATA / "public_reports_2"
RATE = 125.0
TIMES = np.arange(2500) / RATE
NAMES = ("a", "b")


def said(recording: Recording) -> list[Finding]:
    """Return what is worse than a note."""
    return [one for one in looked_through(recording) if one.severity != "note"]


def codes(recording: Recording) -> list[str]:
    """Return the codes of these."""
    return [one.code for one in said(recording)]


def motion(*channels: str, phase: float = 0.0) -> tuple[Side, Side]:
    """Return link and motor side of two joints with dry friction that turns over at once."""
    angle = np.outer(TIMES, [1.1, 0.7]) * 2.0 + phase
    noise = np.random.default_rng(3)
    q = np.sin(angle)
    dq = np.cos(angle) * np.array([2.2, 1.4])
    tau = 16.0 * np.sign(dq) + 3.0 * dq + 5.0 * np.cos(q) + 0.05 * noise.normal(size=q.shape)
    link = Side(
        TIME_NS, q + 2e-6 * noise.normal(size=q.shape), dq + 1e-3 * noise.normal(size=q.shape)
    )
    return link, Side(TIME_NS, effort=tau)


TIME_NS = np.round(1e9 * TIMES).astype(np.int64)


def episodes(folder: str, name: str) -> Sequence[Recording]:
    """Return the runs of a LeRobot folder of the reports."""
    return [*import_runs(REPORTS / folder / name, REPORTS / folder / "four.yaml").values()]


@pytest.mark.parametrize("count", [4, *nightly([16])])
def test_clean_recordings_are_not_warned_of(count: int) -> None:
    """Excitation, points, creeping, joint by joint and servos: `benchmarks.false_alarms` counts
    more of them."""
    wrong = {
        recording.source: found
        for robot, recording in clean_recordings(count, 1)
        if (found := alarms(robot, recording))
    }
    assert not wrong


@needs_data
def test_friction_that_turns_over_is_no_outlier() -> None:
    """A torque that steps as the joint turns round, over one sample or two; a spike of the same
    size is one."""
    assert not said(read_recording(REPORTS / "outlier_at_reversal" / "s_ok_1"))
    link, motor = motion()
    assert not said(Recording(NAMES, link, motor))
    effort = motor.effort.copy()
    row = int(np.argmax(np.abs(link.velocity[:200, 0])))
    effort[row, 0] -= 20.0
    (found,) = said(Recording(NAMES, link, replace(motor, effort=effort)))
    assert found.code == "outliers" and "1 sample of the motor effort of a" in found.message


@needs_data
def test_a_servo_that_stands_is_not_frozen() -> None:
    """It goes on from where it stood; one whose log froze comes again where it went meanwhile."""
    assert not [one for run in episodes("still_is_frozen", "le_steps") for one in said(run)]
    # To and fro between stands of a second, in steps of an encoder.
    u = np.clip((TIMES % 4.0) - 1.0, 0.0, 1.0) - np.clip((TIMES % 4.0) - 3.0, 0.0, 1.0)
    way = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    q = np.round(np.outer(way, [0.8, -0.5]) / 1.5e-3) * 1.5e-3
    assert not said(Recording(NAMES, Side(TIME_NS, q)))
    q = motion()[0].position.copy()
    q[500:520] = q[500]
    assert "frozen" in codes(Recording(NAMES, Side(TIME_NS, q)))


@needs_data
def test_a_torque_of_zero_at_rest_is_measured() -> None:
    """An axis without load has none while it stands; zeros while it moves were filled in."""
    assert not said(read_recording(REPORTS / "zero_at_rest" / "k_ptp"))
    link, motor = motion()
    assert link.position is not None and motor.effort is not None and link.velocity is not None
    # One way, with a stand in the middle: the torque is of one sign before and after.
    way = np.interp(TIMES, [0.0, 8.0, 12.0, 20.0], [0.0, 1.0, 1.0, 2.0])
    speed = np.gradient(way, TIMES)
    tau = np.round((4.0 * np.sign(np.round(speed, 9)) + 30.0 * speed) / 0.1) * 0.1
    one_way = Recording(
        NAMES,
        Side(TIME_NS, np.outer(way, [1.0, 1.5])),
        Side(TIME_NS, effort=np.outer(tau, [1.0, 1.0])),
    )
    assert "zeros_between" not in codes(one_way)
    tau[::50] = 0.0
    filled = replace(one_way, motor=Side(TIME_NS, effort=np.outer(tau, [1.0, 1.0])))
    assert "zeros_between" in codes(filled)


@pytest.mark.parametrize("unwound", ["neither", "positions", "commands"])
def test_commands_cross_a_seam_as_positions_do(unwound: str) -> None:
    """Whichever of the two is given within a turn, both end at the same turn."""
    t = TIMES[:, None]
    command = 2.5 + 1.5 * np.sin(2.0 * t + np.array([0.0, 1.0]))
    q = 2.5 + 1.5 * np.sin(2.0 * (t - 0.06) + np.array([0.0, 1.0]))
    within = [np.mod(one + np.pi, 2 * np.pi) - np.pi for one in (q, command)]
    position = q if unwound == "positions" else within[0]
    given = command if unwound == "commands" else within[1]
    recording = Recording(NAMES, Side(TIME_NS, position), reference=Side(TIME_NS, given))
    whole, _ = cleared(recording)
    assert np.abs(whole.reference.position - whole.link.position).max() < 0.5
    assert not said(recording)


def test_commands_whole_turns_away_throughout_are_at_the_turn_of_the_angle() -> None:
    """A goal from 0 to 2 pi beside positions from -pi to pi is a turn away and never jumps; a
    command that is far from its joint for a while is left alone."""
    q = -1.5 + 0.8 * np.sin(2.0 * TIMES[:, None] + np.array([0.0, 1.0]))
    command = q + 0.05 + np.array([2 * np.pi, 0.0])
    recording = Recording(NAMES, Side(TIME_NS, q), reference=Side(TIME_NS, command))
    whole, found = cleared(recording)
    assert [one.code for one in found] == ["wrapped"]
    np.testing.assert_allclose(whole.reference.position - whole.link.position, 0.05)
    for_a_while = q + np.where(TIMES[:, None] < 2.0, 2 * np.pi, 0.05)
    held = Recording(NAMES, Side(TIME_NS, q), reference=Side(TIME_NS, for_a_while))
    assert cleared(held)[0].reference.position[0, 0] != pytest.approx(q[0, 0], abs=0.1)


@needs_data
def test_commands_of_the_reports_cross_their_seam() -> None:
    """A servo whose angle and commands cross 4095/0 together followed them."""
    for run in episodes("commands_not_unwound", "le_seam"):
        whole, _ = cleared(run)
        assert not said(run) and np.abs(whole.reference.position - whole.link.position).max() < 1.0


@needs_data
def test_clocks_that_are_apart_are_joined() -> None:
    """37 s between commands and positions, and an hour between links and motors, are named and
    taken out."""
    folder = REPORTS / "command_clock_apart"
    whole, found = cleared(read_recording(folder / "j_off", load_channels(folder / "jtc.yaml")))
    assert [one.code for one in found] == ["clocks_apart"] and "37 s behind" in found[0].message
    assert abs(int(whole.reference.stamp_ns[0]) - int(whole.motor.stamp_ns[0])) < 10**9
    link, motor = motion()
    later = Side(TIME_NS + 3_600_000_000_000, link.position, effort=motor.effort)
    joined, found = cleared(Recording(NAMES, link, later))
    assert [one.code for one in found] == ["clocks_apart"] and "3600 s" in found[0].message
    np.testing.assert_array_equal(joined.link.stamp_ns, TIME_NS)
    np.testing.assert_array_equal(joined.motor.stamp_ns, TIME_NS)
    other = motion(phase=2.0)[0]
    strange = Side(
        other.stamp_ns + 10**12,
        np.random.default_rng(0).normal(size=other.position.shape).cumsum(axis=0),
    )
    assert "no motion" in cleared(Recording(NAMES, link, reference=strange))[1][0].message


@pytest.mark.parametrize("late", [0.06, -0.12])
def test_sides_that_are_apart_by_a_tenth_of_a_second_are_named(late: float) -> None:
    """Motor angles of the same joints that are ahead or behind by far more than a drive winds
    up."""
    link, motor = motion()
    shifted = Side(TIME_NS + round(1e9 * late), link.position, effort=motor.effort)
    found = [one for one in said(Recording(NAMES, link, shifted)) if one.code == "sides_apart"]
    assert len(found) == 1 and (" lag " in found[0].message) == (late > 0.0)
    sizes = [float(size) for size in re.findall(r"([\d.]+)(?= to| ms)", found[0].message)]
    assert sizes == pytest.approx([1e3 * abs(late)] * len(sizes), rel=0.05)


@pytest.mark.parametrize(
    ("shift", "words"), [(0, "themselves"), (1, "of 1 sample later"), (-2, "of 2 samples before")]
)
def test_commands_that_are_the_positions_are_no_commands(shift: int, words: str) -> None:
    """Made-up commands follow too well, whichever sample they are taken from, and beside torques,
    too."""
    link, motor = motion()
    made = Side(TIME_NS[5:-5], np.roll(link.position, -shift, axis=0)[5:-5])
    for side in (None, motor):
        (found,) = said(Recording(NAMES, link, side, reference=made))
        assert found.code == "copied_command" and words in found.message


@needs_data
def test_per_cent_of_a_range_is_no_angle() -> None:
    """Steps of one kind of encoder that differ from joint to joint show their ranges."""
    for run in episodes("percent_units", "le_percent"):
        (found,) = said(run)
        assert (
            found.code == "percent"
            and "shoulder_pan 220, shoulder_lift 200, elbow_flex 190" in found.message
        )
    tick = 360.0 / 4096
    way = np.sin(np.outer(TIMES, [1.0, 1.3]))
    for ranges, expected in (
        ((150.0, 270.0), ["percent"]),
        ((200.0, 200.0), []),
        ((200.0, 100.0), []),
    ):
        percent = np.round(way * 20.0 / tick) * tick * 200.0 / np.array(ranges)
        assert codes(Recording(NAMES, Side(TIME_NS, np.deg2rad(percent)))) == expected
