"""Torques at an end of their range and recordings that freeze are found; peaks, rests and slow
channels are not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from elastic_arm.cli.options import ClockChoice, read_by_clock
from elastic_arm.recording import Recording, Side, write_recording
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.inspection.outliers import cleared
from elastic_arm.recording.inspection.report import Finding
from elastic_arm.recording.inspection.stuck_channels import at_updates, channel_findings, frozen
from tests.helpers.random_arms import random_arm

Array = NDArray[np.float64]
NAMES = ("joint_1", "joint_2", "joint_3")
COUNT = 6000
RATE = 200.0


def recording(noise: float = 0.3, step: float = 0.5, limit: float = np.inf) -> Recording:
    """Angles of sines beside motor torques of some steps, which the second joint's drive bounds."""
    t = np.arange(COUNT)[:, None] / RATE
    w = np.array([0.7, 1.1, 1.7])
    q = np.sin(w * t)
    dq = w * np.cos(w * t)
    torque = 60.0 * np.sin(w * t + 0.4) + noise * np.random.default_rng(0).standard_normal(q.shape)
    torque[:, 1] = np.clip(torque[:, 1], -limit, np.inf)
    torque = step * np.rint(torque / step) if step else torque
    stamp_ns = 10**18 + np.rint(1e9 * t[:, 0]).astype(np.int64)
    return Recording(NAMES, link=Side(stamp_ns, q, dq), motor=Side(stamp_ns, effort=torque))


def found(samples: Recording, code: str) -> list[Finding]:
    """Findings of one code, or of all that begin like it."""
    whole = at_updates(samples, slow := list[Finding]())
    return [
        finding for finding in [*slow, *channel_findings(whole)] if finding.code.startswith(code)
    ]


def held(samples: Recording, rows: slice, begin: int | None = None) -> Recording:
    """The recording with all channels in some rows as they were at the first, or at sample
    `begin`."""
    kept = np.arange(COUNT)
    kept[rows] = rows.start if begin is None else begin
    link, motor = (
        replace(side, **{name: values[kept] for name, values in side.channels().items()})
        for side in (samples.link, samples.motor)
        if side is not None
    )
    return replace(samples, link=link, motor=motor)


@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize("step", [0.0, 0.05, 0.5])
def test_a_torque_at_the_end_of_its_range_is_named_with_its_share(
    noise: float, step: float
) -> None:
    """Of the joint whose drive saturates, with the torque at which it does; peaks of the others are
    none."""
    assert found(recording(noise, step), "clipped") == []
    (finding,) = found(recording(noise, step, limit=50.0), "clipped")
    assert finding.code == "clipped"
    assert (
        "motor effort stays at one end of its range while the joint moves: joint_2 for 1"
        in finding.message
    )
    assert "% (-50): the drive" in finding.message and "joint_1" not in finding.message


