"""Whether the laws of a hypothesis are right: each is compared with laws that no catalogue states.

The marginal likelihood of a general law with K columns Z and coefficients N(0, a^2), beside what the hypothesis P keeps
in the regression (nuisance parameters with their priors, the other causes), is in closed form

    ln p(y | a) = y'Z (Z'Z + s/a^2)^-1 Z'y / 2s - ln det(1 + a^2 Z'Z / s) / 2,        y, Z with P projected out,

s the variance of the noise. Its determinant is the price of the coefficients. The size a, in Nm, is marginalised over a
grid. A named law has few numbers, for which nothing is counted: a general law has to explain clearly more.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from elastic_arm.codegen.parallel import share_out
from elastic_arm.diagnosis.calibration.calibrate import effective_noise
from elastic_arm.diagnosis.laws.general_laws import GeneralLaw, general_laws
from elastic_arm.diagnosis.selection.gram_fits import first_row, orthonormal_basis, regularised
from elastic_arm.diagnosis.selection.hypothesis import Key, misfit
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.settings import DiagnosisSettings

Array = NDArray[np.float64]

RANK = 1e-6  # relative singular value below which a combination of columns is not determined; numerical


@dataclass(frozen=True)
class LawFit:
    """A general law and what it explains.

    Parameters
    ----------
    law
        Which.
    gain
        Nats by which it raises the marginal likelihood over the hypothesis, less what choosing among the laws is worth.
    size
        Likeliest size of its torque, Nm.
    torque
        (N', R) Nm of each validation stretch.
    """

    law: GeneralLaw
    gain: float
    size: float
    torque: list[Array]


@dataclass(frozen=True)
class _Base:
    """What a hypothesis keeps in the regression.

    Parameters
    ----------
    basis
        Orthonormal (rows, k).
    left
        (rows,) residual without it.
    log_likelihood
        Nats, up to a constant.
    """

    basis: Array
    left: Array
    log_likelihood: float


class LawComparison:
    """A hypothesis at its optimum, beside which general laws are fitted.

    Parameters
    ----------
    library
        Of all columns.
    selected
        Candidates of the hypothesis, and their derivatives by parameters that do not act linearly.
    settings
        Of the general laws.
    """

    def __init__(self, library: RegressorLibrary, selected: Sequence[Candidate], settings: DiagnosisSettings) -> None:
        self._library, self._selected, self._settings = library, list(selected), settings
        self._nuisance = library.nuisance
        self._noise = effective_noise(misfit(library, self._selected), library.sets[0].band, settings)
        self._white = np.vstack(self._nuisance.white)
        self._residual = np.concatenate([library.matrix(which, [0])[:, 0] for which in (0, 1)])
        self._columns: dict[tuple[int, int], list[tuple[slice, Array]]] = {}
        self._without_cause: dict[Key, _Base] = {}

    def beside(self, joints: Sequence[int]) -> LawFit:
        """Return the general law of some joints that explains most beside the whole hypothesis."""
        return self._best(self._whole, joints)

    def instead_of(self, key: Key, joints: Sequence[int]) -> Iterator[LawFit]:
        """Yield the general laws of some joints in the place of a cause, over that cause, the best one first.

        Parameters
        ----------
        key
            Of the cause.
        joints
            On which it acts.
        """
        return self._ranked(self._beside(key), joints)

    def worth(self, key: Key) -> float:
        """Return by how many nats a cause raises the likelihood of all data beside the others."""
        return self._whole.log_likelihood - self._beside(key).log_likelihood

    def worth_beside(self, key: Key, law: GeneralLaw) -> float:
        """Return by how many nats a cause raises the likelihood of all data beside the others and a general law.

        Parameters
        ----------
        key
            Of the cause.
        law
            One of those that were compared.
        """
        k = self._laws(law.joint).index(law)
        with_cause, without = (self._fits(base, law.joint, [k])[0][0] for base in (self._whole, self._beside(key)))
        return self.worth(key) + with_cause - without

    def instead_of_numbers(self, wider: Mapping[int, float], joints: Sequence[int]) -> Iterator[LawFit]:
        """Yield the general laws where nuisance parameters have the priors of ordinary ones, the best one first.

        Parameters
        ----------
        wider
            How much wider than ordinary the prior of each of these nuisance parameters is in the hypothesis.
        joints
            To which they belong.
        """
        return self._ranked(self._base(self._selected, wider), joints)

    def numbers_beside(self, fit: LawFit, wider: Mapping[int, float]) -> tuple[Array, Array]:
        """Return posterior means and standard deviations (k,) of the nuisance parameters beside a general law.

        They are relative to where the model stands, in standard deviations of the hypothesis' priors.

        Parameters
        ----------
        fit
            The law.
        wider
            As in :meth:`instead_of_numbers`.
        """
        count, narrower = len(self._nuisance), self._narrower(wider)
        columns = [self._white / narrower]
        if self._selected:
            columns.append(self._of(self._selected)[: len(self._white)])
        columns.append(np.vstack([data.whiten(fit.law.plain(data)) for data in self._library.sets]))
        together = np.hstack(columns)
        precision = np.zeros(together.shape[1])
        precision[:count], precision[-columns[-1].shape[1] :] = self._noise, self._noise / fit.size**2
        gram, target = together.T @ together + np.diag(precision), together.T @ self._residual
        target[:count] += self._noise * self._nuisance.centre * narrower
        values, stds = regularised(gram, target, RANK**2)
        return values[:count] / narrower, np.sqrt(self._noise) * stds[:count] / narrower

    def _narrower(self, wider: Mapping[int, float]) -> Array:
        found = np.ones(len(self._nuisance))
        found[list(wider)] = list(wider.values())
        return found

    def against(self, blocks: Sequence[Sequence[Array]], cause: Candidate | None = None) -> tuple[float, float]:
        """Return by how many nats a law is to be expected to lose against another one, and by how many that wins.

        Parameters
        ----------
        blocks
            What the other one adds to the residuals (N', R, 1) of each stretch, of identification and validation.
        cause
            The law, where it is a cause of a fixed size: neither that nor its parameters compete with the other one.
            None where it is among the nuisance parameters.
        """
        base = self._whole if cause is None else self._beside(cause.feature.key)
        left = base.left
        if cause is not None:
            own = np.concatenate([self._library.matrix(which, cause.index) for which in (0, 1)])
            left = left - _without(self._with_priors(own), base.basis)[:, 0]
        sets = zip(self._library.sets, blocks, strict=True)
        column = self._with_priors(np.vstack([data.whiten(parts) for data, parts in sets]))
        column = _without(column, base.basis)[:, 0]
        expected = 0.5 * float(column @ column) / self._noise
        return expected, float(column @ left) / self._noise - expected

    @cached_property
    def _whole(self) -> _Base:
        return self._base(self._selected)

    def _beside(self, key: Key) -> _Base:
        """Return the regression on all but a cause; worked out once."""
        if key not in self._without_cause:
            others = [candidate for candidate in self._selected if candidate.feature.key != key]
            self._without_cause[key] = self._base(others)
        return self._without_cause[key]

    @cached_property
    def _nuisance_basis(self) -> tuple[Array, Array]:
        """Orthonormal basis (rows, k) of the nuisance columns over their priors, and its triangle (k, k)."""
        return self._over_priors(self._white)

    def _over_priors(self, white: Array) -> tuple[Array, Array]:
        """Return an orthonormal basis (rows, k) of columns over their priors, and its triangle (k, k)."""
        prior = np.sqrt(self._noise) * np.eye(len(self._nuisance))
        triangle = np.asarray(np.linalg.cholesky(white.T @ white + self._noise * np.eye(len(prior))).T, dtype=float)
        basis = np.vstack([white, prior]) @ np.linalg.inv(triangle)
        # Once more, as products square the columns' condition.
        second = np.asarray(np.linalg.cholesky(basis.T @ basis).T, dtype=float)
        return basis @ np.linalg.inv(second), second @ triangle

    def _base(self, selected: Sequence[Candidate], wider: Mapping[int, float] | None = None) -> _Base:
        """Return the regression on the nuisance parameters, some with priors that are narrower, and on candidates."""
        prior, narrower = np.sqrt(self._noise), self._narrower(wider or {})
        basis, triangle = self._over_priors(self._white / narrower) if wider else self._nuisance_basis
        price = float(np.sum(np.log(np.abs(np.diag(triangle)) / prior)))
        if selected:
            own = _without(self._of(selected), basis)
            # What the nuisance parameters hold wholly is rounding there.
            own = own[:, np.linalg.norm(own, axis=0) > RANK]
            basis = np.hstack([basis, orthonormal_basis(own, RANK)])
        left = _without(np.append(self._residual, prior * self._nuisance.centre * narrower), basis)
        return _Base(basis, left, -0.5 * float(left @ left) / self._noise - price)

    def _of(self, selected: Sequence[Candidate]) -> Array:
        """Return the columns of candidates, each of length one."""
        index = np.concatenate([candidate.index for candidate in selected])
        columns = np.vstack([self._library.matrix(which, index) for which in (0, 1)])
        return self._with_priors(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))

    def _with_priors(self, columns: Array) -> Array:
        """Return columns of both data sets with a row for each prior."""
        return np.vstack([columns, np.zeros((len(self._nuisance), columns.shape[1]))])

    def _best(self, base: _Base, joints: Sequence[int]) -> LawFit:
        return next(self._ranked(base, joints))

    def _ranked(self, base: _Base, joints: Sequence[int]) -> Iterator[LawFit]:
        """Yield the general laws of some joints beside a base, the one that explains most first."""
        tried = [
            (law, *fit) for joint in joints for law, fit in zip(self._laws(joint), self._fits(base, joint), strict=True)
        ]
        chosen = base.log_likelihood - self._whole.log_likelihood - float(np.log(len(tried)))
        for law, gain, size, coefficients in sorted(tried, key=lambda one: -one[1]):
            torque = [part @ coefficients for part in law.plain(self._library.sets[1])]
            yield LawFit(law, gain + chosen, size, torque)

    def _laws(self, joint: int) -> list[GeneralLaw]:
        if joint not in self._all_laws:
            self._all_laws[joint] = general_laws(self._library.sets, joint, self._settings.general_laws)
        return self._all_laws[joint]

    @cached_property
    def _all_laws(self) -> dict[int, list[GeneralLaw]]:
        return {}

    def _fits(self, base: _Base, joint: int, laws: Sequence[int] | None = None) -> list[tuple[float, float, Array]]:
        """Return the log-likelihoods, nats, that laws gain over a base, their likeliest sizes, and their coefficients.

        Parameters
        ----------
        base
            What is in the regression.
        joint
            On which they act.
        laws
            Numbers of some of the joint's laws; all when None.
        """
        chosen = range(len(self._laws(joint))) if laws is None else laws
        blocks = dict(zip(chosen, share_out(lambda k: self._of_law(joint, k), chosen), strict=True))
        alike: dict[tuple[int, ...], list[int]] = {}
        for k, own in blocks.items():
            alike.setdefault(tuple(rows.start for rows, _ in own), []).append(k)

        def gained(numbers: Sequence[int]) -> list[tuple[float, float, Array]]:
            # The basis is the largest by far, and is gone through once for all laws that act in the same rows.
            parts = [[blocks[k][which] for k in numbers] for which in (0, 1)]
            together = [(own[0][0], np.hstack([columns for _, columns in own])) for own in parts]
            held = np.sum([base.basis[rows].T @ columns for rows, columns in together], axis=0)
            target = np.sum([columns.T @ base.left[rows] for rows, columns in together], axis=0)
            ends = np.cumsum([blocks[k][0][1].shape[1] for k in numbers])[:-1]
            grams = (np.sum([columns.T @ columns for _, columns in blocks[k]], axis=0) for k in numbers)
            each = zip(grams, np.split(held, ends, axis=1), np.split(target, ends), strict=True)
            return [self._gained(gram - along.T @ along, aim) for gram, along, aim in each]

        gains = chain.from_iterable(share_out(gained, alike.values()))
        found = dict(zip(chain.from_iterable(alike.values()), gains, strict=True))
        return [found[k] for k in chosen]

    def _gained(self, gram: Array, target: Array) -> tuple[float, float, Array]:
        """Return what a law gains, its likeliest size, and its coefficients, from products beside a base."""
        values, vectors = np.linalg.eigh(gram / self._noise)
        seen = values > RANK**2 * values[-1]
        values, vectors = values[seen], vectors[:, seen]
        shown = vectors.T @ target / self._noise
        sizes = np.array(self._settings.general_laws.sizes)[:, None]
        gains = 0.5 * np.sum(shown**2 / (values + sizes**-2) - np.log1p(values * sizes**2), axis=1)
        size = float(sizes[int(np.argmax(gains)), 0])
        coefficients = vectors @ (shown / (values + size**-2))
        return float(logsumexp(gains) - np.log(len(gains))), size, coefficients

    def _of_law(self, joint: int, k: int) -> list[tuple[slice, Array]]:
        """Return where the columns of a law are not null in each data set, rows of both together, and them there."""
        if (joint, k) not in self._columns:
            found, first = [], 0
            for data in self._library.sets:
                columns = data.whiten(self._laws(joint)[k].plain(data))
                begin = first_row(columns)
                found.append((slice(first + begin, first + len(columns)), columns[begin:]))
                first += len(columns)
            self._columns[joint, k] = found
        return self._columns[joint, k]


def _without(columns: Array, basis: Array) -> Array:
    return np.asarray(columns - basis @ (basis.T @ columns))
