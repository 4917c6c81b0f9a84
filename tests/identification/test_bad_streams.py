"""Streams with wrong stamps, gaps and pauses before there is much: the estimator takes up what
follows."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.resampling import Clock, joined, part
from elastic_arm.estimation.smoother import design_smoother
from elastic_arm.identification import Identifier, identifier_of
from elastic_arm.identification.stream import CAPACITY, IncomingRun
from elastic_arm.recording import Samples, read_recording
from elastic_arm.robot import load_robot

BATCH = 100
FAR = 1e6  # s ahead


@cache
def samples() -> Samples:
    return read_recording(Path(__file__).parents[2] / "bags" / "excitation").samples()


def at(begin: int, end: int, later: float = 0.0) -> Samples:
    """Return some of the samples, stamped later by so many seconds."""
    some = part(samples(), slice(begin, end))
    return replace(some, t=some.t + later)


def batches(begin: int, end: int, later: float = 0.0) -> list[Samples]:
    return [at(k, min(k + BATCH, end), later) for k in range(begin, end, BATCH)]


def fed(parts: list[Samples]) -> tuple[Identifier, list[str]]:
    """Return the estimator that got these samples, and what it complained of."""
    identifier = identifier_of(load_robot(None))
    complaints = []
    for each in parts:
        try:
            identifier.add(each)
        except IdentificationError as error:
            complaints.append(error.problem)
    identifier.finish()
    return identifier, complaints


@pytest.mark.parametrize("before", [1, 10, 5000])
@pytest.mark.parametrize("alone", [True, False])
def test_a_sample_stamped_in_the_future_does_not_end_the_stream(before: int, alone: bool) -> None:
    """Samples after one that is stamped 12 days ahead are used as those before: not refused until
    that day."""
    first = at(0, before)
    strange = at(before, before + 1, FAR)
    parts = [first, strange] if alone else [joined(first, strange)]
    identifier, complaints = fed([*parts, *batches(before + 1, len(samples()))])
    assert len(complaints) <= 1
    assert identifier.progress.samples > 0.9 * len(samples())
    assert identifier.progress.refused <= 1
    assert max(identifier.fit().noise[-3:]) < 0.2


@pytest.mark.parametrize("few", [1, 30])
def test_a_few_samples_of_a_moving_arm_before_a_gap_do_not_end_the_stream(few: int) -> None:
    """Neither rate nor smoother can be chosen by them: that is said once at most, and they are
    given up."""
    identifier, complaints = fed([at(3000, 3000 + few), *batches(0, len(samples()), 60.0)])
    assert len(complaints) <= 1
    assert identifier.progress.samples > 0.9 * len(samples())


def test_a_clock_set_back_begins_another_piece() -> None:
    """Samples of a clock that is set back by more than a second are used, however long a piece is
    held."""
    half = len(samples()) // 2
    identifier, complaints = fed([*batches(0, half), *batches(half, len(samples()), -1.5)])
    assert (complaints, identifier.progress.refused, identifier.progress.pieces) == ([], 0, 2)


@pytest.mark.parametrize("count", [20, 3000])
def test_a_pause_before_the_arm_moves_chooses_no_smoother(count: int) -> None:
    """An arm at rest shows no bandwidth: what is chosen after the pause is as without it."""
    still = part(samples(), np.zeros(count, dtype=np.intp))
    plain = identifier_of(load_robot(None))
    paused = identifier_of(load_robot(None))
    paused.add(replace(still, t=1e-3 * np.arange(count)))
    paused.pause()
    paused.resume()
    for identifier in (plain, paused):
        for each in batches(0, len(samples()), 5.0):
            identifier.add(each)
    assert paused.smoother is not None and plain.smoother is not None
    assert paused.smoother.cutoff == plain.smoother.cutoff
    np.testing.assert_allclose(paused.fit().std, plain.fit().std)


def test_stamps_that_hardly_advance_take_no_memory() -> None:
    """A nanosecond from sample to sample, the four seconds of motion never come: no more than so
    many are held."""
    run = IncomingRun()
    crawling = at(3000, 8000)
    for k in range(2 + CAPACITY // 5000):
        run.take(replace(crawling, t=k * 1e-5 + 1e-9 * np.arange(5000)))
        assert run.first_in_motion(wait=True) is None
    assert run.waiting == CAPACITY


@pytest.mark.parametrize("count", [12, 32])
def test_a_smoother_is_not_chosen_by_a_handful_of_samples(count: int) -> None:
    """The filter that estimates the noise has not settled by then: refused in words, without a
    number made up."""
    few = at(3000, 3000 + count)
    with pytest.raises(
        IdentificationError, match=f"{count} consecutive samples are not sufficient"
    ):
        design_smoother(Clock(1000.0).place(few), 3)
    with pytest.raises(IdentificationError, match="gaps after every few samples"):
        design_smoother([], 3)
