"""How far the gap shrinks: residuals before and after on motion that no fit has seen, with intervals over blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.band import LowPass
from elastic_arm.estimation.whitening import BLOCK, WhitenedData, block_means

Array = NDArray[np.float64]

NARROWER = (
    1.0,
    0.25,
    1.0 / 16.0,
)  # shares of the band in which an excess is looked for: slow effects hide in wide ones
ALPHA = 1e-3
RESAMPLES = 4000
# The noise is estimated too, its square to a few per cent, and quantised encoders are not quite white.
NOISE_GUARD = 1.12
# Of the noise's power: so much is no chance, even if it comes from few blocks because the arm moves in few.
PLAIN = 2.0
CLEAR = 10.0  # clarity from which an excess is known to a tenth


@dataclass(frozen=True)
class ResidualStatistics:
    """Sizes of all residuals in one band.

    Parameters
    ----------
    band
        Upper edge, Hz.
    rmse, peak, noise
        (R,) Nm.
    freedom
        Number of independent samples.
    blocks
        (blocks, R) Nm², mean squares of blocks of the recording.
    significant
        (R,) which residuals hold more than noise.
    """

    band: float
    rmse: Array
    peak: Array
    noise: Array
    freedom: float
    blocks: Array
    significant: NDArray[np.bool_]

    @property
    def excess(self) -> Array:
        """What is more than noise (R,) Nm²."""
        return np.maximum(self.rmse**2 - self.noise**2, 0.0)

    @property
    def clarity(self) -> float:
        """Excess of the significant residuals over the uncertainty of their noise's square."""
        chosen = self.significant
        uncertainty = (NOISE_GUARD - 1.0 + np.sqrt(2.0 / self.freedom)) * np.sum(self.noise[chosen] ** 2)
        return float(self.excess[chosen].sum() / uncertainty) if chosen.any() else 0.0

    def of(self, significant: NDArray[np.bool_]) -> ResidualStatistics:
        """Return the same sizes with other residuals counted as significant."""
        return replace(self, significant=significant)


def figures(data: WhitenedData, values: Sequence[Array], band: float, tests: int = 1) -> ResidualStatistics:
    """Measure residuals (N', R) of all stretches below `band`.

    Parameters
    ----------
    tests
        Number of bands in which significance is asked for; with the number of residuals, it sharpens each test.
    """
    rate = data.band.kept_rate
    low_pass = LowPass(band, rate)
    passed = [part for part in (low_pass.apply(v) for v in values) if len(part)]
    squares = [v**2 for v in passed]
    blocks = block_means(squares, max(1, round(BLOCK * rate)))
    together = np.concatenate(passed)
    mean = np.concatenate(squares).mean(axis=0)
    noise = data.noise_std(low_pass)
    freedom = max(2.0, 2.0 * band * len(together) / rate)
    level = ALPHA / (tests * len(mean))
    beyond_chance = chi2.sf(freedom * mean / (NOISE_GUARD * noise**2), freedom) < level
    weights = _weights(len(blocks), np.random.default_rng(0))
    plain = mean > PLAIN * noise**2
    resampled = (weights @ blocks <= noise**2).mean(axis=0) < ALPHA
    return ResidualStatistics(
        band, np.sqrt(mean), np.abs(together).max(axis=0), noise, freedom, blocks, beyond_chance & (resampled | plain)
    )


def select_band(
    candidates: Sequence[ResidualStatistics], causes: Sequence[NDArray[np.bool_]] = ()
) -> ResidualStatistics | None:
    """Return the widest band in which the excess stands clear of the noise's uncertainty, else the clearest.

    Parameters
    ----------
    causes
        (R,) each, the residuals in which each of several causes shows: the band must be clear for all of them.
    """

    def of_each(f: ResidualStatistics) -> list[float]:
        return [f.of(f.significant & rows).clarity for rows in causes] or [f.clarity]

    able = [f for f in candidates if f.significant.any()]
    if not able:
        return None
    clear = (f for f in able if min(of_each(f)) > CLEAR)
    return next(clear, max(able, key=lambda f: (sum(c > 1.0 for c in of_each(f)), f.clarity)))


