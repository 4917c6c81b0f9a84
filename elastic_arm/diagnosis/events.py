"""Events inside a recording: stretches of it that its rest contradicts, as a contact, or a payload that is picked up.

What effects and numbers leave of a residual, whitened by its sensors' noise, is cut into blocks of n values with
squares s. Its power ordinarily varies from block to block, as what a model misses does, and grows with the speed w,

    p(s) = Gamma(n/2 + a) / Gamma(a) b^a / (b + s/2)^(n/2 + a)        b = c w^g

with a, c and g most probable; where that is less than the sensors' noise, a block has the noise alone.

An event is a run of blocks of one power p, any that is larger: p(s) = integral of p^(-n/2) exp(-s/2p) dln p, as of a
contact; or of powers that vary from the ordinary one upwards, a any, as of a drive that saturates at each peak for a
while. It pays the odds that there is one, at one of so many places, and of so many runs. The most probable runs follow
by dynamic programming; a torque that no law states acts during them (:class:`.FreeTorques`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, rfft
from scipy.special import gammainc, gammaln, logsumexp

from elastic_arm.arrays import Array
from elastic_arm.estimation.whitening import EDGE, WhitenedData
from elastic_arm.evidence.priors import EVENT, LARGER
from elastic_arm.recording.standstill import STANDS

BLOCK = 0.3  # s: a contact lasts longer
SPREADS = np.geomspace(0.5, 1e4, 40)[:, None]  # a that are tried: from powers of any size to equal ones
VARYING = np.array([0.25, 0.5, 1.0, 2.0])[:, None]  # a of an event's powers, each as likely: over some powers of ten
GROWTHS = np.array([0.0, 1.0, 2.0, 4.0])  # g that are tried: errors of friction, of speeds, of accelerations
NOISE = 1e4  # a and b of blocks of the sensors' noise alone
STEPS = 50  # of b for each, and of runs and b in turns; numerical

Runs = list[tuple[int, int]]  # first block, and the one after the last


@dataclass(frozen=True)
class Event:
    """A stretch of a recording that its rest contradicts, at one joint and side."""

    recording: str
    joint: str
    side: str
    # begin, end: s from the recording's first sample
    begin: float
    end: float
    rmse: float = field(compare=False)  # of what acts there, Nm


class Blocks(NamedTuple):
    """Residuals (M blocks, R rows) of a recording."""

    begin: Array  # (M,) s
    end: Array
    values: Array  # (M, R) how many are independent, less those that went with torques that no law states
    speed: Array  # (M, n) mean squares of the joints' speeds
    white: Array  # (M, R) sums of their squares over the noise
    square: Array  # (M, R) mean squares, Nm²


def blocks_of(data: WhitenedData, left: Sequence[Array], recording: int, offset: float) -> Iterator[Blocks]:
    """Yield what is left (N', R) of each stretch of a recording in blocks, by times that begin at `offset` s."""
    for part, own, share in zip(data.parts, left, data.shares(), strict=True):
        if part.recording != recording:
            continue
        f, inner = np.fft.rfftfreq(len(own), 1 / data.band.kept_rate), slice(EDGE, len(own) - EDGE)
        noise = np.real(np.einsum("frr->fr", part.noise.covariance)) / data.band.step
        gain = np.stack([np.interp(f, part.noise.f, one**-0.5) for one in noise.T], axis=1)
        white = irfft(rfft(own, axis=0) * gain * (f <= data.band.cutoff)[:, None], len(own), axis=0)[inner]
        t, own = part.stretch.t[inner] + offset, own[inner]
        edges = np.linspace(0, len(t), max(1, round((t[-1] - t[0]) / BLOCK)) + 1).astype(int)
        n = np.diff(edges)[:, None]
        dx = data.band.apply(part.signals.values["dx"][:, : data.layout.n])[part.stretch.kept][inner]
        sums = [np.add.reduceat(one, edges[:-1], axis=0) for one in (share[inner], white**2, own**2, dx**2)]
        independent = sums[0] * 2.0 * data.band.cutoff / data.band.kept_rate
        yield Blocks(t[edges[:-1]], t[edges[1:] - 1], independent, sums[3] / n, sums[1], sums[2] / n)


def events_of(
    stretches: Sequence[Blocks], recording: str, places: Sequence[tuple[str, str]], live: NDArray[np.bool_]
) -> list[Event]:
    """Return the most probable events in the stretches of a recording, by joint and side of each row."""
    if not stretches:
        return []
    blocks, found = Blocks(*map(np.concatenate, zip(*stretches, strict=True))), []
    speed = np.sqrt(np.mean(blocks.speed / (blocks.speed.mean(axis=0) + STANDS**2), axis=1))
    for row in np.flatnonzero(live).tolist():
        told = blocks.values[:, row] > 1.0
        begin, end, w = blocks.begin[told], blocks.end[told], speed[told]
        n, white, square = (one[told, row] for one in (blocks.values, blocks.white, blocks.square))
        for i, j in runs_of(n, white, w, len(places)) if told.any() else ():
            rmse = float(np.sqrt(np.mean(square[i:j])))
            found.append(Event(recording, *places[row], float(begin[i]), float(end[j - 1]), rmse))
    return found


def runs_of(n: Array, s: Array, w: Array, places: int) -> Runs:
    """Return the most probable events among blocks of n values with squares s and speeds w, (M,), at so many places."""
    price = float(np.log(places / EVENT) + np.log(len(n) * (len(n) + 1) / 2))
    best: Runs = []
    most, varying = _score(n, s, w, best, price)
    noise = np.full(len(n), NOISE)
    for a, b in (varying, (noise, noise)):  # powers as they vary with all events among them, and noise alone
        before = None
        for _ in range(STEPS):
            runs = _most_probable(n, s, a, b, price)
            score, (a, b) = _score(n, s, w, runs, price)
            if score > most:
                best, most = runs, score
            if runs == before:
                break
            before = runs
    return best


def _score(n: Array, s: Array, w: Array, runs: Runs, price: float) -> tuple[float, tuple[Array, Array]]:
    """Return ln p(s, runs), and a and b (M,) most probable beside them."""
    rest = np.ones(len(n), bool)
    for i, j in runs:
        rest[i:j] = False
    if not rest.any():
        return -np.inf, (np.full(len(n), NOISE),) * 2
    a, g = np.repeat(SPREADS, len(GROWTHS), axis=0), np.tile(GROWTHS, len(SPREADS))[:, None]
    grown = np.maximum(w, STANDS) ** g
    own, h, x = grown[:, rest], n[rest] / 2, s[rest] / 2
    c = a * np.median(x / h)
    for _ in range(STEPS):
        c = a * len(h) / np.sum((h + a) * own / (c * own + x), axis=1, keepdims=True)
    each = _ordinary(n[rest], s[rest], *_noisy(a, c * own)).sum(axis=1)
    m = int(np.argmax(each))
    found = _noisy(a[m], c[m] * grown[m])
    up_to = _events(n, s, found[1] / found[0])
    return float(each[m]) + sum(float(up_to(j)[i]) - price for i, j in runs), found


def _noisy(a: Array, b: Array) -> tuple[Array, Array]:
    """Return a and b of each block, of the sensors' noise alone where that is more."""
    return np.where(b > a, a, NOISE), np.where(b > a, b, NOISE)


def _ordinary(n: Array, s: Array, a: Array, b: Array) -> Array:
    h, x = n / 2, s / 2
    return np.asarray(gammaln(h + a) - gammaln(a) + a * np.log(b) - (h + a) * np.log(b + x))


def _events(n: Array, s: Array, least: Array) -> Callable[[int], Array]:
    """Return what gives ln p (j,) of events from each block to before block j, larger than ordinary powers (M,)."""
    N, S, L = (np.concatenate([[0.0], np.cumsum(v)]) for v in (n, s, least))
    varying = np.pad(np.cumsum(_ordinary(n, s, VARYING, VARYING * least), axis=1), ((0, 0), (1, 0)))

    def up_to(j: int) -> Array:
        h, x, ordinary = (N[j] - N[:j]) / 2, (S[j] - S[:j]) / 2, (L[j] - L[:j]) / np.arange(j, 0, -1)
        larger = np.log(np.maximum(gammainc(h, x / ordinary), 1e-300))
        one = gammaln(h) + larger - h * np.log(x) - np.log(np.log(LARGER))
        several = logsumexp(varying[:, j, None] - varying[:, :j], axis=0) - np.log(len(VARYING))
        return np.asarray(np.logaddexp(one, several) - np.log(2.0))

    return up_to


def _most_probable(n: Array, s: Array, a: Array, b: Array, price: float) -> Runs:
    """Return the most probable runs beside blocks of these ordinary powers."""
    rest, up_to = _ordinary(n, s, a, b), _events(n, s, b / a)
    best, came = np.zeros(len(n) + 1), np.zeros(len(n) + 1, int)
    for j in range(1, len(n) + 1):
        runs = best[:j] + up_to(j) - price
        i = int(np.argmax(runs))
        ordinary = best[j - 1] + rest[j - 1]
        best[j], came[j] = (runs[i], i) if runs[i] > ordinary else (ordinary, -1)
    found: Runs = []
    j = len(n)
    while j:
        if came[j] >= 0:
            found.append((int(came[j]), j))
        j = int(came[j]) if came[j] >= 0 else j - 1
    return found[::-1]
