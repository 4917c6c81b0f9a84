"""All columns that compete for the residuals, and least squares over any choice of them.

A fit on one data set is judged on the other, both ways; both need only the Gram matrices, so that thousands of
choices cost less than one pass over the samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from elastic_arm.codegen.parallel import share_out
from elastic_arm.diagnosis.selection.candidates import Candidate
from elastic_arm.diagnosis.selection.gram_fits import (
    BorderedFits,
    FurtherColumns,
    block,
    gained_each,
    products,
    solution,
)
from elastic_arm.diagnosis.selection.growing_matrix import GrowingMatrix
from elastic_arm.diagnosis.selection.marginalisation import Marginalisation, NuisanceColumns
from elastic_arm.diagnosis.selection.searched_points import monomials, neighbourhood, quadratic_points
from elastic_arm.diagnosis.settings import CandidateSettings
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.whitening import WhitenedData

__all__ = ["Candidate", "RegressorLibrary", "Wanted"]

Array = NDArray[np.float64]
Wanted = Callable[[Feature], bool]


class RegressorLibrary:
    """Columns of many features on two data sets.

    With nuisance columns N and their prior precision 1, the Gram matrix G of any columns X is replaced by
    G - X'N (1 + N'N)^-1 N'X, on one data set for a fit, on both for what one adds to the other.

    Parameters
    ----------
    identify, validate
        The data that causes are fitted on, and the data that judges them.
    settings
        The values of nonlinear parameters that are tried.
    nuisance
        Columns that are marginalised; none where the model is taken as it is.
    """

    def __init__(
        self,
        identify: WhitenedData,
        validate: WhitenedData,
        settings: CandidateSettings,
        nuisance: NuisanceColumns | None = None,
    ) -> None:
        self.sets = (identify, validate)
        self.nuisance = nuisance or NuisanceColumns.none(identify, validate)
        self._marginalisation = Marginalisation(self.nuisance)
        self._marginal = [GrowingMatrix() for _ in range(5 if len(self.nuisance) else 3)]
        self._beside: tuple[Candidate, ...] = ()
        self._settings = settings
        self._candidates: list[Candidate] = []
        self._later: list[Callable[[Wanted], list[Candidate]]] = []
        self._monomials: dict[Feature, Array] = {}
        self._plain: dict[Candidate, list[Array]] = {}
        self._squares: dict[tuple[int, tuple[Candidate, ...]], Array] = {}
        # With the number of columns up to these and with them.
        self._pending: list[list[tuple[int, Array]]] = [[(1, e.white[:, None])] for e in self.sets]
        self._columns = [np.empty((len(e.white), 0), order="F") for e in self.sets]
        self._grams = [GrowingMatrix() for _ in self.sets]

    @property
    def candidates(self) -> list[Candidate]:
        """What competes; columns that were left for later are made now, and come first."""
        if self._later:
            self._candidates[:0] = self._later.pop()(lambda feature: True)
        return self._candidates

    def among(self, wanted: Wanted) -> list[Candidate]:
        """Return what competes of certain features; of columns that were left for later only theirs are made."""
        made = [c for c in self._candidates if wanted(c.feature)]
        return [*self._later[-1](wanted), *made] if self._later else made

    def compete(self, *candidates: Candidate) -> None:
        """Let candidates compete, behind those that are there."""
        self._candidates.extend(candidates)

    def compete_later(self, make: Callable[[Wanted], list[Candidate]]) -> None:
        """Let what a function makes of certain features compete once needed: some libraries are never searched."""
        self._later.append(make)

    @property
    def count(self) -> int:
        """Number of columns, the residual among them."""
        return len(self._grams[-1].filled)

    @property
    def _count(self) -> int:
        """Number of columns with those taken in since."""
        return self._pending[-1][-1][0] if self._pending[-1] else self.count

    def add(self, feature: Feature, searched: tuple[float, ...] | None = (), *, fixed: bool = False) -> Candidate:
        """Take a feature in; :meth:`close` makes it usable. It competes once it is among the candidates.

        Parameters
        ----------
        feature
            Whose columns are added.
        searched
            Its nonlinear parameters; None for columns that span a neighbourhood of them.
        fixed
            Whether its coefficient is 1 instead of fitted.
        """
        return self.add_all([(feature, searched, fixed)])[0]

    def add_all(self, wanted: Sequence[tuple[Feature, tuple[float, ...] | None, bool]]) -> list[Candidate]:
        """Take features in as :meth:`add` does, with its arguments for each; all threads make their columns."""
        parts = [(which, feature, searched) for feature, searched, _ in wanted for which in (0, 1)]
        made = share_out(lambda part: self.columns(*part), parts)
        return [
            Candidate(feature, searched, self.add_columns(own), fixed)
            for (feature, searched, fixed), *own in zip(wanted, made[::2], made[1::2], strict=True)
        ]

    def add_columns(self, blocks: Sequence[Array]) -> slice:
        """Take in whitened columns (rows, k) of both data sets, and return where they stand."""
        first = self._count
        for own, columns in zip(self._pending, blocks, strict=True):
            own.append((first + columns.shape[1], columns))
        return slice(first, self._count)

    def columns(self, which: int, feature: Feature, searched: tuple[float, ...] | None) -> Array:
        """Make whitened columns (rows, k) of a feature on one of the two data sets.

        Parameters
        ----------
        which
            0 for identification, 1 for validation data.
        feature
            The effect at its place.
        searched
            Its nonlinear parameters; None for columns that span a neighbourhood of them.
        """
        data = self.sets[which]
        if searched is not None:
            return data.whiten(data.plain(feature, searched))
        points = neighbourhood(feature, self._settings.reach)
        return np.hstack([data.whiten(data.plain(feature, tuple(point))) for point in points])

    def monomial_columns(self, feature: Feature) -> Array:
        """Return whitened columns (rows, m) of the identification data, one a monomial of the searched numbers.

        Of a feature of one column that is a polynomial of second degree in its searched numbers: at any values of them
        its column is a sum of these.
        """
        if feature not in self._monomials:
            points = quadratic_points(sum(p.size for p in feature.searched))
            columns = np.hstack([self.columns(0, feature, tuple(point)) for point in points])
            self._monomials[feature] = columns @ np.linalg.inv(monomials(points).T)
        return self._monomials[feature]

    def close(self) -> None:
        """Bring the Gram matrices up to the columns taken in since."""
        old, now = self.count, self._count
        if now == old:
            return
        for which, pending in enumerate(self._pending):
            self._reserve(which, old, now)
            columns = self._columns[which]
            np.concatenate([added for _, added in pending], axis=1, out=columns[:, old:now])
            pending.clear()
            new = columns[:, old:now]
            self._grams[which].extend(products(columns[:, :now] if old else new, new))
            self._marginalisation.add(which, new)
        self._marginalise(old)

    def _marginalise(self, old: int) -> None:
        """Bring the marginalised Gram matrices up to the columns from `old` on."""
        first, second = (gram.filled[:, old:] for gram in self._grams)
        further = [first, second, first + second]
        if len(self.nuisance):
            further = [border - held for border, held in zip(further, self._marginalisation.held(old), strict=True)]
            # Given the other data set, one judges by what both hold beyond it.
            further += [further[2] - further[1], further[2] - further[0]]
        for matrix, border in zip(self._marginal, further, strict=True):
            matrix.extend(border)

    def _gram(self, which: int) -> Array:
        """Return the marginalised Gram matrix of identification data, validation data (1), or both (2)."""
        return self._marginal[which].filled

    def _judging(self, which: int) -> Array:
        """Return the Gram matrix by which a data set judges what was fitted on the other."""
        return self._marginal[3 + which if len(self.nuisance) else which].filled

    def marginalised(self, columns: Array, *, residual: bool = False) -> Array:
        """Return rows whose products are those of columns of the identification data, the nuisance marginalised.

        Parameters
        ----------
        columns
            (rows, m).
        residual
            Whether they are the residual, which knows of the prior means.
        """
        return self._marginalisation.rows(columns, residual=residual)

    @property
    def nuisance_basis(self) -> Array:
        """Orthonormal basis (rows + k, k) of the nuisance columns of the identification data over their priors."""
        return self._marginalisation.basis

    def nuisance_values(self, selected: Sequence[Candidate], beta: Array | None = None) -> Array:
        """Return posterior means (k,) of the nuisance parameters on both data sets, relative to where the model stands.

        Parameters
        ----------
        selected
            The candidates.
        beta
            Their coefficients; those fitted to the identification data when None.
        """
        beta = self.fit(0, selected) if beta is None else beta
        return self._marginalisation.means(_split(selected)[0], beta)

    def nuisance_step(self, selected: Sequence[Candidate], misfit: float) -> tuple[Array, Array]:
        """Return posterior means and standard deviations (k,) with the candidates' coefficients free.

        Parameters
        ----------
        selected
            The candidates.
        misfit
            Factor on the noise's variance: with much unexplained the prior counts more.
        """
        index, free = _split(selected)
        gram = self._grams[0].filled + self._grams[1].filled
        return self._marginalisation.joint_posterior(gram, index[free], index[~free], misfit)

    def _reserve(self, which: int, old: int, count: int) -> None:
        columns = self._columns[which]
        if columns.shape[1] < count:
            self._columns[which] = np.empty((len(columns), count + count // 2), order="F")
            self._columns[which][:, :old] = columns[:, :old]

    def matrix(self, which: int, index: Sequence[int] | NDArray[np.intp] | slice) -> Array:
        """Return columns (rows, k) by number; column 0 is the residual."""
        return self._columns[which][:, index]

    def fit(self, which: int, selected: Sequence[Candidate]) -> Array:
        """Return coefficients of all columns of the selected, in order, fitted on one data set."""
        index, free = _split(selected)
        keep = np.append(0, index)
        return solution(block(self._gram(which), keep, keep), free)

    def coefficients(self, selected: Sequence[Candidate]) -> list[Array]:
        """Return the coefficients of each candidate's columns, fitted on the identification data."""
        ends = np.cumsum([len(candidate.index) for candidate in selected])
        return np.split(self.fit(0, selected), ends[:-1]) if len(ends) else []

    def held_by_nuisance(self, candidate: Candidate) -> float:
        """Return the share of a candidate's squares on both data sets that nuisance parameters could hold."""
        raw = sum(np.diag(gram.filled)[candidate.index] for gram in self._grams)
        left = np.diag(self._gram(2))[candidate.index]
        return float(1.0 - np.max(left / np.maximum(raw, 1e-300)))

    def calibrated_beside(self, selected: Sequence[Candidate]) -> RegressorLibrary:
        """Return the library, its columns shared, with residuals at the nuisance parameters beside these candidates."""
        found = copy(self)
        found._beside = tuple(selected)
        return found

    def validation_residuals(self, selected: Sequence[Candidate]) -> list[Array]:
        """Return the residuals (N', R) of each stretch of the validation data that candidates leave, Nm."""
        left = [y.copy() for y in self.sets[1].y]
        if len(self.nuisance):
            keys = {candidate.feature.key for candidate in selected}
            values = self.nuisance_values([*(c for c in self._beside if c.feature.key not in keys), *selected])
            left = [y - N @ values for y, N in zip(left, self.nuisance.validation, strict=True)]
        for candidate, beta in zip(selected, self.coefficients(selected), strict=True):
            for own, columns in zip(left, self._plain_validation(candidate), strict=True):
                own -= columns @ beta
        return left

    def _plain_validation(self, candidate: Candidate) -> list[Array]:
        """Return a candidate's columns (N', R, k) of each stretch of the validation data, Nm; made once."""
        if candidate not in self._plain:
            self._plain[candidate] = self.sets[1].plain(candidate.feature, candidate.searched or ())
        return self._plain[candidate]

    def gain(self, which: int, selected: Sequence[Candidate], beta: Array) -> float:
        """Log-likelihood that coefficients gain on a data set over no cause, nats.

        Parameters
        ----------
        which
            0 for identification, 1 for validation data.
        selected
            The candidates.
        beta
            Coefficients of all their columns, in order.
        """
        index, _ = _split(selected)
        gram = self._judging(which)
        return float(beta @ gram[index, 0] - 0.5 * beta @ block(gram, index, index) @ beta)

    def held_out(self, selected: Sequence[Candidate]) -> float:
        """Log-likelihood gained on both data sets, each with the coefficients of the other."""
        if not selected:
            return 0.0
        return self.gain(1, selected, self.fit(0, selected)) + self.gain(0, selected, self.fit(1, selected))

    def held_out_each(
        self, base: Sequence[Candidate], bounds: Array, further: Sequence[FurtherColumns]
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Return :meth:`held_out` (M,) of `base` with each choice, and which have a coefficient out of bounds (M,).

        Parameters
        ----------
        base
            Candidates that are always there.
        bounds
            (2, p) of the coefficients of their columns.
        further
            Columns of the choices, one of which at a time is added.
        """
        index, free = _split(base)
        scores = np.zeros(sum(len(one.members) for one in further))
        impossible = np.zeros(len(scores), dtype=bool)
        for fitted, judged in ((0, 1), (1, 0)):
            fits = BorderedFits(self._gram(fitted), index, free)
            for members, columns, fixed, own in further:
                fit = fits.with_each(columns, fixed)
                scores[members] += gained_each(self._judging(judged), index, columns, fit.base, fit.further)
                if fitted == 0:
                    impossible[members] = fit.outside(bounds, own)
        return scores, impossible

    def both(self, selected: Sequence[Candidate]) -> float:
        """Log-likelihood gained on both data sets by one fit to both."""
        index, free = _split(selected)
        keep = np.append(0, index)
        gram = block(self._gram(2), keep, keep)
        beta = solution(gram, free)
        return float(beta @ gram[1:, 0] - 0.5 * beta @ gram[1:, 1:] @ beta)

    def remainder(self, which: int, selected: Sequence[Candidate], beta: Array) -> Array:
        """Return the whitened residual (rows,) that candidates leave.

        Parameters
        ----------
        which
            0 for identification, 1 for validation data.
        selected
            The candidates.
        beta
            Coefficients of all their columns, in order.
        """
        index, _ = _split(selected)
        left = self.matrix(which, [0])[:, 0] - self.matrix(which, index) @ beta
        return left - self.nuisance.white[which] @ self.nuisance_values(selected, beta) if len(self.nuisance) else left

    def squares_left(self, selected: Sequence[Candidate]) -> float:
        """Return the sum of whitened squares on both data sets that candidates leave, fitted to identification data."""
        beta, (index, _) = self.fit(0, selected), _split(selected)
        keep = np.append(0, index)
        first, second = (block(gram.filled, keep, keep) for gram in self._grams)
        return self._marginalisation.squares_left(first + second, index, beta)

    def falls(self, without: Sequence[Candidate], selected: Sequence[Candidate]) -> tuple[Array, Array]:
        """Return what the squares of the residual fall, (blocks,) of each data set, fitted on the other."""
        first, second = (self._block_squares(k, without) - self._block_squares(k, selected) for k in (0, 1))
        return first, second

    def _block_squares(self, which: int, selected: Sequence[Candidate]) -> Array:
        """Return the squares (blocks,) of what candidates leave of a data set, fitted on the other; made once."""
        key = (which, tuple(selected))
        if key not in self._squares:
            left = self.remainder(which, selected, self.fit(1 - which, selected))
            in_time = self.sets[which].in_time(left[:, None])[:, 0]
            self._squares[key] = np.bincount(self.sets[which].blocks, in_time**2).astype(float)
        return self._squares[key]


def _split(selected: Sequence[Candidate]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    if not selected:
        return np.empty(0, dtype=int), np.empty(0, dtype=bool)
    index, free = zip(*((candidate.index, candidate.free) for candidate in selected), strict=True)
    return np.concatenate(index), np.concatenate(free)
