"""The description as a prior, where a recording alone predicts other motion badly; and the judgement on held-out data.

Base parameters that a short or slow recording hardly shows go wherever its errors send them, and predict other motion
badly. A prior around the description holds them (ridge regression; A. Hoerl and R. Kennard, Technometrics 12 (1970)
55). Its width is the one that predicts left-out parts of the fitted recordings best: the narrowest within a standard
error of the best (T. Hastie, R. Tibshirani, J. Friedman, The Elements of Statistical Learning, 2009, 7.10), that of the
difference of both part by part, as parts differ by much more than widths do. Without a clear gain there is none.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics.double_double import add, cholesky
from elastic_arm.effects import EffectInstance
from elastic_arm.estimation.motion import Motion
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.consistency.estimation import description_covariance, with_consistency
from elastic_arm.identification.deviations import residual_norms
from elastic_arm.identification.least_squares import Blocks, Fit, Prior
from elastic_arm.identification.result import Identification
from elastic_arm.identification.stream import Identifier
from elastic_arm.identification.verdict import natural_scales
from elastic_arm.robot import Robot

Array = NDArray[np.float64]
ByJoint = Mapping[str, Mapping[str, float]]

# Relative errors of the description that are tried, wide to narrow.
WIDTHS = tuple(np.geomspace(10.0, 0.03, 12).tolist())
# And where held-out motion refutes a fit: errors of a model that does not hold may be many times the noise.
PULLED = (*WIDTHS, 1e-2, 1e-3, 1e-4, 1e-5)
# Relative errors of the description that are compared by their likelihood.
ERRORS = tuple(np.geomspace(0.01, 10.0, 31).tolist())
# Beside its relative error every base parameter may be off by this share of what is usual for its body: descriptions
# hold placeholders that are far too small.
PLACEHOLDER = 0.3
# Few parameters that are determined hardly show how far the others are off: what counts in the deviations is the upper
# end of the interval of 95 %, by the loss of log-likelihood (half of chi-squared with one degree of freedom, one side).
DOUBT = 1.35
FOLDS = 5
# A prior has to lower the error of left-out parts by this share.
GAIN = 0.05
# Relative errors of the description that the consistent arm may still take it for, where it predicts badly.
TRUSTS = (0.3, 0.1, 0.03, 0.01)
# Ratio of rms errors from which a joint is predicted worse than by the description.
WORSE = 1.1
# Mean log ratio of rms errors up to which a fit predicts as well as the description: one that is right already cannot
# be improved.
EQUAL = 0.01


def prior_of(equations: BaseRegression, width: float, error: float = 0.0, laws: Array | None = None) -> Prior:
    """Return the description as a prior of relative error `width`; laws beyond the model are free up to a size.

    Parameters
    ----------
    equations
        In base parameters.
    width
        By which the prior is weighed.
    error
        By which the description is off, as far as is known; it counts in the deviations where it exceeds `width`.
    laws
        What :func:`law_sizes` returned; without it, laws have no size.
    """
    base = equations.base
    own, covariance = _description_errors(equations)
    factor = np.zeros((len(base),) * 2)
    factor[np.ix_(own, own)] = np.linalg.inv(np.linalg.cholesky(covariance)) / width
    if laws is not None:
        sized = np.flatnonzero(np.isfinite(laws))
        factor[sized, sized] = 1.0 / laws[sized]
    return Prior(base.T @ equations.nominal, factor, max(error / width, 1.0))


def law_sizes(blocks: Blocks, equations: BaseRegression) -> Array:
    """Return the size (B,) at which each law beyond the model makes all the torque of its joint; NaN for the others.

    A joint that never reverses shows friction and the zero of its torque as one and the same constant: any two numbers
    of the right sum would fit.

    Parameters
    ----------
    blocks
        The data.
    equations
        In base parameters.
    """
    squares = np.diagonal(functools.reduce(add, blocks.grams)[0], axis1=1, axis2=2)
    columns, torques = squares[:, :-1], squares[:, -1:]
    whole = np.sum(np.where(columns > 0.0, torques, 0.0), axis=0)
    law = np.array([":" in name and not name.startswith("link_encoder:") for name in equations.base.names])
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes = np.sqrt(whole / columns.sum(axis=0))
    return np.where(law & np.isfinite(sizes) & (sizes > 0.0), sizes, np.nan)


def _description_errors(equations: BaseRegression) -> tuple[NDArray[np.intp], Array]:
    """Return which base parameters are the arm's own, and the covariance of their description at a relative error 1."""
    base, scales = equations.base, natural_scales(equations)
    own = np.flatnonzero(np.isfinite(scales))
    covariance = (base.T @ description_covariance(equations) @ base.T.T)[np.ix_(own, own)]
    return own, covariance + np.diag((PLACEHOLDER * scales[own]) ** 2)