@pytest.mark.parametrize("times", [2, 5, 20])
def test_channels_that_hold_every_value_are_not_at_the_end_of_their_range(times: int) -> None:
    """A torque that is updated every few samples has its peak as often as any other value."""
    slow = recording(step=0.0)
    effort = slow.motor.effort[times * (np.arange(COUNT) // times)]
    assert found(replace(slow, motor=replace(slow.motor, effort=effort)), "clipped") == []


def test_an_arm_at_rest_neither_freezes_nor_saturates() -> None:
    """Without noise all its channels repeat there, and its torque may be the largest of all."""
    resting = recording(noise=0.0, step=0.0)
    turning = int(np.argmin(np.abs(resting.link.velocity).max(axis=1)[:600]))
    still = held(resting, slice(2000, 3000), turning)
    velocity = still.link.velocity.copy()
    effort = np.array(still.motor.effort)
    velocity[2000:3000] = 0.0
    effort[2000:3000] = 80.0
    still = replace(
        still,
        link=replace(still.link, velocity=velocity),
        motor=replace(still.motor, effort=effort),
    )
    assert frozen(still) == channel_findings(still) == []


@pytest.mark.filterwarnings("error")
def test_a_recording_of_one_sample_throughout_holds_no_motion(tmp_path: Path) -> None:
    """Numbers that never change are said to be no motion, in words and without a warning of the
    numbers' own."""
    stamp_ns = np.arange(400, dtype=np.int64) * 5_000_000
    same = Side(stamp_ns, *(np.full((400, 2), value) for value in (0.3, 0.0, 1.0)))
    bag = write_recording(tmp_path / "bag", Recording(("joint_1", "joint_2"), same, same))
    report = check_bag(bag)
    assert not report.ok
    (words,) = [f.message for f in report.findings if f.code == "no_motion"]
    assert "contains no motion" in words and "excite" in words
    moved = np.array(same.position)
    moved[200:, 1] += 0.01
    one = write_recording(
        tmp_path / "one", Recording(("joint_1", "joint_2"), replace(same, position=moved), same)
    )
    assert not [f for f in check_bag(one).findings if f.code == "no_motion"]


def test_freezes_are_found_with_their_times() -> None:
    """Two stretches of 0.1 s, and the end; with velocities and without; single repeats and slow
    channels are none."""
    rows = (slice(1000, 1021), slice(3000, 3021), slice(COUNT - 100, COUNT))
    whole = recording()
    icy = recording()
    for stretch in rows:
        icy = held(icy, stretch)
    for frosty in (icy, replace(icy, link=replace(icy.link, velocity=None))):
        (finding,) = frozen(frosty)
        assert (finding.code, finding.time) == ("frozen", pytest.approx(5.0))
        assert (
            "3 times while the arm moves: 0.1 s from 5.00 s, 0.1 s from 15.00 s, 0.49 s from 29.5"
            in finding.message
        )
    later = replace(icy, motor=replace(icy.motor, stamp_ns=icy.motor.stamp_ns + 100_000))
    assert [finding.message.split(" are unchanged")[0] for finding in frozen(later)] == [
        "all channels of the link side"
    ]
    assert frozen(whole) == []
    for row in range(100, 5000, 100):
        whole = held(whole, slice(row, row + 2))
    assert frozen(whole) == []
    slow = np.repeat(np.arange(0, COUNT, 10), 10)
    assert (
        frozen(replace(whole, link=_taken(whole.link, slow), motor=_taken(whole.motor, slow))) == []
    )


def _taken(side: Side, rows: NDArray[np.int_]) -> Side:
    return replace(side, **{name: values[rows] for name, values in side.channels().items()})


def test_check_and_the_commands_that_fit_say_so(tmp_path: Path) -> None:
    """Findings of `bag check`, and notes of the recording that `identify` and `diagnose` read."""
    bag = write_recording(tmp_path / "bag", held(recording(limit=50.0), slice(1000, 1021)))
    said = {finding.code: finding.message for finding in check_bag(bag).findings}
    arm = random_arm(3, np.random.default_rng(0), elastic=False)
    named = [replace(joint, name=name) for joint, name in zip(arm.joints, NAMES, strict=True)]
    notes = read_by_clock(bag, None, arm.with_(joints=tuple(named)), ClockChoice.auto).notes
    assert {f"{bag}: {said[code]}." for code in ("clipped", "frozen")} <= set(notes)


STUCK = {
    "a link's encoder": (
        "link",
        "position",
        0.7,
        "link position is constant while the joint moves: joint_2 at 0.7",
    ),
    "a velocity": (
        "link",
        "velocity",
        0.0,
        "link velocity is constant while the joint moves: joint_2 at 0:",
    ),
    "a torque of zero": (
        "motor",
        "effort",
        0.0,
        "motor effort is constant while the joint moves: joint_2 at 0:",
    ),
    "the zero below": ("motor", "effort", -0.0, "joint_2 at 0:"),
    "the smallest number": ("motor", "effort", 5e-324, "joint_2 at 4.94e-324:"),
    "any torque": ("motor", "effort", 31.5, "joint_2 at 31.5:"),
}


def with_motor_encoders() -> Recording:
    """A recording whose drives have encoders, too."""
    made = recording()
    return replace(
        made, motor=replace(made.motor, position=made.link.position, velocity=made.link.velocity)
    )


@pytest.mark.parametrize("what", STUCK)
def test_a_channel_that_holds_one_number_while_its_joint_moves_is_named(
    what: str, tmp_path: Path
) -> None:
    """By the check, and as a note before anything is fitted; no channel of the recording as it
    was."""
    whole = with_motor_encoders()
    assert found(whole, "stuck") == []
    name, channel, value, words = STUCK[what]
    side: Side = getattr(whole, name)
    values = side.channels()[channel].copy()
    values[:, 1] = value
    spoilt = replace(whole, **{name: replace(side, **{channel: values})})
    write_recording(tmp_path / "bag", spoilt)
    assert any(words in finding.message for finding in check_bag(tmp_path / "bag").findings)
    read = read_by_clock(
        tmp_path / "bag", None, random_arm(3, np.random.default_rng(1)), ClockChoice.auto
    )
    assert any(words in note and "joint_1" not in note for note in read.notes), read.notes


def test_joints_at_rest_hold_their_numbers() -> None:
    """Neither a joint that rests beside others that move, nor its encoder's zero of the velocity,
    is suspicious."""
    whole = with_motor_encoders()
    for name in ("link", "motor"):
        side: Side = getattr(whole, name)
        position, velocity = (values.copy() for values in (side.position, side.velocity))
        position[:, 1] = 0.3
        velocity[:, 1] = 5e-3
        whole = replace(whole, **{name: replace(side, position=position, velocity=velocity)})
    torque = whole.motor.effort.copy()
    torque[:, 1] = 2.0
    assert found(replace(whole, motor=replace(whole.motor, effort=torque)), "stuck") == []


def test_impulses_are_no_saturation() -> None:
    """A torque that saturates leads to the end of its range; single samples do not."""
    made = recording()
    torque = made.motor.effort.copy()
    torque[::100, 1] = 1e5
    assert found(replace(made, motor=replace(made.motor, effort=torque)), "clipped") == []


def every(times: int, values: Array) -> Array:
    """Values that are updated every few samples."""
    return values[times * (np.arange(len(values)) // times)]


@pytest.mark.parametrize("step", [0.0, 0.05])
@pytest.mark.parametrize("times", [2, 3, 20])
@pytest.mark.parametrize(
    ("side", "channel"), [("link", "position"), ("link", "velocity"), ("motor", "effort")]
)
def test_a_channel_of_any_kind_that_is_held_is_named_with_its_period(
    side: str, channel: str, times: int, step: float
) -> None:
    """One rule for angles, speeds and torques, rounded or not; the other channels are not
    blamed."""
    whole = recording(step=step)
    assert found(whole, "held") == []
    own = getattr(whole, side)
    slow = replace(own, **{channel: every(times, own.channels()[channel])})
    (finding,) = found(replace(whole, **{side: slow}), "held")
    assert (
        f"{side} {channel} of all joints is held: it changes every {times} samples"
        in finding.message
    )
    assert f"{RATE / times:.3g} Hz in a recording of 200 Hz" in finding.message


def test_a_cycle_missed_now_and_then_is_named_with_its_share() -> None:
    """One torque in fifty repeats the one before."""
    whole = recording(step=0.0)
    effort = whole.motor.effort.copy()
    effort[50::50] = effort[49:-1:50]
    (finding,) = found(replace(whole, motor=replace(whole.motor, effort=effort)), "held")
    assert (
        "motor effort of all joints repeats the previous value in 1.99 to 2.09 % of the samples"
        in finding.message
    )


def test_velocities_of_a_coarse_encoder_are_zero_by_right() -> None:
    """Differences of rounded angles by stamps that jitter are zero wherever the encoder takes no
    step."""
    whole = recording()
    assert whole.link is not None and whole.link.position is not None
    jitter = np.random.default_rng(0).integers(-100_000, 100_000, COUNT)
    q = 0.004 * np.rint(whole.link.position / 0.004)
    link = Side(whole.link.stamp_ns + jitter, q)
    velocity = (
        np.diff(q, axis=0, prepend=q[:1]) / (1e-9 * np.diff(link.stamp_ns, prepend=0))[:, None]
    )
    assert np.mean(velocity == 0.0) > 0.2
    assert found(replace(whole, link=replace(link, velocity=velocity)), "zeros") == []


def test_zeros_between_the_values_of_a_channel_are_named() -> None:
    """A velocity that is zero two samples of three is no velocity that is held; one that passes
    zero has none."""
    whole = recording()
    assert found(whole, "zeros") == []
    velocity = whole.link.velocity * (np.arange(COUNT) % 3 == 0)[:, None]
    (finding,) = found(replace(whole, link=replace(whole.link, velocity=velocity)), "zeros")
    assert "link velocity is zero between nonzero values: joint_1 in 6" in finding.message


def test_rounded_noise_is_not_held() -> None:
    """A converter of few bits repeats a torque as often as it changes it by one step."""
    rng = np.random.default_rng(3)
    for noise in (0.3, 1.0, 3.0, 8.0):
        whole = recording(noise=0.0, step=0.0)
        effort = np.rint(whole.motor.effort + noise * rng.standard_normal(whole.motor.effort.shape))
        assert found(replace(whole, motor=replace(whole.motor, effort=effort)), "held") == []


def test_measured_values_between_zeros_are_no_outliers() -> None:
    """A velocity that is zero in two of three samples is named as that, and nothing of it is left
    out."""
    t = np.arange(3000) / 250.0
    q = np.sin(2.0 * t)[:, None]
    dq = 2.0 * np.cos(2.0 * t)[:, None]
    dq[np.arange(len(t)) % 3 != 0] = 0.0
    given = Recording(("j",), motor=Side(np.rint(1e9 * t).astype(np.int64), q, dq, 3.0 * q))
    whole, found = cleared(given)
    assert whole.motor is not None and len(whole.motor) == len(t) and not found
    assert [f.code for f in channel_findings(whole) if "velocity" in f.message] == ["zeros_between"]
