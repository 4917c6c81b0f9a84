"""The colour of the torque sensors' noise, from what no motion explains in the recordings.

White noise is what a recording shows above the motion's frequencies. Within the band it is tested: what is left of the
residuals beside all candidates and all shapes of :mod:`.lack_of_fit` can be no effect of the motion. Where that
is not white, and where a smooth spectrum describes it, the sensors' noise has that colour. Where no smooth spectrum
does, or where it is a good part of the torques, something of the arm is in it that no column resembles, and the noise
is left white.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.linalg import solve_triangular

from elastic_arm.codegen.parallel import share_out
from elastic_arm.diagnosis.inference.lack_of_fit import placed, shapes_of
from elastic_arm.diagnosis.laws.general_laws import changing_friction
from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.selection.gram_fits import independent_columns
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis
from elastic_arm.diagnosis.selection.plausible_size import typical_torques
from elastic_arm.diagnosis.settings import ColourSettings
from elastic_arm.estimation.convolution import Harmonics
from elastic_arm.estimation.noise_colour import Colour, ColourFit, Periodogram, covariances, fit_colour, lacks, pooled

Array = NDArray[np.float64]
Real = NDArray[np.floating]
Complex = NDArray[np.complexfloating]

RANK = 1e-6  # relative eigenvalue below which a combination of columns is not determined; numerical
NOTHING = 1e-9  # of a column's size, if it holds nothing but a mean; numerical
CHUNK = 64  # columns transformed, and frequencies whitened, at once: bounds the memory
AT_ONCE = 4  # products of all columns that are made before they are summed: bounds the memory
LONG = 4000  # coordinates of a stretch up to which the spectra of single harmonics are kept; bounds the memory
SLOW = 5.0  # Hz, below which every frequency of a recording counts
FREQUENCIES = 500  # above it: enough to know a smooth spectrum to some per cent
LEAST_SHARE = 0.05  # of the noise at a frequency that is left beside all columns; numerical
# Regimes that are no function of the motion: a zero that drifts is noise of the sensor.
NO_MOTION = ("always", "drift")


@dataclass(frozen=True)
class NoiseColours:
    """The colour of the torque sensors' noise, and where it does not describe what no motion explains.

    Parameters
    ----------
    of_sets
        On identification and validation data.
    unlike
        By row of the residuals how many times the power of this noise is there, where that is too much for noise.
    """

    of_sets: tuple[Colour, Colour]
    unlike: Mapping[int, float]


def noise_colours(prepared: PreparedData, hypothesis: Hypothesis) -> NoiseColours | None:
    """Return the colour of the torque sensors' noise on identification and validation data.

    It may differ between them: the error of a coarse sensor depends on how fast the torque changes. None where the
    noise is white, or where its colour is not known.

    Parameters
    ----------
    prepared
        Data and regressors, whitened as if the noise were white.
    hypothesis
        The best hypothesis of the search.
    """
    library, settings = prepared.library, prepared.settings.colour
    beta = library.fit(0, hypothesis.selected)
    spectra = share_out(
        lambda which: _spectra(prepared, which, [library.remainder(which, hypothesis.selected, beta)[:, None]]), (0, 1)
    )
    left = [[Periodogram(s.f, s.values[:, :, 0], np.ones(s.values.shape[:2]), s.ways) for s in own] for own in spectra]
    fits = share_out(fit_colour, left)
    projected = []
    # The worst first: where no smooth spectrum describes that, the other one changes nothing.
    for which in sorted((0, 1), key=lambda k: -fits[k].lack):
        if fits[which].gain < settings.least_gain / 2:
            continue
        # A second time, with all that a motion can do projected out by weighted least squares.
        columns = _spectra(prepared, which, _motion_columns(prepared, which, hypothesis))
        left[which] = _beside(spectra[which], columns, fits[which].colour)
        fits[which] = fit_colour(left[which])
        projected.append(which)
        if not _smooth(fits[which], settings):
            return None
    if not _credible(fits, settings):
        return None
    colours = [one.colour for one in fits]
    white = _white_levels(prepared, list(colours[0].coefficients))
    first, second = pooled(colours, white, prepared.validation.band.cutoff)
    if not _is_of_sensors(prepared, (first, second)):
        return None
    # One sensor may have far more than those of its kind: then something of the arm is in it.
    power = np.max([lacks(left[which], (first, second)[which]) for which in projected], axis=0)
    return NoiseColours(
        (first, second), {int(row): power[row] for row in np.flatnonzero(power > settings.largest_lack)}
    )


def _white_levels(prepared: PreparedData, channels: Sequence[str]) -> dict[str, Array]:
    """Return the variance (n,) Nm² of the torque channels' white noise, by channel."""
    n, observations = prepared.model.n, [o for part in prepared.observed for o in part]
    return {channel: np.mean([o.torque_variances(n)[channel] for o in observations], axis=0) for channel in channels}


