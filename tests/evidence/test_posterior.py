"""The posterior of a set of terms: against dense formulas, numerical integration and scipy."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm, truncnorm

from elastic_arm.evidence.posterior import mass
from elastic_arm.evidence.priors import TRUST, Assumed
from tests.evidence.made_up import bands, model, quiet, term

RNG = np.random.default_rng(1)
Y = quiet(RNG)
N = RNG.standard_normal((len(Y), 3)) * [0.3, 1.0, 0.1]
X = RNG.standard_normal((len(Y), 2)) * 0.2
ROUGH = TRUST["rough"].factor
CONSTANT = 0.5 * len(Y) * np.log(2 * np.pi)  # that the evidence leaves out


def dense(
    columns: np.ndarray, std: np.ndarray, mean: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return posterior mean, covariance and ln p(y) of y ~ N(columns mean, v + columns std²
    columns')."""
    S = np.linalg.inv(columns.T @ (columns / v[:, None]) + np.diag(std**-2.0))
    x = S @ (columns.T @ (Y / v) + mean / std**2)
    spread = np.diag(v) + (columns * std**2) @ columns.T
    return x, S, float(multivariate_normal.logpdf(Y, columns @ mean, spread))


def test_posterior_and_evidence_are_those_of_dense_formulas() -> None:
    """Mean, covariance and ln p(y) of numbers with a trust and a prior mean, and of two terms, to
    rounding."""
    mean = np.array([0.4, -1.0, 2.0])
    one, two = term("one", X[:, :1], 2.0, mean=np.array([0.3])), term("two", X, 0.7)
    fit = model(Y, N, mean=mean, assumed=Assumed("rough")).fit([one, two])
    std = np.array([ROUGH, ROUGH, ROUGH, 2.0, 0.7, 0.7])
    x, S, evidence = dense(
        np.hstack([N, X[:, :1], X]), std, np.concatenate([mean, [0.3, 0.0, 0.0]]), np.ones(len(Y))
    )
    np.testing.assert_allclose(fit.numbers, x[:3], rtol=1e-8)
    np.testing.assert_allclose(fit.number_covariance, S[:3, :3], rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(np.concatenate([fit.beta(one), fit.beta(two)]), x[3:], rtol=1e-8)
    np.testing.assert_allclose(fit.covariance(two), S[4:, 4:], rtol=1e-8)
    assert fit.found.evidence == pytest.approx(evidence + CONSTANT, abs=1e-6)


def test_numbers_that_the_data_say_nothing_of_keep_their_priors() -> None:
    """A number without a column stays at its prior mean with the trust as its deviation, and
    changes no evidence."""
    silent = np.column_stack([N, np.zeros(len(Y))])
    mean = np.array([0.4, -1.0, 2.0, 0.7])
    with_it = model(Y, silent, mean=mean, assumed=Assumed("rough")).fit([])
    without = model(Y, N, mean=mean[:3], assumed=Assumed("rough")).fit([])
    assert with_it.numbers[3] == pytest.approx(0.7)
    assert with_it.number_covariance[3, 3] == pytest.approx(ROUGH**2)
    assert with_it.found.evidence == pytest.approx(without.found.evidence)


def test_a_term_of_known_size_is_taken_off_the_residual() -> None:
    """An offset beside a free term is the free term's fit of what the offset leaves."""
    known = term("known", X[:, :0], offset=3.0 * X[:, 0])
    fit = model(Y, N).fit([known, term("free", X[:, 1])])
    alone = model(Y - 3.0 * X[:, 0], N).fit([term("free", X[:, 1])])
    np.testing.assert_allclose(fit.found.x, alone.found.x, rtol=1e-9)
    assert fit.found.evidence == pytest.approx(alone.found.evidence)


@pytest.mark.parametrize("bounds", [(0.0, np.inf), (-np.inf, 0.0), (0.05, 0.3), (-0.9, -0.5)])
def test_evidence_of_a_bounded_coefficient_is_its_integral(bounds: tuple[float, float]) -> None:
    """ln of the integral of likelihood times truncated prior, whether the optimum lies within the
    bounds or not."""
    low, high = bounds
    x, prior = X[:, 0], truncnorm(low / 0.8, high / 0.8, scale=0.8)
    first = -0.5 * Y @ Y

    def integrand(b: float) -> float:
        return float(np.exp(-0.5 * np.sum((Y - x * b) ** 2) - first) * prior.pdf(b))

    centre = float(np.clip(x @ Y / (x @ x), max(low, -5.0), min(high, 5.0)))
    ends = max(low, -5.0), min(high, 5.0)
    whole, _ = quad(integrand, *ends, points=[centre], limit=400)
    one = term("bounded", x, 0.8, low=np.array([low]), high=np.array([high]))
    assert model(Y).fit([one]).found.evidence == pytest.approx(np.log(whole) + first, abs=1e-5)


@pytest.mark.parametrize(
    ("mean", "low", "high"), [(0.0, -1.0, 2.0), (3.0, -np.inf, 0.0), (-8.0, 0.0, np.inf)]
)
def test_mass_within_bounds_is_scipys(mean: float, low: float, high: float) -> None:
    """ln of a Gaussian's mass between bounds, also where nearly all of it is outside."""
    expected = np.log(norm.cdf(high, mean, 1.5) - norm.cdf(low, mean, 1.5))
    found = mass(*(np.array([v]) for v in (mean, 1.5, low, high)))
    assert float(found[0]) == pytest.approx(expected, abs=1e-6)


def test_noise_that_nobody_explains_is_found_and_bends_nothing() -> None:
    """Three times the noise at one place in one octave: its power comes out, and rows count by
    it."""
    rng, layout = np.random.default_rng(2), bands()
    loud = layout.used[np.argmax(layout.n)]
    std = np.where(layout.of_rows == loud, 3.0, 1.0)
    y, x = std * rng.standard_normal(len(std)), rng.standard_normal(len(std))
    fit = model(y, N).fit([term("one", x)])
    k = int(np.argmax(layout.n))
    assert fit.found.v[k] == pytest.approx(9.0, rel=4.0 * np.sqrt(2.0 / layout.n[k]))
    others = np.delete(fit.found.v, k)
    assert (others < 1.0 + 5.0 * np.sqrt(2.0 / np.delete(layout.n, k))).all() and (
        fit.found.v >= 1.0
    ).all()
    alone = model(y).fit([term("one", x)])
    v = alone.found.v[np.searchsorted(layout.used, layout.of_rows)]
    assert alone.found.S[0, 0] == pytest.approx(1.0 / (np.sum(x**2 / v) + 1.0), rel=1e-2)
    assert alone.found.x[0] == pytest.approx(np.sum(x * y / v) * alone.found.S[0, 0], rel=1e-2)
