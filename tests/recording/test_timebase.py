"""Both sides on one time base."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from elastic_arm.recording import Recording, Side
from elastic_arm.recording.sides import ClockMode
from elastic_arm.recording.timebase.clocks import rates_of
from elastic_arm.recording.timebase.joining import pair
from tests.helpers.bags import JOINTS, START_NS, side, stamps, two_sided


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
    link = side(rng, stamps(1000))
    motor = side(rng, stamps(1000))
    samples = Recording(
        JOINTS, link.at(np.arange(1000) != 40), motor.at(np.arange(1000) != 70)
    ).samples()
    keep = np.delete(np.arange(1000), [40, 70])
    np.testing.assert_array_equal(samples.q, link.position[keep])
    np.testing.assert_array_equal(samples.tau_m, motor.effort[keep])
    assert "2 samples" in samples.notes[0]


def test_stamps_apart_are_interpolated_to_the_link_side() -> None:
    """Half a sample apart, a 5 Hz motion at 1 kHz is met to the cubic spline's error, and the
    result says so."""
    link = wave(stamps(2000))
    motor = wave(stamps(2000) + 500_000)
    samples = Recording(JOINTS, link, motor).samples()
    expected = wave(samples.stamp_ns)
    # (w h)^4 / 384 of the spline's error bound, h = 1 ms, w = 2 pi 10 Hz of the effort
    bound = 5 * (2 * np.pi * 10 * 1e-3) ** 4 / 384
    inner = slice(10, -10)  # the ends of the spline are worse
    for got, want in ((samples.theta, expected.position), (samples.tau_m, expected.effort)):
        assert np.abs(got - want)[inner].max() < bound
    assert "interpolated" in samples.notes[0]
    assert len(samples) == 1999  # the first link sample lies before the motor's first


@pytest.mark.parametrize(
    ("clock", "true"), [(None, False), (None, True), ("regular", False), ("stamps", True)]
)
def test_each_side_has_its_own_jitter(
    rng: np.random.Generator, clock: ClockMode | None, true: bool
) -> None:
    """Two drivers stamp apart: the jitter of stamps moves no sample that was taken regularly, and
    those that it does.

    By the stamps alone positions of regular samples would be off by 4e-3, the jitter of both times
    their velocity; the mean of 4000 stamps is known to a sixtieth of that.
    """
    jitter = rng.normal(0.0, 3e-5, (2, 4000))
    late = [stamps(4000) + np.round(1e9 * own).astype(np.int64) for own in jitter]
    link, motor = (replace(wave(at if true else stamps(4000)), stamp_ns=at) for at in late)
    samples = Recording(JOINTS, link, motor, clock=clock).samples()
    expected = wave(
        samples.stamp_ns if true else stamps(4000)[np.searchsorted(late[0], samples.stamp_ns)]
    )
    inner = slice(10, -10)
    np.testing.assert_allclose(samples.theta[inner], expected.position[inner], rtol=0, atol=1.5e-4)
    np.testing.assert_allclose(samples.tau_m[inner], expected.effort[inner], rtol=0, atol=3e-4)


def test_a_side_without_positions_goes_by_the_clock_of_the_other(rng: np.random.Generator) -> None:
    """Torques alone do not tell what their stamps mean."""
    late = [stamps(4000) + np.round(rng.normal(0.0, 3e4, 4000)).astype(np.int64) for _ in range(2)]
    link, motor = (replace(wave(stamps(4000)), stamp_ns=at) for at in late)
    _, torques = pair(
        link, Side(motor.stamp_ns, effort=motor.effort), "the torques", "the link side", []
    )
    inner = slice(10, -10)
    given = link.effort[np.searchsorted(late[0], torques.stamp_ns)]
    np.testing.assert_allclose(torques.effort[inner], given[inner], rtol=0, atol=3e-4)


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


@pytest.mark.parametrize(
    ("parts", "rates", "begins"),
    [
        ([(10, 1000), (10, 500)], [1000, 500], [0, 10]),
        ([(4, 1000), (3, 250), (10, 1000)], [1000, 250, 1000], [0, 4, 7]),
        ([(1, 1000), (20, 500)], [500], [0]),
        ([(20, 1000), (1, 500)], [1000], [0]),
    ],
)
def test_rates_that_last_are_told_apart(
    rng: np.random.Generator, parts: list[tuple[int, int]], rates: list[int], begins: list[int]
) -> None:
    """Stretches of 2.5 s and more, with jittered stamps and a hole; shorter ones count to their
    neighbours."""
    t = np.cumsum(np.concatenate([np.full(seconds * rate, 1 / rate) for seconds, rate in parts]))
    t += rng.uniform(0.0, 2e-4, len(t))
    holed = t + 30.0 * (t > 2.0)
    for stamped in (t, holed):
        found = rates_of(stamped, 2.5)
        assert [rate for _, rate in found] == pytest.approx(rates, rel=0.02)
        np.testing.assert_allclose([t[k] for k, _ in found], begins, atol=0.15)


def test_neither_bunches_nor_lost_samples_nor_jitter_are_another_rate(
    rng: np.random.Generator,
) -> None:
    """One rate is told of samples that arrive in bunches of 20, of which a third is lost, or late
    by 2 ms."""
    t = np.arange(1, 20_000) * 1e-3
    bunched = np.ceil(t / 0.02) * 0.02 + np.arange(len(t)) * 1e-9
    short = np.arange(500) * 10_000_000 * 1e-9  # its bunches end where it ends
    for stamped in (
        short,
        bunched,
        t[rng.random(len(t)) < 0.67],
        np.sort(t + rng.normal(0.0, 2e-3, len(t))),
    ):
        assert len(rates_of(stamped, 2.5)) == 1
