"""The trajectories that excite the prototype: one search for each model's own regressor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elastic_arm.excitation import ExcitationResult, FourierTrajectory, MotionLimits, Shape, optimise
from elastic_arm.robot.description import Robot
from elastic_arm.studies.paper.identification_study import CoefficientFit

SHAPE = Shape(harmonics=5, period=10.0, ramp=1.0)
"""The paper's duration of 10 s, between smooth ramps."""


@dataclass(frozen=True)
class ExcitationSearch:
    """A search's outcome in condition numbers of the base regressor."""

    trajectory: FourierTrajectory  # what was found
    # condition, unoptimised, random: Of the trajectory found, of the one the search began with (the best of the random
    # ones), and of the random ones within the same limits
    condition: float
    unoptimised: float
    random: np.ndarray
    course: tuple[tuple[int, float], ...]  # (evaluation, best so far)
    evaluations: int
    # Names of coefficients that no ordinary motion separates from the others, left out of the condition number
    indistinct: tuple[str, ...]
    limits: tuple[str, ...]  # limits that the arm file does not state and the search assumed


def excite(robot: Robot, model: str, evaluations: int, random: int, seed: int) -> ExcitationSearch:
    """Search the motion within the robot's limits whose regressor of `model` is conditioned best."""
    problem = CoefficientFit(robot, model)
    limits = MotionLimits.of(robot)
    columns = [int(c) for c in problem.equations.base.columns]
    rng = np.random.default_rng(seed)
    found: ExcitationResult = optimise(
        problem.model, limits, columns, rng=rng, shape=SHAPE, evaluations=evaluations, random=random
    )
    return ExcitationSearch(
        found.trajectory,
        found.condition_after,
        found.condition_before,
        found.random,
        found.history,
        found.evaluations,
        tuple(problem.names[columns.index(c)] for c in found.indistinct),
        limits.assumed,
    )
