"""How far the gap shrinks: residuals before and after on motion that no fit has seen, with intervals over blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, f

from elastic_arm.diagnosis.bootstrap import block_weights, interval
from elastic_arm.diagnosis.settings import DiagnosisSettings, ResamplingSettings, SignificanceSettings
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.band import LowPass
from elastic_arm.estimation.whitening import BLOCK, WhitenedData

Array = NDArray[np.float64]


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

    def clarity(self, noise_guard: float) -> float:
        """Return the excess of the significant residuals over the uncertainty of their noise's square."""
        chosen = self.significant
        uncertainty = (noise_guard - 1.0 + np.sqrt(2.0 / self.freedom)) * np.sum(self.noise[chosen] ** 2)
        return float(self.excess[chosen].sum() / uncertainty) if chosen.any() else 0.0

    def of(self, significant: NDArray[np.bool_]) -> ResidualStatistics:
        """Return the same sizes with other residuals counted as significant."""
        return replace(self, significant=significant)


def residual_statistics(
    data: WhitenedData,
    values: Sequence[Array],
    band: float,
    settings: DiagnosisSettings,
    seed: int,
    tests: int = 1,
) -> ResidualStatistics:
    """Measure residuals below a frequency, and test which hold more than noise.

    A residual is significant if a chi-square test rejects noise alone, and block resampling does, too, or its power is
    far above the noise.

    Parameters
    ----------
    data
        Of the recording; gives the noise behind the low pass.
    values
        Residuals (N', R) of each stretch, Nm.
    band
        Upper edge, Hz.
    settings
        Thresholds of significance and number of resamples.
    seed
        Of the generator that draws the resamples.
    tests
        Number of bands in which significance is tested; with the number of residuals, it sharpens each test.
    """
    significance, rate = settings.significance, data.band.kept_rate
    low_pass = LowPass(band, rate)
    passed = [part for part in (low_pass.apply(v) for v in values) if len(part)]
    squares = [v**2 for v in passed]
    blocks = block_means(squares, max(1, round(BLOCK * rate)))
    together = np.concatenate(passed)
    mean = np.concatenate(squares).mean(axis=0)
    noise = data.noise_std(low_pass)
    freedom = max(2.0, 2.0 * band * len(together) / rate)
    level = significance.alpha / (tests * len(mean))
    ratio = mean / (significance.noise_guard * noise**2)
    beyond_chance = chi2.sf(freedom * ratio, freedom) < level
    breadth = data.noise_breadth(low_pass)
    if breadth is not None:
        # Slow noise has few independent samples, and its size comes from as many.
        slow = np.maximum(freedom * breadth, 1.0)
        beyond_chance &= f.sf(ratio, slow, slow) < level
    weights = block_weights(len(blocks), settings.resampling.draws, seed)
    obvious = mean > significance.obvious * noise**2
    resampled = (weights @ blocks <= noise**2).mean(axis=0) < significance.alpha
    significant = beyond_chance & (resampled | obvious)
    return ResidualStatistics(band, np.sqrt(mean), np.abs(together).max(axis=0), noise, freedom, blocks, significant)


def statistics_in_bands(
    data: WhitenedData, values: Sequence[Array], settings: DiagnosisSettings
) -> list[ResidualStatistics]:
    """Measure residuals in every band that is tried, widest first.

    Parameters
    ----------
    data
        Of the recording.
    values
        Residuals (N', R) of each stretch, Nm.
    settings
        The bands, thresholds of significance, and seeds.

    Raises
    ------
    DiagnosisError
        If the stretches are too short for every band.
    """
    rate, longest = data.band.kept_rate, max(len(v) for v in values)
    cutoffs = [data.band.cutoff * share for share in settings.significance.bands]
    usable = [c for c in cutoffs if 2 * LowPass(c, rate).margin < longest / 2]
    if not usable:
        raise DiagnosisError("too little motion is left to judge after filtering", "Record longer without gaps")
    tests = len(usable)
    seed = settings.resampling.significance_seed
    return [residual_statistics(data, values, c, settings, seed, tests) for c in usable]


