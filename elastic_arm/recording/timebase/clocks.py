"""Decide what stamps mean: samples may have been taken at their stamps, or regularly with stamps
that are late.

If the stamps are true, assuming a regular clock shifts each sample by the jitter e of its stamp,
which changes a position by w e, where w is the velocity. The share b of this change that is present
in the positions is a regression coefficient: 1 if the stamps are true, 0 if the samples are
regular. It is estimated twice, each time with a standard deviation: from positions and velocities
together (change of position minus the integral of the velocity), and from the smoothness of the
positions alone.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from elastic_arm.arrays import Array
from elastic_arm.recording.sides import Samples

# Spans, in samples, over which positions are compared with integrals of velocities.
SPANS = (1, 4, 16, 64)
# Order of the differences that smooth motion does not have.
ROUGHNESS = 6
# A share is believed when its standard deviation is below this.
CERTAIN = 0.15
# Samples that are looked at.
ENOUGH = 20000
# Stamps that wander from a regular clock by more than so many samples, and so many times their own
# jitter, are no late stamps of regular samples.
WANDER = 2.0
WANDER_OVER_JITTER = 5.0
# Two stamps further apart than this, in sample intervals, have a sample missing between them; so
# many more where stamps are late by more than an interval, so that those of samples taken regularly
# wander when they are counted so.
MISSING = 1.6
MISSING_LATE = (3.0, 6.0, 12.0)
# Sample intervals without a sample, over which a recording is broken: as where standstill was left
# out.
HOLE = 1000
# Samples over which the mean interval is taken then: late stamps come in bunches.
BUNCH = 32
# Relative difference of two rates that no clock and no loss of single samples makes.
RATE_CHANGE = 0.2
# Instants at which the rate is looked at in the time that it lasts at least.
LASTING = 200
# Deviations of the stamps below this share of an interval change nothing.
NO_JITTER = 1e-3
# A velocity that equals the difference of the positions to this share is made from it, and no
# measurement.
DERIVED = 1e-3


@dataclass(frozen=True)
class Evidence:
    """The evidence for true stamps."""

    # Of the stamps' jitter that the motion shows: 1 where stamps are true, 0 where samples are
    # regular
    share: float
    std: float  # Its standard deviation
    words: str  # Where it comes from

    @property
    def stamps(self) -> bool:
        """Whether the stamps are true."""
        return self.share > 0.5


def evidence(samples: Samples, k: NDArray[np.int64], rate: float) -> Evidence | None:
    """Return the evidence of a recording about its clock; None if noise hides it."""
    jitter = jitter_of(samples.t, k)
    if wanders(jitter, rate):
        size = float(np.std(np.diff(jitter))) / np.sqrt(2.0)
        words = (
            f"they deviate by {1e3 * np.std(jitter):.2g} ms from a regular clock, with"
            f" jitter of {1e3 * size:.2g} ms"
        )
        return Evidence(1.0, 0.0, words)
    part = unbroken(k)
    k = k[part]
    jitter = jitter[part]
    found: list[Evidence] = []
    for position, velocity in ((samples.q, samples.dq), (samples.theta, samples.dtheta)):
        if position is not None:
            found.append(_by_smoothness(position[part], k, jitter, rate))
            if velocity is not None:
                found += _by_velocity(position[part], velocity[part], k, jitter, rate)
    best = min(found, key=lambda each: each.std, default=None)
    return best if best is not None and best.std < CERTAIN else None


def unbroken(k: NDArray[np.int64]) -> slice:
    """Return the longest run of samples without missing numbers.

    Only runs of sufficient length count.
    """
    edges = np.concatenate([[0], np.flatnonzero(np.diff(k) > HOLE) + 1, [len(k)]])
    first = int(np.argmax(np.diff(edges)))
    return slice(int(edges[first]), int(min(edges[first + 1], edges[first] + ENOUGH)))


def increments(steps: Array, missing: float = MISSING) -> NDArray[np.int64]:
    """Return the number of steps (N,) of a regular clock between samples."""
    points = np.ones(len(steps), np.int64)
    apart = np.flatnonzero(steps >= missing)
    points[apart] = np.rint(steps[apart])
    return points


def numbered(t: Array) -> tuple[NDArray[np.int64], float, float, Array]:
    """Return sample numbers (N,), rate, gap and jitter (N,) s on a regular clock.

    The gap is where a sample counts as missing.

    Stamps that are late by more than an interval look like missing samples. They are counted as
    such if they then keep to a regular clock, or if no other way of counting makes them do so; else
    in the way that keeps to it most closely.
    """
    steps = np.diff(t)
    interval = float(np.median(steps))
    near = steps < HOLE * interval
    if not near.all():  # a median that jitters does not count what a long hole lacks
        interval = float(steps[near].sum() / increments(steps[near] / interval).sum())
    found = []
    for missing in (MISSING, *MISSING_LATE):
        k = np.concatenate([[0], np.cumsum(increments(steps / interval, missing))])
        rate = float((k[-1] - k[0]) / (t[-1] - t[0]))
        jitter = jitter_of(t, k)
        if missing == MISSING:
            if not wanders(jitter, rate):
                return k, rate, missing, jitter
            interval = bunched(t)
        found.append((wanders(jitter, rate), float(np.std(jitter)), k, rate, missing, jitter))
    late = [each for each in found if not each[0]]
    return min(late or found[:1], key=lambda each: each[1])[2:]


def bunched(t: Array) -> float:
    """Return the mean interval, s, in most stretches of :data:`BUNCH` samples."""
    span = min(BUNCH, len(t) - 1)
    return float(np.median((t[span:] - t[:-span]) / span))


def rates_of(t: Array, lasting: float) -> list[tuple[int, float]]:
    """Return the first sample and the rate, Hz, of each stretch of one rate.

    Stretches last so many s or more.
    """
    each = np.diff(t[::BUNCH]) / BUNCH
    if not len(each):
        return []
    lasts = np.cumsum(np.where(each < HOLE / BUNCH * np.median(each), each, 0.0)) * BUNCH
    at = np.searchsorted(lasts[:-1], np.arange(0.0, lasts[-1], lasting / LASTING), side="right")
    usual = np.log(median_filter(each[at], 2 * LASTING - 1, mode="nearest"))
    found = [0]
    first = usual[0]
    for k in range(1, len(usual) - LASTING + 1):
        if abs(usual[k] - first) > np.log1p(RATE_CHANGE) and np.ptp(
            usual[k : k + LASTING]
        ) < np.log1p(RATE_CHANGE):
            found = [*found, k] if k >= LASTING else [0]
            first = usual[k]
    return [
        (int(at[a]) * BUNCH if a else 0, float(np.exp(-np.median(usual[a:b]))))
        for a, b in pairwise([*found, len(usual)])
    ]


def jitter_of(t: Array, k: NDArray[np.int64]) -> Array:
    """Return deviations (N,) s of stamps from a straight line over their numbers `k`."""
    line = k - k.mean()
    jitter: Array = t - t.mean()
    # In place: to clear new memory takes longer than the arithmetic.
    line *= line @ jitter / (line @ line)
    jitter -= line
    return jitter


def wanders(jitter: Array, rate: float) -> bool:
    """Return whether stamps deviate from a regular clock by much more than their jitter."""
    size = np.std(np.diff(jitter)) / np.sqrt(2.0)
    return bool(np.std(jitter) * rate > WANDER and np.std(jitter) > WANDER_OVER_JITTER * size)


def is_even(jitter: Array, rate: float) -> bool:
    """Return whether stamps are practically regular."""
    return bool(np.std(np.diff(jitter)) * rate < NO_JITTER)


def _by_velocity(
    position: Array, velocity: Array, k: NDArray[np.int64], jitter: Array, rate: float
) -> Iterator[Evidence]:
    """Yield the share for each span, by the change of position minus the integral of the
    velocity."""
    p = position
    v = velocity
    e = jitter
    step = np.diff(k)[:, None] / rate
    moved = np.diff(p, axis=0)
    for made in (v[1:], v[:-1]):
        if np.std(made * step - moved) < DERIVED * np.std(moved):
            return
    middle = 0.5 * (v[1:] + v[:-1])
    left = moved - middle * step
    expected = middle * np.diff(e)[:, None]
    for span in SPANS:
        count = len(left) // span
        if count < 50:
            return
        sums = [x[: count * span].reshape(count, span, -1).sum(axis=1) for x in (left, expected)]
        yield _share(sums[0], sums[1], "velocities are the derivatives of positions")


def _by_smoothness(position: Array, k: NDArray[np.int64], jitter: Array, rate: float) -> Evidence:
    """Return the share by the deviation of the positions from a smooth motion."""
    speed = np.gradient(position, k / rate, axis=0)
    # Of the wander only what the differences see counts; a speed averaged over some samples is less
    # noisy.
    width = 9
    smooth = np.apply_along_axis(
        lambda x: np.convolve(x, np.ones(width) / width, mode="same"), 0, speed
    )
    # Differences of neighbours are correlated: one of so many is independent. None reaches over a
    # missing sample.
    own = np.arange(0, len(k) - ROUGHNESS, ROUGHNESS + 1)
    own = own[k[own + ROUGHNESS] - k[own] == ROUGHNESS]
    if not len(own):
        return Evidence(0.0, np.inf, "")
    rough = np.diff(position, ROUGHNESS, axis=0)[own]
    expected = np.diff(smooth * jitter[:, None], ROUGHNESS, axis=0)[own]
    return _share(rough, expected, "the motion is smooth")


def _share(left: Array, expected: Array, words: str) -> Evidence:
    """Return the coefficient of `expected` in `left` over all joints, each weighted by its own
    noise."""
    left = left - left.mean(axis=0)
    expected = expected - expected.mean(axis=0)
    size = np.sum(expected**2, axis=0)
    own = np.sum(left * expected, axis=0) / np.where(size > 0, size, 1.0)
    variance = np.mean((left - own * expected) ** 2, axis=0) + 1e-12 * np.mean(left**2, axis=0)
    used = (size > 0) & (variance > 0)
    if not used.any():
        return Evidence(0.0, np.inf, words)
    information = size[used] / variance[used]
    return Evidence(
        float(own[used] @ information / information.sum()), float(information.sum() ** -0.5), words
    )