def description_error(fit: Fit, equations: BaseRegression, doubt: float = 0.0) -> float:
    """Return the relative error of the description that the parameters which the data do determine speak for.

    The width of the prior in `fit`'s estimate less the description, by maximum likelihood (empirical Bayes; B. Efron,
    Large-Scale Inference, 2010, 1), parameter by parameter. The width that predicts best is none of the description's
    errors: where the data show nothing of a parameter, any narrow prior predicts as well.

    Parameters
    ----------
    fit
        Without a prior.
    equations
        In base parameters.
    doubt
        Return the smallest error above it whose log-likelihood is more than this below its own; it itself when 0.
    """
    own, covariance = _description_errors(equations)
    seen = np.isfinite(fit.std[own])
    off = (fit.Psi - equations.base.T @ equations.nominal)[own][seen]
    described, noise = np.diag(covariance)[seen], fit.std[own][seen] ** 2
    likelihoods = []
    for error in ERRORS:
        variance = noise + error**2 * described
        likelihoods.append(-0.5 * np.sum(np.log(variance) + off**2 / variance))
    best = int(np.argmax(likelihoods))
    if not doubt:
        return ERRORS[best]
    unlikely = np.flatnonzero(likelihoods[best] - np.array(likelihoods) > doubt)
    return ERRORS[min(unlikely[unlikely > best].tolist(), default=-1)]


def chosen_width(blocks: Blocks, fit: Fit, equations: BaseRegression) -> float | None:
    """Return the width of the prior that cross-validation prefers; None where none predicts clearly better.

    Parameters
    ----------
    blocks
        The data, in rows that are linear in the base parameters.
    fit
        Of these, without a prior: its weights are used.
    equations
        In base parameters.
    """
    if len(blocks.grams) < 2 * FOLDS:
        return None
    size = np.sqrt(np.mean((fit.weights * fit.noise) ** 2))
    parts = [_gram(blocks, part, fit.weights / size) for part in np.array_split(np.arange(len(blocks.grams)), FOLDS)]
    plain, whole = _left_out_errors(parts, None), np.sum(parts, axis=0)
    solution = np.append(-solved(whole, None), 1.0)
    if (1.0 - GAIN) * plain.sum() <= solution @ whole @ solution:
        # Nothing predicts left-out parts much better than it fits them.
        return None
    laws = law_sizes(blocks, equations)
    errors = np.array([plain, *(_left_out_errors(parts, prior_of(equations, width, laws=laws)) for width in WIDTHS)])
    total = errors.sum(axis=1)
    best = int(np.argmin(total))
    gain = errors[0] - errors[best]
    if total[best] > (1.0 - GAIN) * total[0] or gain.sum() < _standard_error(gain):
        return None
    near = [k for k in range(1, len(errors)) if total[k] - total[best] <= _standard_error(errors[k] - errors[best])]
    return WIDTHS[max(near, default=best) - 1]


def _standard_error(summands: Array) -> float:
    """Return the standard deviation of the sum of these."""
    return float(np.std(summands, ddof=1) * np.sqrt(len(summands)))


def _gram(blocks: Blocks, part: NDArray[np.intp], weights: Array) -> Array:
    """Return the weighted sums (B + 1, B + 1) of some blocks."""
    hi, lo = functools.reduce(add, [blocks.grams[k] for k in part.tolist()])
    known = np.sum([blocks.known_noise[k] for k in part.tolist()], axis=0)
    return np.asarray(np.tensordot(weights**2, hi - known + lo, 1))


def _left_out_errors(parts: Sequence[Array], prior: Prior | None) -> Array:
    """Return the squared weighted errors of each part, predicted from the others, (folds,)."""
    whole = np.sum(parts, axis=0)
    found = []
    for part in parts:
        solution = np.append(-solved(whole - part, prior), 1.0)
        found.append(solution @ part @ solution)
    return np.array(found)


