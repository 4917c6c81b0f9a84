"""Nuisance parameters marginalised in closed form.

With nuisance columns N, whose parameters have standard normal priors, the Gram matrix G of any columns X becomes the
Schur complement G - X'N (1 + N'N)^-1 N'X: on one data set for a fit, on both for what one adds to the other. So
hypotheses are compared as if every nuisance parameter had been integrated out.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular

from elastic_arm.diagnosis.selection.gram_fits import first_row, products, regularised
from elastic_arm.estimation.whitening import WhitenedData

Array = NDArray[np.float64]
RANK = 1e-10  # relative eigenvalue below which a combination of columns is not determined; numerical


@dataclass(frozen=True, eq=False)
class NuisanceColumns:
    """Columns of nuisance parameters with standard normal priors, marginalised in every fit.

    Parameters
    ----------
    white
        (rows, k) on the identification and on the validation data.
    validation
        (N', R, k) Nm, of each stretch of the validation data.
    centre
        (k,) prior means: minus the values at which the model stands already.
    limits
        (k,) largest believable distances from the description, in standard deviations of the priors.
    joints
        (k,) to which they belong.
    noise
        Variance of the whitened noise: what no hypothesis explains counts as noise, so that it does not bend the
        nuisance parameters.
    turned_over
        Speeds, rad/s, by joint, below which they hold how dry friction turns over.
    squares
        Of the columns, once anyone has asked.
    """

    white: tuple[Array, Array]
    validation: Sequence[Array]
    centre: Array
    limits: Array
    joints: Sequence[str]
    noise: float = 1.0
    turned_over: Mapping[str, float] = field(default_factory=dict)
    squares: list[Array] = field(default_factory=list, repr=False, compare=False)

    @staticmethod
    def none(identify: WhitenedData, validate: WhitenedData) -> NuisanceColumns:
        """Return those of a model that is taken as it is."""
        white = (np.zeros((len(identify.white), 0)), np.zeros((len(validate.white), 0)))
        return NuisanceColumns(white, (), np.zeros(0), np.zeros(0), ())

    def widened(self, factors: Array) -> NuisanceColumns:
        """Return the columns where the standard deviations of the priors are wider by factors (k,)."""
        first, second = (white * factors for white in self.white)
        validation = [columns * factors for columns in self.validation]
        return replace(
            self,
            white=(first, second),
            squares=[],
            validation=validation,
            centre=self.centre / factors,
            limits=self.limits / factors,
        )

    @property
    def products(self) -> list[Array]:
        """Products (k, k) of the columns of each data set; worked out once, whatever the noise."""
        if not self.squares:
            self.squares.extend(products(N, N) for N in self.white)
        return self.squares

    def possible(self, values: Array, joints: Collection[str | None]) -> bool:
        """Whether the nuisance parameters of some joints are within what is believable.

        A hypothesis that makes a drive carry no torque, or a sensor measure none, explains every recording.

        Parameters
        ----------
        values
            (k,) relative to where the model stands.
        joints
            Names.
        """
        beyond = np.abs(values - self.centre) > self.limits
        return not any(one and joint in joints for one, joint in zip(beyond, self.joints, strict=True))

    def __len__(self) -> int:
        return len(self.centre)


class Marginalisation:
    """Sums over the nuisance columns of two data sets, and what follows from them.

    Parameters
    ----------
    nuisance
        The columns, (rows, k) of identification and validation data.
    """

    def __init__(self, nuisance: NuisanceColumns) -> None:
        self._nuisance = nuisance
        own = nuisance.products
        one = nuisance.noise * np.eye(len(nuisance))
        self._precision = (one + own[0], one + own[1], one + own[0] + own[1])
        self._factors = [np.linalg.cholesky(a) for a in self._precision]
        # N'X of each data set; L^-1 N'X of identification data, validation data and both.
        self._cross = [np.empty((len(one), 0)) for _ in own]
        self._held = [np.empty((len(one), 0)) for _ in self._factors]

    def add(self, which: int, columns: Array) -> None:
        """Take further columns (rows, m) of one data set."""
        own = products(self._nuisance.white[which], columns)
        self._cross[which] = np.hstack([self._cross[which], own])

    def held(self, old: int) -> list[Array]:
        """Return what nuisance parameters hold of products of columns, those from `old` on with all.

        Parameters
        ----------
        old
            Number of columns that were asked for before.

        Returns
        -------
        (m, m - old) for identification data, validation data and both.
        """
        crosses = (*self._cross, self._cross[0] + self._cross[1])
        return [self._extended(which, cross, old) for which, cross in enumerate(crosses)]

    def _extended(self, which: int, cross: Array, old: int) -> Array:
        further = cross[:, old:].copy()
        if not old:
            further[:, 0] += self._nuisance.noise * self._nuisance.centre
        own = solve_triangular(self._factors[which], further, lower=True) if len(further) else further
        self._held[which] = np.hstack([self._held[which], own])
        return np.asarray(self._held[which].T @ own)

    def squares_left(self, gram: Array, index: NDArray[np.intp], beta: Array) -> float:
        """Return the sum of squares on both data sets that columns and the posterior means of nuisance leave.

        Parameters
        ----------
        gram
            Of the residual and these columns on both data sets, not marginalised.
        index, beta
            Numbers of the columns, and their coefficients.
        """
        signed = np.append(1.0, -beta)
        if not len(self._nuisance):
            return float(signed @ gram @ signed)
        values = self.means(index, beta)
        cross = sum(part[:, np.append(0, index)] @ signed for part in self._cross)
        own = self._precision[2] @ values - self._nuisance.noise * values
        return float(signed @ gram @ signed + values @ (own - 2.0 * cross))

    def rows(self, columns: Array, *, residual: bool = False) -> Array:
        """Return rows whose products are those of columns of the identification data, marginalised.

        Parameters
        ----------
        columns
            (rows, m).
        residual
            Whether they are the residual, which knows of the prior means.

        Returns
        -------
        (rows + k, m): a prior is one more row for each of the k nuisance parameters.
        """
        if not len(self._nuisance):
            return columns
        below = np.zeros((len(self._nuisance), columns.shape[1]))
        if residual:
            below += np.sqrt(self._nuisance.noise) * self._nuisance.centre[:, None]
        begin, rows = first_row(columns), len(columns)
        left = self.basis @ -(self.basis[begin:rows].T @ columns[begin:] + self.basis[rows:].T @ below)
        left[begin:rows] += columns[begin:]
        left[rows:] += below
        return np.asarray(left)

    @cached_property
    def basis(self) -> Array:
        """Orthonormal basis (rows + k, k) of the nuisance columns over their priors."""
        prior = np.sqrt(self._nuisance.noise) * np.eye(len(self._nuisance))
        tall = np.vstack([self._nuisance.white[0], prior])
        if not tall.size:  # SciPy 1.11 solves no empty system
            return tall
        basis: Array = solve_triangular(self._factors[0], tall.T, lower=True).T
        return basis

    def means(self, index: NDArray[np.intp], beta: Array) -> Array:
        """Return posterior means (k,) on both data sets beside columns with these coefficients."""
        target = sum(cross[:, 0] - cross[:, index] @ beta for cross in self._cross)
        target = target + self._nuisance.noise * self._nuisance.centre
        return np.asarray(cho_solve((self._factors[2], True), target))

    def joint_posterior(
        self, gram: Array, free: NDArray[np.intp], fixed: NDArray[np.intp], misfit: float
    ) -> tuple[Array, Array]:
        """Return posterior means and standard deviations (k,) on both data sets.

        Parameters
        ----------
        gram
            Of all columns on both data sets, not marginalised.
        free, fixed
            Columns with a coefficient to fit, and with coefficient 1.
        misfit
            Factor on the noise's variance.
        """
        k, cross = len(self._nuisance), self._cross[0] + self._cross[1]
        precision = self._precision[2] + (misfit - self._nuisance.noise) * np.eye(k)
        target = np.append(
            cross[:, 0] - cross[:, fixed].sum(axis=1) + misfit * self._nuisance.centre,
            gram[free, 0] - gram[np.ix_(free, fixed)].sum(axis=1),
        )
        whole = np.block([[precision, cross[:, free]], [cross[:, free].T, gram[np.ix_(free, free)]]])
        values, stds = regularised(whole, target, RANK)
        return values[:k], np.sqrt(misfit) * stds[:k]
