"""Effects of no catalogue as the challenge draws them: where, in which form, and how much."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from elastic_arm.studies.blind_challenge.hidden_arms.further_laws import FOREIGN

Form = Callable[[np.random.Generator, float], dict[str, float]]


def _phase(rng: np.random.Generator) -> float:
    return float(rng.uniform(-np.pi, np.pi))


# Parameters other than the size, for a run of so many seconds.
FORMS: dict[str, Form] = {
    "dress_pack": lambda rng, _: {"rest": float(rng.uniform(-0.5, 0.5)), "slack": float(rng.uniform(0.1, 0.4))},
    "periodic_disturbance": lambda rng, _: {"rate": 2 * np.pi * float(rng.uniform(0.3, 3.0)), "phase": _phase(rng)},
    "loose_payload": lambda rng, _: {"phase": _phase(rng), "relaxation": float(rng.uniform(0.05, 0.3))},
    "cogging_cable": lambda rng, _: {"rate": float(rng.uniform(8, 25)), "phase": _phase(rng)},
    "saturating_drive": lambda rng, _: {},
    "gear_creep": lambda rng, _: {"relaxation": float(rng.uniform(0.5, 4.0))},
    "worn_zone": lambda rng, _: {"place": float(rng.uniform(-0.6, 0.6)), "width": float(rng.uniform(0.1, 0.3))},
    "oil_drag": lambda rng, _: {},
    "dragging_brake": lambda rng, seconds: _while(rng, seconds),
    "sensor_crosstalk": lambda rng, _: {},
}


def sample_foreign(effect: str, n: int, seconds: float, rng: np.random.Generator) -> Fault:
    """Draw where an effect of no catalogue sits, and its parameters other than the size."""
    joint = n - 1 if effect == "loose_payload" else int(rng.integers(n))
    return Fault(effect, joint, FORMS[effect](rng, seconds))


def sized_foreign(fault: Fault, amount: float, peak: Callable[[], np.ndarray]) -> Fault:
    """Return an effect of no catalogue with so much of it."""
    size = {FOREIGN[fault.effect]: float(amount)}
    if fault.effect == "saturating_drive":
        size["limit"] = float((1.0 - amount) * peak()[fault.joint or 0])
    return replace(fault, parameters={**fault.parameters, **size})


def _while(rng: np.random.Generator, seconds: float) -> dict[str, float]:
    on = float(rng.uniform(0.15, 0.4) * seconds)
    return {"on": on, "off": on + float(rng.uniform(0.3, 0.5) * seconds)}