def _credible(fits: Sequence[ColourFit], settings: ColourSettings) -> bool:
    return sum(one.gain for one in fits) > settings.least_gain and all(_smooth(one, settings) for one in fits)


def _smooth(fit: ColourFit, settings: ColourSettings) -> bool:
    """Whether a smooth spectrum describes the noise."""
    return fit.lack < settings.largest_lack and fit.peakedness < settings.largest_peakedness


def _is_of_sensors(prepared: PreparedData, colours: Sequence[Colour]) -> bool:
    """Whether a colour is as small beside the torques as sensors' noise is; what is larger, the model lacks.

    Of the arm as a whole: a joint that carries next to nothing may show more noise than torque.
    """
    largest = prepared.settings.colour.largest_share
    for data, colour in zip(prepared.library.sets, colours, strict=True):
        f = np.linspace(colour.lowest, data.band.cutoff, FREQUENCIES)
        for channel in colour.coefficients:
            noise = np.sqrt(np.mean(colour.density(channel, f), axis=0) * 2.0 * data.band.cutoff / data.band.rate)
            if np.linalg.norm(noise) > largest * np.linalg.norm(typical_torques(data, channel)):
                return False
    return True


@dataclass(frozen=True, eq=False)
class _Spectra:
    """Discrete spectra of whitened columns of one stretch.

    Parameters
    ----------
    f
        (F,) Hz, within the band; thinned where there are many.
    values
        (F, R, k) complex; white noise of variance one has mean square one.
    ways
        Channel -> (F, R, n): what white noise of 1 Nm a sample on each sensor is in them.
    """

    f: Real
    values: Complex
    ways: Mapping[str, Complex]


def _spectra(prepared: PreparedData, which: int, blocks: Sequence[Array]) -> list[_Spectra]:
    """Return the spectra of blocks of whitened columns (rows, k) of one data set, stretch by stretch."""
    data, found, first = prepared.library.sets[which], [], 0
    R, coefficients = data.layout.rows, data.layout.torque_coefficients
    for part, harmonics in zip(data.parts, data.harmonics, strict=True):
        place = slice(first, first + harmonics.size)
        first = place.stop
        f, transform = _transform(harmonics, data.band.kept_rate, data.band.cutoff)
        values = np.zeros((sum(columns.shape[1] for columns in blocks), R, len(f)), dtype=complex)
        _transform_all(values, blocks, place, transform)
        whitener = part.noise.whitener(f)
        ways = {channel: whitener @ C for channel, C in coefficients.items() if C.any()}
        found.append(_Spectra(f, values.T, ways))
    return found


def _transform_all(
    values: Complex, blocks: Sequence[Array], place: slice, transform: Callable[[Array], Complex]
) -> None:
    """Write the spectra of blocks of whitened columns (rows, k) to `values` (k in all, R, F).

    Parameters
    ----------
    values, blocks
        See above.
    place
        Where the stretch stands among the rows of each residual.
    transform
        Makes spectra of coordinates of the stretch.
    """
    starts = np.cumsum([0, *(columns.shape[1] for columns in blocks)])
    tasks = [
        (start + k, columns[:, k : k + CHUNK])
        for start, columns in zip(starts, blocks, strict=False)
        for k in range(0, columns.shape[1], CHUNK)
    ]

    def write(task: tuple[int, Array]) -> None:
        first, columns = task
        some = columns.T.reshape(columns.shape[1], values.shape[1], -1)[:, :, place]
        acting = some.any(axis=2)
        spectra = values[first : first + len(some)]
        spectra[acting] = transform(some[acting])
        # The mean does not count: of a constant column rounding is left, which is no direction to project out.
        spectra[_size(spectra) < NOTHING * _size(some)] = 0.0

    share_out(write, tasks)


