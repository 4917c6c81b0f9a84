"""Residuals and their derivatives at given numbers of arm and sensors.

    r(nu, beta) = r(nu_0) - N (nu - nu_0) - X(theta) beta

Late channels are shifted back in time and torques are divided by their gains, so that the remaining
errors of both act linearly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from elastic_arm.arrays import Array, Mask
from elastic_arm.dynamics import Model, build_model
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.parameters import Parameter
from elastic_arm.equations.channels import gains, lags
from elastic_arm.equations.number_columns import (
    calibrated_parameters,
    features_at,
    inertial_columns,
    number_columns,
)
from elastic_arm.equations.places import allowed_values
from elastic_arm.equations.robot_at import nearest_robot
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.estimation.whitening import NearStretch, WhitenedData
from elastic_arm.evidence.problem import ALL, FITTED, JUDGING, Observations, Problem


class Motions(NamedTuple):
    """Quantities that depend only on the motion: stretches, their columns (N', R, K) of inertial
    numbers if these are kept, and the shifts of channels."""

    stretches: list[NearStretch]
    inertial: list[Array]
    late: dict[str, Array]


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Residuals and their derivatives at given numbers of arm and sensors."""

    problem: Problem  # recordings, equations, numbers
    values: Array  # (K,) of the numbers, in standard deviations of their priors
    acting: tuple[ActingEffect, ...]  # effects that act in the predicted torques
    which: int = ALL  # the part of the recordings
    # computed quantities, and before that "near": the motions of the same recordings at other
    # numbers
    cache: dict[str, Any] = field(default_factory=dict, init=False, repr=False)
    _allowed: dict[object, list[Parameter]] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def model(self) -> Model:
        """The arm at these values."""
        p = self.problem
        model = build_model(nearest_robot(p.robot, p.numbers, self.values), p.model)
        return model.at(calibrated_parameters(model, p.robot, self.values, p.directions))

    @cached_property
    def late(self) -> dict[str, Array]:
        """The shift of each channel back in time, (n,) s."""
        return lags(self.problem.numbers, self.values, self.problem.robot.joint_names)

    @cached_property
    def observed(self) -> Observations:
        """The recordings without the lags of channels and the gains of torques."""
        scale = gains(self.problem.numbers, self.values, self.problem.robot.joint_names)
        return tuple(
            o.corrected(self.late, scale, self.model.robot) for o in self.problem.part(self.which)
        )

    @property
    def judging(self) -> Linearisation:
        """The validation recordings at the same values, computed once."""
        if "judging" not in self.cache:
            self.cache["judging"] = self.part(JUDGING)
        return self.cache["judging"]

    def part(self, which: int, problem: Problem | None = None) -> Linearisation:
        """Return a part of the recordings at the same values, with the shared quantities of motion.

        problem: may differ from this one in the events of its recordings; None for this one.
        """
        found = replace(self, problem=problem or self.problem, which=which)
        fitted = len(self.problem.observed[FITTED])
        recordings = [part.recording for part in self.data.parts]
        each = zip(recordings, self.data.stretches, self.inertial, strict=True)
        own = [one for one in each if (one[0] < fitted) == (which == FITTED)]
        stretches = [stretch.without_noise() for _, stretch, _ in own]
        found.cache["near"] = Motions(stretches, [columns for *_, columns in own], self.late)
        return found

    @cached_property
    def fitted_rows(self) -> Mask:
        """Whether each whitened row (rows,) belongs to a fitted recording."""
        fitted = len(self.problem.observed[FITTED])
        of_stretches = [part.recording < fitted for part in self.data.parts]
        return np.tile(self.data.of_stretches(of_stretches), self.data.layout.rows)

    @cached_property
    def data(self) -> WhitenedData:
        """The whitened residuals."""
        p = self.problem
        near = self.cache.get("near")
        return WhitenedData(
            self.model,
            self.observed,
            p.layout,
            p.band,
            predicted=True,
            sticking_removed=True,
            acting=self.acting,
            described=(p.described, p.motion_noise(self.which)),
            near=() if near is None else near.stretches,
            whole=p.part(ALL),
        )

    @cached_property
    def inertial(self) -> list[Array]:
        """Columns (N', R, K) of the inertial numbers of each stretch, which depend only on the
        motion."""
        near = self.cache.pop("near", None)
        if near is not None and self._moves_as(near):
            return near.inertial
        return inertial_columns(
            self.model, self.data, self.problem.numbers, self.problem.directions
        )

    def _moves_as(self, near: Motions) -> bool:
        """Whether columns at other numbers belong to the same motion.

        Another lag moves them by less than a sample, or it is that of a torque.
        """
        y = self.data.y
        stretches = zip(near.inertial, y, strict=False)
        alike = len(near.inertial) == len(y) and all(len(a) == len(b) for a, b in stretches)
        if not alike or near.late.keys() != self.late.keys():
            return False
        steps = [float(np.abs(self.late[k] - near.late[k]).max()) for k in self.late]
        if max(steps, default=0.0) * self.observed[0].rate < 1.0:
            return True
        parts = zip(self.data.parts, near.stretches, strict=True)
        return all(
            other.part is not None and part.signals.shares_motion(other.part.signals)
            for part, other in parts
        )

    def anew(self) -> Linearisation:
        """Return the same linearisation without its computed quantities, except those of free
        torques."""
        found = replace(self)
        if "data" in vars(self):
            stretches = [stretch.without_motion() for stretch in self.data.stretches]
            found.cache["near"] = Motions(stretches, [], self.late)
        return found

    def moved(self, values: Array, acting: tuple[ActingEffect, ...]) -> Linearisation:
        """Return the linearisation at other values, with the shared quantities of motion."""
        there = Linearisation(self.problem, values, acting)
        there.cache["near"] = Motions(self.data.stretches, self.inertial, self.late)
        return there

    @property
    def plain_numbers(self) -> list[Array]:
        """Columns (N', R, K) of the numbers of each stretch, Nm for one standard deviation.

        Those of all recordings are large and used only once, for whitening, so each call recomputes
        them. Those of a part are cached, because they are used repeatedly.
        """
        if self.which == ALL:
            return self._number_columns()
        if "plain" not in self.cache:
            self.cache["plain"] = self._number_columns()
        return self.cache["plain"]

    def _number_columns(self) -> list[Array]:
        p = self.problem
        return number_columns(
            self.model,
            p.robot,
            self.data,
            p.numbers,
            self.inertial,
            self.features,
            p.numbered(self.which),
        )

    @cached_property
    def features(self) -> dict[int, Feature]:
        """The effects whose sizes are numbers, by the index of the number."""
        return features_at(self.model, self.problem.numbers, self.acting)

    @cached_property
    def numbers(self) -> Array:
        """The whitened columns of the numbers (rows, K)."""
        return self.data.whiten(self.plain_numbers)

    def columns(self, feature: Feature, theta: Sequence[float] = ()) -> Array:
        """Return the whitened columns (rows, k) of an effect."""
        return self.columns_at(feature, [theta])

    def columns_at(self, feature: Feature, points: Sequence[Sequence[float]]) -> Array:
        """Return the columns (rows, points x k) at several points of the nonlinear numbers."""
        return self.data.whiten(self.data.plain_at(feature, points))

    def allowed(self, feature: Feature) -> list[Parameter]:
        """Return the parameters of nonlinear numbers with the ranges that the recordings allow."""
        key = feature.key, feature.fixed  # an effect as a whole has other numbers
        if key not in self._allowed:
            own = [allowed_values(feature, p, self.data) for p in feature.searched]
            self._allowed[key] = [p for p in own for _ in range(p.size)]
        return self._allowed[key]

    def placed(self, features: Sequence[Feature]) -> list[Feature]:
        """Return effects on the arm at these values."""
        equations = ArmEquations(self.model.robot, self.problem.model)
        return [feature.at(equations) for feature in features]