def band_of_largest_excess(candidates: Sequence[ResidualStatistics], row: int) -> ResidualStatistics:
    """Return the band in which one residual stands highest over its noise, counted as significant there."""
    best = max(candidates, key=lambda f: f.rmse[row] / f.noise[row])
    return best.of(np.arange(len(best.rmse)) == row)


def statistics_in_bands(data: WhitenedData, values: Sequence[Array]) -> list[ResidualStatistics]:
    """Measure residuals in every band that is tried, widest first."""
    rate, longest = data.band.kept_rate, max(len(v) for v in values)
    cutoffs = [data.band.cutoff * share for share in NARROWER]
    usable = [c for c in cutoffs if 2 * LowPass(c, rate).margin < longest / 2]
    if not usable:
        raise DiagnosisError("too little motion is left to judge after filtering", "Record longer without gaps")
    return [figures(data, values, c, len(usable)) for c in usable]


def improved(before: ResidualStatistics, after: ResidualStatistics) -> NDArray[np.bool_]:
    """Which residuals (R,) hold an excess that the causes make smaller."""
    return (before.excess > 0.0) & (after.rmse < before.rmse)


def shrink(before: ResidualStatistics, after: ResidualStatistics) -> tuple[float, tuple[float, float]]:
    """Share of the excess that is gone, over the residuals significant before, and its 95 % interval over blocks."""
    chosen = before.significant
    noise2 = before.noise[chosen] ** 2

    def share(weights: Array) -> Array:
        was, now = (np.maximum(weights @ f.blocks[:, chosen] - noise2, 0.0).sum(axis=1) for f in (before, after))
        return 1.0 - now / np.maximum(was, 1e-300)

    total = _gap(before, after)
    if not total:
        return 0.0, (0.0, 0.0)
    whole = 1.0 - after.excess[chosen].sum() / total
    sample = share(_weights(len(before.blocks), np.random.default_rng(1)))
    low, high = np.percentile(sample, [2.5, 97.5])
    return float(whole), (float(min(low, whole)), float(max(high, whole)))


def contribution(before: ResidualStatistics, without: ResidualStatistics, after: ResidualStatistics) -> float:
    """Return what one cause takes off the excess beside the others, as a share of the whole gap."""
    chosen = before.significant
    saved = (without.blocks - after.blocks)[:, chosen].sum(axis=1)
    total = _gap(before, after)
    return float(saved.mean() / total) if total else 0.0


def _gap(before: ResidualStatistics, after: ResidualStatistics) -> float:
    """Return the excess before, Nm²; of a gap below what its noise is known to, at least what the causes took away."""
    chosen = before.significant
    fall = float(np.sum(before.rmse[chosen] ** 2 - after.rmse[chosen] ** 2))
    return max(float(before.excess[chosen].sum()), fall + float(after.excess[chosen].sum()))


def lowest(sums: Array) -> float:
    """Return the lowest of 97.5 % of resamplings of whole blocks of the total of their sums (blocks,)."""
    return float(np.percentile(_weights(len(sums), np.random.default_rng(2)) @ sums, 2.5))


def remaining(data: WhitenedData, selected: Sequence[Candidate], beta: Array) -> list[Array]:
    """Return the residuals (N', R) of all stretches that candidates with these coefficients leave."""
    left = [y.copy() for y in data.y]
    k = 0
    for candidate in selected:
        count = candidate.columns.stop - candidate.columns.start
        coefficients = beta[k : k + count]
        for own, columns in zip(left, data.plain(candidate.feature, candidate.searched or ()), strict=True):
            own -= columns @ coefficients
        k += count
    return left


def _weights(blocks: int, rng: np.random.Generator) -> Array:
    """Rows (resamples, blocks) of weights of blocks drawn with replacement."""
    return rng.multinomial(blocks, np.full(blocks, 1.0 / blocks), RESAMPLES) / blocks
