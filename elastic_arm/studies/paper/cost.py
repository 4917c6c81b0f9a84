"""What a model costs: one inverse dynamics, one regressor, per sample of an array and per single call."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from elastic_arm.dynamics import build_model
from elastic_arm.robot.description import Robot
from elastic_arm.studies.paper.comparison import MODELS

Evaluation = Callable[..., np.ndarray]
SAMPLES = 10_000
REPEATS = 7


@dataclass(frozen=True)
class Cost:
    """Medians in microseconds: within an array of :data:`SAMPLES`, and of a call with one sample."""

    model: str
    what: str
    per_sample: float
    per_call: float


def measure(robot: Robot, rng: np.random.Generator) -> list[Cost]:
    """Time inverse dynamics and regressor of each model on this machine, kernels already compiled."""
    costs = []
    for name in MODELS:
        model = build_model(robot, name)
        many = [rng.standard_normal((SAMPLES, model.dof)) for _ in range(3)]
        one = [part[:1] for part in many]
        evaluations: dict[str, Evaluation] = {"inverse dynamics": model.inverse_dynamics, "regressor": model.regressor}
        for what, evaluate in evaluations.items():
            evaluate(*one)  # compiles the kernel
            costs.append(Cost(name, what, _median(evaluate, many) / SAMPLES, _median(evaluate, one)))
    return costs


def _median(evaluate: Evaluation, states: list[np.ndarray]) -> float:
    """Return the median time of a call, microseconds."""
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        evaluate(*states)
        times.append(time.perf_counter() - start)
    return 1e6 * float(np.median(times))
