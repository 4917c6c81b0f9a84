"""Laws without a form: what is likely of them before anything is recorded."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from elastic_arm.equations.formless import _splines


def test_smooth_laws_are_likelier_than_rough_ones() -> None:
    angle = np.linspace(-1.0, 1.0, 400)
    signals: Any = SimpleNamespace(values={"x": angle[:, None]})
    sets: Any = [SimpleNamespace(parts=[SimpleNamespace(signals=signals)])]
    X = _splines(sets, lambda s: s.values["x"][:, 0], 32)(signals)
    bends = X[:, :-1]
    np.testing.assert_allclose(np.mean(np.sum(bends**2, axis=1)), 1.0, rtol=0.2)  # bends of 1 Nm make laws of 1 Nm

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
    # Fits of least squares differ by as little as both laws are splines; the prior tells them apart.
    assert evidence(np.sqrt(2.0) * np.sin(3.0 * angle) + noise) > evidence(rough + noise) + 50.0