def solved(gram: Array, prior: Prior | None) -> Array:
    """Return the parameters (B,) from sums, at unit length of the columns."""
    total = gram if prior is None else gram + prior.rows().T @ prior.rows()
    scale = np.sqrt(np.maximum(np.diag(total)[:-1], 0.0))
    scale = np.where(scale > 0, scale, 1.0)
    normal = total[:-1, :-1] / np.outer(scale, scale)
    return np.asarray(np.linalg.pinv(normal, rcond=1e-13, hermitian=True) @ (total[:-1, -1] / scale) / scale)


def described_width(width: float, judge: str) -> str:
    """Return in words that the description served as a prior, and what chose how far it is trusted."""
    return f"regularised towards the description, taken for wrong by {width:.2g} of it: {judge} are predicted best so"


@dataclass(frozen=True)
class HeldOut:
    """Motion that no fit has seen.

    Parameters
    ----------
    equations
        In base parameters.
    motions
        Runs of smoothed motion by recording.
    """

    equations: BaseRegression
    motions: Mapping[str, Sequence[Motion]]

    @cached_property
    def _factors(self) -> dict[str, tuple[Array, int]]:
        """Triangular factors (groups, B + 1, B + 1) of the rows of each recording, and its number of samples."""
        found = {}
        for source, motions in self.motions.items():
            grams = [self.equations.information(motion) for motion in motions]
            found[source] = cholesky(functools.reduce(add, grams)), sum(map(len, motions))
        return found

    def errors(self, Psi_base: Array) -> dict[str, dict[str, dict[str, float]]]:
        """Return recording -> equation -> joint -> rms, Nm, of base parameters."""
        scale = np.concatenate(list(self.equations.comparable(Psi_base).values()))
        return {
            source: self.equations.by_joint(scale * residual_norms(factors, Psi_base) / np.sqrt(max(samples, 1)))
            for source, (factors, samples) in self._factors.items()
        }

    @cached_property
    def nominal(self) -> dict[str, dict[str, dict[str, float]]]:
        """Errors of the description."""
        return self.errors(self.equations.base.T @ self.equations.nominal)

    def ratio(self, Psi_base: Array) -> float:
        """Return the mean log ratio of rms errors to those of the description; above 0 is worse."""
        return log_ratio(list(self.errors(Psi_base).values()), list(self.nominal.values()), self.equations)

    def worse(self, Psi_base: Array) -> list[str]:
        """Return the joints that some recording shows to be predicted clearly worse than by the description."""
        pairs = _pairs(list(self.errors(Psi_base).values()), list(self.nominal.values()), self.equations)
        return list(dict.fromkeys(joint for _, joint, a, b in pairs if a > WORSE * b))


def validated(
    result: Identification,
    identifier: Identifier,
    robot: Robot,
    effects: Sequence[EffectInstance],
    held_out: HeldOut,
) -> Identification:
    """Add the errors on held-out recordings; what they refute is pulled to the description until it is no worse.

    Parameters
    ----------
    result, identifier
        The identification so far, and the estimator that it came from.
    robot
        The nominal arm.
    effects
        Laws beyond the model.
    held_out
        What no fit has seen.
    """
    linear = not held_out.equations.summed  # Else each prior takes a search of its own: too long for a single joint.
    if held_out.ratio(result.Psi_base) > EQUAL or (linear and held_out.worse(result.Psi_base)):
        result = _pulled(result, identifier, held_out)
    if result.Psi is not None:
        result = _consistent_or_none(result, identifier, robot, effects, held_out)
    equations = held_out.equations
    arms = {"nominal": equations.base.T @ equations.nominal, "identified": result.Psi_base}
    if result.Psi is not None:
        arms["consistent"] = equations.base.T @ result.Psi
    tables = {arm: held_out.errors(Psi) for arm, Psi in arms.items()}
    found = {source: {arm: table[source] for arm, table in tables.items()} for source in held_out.motions}
    notes = list(result.notes)
    for source, by_arm in found.items():
        worse = worse_joints(by_arm["identified"], by_arm["nominal"], equations)
        notes += [f"{source} is predicted worse than by the description: {', '.join(worse)}"] if worse else []
    return result.with_(validation=found, notes=tuple(notes))


