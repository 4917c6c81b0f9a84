"""Events: stretches of a recording that contradict its rest, such as a contact or a payload that is
picked up.

The residual that effects and numbers leave, whitened by the noise of its sensors, is divided into
blocks of n values with sum of squares s. Ordinarily the power of a block varies, because of what
the model misses:

    p(s) = Gamma(n/2 + a) / Gamma(a) b^a / (b + s/2)^(n/2 + a)

    a, b most probable, b >= a (sensors' noise)

An event is a run of blocks with one larger power p: p(s) = integral of p^(-n/2) exp(-s/2p) dln p.
It begins and ends within a block, so its first and last blocks may have powers of their own. Its
prior odds account for the number of possible places and runs. Dynamic programming finds the most
probable runs. During an event, a free torque acts at the joint (:class:`.FreeTorques`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.fft import irfft, rfft
from scipy.special import gammainc, gammaln

from elastic_arm.arrays import Array, Indices, Mask
from elastic_arm.estimation.equation_sets import Place
from elastic_arm.estimation.whitening import EDGE, noise_at
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.priors import EVENT, LARGER
from elastic_arm.evidence.runs import Runs, most_probable_runs

BLOCK = 0.3  # s, length of a block; a contact lasts longer
SPREADS = np.geomspace(0.5, 1e4, 40)[:, None]  # values of a: from powers of any size to equal ones
NOISE = (1e4, 1e4)  # a, b for blocks with only the noise of the sensors
STEPS = 50  # iterations of b for each a, and of runs and b in turn; numerical


@dataclass(frozen=True)
class Event:
    """A stretch of a recording that contradicts its rest, at one joint and side."""

    recording: str
    joint: str
    side: str
    # begin, end: s from the first sample of the recording
    begin: float
    end: float
    rmse: float = field(compare=False)  # of the torque that acts there, Nm
    # whether all drives ignored their commands, for example because torque was switched off
    ignored: bool = False


class Blocks(NamedTuple):
    """Residuals (M blocks, R rows) of a recording."""

    begin: Array  # (M,) s
    end: Array
    # (M, R) numbers of independent values, less those that free torques take
    values: Array
    white: Array  # (M, R) sums of squares over the noise
    square: Array  # (M, R) mean squares, Nm²
    power: Array  # (M, R) of the noise at the pose, over that of the whole motion


def blocks_of(
    linear: Linearisation, left: Sequence[Array], recording: int, offset: float
) -> Iterator[Blocks]:
    """Yield the remaining residuals (N', R) of each stretch of a recording in blocks.

    Their times begin at `offset`, s.
    """
    data = linear.data
    observation = linear.observed[recording]
    for part, own, share in zip(data.parts, left, data.shares(), strict=True):
        if part.recording != recording:
            continue
        band = part.stretch.band
        f = np.fft.rfftfreq(len(own), 1 / band.kept_rate)
        inner = slice(EDGE, len(own) - EDGE)
        noise = np.real(np.einsum("frr->fr", part.noise.covariance)) / band.step
        gain = np.stack([np.interp(f, part.noise.f, one**-0.5) for one in noise.T], axis=1)
        white = irfft(rfft(own, axis=0) * gain * (f <= band.cutoff)[:, None], len(own), axis=0)[
            inner
        ]
        t = part.stretch.t[inner] + offset
        own = own[inner]
        edges = np.linspace(0, len(t), max(1, round((t[-1] - t[0]) / BLOCK)) + 1).astype(int)
        sums = [
            np.add.reduceat(one, edges[:-1], axis=0) for one in (share[inner], white**2, own**2)
        ]
        independent = sums[0] * 2.0 * band.cutoff / band.kept_rate
        begin = t[edges[:-1]]
        end = t[edges[1:] - 1]
        motion = part.stretch.quiet
        poses = motion.q[np.searchsorted(motion.t, 0.5 * (begin + end) - offset)]
        power = noise_at(poses, linear.model, observation, data.layout, part.noise, band.cutoff)
        squares = sums[2] / np.diff(edges)[:, None]
        yield Blocks(begin, end, independent, sums[1], squares, power)


def events_of(
    stretches: Sequence[Blocks],
    recording: str,
    places: Sequence[Place],
    live: Mask,
) -> list[Event]:
    """Return the most probable events in the stretches of a recording.

    places: joint and side of each row.
    """
    if not stretches:
        return []
    blocks = Blocks(*map(np.concatenate, zip(*stretches, strict=True)))
    found = []
    for row in np.flatnonzero(live).tolist():
        told = blocks.values[:, row] > 1.0
        begin = blocks.begin[told]
        end = blocks.end[told]
        n = blocks.values[told, row]
        white = blocks.white[told, row]
        square = blocks.square[told, row]
        power = blocks.power[told, row]
        for i, j in runs_at_poses(n, white, power, len(places)) if told.any() else ():
            rmse = float(np.sqrt(np.mean(square[i:j])))
            found.append(Event(recording, *places[row], float(begin[i]), float(end[j - 1]), rmse))
    return found


def runs_at_poses(n: Array, s: Array, power: Array, places: int) -> Runs:
    """Return the most probable events if the noise of blocks has these powers (M,), or one power:
    whichever is more probable.

        ln p(y) = ln p'(y / sqrt(power)) - sum of n/2 ln power

    The noise of accelerations depends on the pose, but it need not be what is left.
    """
    alike = runs_of(n, s, places)
    varying = runs_of(n, s / power, places)
    change = 0.5 * float(np.sum(n * np.log(power)))
    return varying.runs if varying.score - change > alike.score else alike.runs


class Found(NamedTuple):
    """Events, and ln p of the blocks with them."""

    runs: Runs
    score: float


def runs_of(n: Array, s: Array, places: int) -> Found:
    """Return the most probable events among blocks of n (M,) values with sums of squares s (M,).

    places: number of places at which events are sought.
    """
    price = float(np.log(places / EVENT) + np.log(len(n) * (len(n) + 1) / 2))
    best: Runs = []
    most, varying = _score(n, s, best, price)
    for a, b in (
        varying,
        NOISE,
    ):  # start from the variation of all powers, events included, and from noise only
        before = None
        for _ in range(STEPS):
            runs = _most_probable(n, s, a, b, price)
            score, (a, b) = _score(n, s, runs, price)
            if score > most:
                best = runs
                most = score
            if runs == before:
                break
            before = runs
    return Found(best, most)


def _score(n: Array, s: Array, runs: Runs, price: float) -> tuple[float, tuple[float, float]]:
    """Return ln p(s, runs), and the most probable a and b given the runs."""
    rest = np.ones(len(n), bool)
    for i, j in runs:
        rest[i:j] = False
    if not rest.any():
        return -np.inf, NOISE
    a = SPREADS
    h = n[rest] / 2
    x = s[rest] / 2
    b = a * np.median(x / h)
    for _ in range(STEPS):
        b = np.maximum(a, a * len(h) / np.sum((h + a) / (b + x), axis=1, keepdims=True))
    each = _ordinary(n[rest], s[rest], a, b).sum(axis=1)
    k = int(np.argmax(each))
    best = float(a[k, 0]), float(b[k, 0])
    power = best[1] / best[0]
    N, S = _sums(n, s)
    events = 0.0
    if runs:
        first, end = np.array(runs).T
        events = float(np.sum(_runs(_events(N, S, power), first, end) - price))
    return float(each[k]) + events, best


def _ordinary(n: Array, s: Array, a: Array | float, b: Array | float) -> Array:
    h = n / 2
    x = s / 2
    return gammaln(h + a) - gammaln(a) + a * np.log(b) - (h + a) * np.log(b + x)


def _event(n: Array, s: Array, least: float) -> Array:
    h = n / 2
    x = s / 2
    larger = np.log(np.maximum(gammainc(h, x / least), 1e-300))
    return gammaln(h) + larger - h * np.log(x) - np.log(np.log(LARGER))


def _sums(n: Array, s: Array) -> tuple[Array, Array]:
    """Return the cumulative sums (M + 1,) of the values and squares of the blocks."""
    N = np.concatenate([[0.0], np.cumsum(n)])
    S = np.concatenate([[0.0], np.cumsum(s)])
    return N, S


def _events(N: Array, S: Array, least: float) -> Array:
    """Return ln p (M + 1, M + 1) of one event, of one power, from block i to j - 1; 0 if empty.

    N, S: cumulative sums of :func:`_sums`.
    """
    first, end = np.triu_indices(len(N), 1)
    n = np.maximum(N[end] - N[first], 1.0)
    s = np.maximum(S[end] - S[first], 1e-300)
    found = np.zeros((len(N), len(N)))
    found[first, end] = _event(n, s, least)
    return found


def _runs(events: Array, first: Indices, end: Indices) -> Array:
    """Return ln p of the events from blocks `first` (k,) to the blocks before `end` (k,).

    An event begins and ends within a block, so its first and last blocks may have powers of their
    own.

    events: ln p of events with one power, from :func:`_events`.
    """
    after = first + 1
    before = np.maximum(end - 1, after)
    shapes = (
        events[first, end],
        events[first, after] + events[after, end],
        events[first, before] + events[before, end],
        events[first, after] + events[after, before] + events[before, end],
    )
    return np.asarray(np.max(shapes, axis=0)) - float(np.log(len(shapes)))


def _most_probable(n: Array, s: Array, a: float, b: float, price: float) -> Runs:
    """Return the most probable runs among blocks with these ordinary powers."""
    first, end = np.triu_indices(len(n) + 1, 1)
    to = np.full((len(n) + 1, len(n) + 1), -np.inf)
    to[first, end] = _runs(_events(*_sums(n, s), b / a), first, end) - price
    return most_probable_runs(_ordinary(n, s, a, b), lambda j: to[:j, j])
