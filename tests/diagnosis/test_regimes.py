"""Which regime a residual follows, on motion made up."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elastic_arm.diagnosis.regimes import regime, shares

RATIOS = (100.0, 300.0)
T = np.arange(3000) / 100.0
SPEED = np.cos(1.1 * T) + 0.4 * np.cos(2.3 * T)
ANGLE = np.sin(1.1 * T) / 1.1 + 0.4 * np.sin(2.3 * T) / 2.3
LOAD = 30.0 * np.sin(0.7 * T + 0.3)


def column(values: np.ndarray) -> np.ndarray:
    return np.stack([values, values], axis=1)


SIGNALS: Any = SimpleNamespace(
    t=T,
    values={
        "x": column(ANGLE),
        "dx": column(SPEED),
        "ddx": column(np.gradient(SPEED, T)),
        "tau_J": LOAD[:, None],
        "dtau_J": np.gradient(LOAD, T)[:, None],
        "sign_link": np.sign(SPEED)[:, None],
        "sign_motor": np.sign(SPEED)[:, None],
    },
    model_torques={"clear": LOAD[:, None]},
    once=lambda _, make: make(),
)
DATA: Any = SimpleNamespace(
    layout=SimpleNamespace(n=1, sides=("link", "motor")),
    parts=[
        SimpleNamespace(
            signals=SIGNALS,
            stretch=SimpleNamespace(
                in_band=lambda values: values, band=SimpleNamespace(kept_rate=100.0)
            ),
        )
    ],
)


@pytest.mark.parametrize(
    ("residual", "expected"),
    [
        (np.sign(SPEED), "velocity_reversal"),
        (SPEED * np.abs(SPEED), "high_speed"),
        (LOAD, "load"),
        (np.sin(100.0 * ANGLE + 0.2), "wave_generator_angle"),
        (np.sin(900.0 * ANGLE), "rotor_angle"),
        (T - 5.0, "drift"),
        (np.where(T < 1.0, 1.0, 0.0) * np.sin(40.0 * T), "start"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_residual_is_named_by_what_it_is_made_of(residual: np.ndarray, expected: str) -> None:
    """A residual that is a function of one quantity follows the regime of that quantity."""
    found = shares(DATA, [np.stack([0 * residual, residual], axis=1)], 1, RATIOS)
    assert regime(found) == expected


def test_noise_follows_no_regime() -> None:
    """White noise has a weak share of everything, and is there always."""
    noise = np.random.default_rng(0).standard_normal((3000, 2))
    assert regime(shares(DATA, [noise], 1, RATIOS)) == "always"