def _pulled(result: Identification, identifier: Identifier, held_out: HeldOut) -> Identification:
    """Return the result with the description as the prior that predicts held-out motion best, joint by joint first.

    A fit that is better than the description on the whole stays as it is, unless fewer joints are worse with the prior.
    """
    tries, error = [], description_error(identifier.fit(), held_out.equations, DOUBT)
    laws = law_sizes(identifier.linear_blocks(), held_out.equations)
    for width in PULLED:
        prior = prior_of(held_out.equations, width, error, laws)
        own = identifier.estimate(result.recordings, result.derivatives, None, prior)
        tries.append((len(held_out.worse(own.Psi_base)), held_out.ratio(own.Psi_base), width, own))
    now, worse = held_out.ratio(result.Psi_base), held_out.worse(result.Psi_base)
    refuted = now > EQUAL
    if refuted:
        _, ratio, width, best = min(tries, key=lambda each: each[1])
        better, said = ratio < now, ["the fit predicts the held-out recordings worse than the description does"]
    else:
        count, ratio, width, best = min(tries, key=lambda each: each[:2])
        better, said = count < len(worse) and ratio <= now + EQUAL, list[str]()
    if better:
        said += [] if refuted else [f"the fit predicts {', '.join(worse)} worse than the description does"]
        said.append(described_width(width, "the held-out recordings"))
        result = result.with_(estimates=best.estimates, covariance=best.covariance, noise=best.noise)
    if refuted and ratio > EQUAL:
        said.append("no fit near the description is better than it: do not use the identified numbers")
    return result.with_(notes=(*result.notes, *said))


def _consistent_or_none(
    result: Identification, identifier: Identifier, robot: Robot, effects: Sequence[EffectInstance], held_out: HeldOut
) -> Identification:
    """Return the result with a consistent arm that predicts no joint worse on held-out motion, or none.

    Where it does, the description is trusted more, and the laws of the joints in question stay as described.
    """
    T, worst = held_out.equations.base.T, list[str]()
    kept: list[str] = []
    correlated = (result.consistency or {}).get("correlation", 1.0)
    consistent = partial(with_consistency, result, identifier, robot, effects, correlated=correlated)
    for trust in (None, *TRUSTS):
        tried = result if trust is None else consistent(trust)
        for last in (False, True):
            if tried.Psi is None:
                break
            worse = held_out.worse(T @ tried.Psi)
            if not worse and held_out.ratio(T @ tried.Psi) <= 0.0:
                return tried.with_(notes=(*tried.notes, _described(kept))) if last else tried
            worst = worst or worse
            if last or not worse:
                break
            kept = worse
            tried = consistent(trust, described=kept)
    where = f" at {', '.join(worst)}" if worst else ""
    note = f"the consistent arm predicts the held-out recordings worse than the description{where}: "
    return result.with_(identified=None, notes=(*result.notes, note + "no robot.yaml is written"))


def log_ratio(found: Sequence[ByJoint], nominal: Sequence[ByJoint], equations: BaseRegression) -> float:
    """Return the mean log ratio of rms errors, over joints and the equations that hold a torque; above 0 is worse.

    Parameters
    ----------
    found, nominal
        What :meth:`HeldOut.errors` returned for two arms, recording by recording.
    equations
        Whose residuals they are.
    """
    return float(np.mean([np.log(a / b) for _, _, a, b in _pairs(found, nominal, equations)]))


def worse_joints(found: ByJoint, nominal: ByJoint, equations: BaseRegression) -> list[str]:
    """Return the joints that are predicted clearly worse than by the description, in words.

    Parameters
    ----------
    found, nominal, equations
        See :func:`log_ratio`, of one recording.
    """
    pairs = _pairs([found], [nominal], equations)
    unit = equations.model.robot.units.at
    return [
        f"{joint} ({side}: {a:.3g} against {b:.3g} {unit(joint, 'Nm')})" for side, joint, a, b in pairs if a > WORSE * b
    ]


def _described(joints: Sequence[str]) -> str:
    return (
        f"robot.yaml has the laws of {', '.join(joints)} as the description has them: with those identified, "
        "the held-out recordings are predicted worse"
    )


def _pairs(
    found: Sequence[ByJoint], nominal: Sequence[ByJoint], equations: BaseRegression
) -> list[tuple[str, str, float, float]]:
    sides = [
        side for side in equations.sides if equations.equations.equation(side).torque is not None
    ] or equations.sides
    return [
        (side, joint, max(one[side][joint], 1e-300), max(other[side][joint], 1e-300))
        for one, other in zip(found, nominal, strict=True)
        for side in sides
        for joint in one[side]
    ]
