"""Two joints that moved, with a torque that no model has: what a recording is to the regression, and nothing more."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_arm.estimation.regressors import Signals

Array = NDArray[np.float64]
Torque = Callable[[Signals], Array]

JOINT = 1
SENSOR, MOTOR = 0.26, 0.3  # Nm, noise of the joint torque sensors, and what the motors' equations have besides
COUNT = 1500


class Moved:
    """Residuals of two joints that moved for 15 s, made of white noise, and a torque on joint 2 that no model has."""

    layout = SimpleNamespace(n=2, sides=("link", "drive", "motor"), rows=6)
    band = SimpleNamespace(apply=lambda columns: columns, cutoff=40.0, rate=1000.0)

    def __init__(self, seed: int, torque: Torque, sides: dict[str, float]) -> None:
        rng = np.random.default_rng(seed)
        signals = _signals(rng)
        self.parts = [SimpleNamespace(signals=signals, stretch=SimpleNamespace(kept=slice(None)))]
        shared, own = SENSOR * rng.standard_normal((COUNT, 2)), rng.standard_normal((COUNT, 3, 2))
        scales = np.array([0.05, 0.05, MOTOR])[:, None]
        signs = np.array([1.0, 1.0, -1.0])[:, None]
        noise = scales * own + signs * shared[:, None]
        covariance = np.diag(scales[:, 0] ** 2) + SENSOR**2 * signs @ signs.T
        self._whitener = np.kron(np.linalg.inv(np.linalg.cholesky(covariance)), np.eye(2))
        self.added = torque(signals)
        self.y = [noise.reshape(COUNT, 6)]
        for side, sign in sides.items():
            self.y[0][:, 2 * self.layout.sides.index(side) + JOINT] += sign * self.added
        self.white = self.whiten([self.y[0][:, :, None]])[:, 0]
        self.freedom = float(len(self.white))

    def whiten(self, columns: Sequence[Array]) -> Array:
        return np.concatenate([(self._whitener @ c).reshape(-1, c.shape[2]) for c in columns])

    def weighted(self, columns: Sequence[Array], *, in_place: bool = False) -> list[Array]:
        return list(columns)

    def plain(self, feature: Any, searched: Sequence[float]) -> list[Array]:
        """Return the one column of a feature that acts on motor 2."""
        column = np.zeros((COUNT, 6, 1))
        column[:, 2 * self.layout.sides.index("motor") + JOINT, 0] = feature.law(self.parts[0].signals)
        return [column]


def _signals(rng: np.random.Generator) -> Signals:
    t = np.arange(COUNT) / 100.0
    omega, phase = rng.uniform(0.5, 3.0, (3, 2)), rng.uniform(0, 6.3, (3, 2))
    angle = omega * t[:, None, None] + phase
    q, dq, ddq = (f.sum(axis=1) for f in (np.sin(angle), omega * np.cos(angle), -(omega**2) * np.sin(angle)))
    load = 50.0 * np.sin(q + 0.3)
    values = {name: np.hstack([v, v]) for name, v in (("x", q), ("dx", dq), ("ddx", ddq))}
    values |= {"tau_J": load, "tau_m": load, "dtau_J": 50.0 * np.cos(q + 0.3) * dq, "dtau_m": load}
    values |= {
        "sign_link": np.tanh(dq / 1e-3),
        "sign_motor": np.tanh(dq / 1e-3),
        "progress": (t / t[-1] - 0.5)[:, None],
    }
    return Signals(t, values, model_torques={"tau_J": load, "tau_m": load, "clear": load})
