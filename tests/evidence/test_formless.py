"""Laws without a form: what is likely of them before anything is recorded."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from elastic_arm.equations.formless import FINE_SHARE, PRIORS, ROUGH, SMOOTH, _splines


def test_smooth_laws_are_likelier_than_rough_ones() -> None:
    angle = np.linspace(-1.0, 1.0, 400)
    signals: Any = SimpleNamespace(values={"x": angle[:, None]})
    sets: Any = [SimpleNamespace(parts=[SimpleNamespace(signals=signals)])]
    X = _splines(sets, lambda s: s.values["x"][:, 0], 32)(signals) @ PRIORS[ROUGH](32)
    bends = X[:, :-1]
    np.testing.assert_allclose(
        np.mean(np.sum(bends**2, axis=1)), 1.0, rtol=0.2
    )  # bends of 1 Nm make laws of 1 Nm

    def evidence(y: np.ndarray) -> float:
        """ln p(y) of a law with 0.1 Nm of noise, its size at its most probable."""
        found = []
        for size in np.geomspace(1e-3, 100.0, 40):
            C = size**2 * X @ X.T + 0.01 * np.eye(len(y))
            found.append(-0.5 * y @ np.linalg.solve(C, y) - 0.5 * np.linalg.slogdet(C)[1])
        return float(max(found))

    rng = np.random.default_rng(0)
    noise = 0.1 * rng.standard_normal(len(angle))
    rough = np.repeat(rng.choice([-1.0, 1.0], 32), 13)[: len(angle)]
    # Fits of least squares differ by as little as both laws are splines; the prior tells them
    # apart.
    assert evidence(np.sqrt(2.0) * np.sin(3.0 * angle) + noise) > evidence(rough + noise) + 50.0


def test_a_law_reaches_as_far_as_the_argument_does_in_any_recording() -> None:
    """A law that spans all recordings varies beyond the range of the first one; one of the first
    alone is constant."""
    signals: list[Any] = []
    for reach in (1.0, 2.0):
        angle = np.linspace(-reach, reach, 200)
        signals.append(SimpleNamespace(values={"x": angle[:, None]}))
    each: list[Any] = [SimpleNamespace(parts=[SimpleNamespace(signals=one)]) for one in signals]
    beyond = signals[1].values["x"][:, 0] > 1.2
    for functions in PRIORS.values():
        whole, first = (
            _splines(sets, lambda s: s.values["x"][:, 0], 16)(signals[1])[beyond] @ functions(16)
            for sets in (each, each[:1])
        )
        assert np.ptp(first, axis=0).max() < 1e-6
        assert np.ptp(whole, axis=0).max() > 0.05


def test_a_smooth_law_has_fewer_shapes_and_the_variance_of_its_kernel() -> None:
    angle = np.linspace(-1.0, 1.0, 400)
    signals: Any = SimpleNamespace(values={"x": angle[:, None]})
    sets: Any = [SimpleNamespace(parts=[SimpleNamespace(signals=signals)])]
    X = _splines(sets, lambda s: s.values["x"][:, 0], 32)(signals) @ PRIORS[SMOOTH](32)
    assert X.shape[1] < 20
    np.testing.assert_allclose(np.sum(X**2, axis=1), 2.0 + FINE_SHARE**2, rtol=0.05)
