"""Effects that are known to act: stated by the description, or by the user."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.effects.effect import EffectInstance
from elastic_arm.equations.robot_at import LEAST
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.priors import STATED
from elastic_arm.evidence.terms.effect import EffectTerm, linear_prior
from elastic_arm.evidence.terms.term import Coefficients, Term


@dataclass(frozen=True, eq=False)
class KnownTerm(EffectTerm):
    """An effect that is in every set; its size has the prior of the description or its range."""

    stated: Array | None = None  # (k,) sizes that the description states
    about: Array | None = None  # (k,) sizes about which the prior of their logarithms is a Gaussian
    law: Any = None  # feature and numbers of the law as stated, where it is not linear in them

    @property
    def is_open(self) -> bool:
        """Its nonlinear numbers are known."""
        return False

    def std_at(self, trust: float) -> Array:
        """Return the deviation (k,) of the prior at a factor of the trust in the description."""
        return self.std if self.stated is None else self.std * trust

    def acting(self, fit: Coefficients, *, known: bool) -> ActingEffect:
        """Return what it adds to the torques that a model predicts, by a fit that holds it.

        A stated size moves by its logarithm, so that it keeps its sign.
        """
        acting = super().acting(fit, known=known)
        if self.about is None:
            return acting
        return replace(acting, coefficients=moved_by_logarithm(self.about, acting.coefficients))

    def steps(self, fit: Coefficients) -> Array:
        """Return how far a fit that holds it puts its stated sizes from where their prior is a
        Gaussian, in their deviations."""
        if self.about is None:
            return np.zeros(0)
        off = np.where(self.about == 0.0, 0.0, fit.beta(self) - self.about)
        return np.abs(off) / np.sqrt(np.diag(fit.covariance(self)))

    def added(self, linear: Linearisation, fit: Coefficients, along: Array) -> list[Array]:
        """Return what it adds to the residuals (N', R) of each stretch, Nm."""
        return self._added(linear, fit, along, self.coefficients(fit))

    def added_as_stated(
        self, linear: Linearisation, fit: Coefficients, along: Array
    ) -> list[Array]:
        """Return the same at its stated size; at the one found where none is stated."""
        beta = self.coefficients(fit) if self.stated is None else self.stated
        return self._added(linear, fit, along, beta)

    def _added(
        self, linear: Linearisation, fit: Coefficients, along: Array, beta: Array
    ) -> list[Array]:
        columns = self.plain(linear, fit, along)
        found = [X @ beta for X in columns]
        if self.stated is None or self.law is None:
            return found
        # Its columns are the law to first order.
        laws = zip(found, linear.data.plain(*self.law), columns, strict=True)
        return [more + W.sum(axis=2) - X @ self.stated for more, W, X in laws]


@dataclass(frozen=True, eq=False)
class StatedTerm(EffectTerm):
    """By how much a stated effect is far off, beside its :class:`KnownTerm`."""

    kind = "stated"

    @property
    def is_open(self) -> bool:
        """Its nonlinear numbers are known."""
        return False

    def again(
        self, linear: Linearisation, fit: Coefficients, others: Sequence[Term]
    ) -> Sequence[Term]:
        """Return it at another linearisation."""
        (there,) = (t for t in known_terms(linear)[1] if t.key == self.key)
        return [replace(self, columns=there.columns, feature=there.feature)]


Known = tuple[list[KnownTerm], list[StatedTerm]]


def known_terms(linear: Linearisation) -> Known:
    """Return the terms of known effects, and those by which stated ones may be far off; made
    once."""
    if "known" not in linear.cache:
        linear.cache["known"] = _known_terms(linear)
    return linear.cache["known"]


def _known_terms(linear: Linearisation) -> Known:
    problem = linear.problem
    always: list[KnownTerm] = []
    off: list[StatedTerm] = []
    acting = {one.feature.key: one.coefficients for one in linear.acting if one.known}
    for i, (feature, instance) in enumerate(problem.known):
        (feature,) = linear.placed([feature])
        theta = theta_of(feature, instance)
        X = linear.columns(feature, theta)
        if feature.fixed:
            whole = X.sum(axis=1)
            none = np.zeros(0)
            term = KnownTerm(
                feature.key, X[:, :0], none, offset=whole, feature=feature, theta=theta
            )
            always.append(term)
            continue
        std, _, _ = linear_prior(feature, problem.largest_at(feature.joint))
        if i >= len(problem.stated):
            always.append(KnownTerm(feature.key, X, std, feature=feature, theta=theta))
            continue
        stated = coefficients_of(feature, instance.parameters)
        law = _whole(feature, instance)
        # Its columns are the law to first order; the stated law is known exactly.
        offset = None if law is None else linear.columns(*law).sum(axis=1) - X @ stated
        mean, width, about = _prior_of_stated(stated, acting.get(feature.key, stated))
        width = np.where(stated == 0.0, 1e-3 * STATED * std, width)
        always.append(
            KnownTerm(
                feature.key,
                X,
                width,
                mean=mean,
                offset=offset,
                feature=feature,
                theta=theta,
                stated=stated,
                about=about,
                law=law,
            )
        )
        low = least_of(feature, len(stated)) - stated
        off.append(StatedTerm(feature.key, X, std, low=low, feature=feature, theta=theta))
    return always, off


def least_of(feature: Feature, count: int) -> Array:
    """Return the least coefficients (k,) of an effect that is stated or known: less than no
    friction would be a gain."""
    each = [np.full(p.size, p.least - (p.neutral or 0.0)) for p in feature.linear]
    least = np.concatenate([np.zeros(0), *each])
    bounded = len(least) == count and bool(np.isfinite(least).all())
    return least if bounded else np.full(count, -np.inf)


def moved_by_logarithm(sizes: Array, wanted: Array) -> Array:
    """Return sizes (k,) moved to where a fit about them wants them, smaller ones by their
    logarithm.

    b' = b exp((x - b) / b)   where x / b < 1,   x otherwise
    """
    nonzero = np.where(sizes == 0.0, 1.0, sizes)
    step = (wanted - sizes) / nonzero
    smaller = sizes * np.exp(np.minimum(step, 0.0))
    return np.where((step < 0.0) & (sizes != 0.0), smaller, wanted)


def _prior_of_stated(stated: Array, now: Array) -> tuple[Array, Array, Array]:
    """Return mean and deviation (k,) of the Gaussian that a prior of the logarithm is at a size,
    and the size.

        p(ln b) = N(ln b_0, s²):  mean = b (1 - ln(b / b_0)),  deviation = s b

    stated, now: b_0 and b, (k,). A size of another sign than the stated one counts as small.
    """
    nonzero = np.where(stated == 0.0, 1.0, stated)
    ratio = np.maximum(np.where(stated == 0.0, 1.0, now / nonzero), LEAST)
    about = stated * ratio
    return about * (1.0 - np.log(ratio)), STATED * np.abs(about), about


def theta_of(feature: Feature, instance: EffectInstance) -> tuple[float, ...]:
    """Return the nonlinear numbers of an effect with its parameters."""
    values = [np.atleast_1d(instance.parameters[p.name]) for p in feature.searched]
    return tuple(float(v) for each in values for v in each)


def _whole(feature: Feature, instance: EffectInstance) -> tuple[Feature, tuple[float, ...]] | None:
    """Return the law at its stated numbers where it is not linear in them."""
    return (feature.whole(), theta_of(feature.whole(), instance)) if feature.bends else None


def coefficients_of(feature: Feature, values: Mapping[str, Any]) -> Array:
    """Return the coefficients of the columns of an effect with these parameters."""
    if feature.phase is not None:
        size = values[feature.linear[0].name]
        phase = values[feature.phase.name]
        return size * np.array([np.cos(phase), np.sin(phase)])
    each = [np.atleast_1d(values[p.name]) - (p.neutral or 0.0) for p in feature.linear]
    return np.concatenate(each)