def _size(columns: NDArray[Any]) -> Array:
    """Return the norms (k,) of columns (k, R, F)."""
    return np.asarray(np.linalg.norm(columns.reshape(len(columns), -1), axis=1))


def _transform(harmonics: Harmonics, rate: float, cutoff: float) -> tuple[Real, Callable[[Array], Complex]]:
    """Return frequencies (F,), and what makes coordinates (m, 2 H) of a stretch spectra there (m, F), without its ends.

    Of a short stretch the spectra of single harmonics serve for all columns; of a long one they would not fit memory.
    """
    count = harmonics.samples - 2 * harmonics.edge
    f = np.fft.rfftfreq(count, 1.0 / rate)
    kept = _kept(f, cutoff)

    def direct(coordinates: Array) -> Complex:
        return np.asarray(rfft(harmonics.signals(coordinates), axis=1)[:, kept] / np.sqrt(count))

    if harmonics.size > LONG:
        return f[kept], direct
    change = _spectra_of_harmonics(harmonics, rate, cutoff)
    return f[kept], lambda coordinates: np.asarray((coordinates @ change).view(complex))


@lru_cache(maxsize=2)
def _spectra_of_harmonics(harmonics: Harmonics, rate: float, cutoff: float) -> Array:
    """Return the spectra of each harmonic between the ends of a stretch, (2 H, 2 F), real and imaginary parts in turn.

    They are asked for once for a residual, and once for all columns.
    """
    signals = harmonics.signals(np.eye(harmonics.size))
    kept = _kept(np.fft.rfftfreq(signals.shape[1], 1.0 / rate), cutoff)
    return np.ascontiguousarray(rfft(signals, axis=1)[:, kept] / np.sqrt(signals.shape[1])).view(float)


