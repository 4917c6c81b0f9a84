"""Absurd but finite numbers: named by the check, left out with a note by identification and
diagnosis."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.cli.options import ClockChoice, read_by_clock
from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.errors import RecordingError
from elastic_arm.identification import IdentificationSettings, identify
from elastic_arm.recording import Recording, Side, read_recording, write_recording
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.inspection.outliers import find_outliers, without_outliers, without_zeros
from elastic_arm.robot import load_robot
from tests.helpers.bags import JOINT_STATE, joint_state, two_sided, write_foreign
from tests.helpers.nightly import nightly

ROOT = Path(__file__).parents[2]
ABSURD = [
    ("link", "position", 1e200),
    ("motor", "position", -1.7e308),
    ("motor", "effort", 1e6),
    ("link", "effort", 1.7e308),
]


@pytest.fixture(scope="module")
def recording() -> Recording:
    return read_recording(ROOT / "bags" / "excitation")


def spoiled(
    recording: Recording, side: str, channel: str, value: float, rows: object = 5000
) -> Recording:
    """Set samples of joint_2 to a value."""
    whole = getattr(recording, side)
    values = getattr(whole, channel).copy()
    values[rows, 1] = value
    return replace(recording, **{side: replace(whole, **{channel: values})})


def test_a_sound_recording_has_no_outliers(recording: Recording) -> None:
    """Motion, noise and friction stay as they are: the very same object comes back."""
    assert without_outliers(recording) is recording
    noise = two_sided(np.random.default_rng(1), 20_000)
    assert without_outliers(noise) is noise


@pytest.mark.parametrize(("side", "channel", "value"), ABSURD)
@pytest.mark.parametrize("rows", [5000, slice(5000, 5200), [0, 700, 9_000]])
def test_absurd_numbers_are_found_and_left_out(
    recording: Recording, side: str, channel: str, value: float, rows: object
) -> None:
    """One sample, a run of them, or some here and there: exactly these rows, with place and size in
    the note."""
    bad = spoiled(recording, side, channel, value, rows)
    (found,) = find_outliers(bad)
    assert found.rows.tolist() == np.atleast_1d(np.arange(len(bad.link))[rows]).tolist()  # type: ignore[index, arg-type]
    kept = without_outliers(bad)
    assert len(getattr(kept, side)) == len(getattr(bad, side)) - len(found.rows)
    assert f"{side} {channel} of joint_2" in kept.notes[-1]


@pytest.mark.parametrize("every", [60, 100, 200, 1000])
@pytest.mark.parametrize("value", [1e4, 1e5, -1e12])
def test_impulses_at_regular_intervals_are_outliers(
    recording: Recording, every: int, value: float
) -> None:
    """So many samples that they lie within the range of nearly all; their neighbours have nothing
    of them."""
    spoilt = spoiled(recording, "motor", "effort", value, slice(0, None, every))
    (found,) = find_outliers(spoilt)
    assert found.rows.tolist() == list(range(0, len(spoilt.motor), every))
    whole = without_outliers(spoilt)
    assert np.abs(whole.motor.effort).max() < 5e3


@pytest.mark.filterwarnings("error")
def test_a_joint_without_a_channel_has_no_outliers(recording: Recording) -> None:
    """Nor has a channel that is nowhere a number."""
    assert find_outliers(spoiled(recording, "motor", "effort", np.nan, slice(None))) == []
    motor = replace(recording.motor, effort=np.full_like(recording.motor.effort, np.nan))
    assert find_outliers(replace(recording, motor=motor)) == []


IMPOSSIBLE = {
    "angles": (
        "link",
        "position",
        lambda values: values + 1e12,
        "link position of all joints reaches 1e.12 rad",
    ),
    "torques": (
        "motor",
        "effort",
        lambda values: values * 1e150,
        "motor effort of all joints reaches .*e.15. Nm",
    ),
    "no torques": (
        "motor",
        "effort",
        lambda values: 0.0 * values + 5e-324,
        "motor effort is 4.94e-324 Nm at most",
    ),
    "speeds": (
        "motor",
        "velocity",
        lambda values: values - 1e9,
        "motor velocity of all joints reaches 1e.09 rad/s",
    ),
}


@pytest.mark.parametrize("what", IMPOSSIBLE)
@pytest.mark.filterwarnings("error")
def test_a_channel_that_is_of_no_arm_throughout_is_refused(
    tmp_path: Path, recording: Recording, what: str
) -> None:
    """By the check, and by all that computes with it."""
    name, channel, change, words = IMPOSSIBLE[what]
    side = getattr(recording, name)
    spoilt = replace(
        recording, **{name: replace(side, **{channel: change(side.channels()[channel])})}
    )
    with pytest.raises(RecordingError, match=words):
        without_outliers(spoilt)
    with pytest.raises(RecordingError, match=words):
        identify(spoilt, load_robot())
    with pytest.raises(RecordingError, match=words):
        diagnose([spoilt], Question(load_robot()))
    write_recording(tmp_path / "bag", spoilt)
    (finding,) = [one for one in check_bag(tmp_path / "bag").findings if one.severity == "error"]
    assert re.search(words, finding.message)


@pytest.mark.parametrize(
    ("side", "channel", "value"),
    [
        ("link", "velocity", 1e300),
        *nightly([("motor", "effort", 1e300), ("link", "velocity", -1.7e308)]),
        ("motor", "effort", -1.7e308),
    ],
)
@pytest.mark.filterwarnings("error")
def test_the_largest_numbers_are_looked_at_without_a_warning_of_the_library(
    tmp_path: Path, recording: Recording, side: str, channel: str, value: float
) -> None:
    """What reads a bag for a fit leaves them out before it squares anything."""
    write_recording(tmp_path / "bag", spoiled(recording, side, channel, value, slice(10, 20)))
    read_by_clock(tmp_path / "bag", None, load_robot(), ClockChoice.auto)
    check_bag(tmp_path / "bag", robot=load_robot())


def test_joints_that_rest_have_no_outliers_by_resolution() -> None:
    """A joint that stands still but for a step of its encoder keeps its samples."""
    recording = two_sided(np.random.default_rng(1), 5000)
    position = recording.link.position.copy()  # type: ignore[union-attr]
    position[:, 0] = 0.5
    position[2500, 0] += 1e-4
    still = replace(recording, link=replace(recording.link, position=position))
    assert not find_outliers(still)


def test_a_single_sample_within_the_range_of_others_is_said_to_be_off_its_neighbours() -> None:
    """It is no sample beyond the range of nearly all others, and nothing of the kind is said."""
    t = np.arange(4000) / 200.0
    torque = 50.0 * np.sin(np.outer(t, [1.0, 1.3])) + 0.3 * np.random.default_rng(
        2
    ).standard_normal((4000, 2))
    torque[2000, 1] = 20.0 if torque[2000, 1] < 0.0 else -20.0
    stamp_ns = np.rint(1e9 * t).astype(np.int64)
    (found,) = find_outliers(
        Recording(("a", "b"), motor=Side(stamp_ns, np.sin(np.outer(t, [1.0, 1.3])), effort=torque))
    )
    words = found.words()
    assert (
        f"1 sample of the motor effort of b up to {torque[2000, 1]:.3g}, with a deviation of up to"
        in words
        and "from the curve through its neighbours" in words
    )
    off = float(words.split("with a deviation of up to ")[1].split()[0])
    kept = float(words.split("within ")[1])
    assert off > 10.0
    assert kept < 3.0
    assert "others are between" not in words


@pytest.mark.parametrize("row", [3, 20_000, 39_996])
def test_single_samples_are_found_wherever_they_lie(row: int) -> None:
    """Those at the ends of the samples that are looked at together, too."""
    stamp_ns = 10**6 * np.arange(40_000)
    position = np.sin(np.outer(6e-9 * stamp_ns, [1.0, 1.3, 0.7]))
    position += 1e-6 * np.random.default_rng(1).standard_normal(position.shape)
    names = ("joint_1", "joint_2", "joint_3")
    assert not find_outliers(Recording(names, Side(stamp_ns, position)))
    position[row, 1] += 1e-3
    (found,) = find_outliers(Recording(names, Side(stamp_ns, position)))
    assert (found.channel, found.joint, found.rows.tolist()) == ("position", "joint_2", [row])


T = np.arange(0.0, 20.0, 0.01)
STAMPS = 10**18 + np.rint(1e9 * T).astype(np.int64)


def turning(noise: float = 2e-5, hold: int = 1) -> Recording:
    """Two joints with torques: one goes to and fro, the other on and on."""
    rng = np.random.default_rng(4)
    q = np.stack([np.sin(1.3 * T) + 0.5 * np.sin(3.1 * T), 2.0 * T + 0.3 * np.sin(2.0 * T)], axis=1)
    effort = (
        5.0 * np.sin(q)
        + 0.3 * np.sign(np.gradient(q, axis=0))
        + 0.02 * rng.standard_normal(q.shape)
    )
    q = (q + noise * rng.standard_normal(q.shape))[hold * (np.arange(len(q)) // hold)]
    return Recording(("a", "b"), motor=Side(STAMPS, q, effort=effort))


def moved(
    recording: Recording, change: Callable[[np.ndarray], np.ndarray], effort: bool = False
) -> Recording:
    """The recording with other positions, and torques of them."""
    motor = recording.motor
    position = change(motor.position.copy())
    torque = 5.0 * np.sin(position) if effort else motor.effort
    return replace(recording, motor=replace(motor, position=position, effort=torque))


def within(turn: float) -> Callable[[np.ndarray], np.ndarray]:
    """What gives angles within a turn about zero."""
    return lambda q: np.mod(q + 0.5 * turn, turn) - 0.5 * turn


@pytest.mark.parametrize("hold", [1, 3])
@pytest.mark.parametrize(
    ("turn", "noise"),
    [
        (2 * np.pi, 0.0),
        (2 * np.pi, 2e-5),
        (2 * np.pi, 3e-3),
        (0.4 * np.pi, 0.0),
        (0.4 * np.pi, 2e-5),
    ],
)
def test_angles_within_a_turn_are_unwound(turn: float, noise: float, hold: int) -> None:
    """A joint's own turn, or that of its motor over the gear ratio; with noise at its end, and held
    values; said."""
    given = turning(noise, hold)
    whole = without_outliers(given)
    assert (whole is given) == (hold == 1)
    found = without_outliers(moved(given, within(turn)))
    off = found.motor.position - whole.motor.position
    exact = 1e-9 if turn > 6.0 else 0.02
    np.testing.assert_allclose(off, np.broadcast_to(off[0], off.shape), rtol=0, atol=exact)
    assert any(f"b is given within a turn of {turn:.4g} rad" in note for note in found.notes)


@pytest.mark.parametrize("size", [0.2, 1.0, 5.5, -1.0])
def test_an_encoder_whose_zero_is_set_runs_on(size: float) -> None:
    """Sample, joint and size are named, and the jump taken out: torques and speeds are as
    before."""
    whole = turning()
    found = without_outliers(moved(whole, lambda q: q + size * np.outer(T > 9.995, [1.0, 0.0])))
    (note,) = found.notes
    assert (
        "motor position of a jumps in a physically impossible way, by" in note
        and "after sample 999, 9.990000 s" in note
    )
    assert float(note.split(", by ")[1].split()[0]) == pytest.approx(size, abs=5e-3)
    kept = np.isin(whole.motor.stamp_ns, found.motor.stamp_ns)
    np.testing.assert_allclose(found.motor.position, whole.motor.position[kept], rtol=0, atol=5e-3)  # type: ignore[index]


def test_joined_recordings_are_parted() -> None:
    """Where angles and torques jump nothing is bridged: a hole is left, and the angles stay as they
    are."""
    joined = moved(turning(), lambda q: np.vstack([q[:1200], q[400:1200]]), effort=True)
    found = without_outliers(joined)
    assert len(found.notes) == 2 and all(
        "concatenated recordings? The recording is split there" in note for note in found.notes
    )
    kept = np.isin(joined.motor.stamp_ns, found.motor.stamp_ns)
    assert 5 < np.count_nonzero(~kept) < 12 and not kept[1200:1206].any()
    assert without_outliers(found) is found
    np.testing.assert_array_equal(found.motor.position, joined.motor.position[kept])  # type: ignore[index]


def test_what_forces_do_is_no_jump() -> None:
    """An impact changes the speed at once, a held channel goes by steps, a joint starts and stops:
    nothing is said."""
    whole = turning()
    impact = moved(whole, lambda q: q + np.outer(np.maximum(T - 8.0, 0.0), [0.5, -0.6]))
    stop = moved(
        whole, lambda q: np.where((T > 5.0)[:, None] & (T < 9.0)[:, None], q[500], q) + 0.0 * q
    )
    for one in (whole, impact):
        assert without_outliers(one) is one
    for hold in (10, 50):
        assert not any("jumps" in note for note in without_outliers(turning(2e-5, hold)).notes)
    assert all("of a" in note or "of b" in note for note in without_outliers(stop).notes)


@pytest.mark.parametrize(("same_stamp", "pose"), [(False, 0.0), (True, 0.0), (False, 2.5)])
def test_a_second_publisher_of_one_pose_is_left_out(
    tmp_path: Path, same_stamp: bool, pose: float
) -> None:
    """Between the samples of the arm, or zeros at their stamps: the arm's alone are left, and that
    is said."""
    whole = turning()
    later = STAMPS + (0 if same_stamp else 2_000_000)
    values = {"position": whole.motor.position, "velocity": None, "effort": whole.motor.effort}
    messages = [
        ("/motor_states", JOINT_STATE, int(log), joint_state(int(stamp), ("a", "b"), q, [], tau))
        for row, t in enumerate(STAMPS)
        for log, stamp, q, tau in (
            (t, t, values["position"][row], values["effort"][row]),  # type: ignore[index]
            (t + 2_000_000, later[row], np.full(2, pose), np.zeros(2)),
        )
    ]
    bag = write_foreign(tmp_path / "bag", messages)
    found = without_outliers(read_recording(bag))
    np.testing.assert_array_equal(found.motor.stamp_ns, STAMPS)
    np.testing.assert_array_equal(found.motor.position, whole.motor.position)
    assert not check_bag(bag).ok


def test_a_pose_that_an_arm_comes_back_to_is_no_second_publisher() -> None:
    """It rests there again and again, as still as a simulation without noise is, or its encoder
    changes by a code."""
    phase = np.clip(np.abs(T % 2.0 - 1.0) * 3.0 - 1.0, 0.0, 1.0)
    still = moved(turning(), lambda q: 0.3 + np.outer(3 * phase**2 - 2 * phase**3, [0.5, -0.8]))
    still = replace(still, motor=replace(still.motor, effort=None))
    assert without_zeros(still, []) is still
    codes = np.full((6000, 2), 0.3)
    codes[5100::97] += 2e-4
    flickering = Recording(("a", "b"), motor=Side(1_000_000 * np.arange(6000), codes))
    assert without_zeros(flickering, []) is flickering


@pytest.mark.slow(3)
def test_identification_goes_on_without_them(recording: Recording) -> None:
    """The same parameters as without the sample, within a small part of their deviations, and a
    note."""
    sound = identify(recording, load_robot(), IdentificationSettings(consistent=False))
    spoilt = spoiled(recording, "motor", "effort", 1e6)
    found = identify(spoilt, load_robot(), IdentificationSettings(consistent=False))
    assert any("outliers" in note for note in found.notes)
    np.testing.assert_array_less(np.abs(found.Psi_base - sound.Psi_base), 0.5 * sound.std)