def select_band(
    tried: Sequence[ResidualStatistics], settings: SignificanceSettings, causes: Sequence[NDArray[np.bool_]] = ()
) -> ResidualStatistics | None:
    """Return the widest band in which the excess stands clear of the noise's uncertainty, else the clearest.

    Parameters
    ----------
    tried
        Statistics in all bands, widest first.
    settings
        What counts as clear.
    causes
        (R,) each, the residuals in which each of several causes shows: the band must be clear for all of them.
    """

    def clarities(s: ResidualStatistics) -> list[float]:
        each = [s.of(s.significant & rows) for rows in causes] or [s]
        return [one.clarity(settings.noise_guard) for one in each]

    able = [s for s in tried if s.significant.any()]
    if not able:
        return None
    clear = (s for s in able if min(clarities(s)) > settings.clear)

    def strength(s: ResidualStatistics) -> tuple[int, float]:
        return sum(c > 1.0 for c in clarities(s)), s.clarity(settings.noise_guard)

    return next(clear, max(able, key=strength))


def band_of_largest_excess(tried: Sequence[ResidualStatistics], row: int) -> ResidualStatistics:
    """Return the band in which one residual stands highest over its noise, counted as significant there."""
    best = max(tried, key=lambda s: s.rmse[row] / s.noise[row])
    return best.of(np.arange(len(best.rmse)) == row)


def improved(before: ResidualStatistics, after: ResidualStatistics) -> NDArray[np.bool_]:
    """Which residuals (R,) hold an excess that the causes make smaller."""
    return (before.excess > 0.0) & (after.rmse < before.rmse)


def shrink(
    before: ResidualStatistics, after: ResidualStatistics, settings: ResamplingSettings, seed: int
) -> tuple[float, tuple[float, float]]:
    """Share of the excess that is gone, over the residuals significant before, and its interval over blocks.

    Parameters
    ----------
    before, after
        In the same band.
    settings
        Number of resamples, level of the interval.
    seed
        Of the generator that draws the resamples.
    """
    chosen = before.significant
    noise2 = before.noise[chosen] ** 2

    def share(weights: Array) -> Array:
        was, now = (np.maximum(weights @ s.blocks[:, chosen] - noise2, 0.0).sum(axis=1) for s in (before, after))
        return 1.0 - now / np.maximum(was, 1e-300)

    total = _gap(before, after)
    if not total:
        return 0.0, (0.0, 0.0)
    whole = 1.0 - after.excess[chosen].sum() / total
    low, high = interval(share(block_weights(len(before.blocks), settings.draws, seed)), settings.interval)
    return float(whole), (float(min(low, whole)), float(max(high, whole)))


def contribution(before: ResidualStatistics, without: ResidualStatistics, after: ResidualStatistics) -> float:
    """Return what one cause takes off the excess beside the others, as a share of the whole gap.

    Parameters
    ----------
    before, without, after
        Without any cause, without this one, and with all.
    """
    chosen = before.significant
    saved = (without.blocks - after.blocks)[:, chosen].sum(axis=1)
    total = _gap(before, after)
    return float(saved.mean() / total) if total else 0.0


def place_contribution(before: ResidualStatistics, without: ResidualStatistics, after: ResidualStatistics) -> float:
    """Return what one cause takes off the excess beside the others, as the largest share of a residual's own excess.

    Parameters
    ----------
    before, without, after
        Without any cause, without this one, and with all.
    """
    chosen = before.significant & (before.excess > 0.0)
    saved = (without.blocks - after.blocks)[:, chosen].mean(axis=0)
    return float(np.max(saved / before.excess[chosen], initial=0.0))


def _gap(before: ResidualStatistics, after: ResidualStatistics) -> float:
    """Return the excess before, Nm²; of a gap below what its noise is known to, at least what the causes took away."""
    chosen = before.significant
    fall = float(np.sum(before.rmse[chosen] ** 2 - after.rmse[chosen] ** 2))
    return max(float(before.excess[chosen].sum()), fall + float(after.excess[chosen].sum()))


def block_means(squares: Sequence[Array], length: int) -> Array:
    """Return means (blocks, k) of consecutive blocks of `length` rows of each part."""
    blocks: list[Array] = []
    for part in squares:
        count = max(1, len(part) // length)
        blocks.extend(np.mean(piece, axis=0) for piece in np.array_split(part, count))
    return np.array(blocks)