def _kept(f: Real, cutoff: float) -> NDArray[np.intp]:
    """Return the frequencies that are used: all slow ones, and so many of the others, but not the mean."""
    inside = np.flatnonzero((f > 0.0) & (f <= cutoff))
    slow = int(np.searchsorted(f[inside], SLOW))
    return np.concatenate([inside[:slow], inside[slow :: max(1, -(-(len(inside) - slow) // FREQUENCIES))]])


def _beside(spectra: Sequence[_Spectra], columns: Sequence[_Spectra], colour: Colour) -> list[Periodogram]:
    """Return what is left of residuals beside columns, by least squares weighted by the inverse of a coloured noise.

    Parameters
    ----------
    spectra
        Of the residual of each stretch.
    columns
        Of the columns of each stretch.
    colour
        Of the noise.
    """
    factors = [_factor(one, colour) for one in spectra]
    inverses = [np.linalg.inv(factor) for factor in factors]
    # Equations are made independent in their order: a column is null before the first residual in which it shows. Those
    # that begin last come first, so that what is made orthogonal in this order is null there, too.
    first = np.argmax(np.any([one.values.any(axis=0) for one in columns], axis=0), axis=0)
    order, alone = np.argsort(-first, kind="stable"), np.zeros(1, dtype=int)
    null = np.searchsorted(-first[order], -np.arange(spectra[0].values.shape[1]))
    rows = [_real_rows(inverse, one.values, order) for inverse, one in zip(inverses, columns, strict=True)]
    aims = [_real_rows(inverse, one.values, alone)[:, :, 0] for inverse, one in zip(inverses, spectra, strict=True)]
    gram, target = _products(rows, aims, null)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    chosen, triangle, lost = independent_columns(gram / np.outer(scale, scale), RANK)
    scale, null = scale[chosen], np.searchsorted(chosen, null)
    beta = solve_triangular(triangle, target[chosen] / scale, lower=True)
    beta -= lost @ (lost.T @ beta)

    def left_of(residual: tuple[Array, Array, int]) -> tuple[Array, Array]:
        own, aim, k = residual
        some = (own[:, chosen[k:]] / scale[k:]).T
        along = solve_triangular(triangle[k:, k:], some, lower=True, check_finite=False)
        squares = np.square(along).sum(axis=0) - np.square(lost[k:].T @ along).sum(axis=0)
        return squares, aim - beta[k:] @ along

    found = []
    for one, factor, x, v in zip(spectra, factors, rows, aims, strict=True):
        shape = (*one.values.shape[:2], 2)
        held, parts = np.empty(shape), np.empty(shape)
        each = zip(x, v, null, strict=True)
        for r, (squares, rest) in enumerate(share_out(left_of, each)):
            held[:, r], parts[:, r] = squares.reshape(-1, 2), rest.reshape(-1, 2)
        # Of real columns a complex number holds two: half the leverage is each one's.
        share = np.maximum(1.0 - 0.5 * held.sum(axis=2), LEAST_SHARE)
        left = parts.view(complex)[:, :, 0] / np.sqrt(share)
        found.append(Periodogram(one.f, (factor @ left[:, :, None])[:, :, 0], share, one.ways))
    return found


def _products(rows: Sequence[Array], aims: Sequence[Array], null: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return the products (k, k) of columns with each other, and (k,) with residuals, over all stretches.

    Parameters
    ----------
    rows, aims
        (R, 2 F, k) columns and (R, 2 F) residuals of each stretch.
    null
        (R,) how many of the first columns are null in a residual.
    """

    def product(residual: tuple[Array, Array, int]) -> tuple[Array, Array]:
        own, aim, k = residual
        return own[:, k:].T @ own[:, k:], own[:, k:].T @ aim

    count = rows[0].shape[2]
    gram, target = np.zeros((count, count)), np.zeros(count)
    residuals = [each for x, v in zip(rows, aims, strict=True) for each in zip(x, v, null.tolist(), strict=True)]
    for first in range(0, len(residuals), AT_ONCE):
        some = residuals[first : first + AT_ONCE]
        for (_, _, k), (square, along) in zip(some, share_out(product, some), strict=True):
            gram[k:, k:] += square
            target[k:] += along
    return gram, target


def _real_rows(inverse: Complex, values: Complex, order: NDArray[np.intp]) -> Array:
    """Return some of the columns whitened, (R, 2 F, k): both parts of each entry are a row, as coefficients are real.

    Parameters
    ----------
    inverse
        (F, R, R) of the noise's factors.
    values
        (F, R, …) columns.
    order
        (k,) numbers of those wanted.
    """
    (F, R), k = values.shape[:2], len(order)
    rows = np.empty((R, F, 2, k))

    def write(first: int) -> None:
        part = slice(first, first + CHUNK)
        white = (inverse[part] @ np.take(values[part], order, axis=2)).transpose(1, 0, 2)
        rows[:, part, 0], rows[:, part, 1] = white.real, white.imag

    share_out(write, range(0, F, CHUNK))
    return rows.reshape(R, 2 * F, k)


def _factor(one: _Spectra, colour: Colour) -> Complex:
    """Return the Cholesky factors (F, R, R) of white and coloured noise together."""
    return np.asarray(np.linalg.cholesky(covariances(one.f, one.ways, colour)))


def _motion_columns(prepared: PreparedData, which: int, hypothesis: Hypothesis) -> list[Array]:
    """Return blocks of whitened columns (rows, k) of what candidates and general shapes can do to the residuals.

    With them goes friction that changes over time: a brake that drags for a while is no noise. What the search tried on
    its way is left out: it differs from candidates by next to nothing, and the noise would depend on the way.

    Parameters
    ----------
    prepared
        Data and regressors.
    which
        0 for identification, 1 for validation data.
    hypothesis
        The best one of the search.
    """
    library = prepared.library
    data = library.sets[which]
    tried = [c.index for c in (*library.candidates, *hypothesis.selected)]
    own = np.unique(np.concatenate([np.zeros(0, dtype=int), *tried]))

    def of_joint(joint: int) -> Array:
        plain: list[Sequence[Array]] = []
        ratios = prepared.gear_ratios(joint)
        for of in ("link", "motor"):
            sides = [side for side in data.layout.sides if (side == "link") == (of == "link")]
            found = shapes_of(data, of, joint, ratios, prepared.settings.regimes) if sides else {}
            shapes = [part for regime, part in found.items() if regime not in NO_MOTION]
            plain += [placed(data, side, joint, part) for side in sides for part in shapes]
        plain += [law.plain(data) for law in changing_friction(library.sets, joint, prepared.settings.general_laws)]
        return data.whiten([np.concatenate(parts, axis=2) for parts in zip(*plain, strict=True)])

    general = share_out(of_joint, range(data.layout.n))
    return [library.matrix(which, own), library.nuisance.white[which], *general]
