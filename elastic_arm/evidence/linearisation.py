"""Residuals and their derivatives where the numbers of arm and sensors have some values.

    r(nu, beta) = r(nu_0) - N (nu - nu_0) - X(theta) beta

Late channels are moved back in time and torques divided by their gains, so that what is left of them acts linearly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics import Model, build_model
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.equations.channels import gains, lags
from elastic_arm.equations.number_columns import calibrated_parameters, features_at, inertial_columns, nuisance_columns
from elastic_arm.equations.robot_at import nearest_robot
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.evidence.problem import Observations, Problem

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Residuals and their derivatives where the numbers of arm and sensors have some values.

    Parameters
    ----------
    problem
        Recordings, equations, numbers.
    values
        (K,) of the numbers, in standard deviations of their priors.
    acting
        Effects that act in the predicted torques.
    which
        0 for the recordings that are fitted, 1 for those that judge.
    near
        The same recordings beside other numbers: what depends on the motion alone is taken from them.
    """

    problem: Problem
    values: Array
    acting: tuple[ActingEffect, ...]
    which: int = 0
    near: WhitenedData | None = field(default=None, repr=False)

    @cached_property
    def model(self) -> Model:
        """The arm at these values."""
        p = self.problem
        model = build_model(nearest_robot(p.robot, p.numbers, self.values), p.model)
        return model.at(calibrated_parameters(model, p.robot, self.values, p.directions))

    @cached_property
    def late(self) -> dict[str, Array]:
        """By how much channels are moved back, (n,) s."""
        return lags(self.problem.numbers, self.values, self.problem.robot.joint_names)

    @cached_property
    def observed(self) -> Observations:
        """The recordings, late channels moved back, torques without their gains."""
        scale = gains(self.problem.numbers, self.values, self.problem.robot.joint_names)
        return tuple(o.corrected(self.late, scale) for o in self.problem.observed[self.which])

    @cached_property
    def data(self) -> WhitenedData:
        """Their whitened residuals."""
        p = self.problem
        return WhitenedData(
            self.model,
            self.observed,
            p.layout,
            p.band,
            predicted=True,
            sticking_removed=True,
            acting=self.acting,
            near=self.near,
        )

    @cached_property
    def plain_numbers(self) -> list[Array]:
        """Columns (N', R, K) of the numbers of each stretch, Nm for one standard deviation."""
        p = self.problem
        inertial = inertial_columns(self.model, self.data, p.numbers, p.directions)
        features = features_at(self.model, p.numbers, self.acting)
        return nuisance_columns(
            self.model, p.robot, self.data, p.numbers, inertial, features, p.indices[self.which]
        )

    @cached_property
    def numbers(self) -> Array:
        """The same whitened, (rows, K)."""
        return self.data.whiten(self.plain_numbers)

    def columns(self, feature: Feature, theta: Sequence[float] = ()) -> Array:
        """Return the whitened columns (rows, k) of an effect."""
        return self.data.whiten(self.data.plain(feature, theta))

    def placed(self, features: Sequence[Feature]) -> list[Feature]:
        """Return effects on the arm at these values."""
        equations = ArmEquations(self.model.robot, self.problem.model)
        return [feature.at(equations) for feature in features]
