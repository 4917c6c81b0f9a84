"""Residuals of a model, and their derivatives, at certain values of its nuisance parameters.

A description is wrong everywhere, and a sensor a little. Both are nuisance parameters with priors
(:mod:`.nuisance`), in which the residuals are linear nearby. Late channels are moved back in time, so that what is left
of them acts linearly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.codegen.parallel import share_out
from elastic_arm.diagnosis.calibration.calibrated_robot import nearest_robot
from elastic_arm.diagnosis.calibration.channels import gains, lags
from elastic_arm.diagnosis.calibration.columns import (
    calibrated_parameters,
    features_at,
    inertial_columns,
    nuisance_columns,
)
from elastic_arm.diagnosis.calibration.problem import CalibrationProblem, Observations
from elastic_arm.diagnosis.selection.marginalisation import NuisanceColumns
from elastic_arm.dynamics import Model, build_model
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.estimation.whitening import WhitenedData

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Expansion:
    """Residuals and their derivatives at certain values of the nuisance parameters.

    Parameters
    ----------
    model
        At these values.
    values
        (k,) of the nuisance parameters, in standard deviations of their priors.
    observed
        The recordings of identification and validation, late channels moved back, torques without their gains.
    data
        Their whitened residuals.
    nuisance
        The derivatives by the nuisance parameters; None where there are none.
    inertial
        Those among them that depend on the motion alone, of each stretch of both data sets.
    late
        By how much each channel was moved back, (n,) s.
    acting
        Known effects as they were fitted: what sensors' gains and temperature scale.
    derived_at
        Values of the nuisance parameters (k,) and known effects with which the derivatives were evaluated.
    """

    model: Model
    values: Array
    observed: tuple[Observations, Observations]
    data: tuple[WhitenedData, WhitenedData]
    nuisance: NuisanceColumns | None
    inertial: tuple[list[Array], list[Array]] | None = None
    late: Mapping[str, Array] = field(default_factory=dict)
    acting: tuple[ActingEffect, ...] = ()
    derived_at: tuple[Array, tuple[ActingEffect, ...]] | None = None

    def widened(self, factors: Array) -> Expansion:
        """Return it where the standard deviations of the priors are wider by factors (k,): the same point."""
        assert self.nuisance is not None and self.inertial is not None and self.derived_at is not None
        first, second = ([columns * factors for columns in part] for part in self.inertial)
        return replace(
            self,
            values=self.values / factors,
            nuisance=self.nuisance.widened(factors),
            inertial=(first, second),
            derived_at=(self.derived_at[0] / factors, self.derived_at[1]),
        )


def expand(
    problem: CalibrationProblem,
    values: Array,
    near: Expansion | None = None,
    acting: Sequence[ActingEffect] = (),
    *,
    same_problem: bool = False,
) -> Expansion:
    """Evaluate residuals and their derivatives at values of the nuisance parameters.

    Parameters
    ----------
    problem
        What is calibrated.
    values
        (k,) in standard deviations of the priors.
    near
        Another expansion: what depends on the motion alone is taken from it where channels moved by less than a sample.
    acting
        Known effects as they were fitted there: a sensor's gain scales their torques, too, and temperature friction.
    same_problem
        Whether the other expansion is of the same problem: its derivatives, too, are then taken from where the values
        are nearly the same. Residuals are exact in any case.

    Raises
    ------
    DiagnosisError
        If filters leave nothing of either part of the recordings.
    """
    robot, parameters = problem.robot, problem.parameters
    if parameters:
        robot = nearest_robot(robot, parameters, values)
    model = build_model(robot, problem.model)
    if parameters:
        model = model.at(calibrated_parameters(model, problem.robot, values, problem.directions))
    late = lags(parameters, values, robot.joint_names)
    scale = gains(parameters, values, robot.joint_names)
    corrected = [tuple(o.corrected(late, scale) for o in part) for part in problem.observed]

    def whitened(which: int) -> WhitenedData:
        return WhitenedData(
            model,
            corrected[which],
            problem.layout,
            problem.band,
            predicted=len(parameters) > 0,
            sticking_removed=problem.sticking_removed,
            acting=acting,
            near=None if near is None else near.data[which],
            scales=problem.scales,
        )

    identify, validate = share_out(whitened, (0, 1))
    seen, data = (corrected[0], corrected[1]), (identify, validate)
    if not parameters:
        return Expansion(model, values, seen, data, None)
    inertial = None if near is None else near.inertial
    if near is None or inertial is None or not _alike(data, late, near):
        first, second = share_out(lambda one: inertial_columns(model, one, parameters, problem.directions), data)
        inertial, near = (first, second), None
    if near is not None and same_problem and _derivatives_hold(problem, values, acting, near):
        assert near.nuisance is not None
        nuisance, derived_at = replace(near.nuisance, centre=-values), near.derived_at
    else:
        nuisance, derived_at = _nuisance(problem, model, data, values, inertial, acting), (values, tuple(acting))
    return Expansion(model, values, seen, data, nuisance, inertial, late, tuple(acting), derived_at)


def _derivatives_hold(
    problem: CalibrationProblem, values: Array, acting: Sequence[ActingEffect], near: Expansion
) -> bool:
    """Whether values and known effects are so near to those of other derivatives that these hold."""
    settings = problem.settings.refit
    if near.derived_at is None or len(acting) != len(near.derived_at[1]):
        return False
    before, others = near.derived_at
    moved = [abs(v - w) * p.widened for v, w, p in zip(values, before, problem.parameters, strict=True)]
    return max(moved, default=0.0) < settings.same_derivatives and all(
        one.feature.key == other.feature.key
        and np.allclose(one.searched, other.searched, rtol=settings.same_torques, atol=0.0)
        and np.linalg.norm(one.coefficients - other.coefficients)
        <= settings.same_torques * np.linalg.norm(other.coefficients)
        for one, other in zip(acting, others, strict=True)
    )


def _alike(data: tuple[WhitenedData, WhitenedData], late: Mapping[str, Array], near: Expansion) -> bool:
    """Whether channels were moved by the same to within a sample, and the stretches are as long."""
    rate = near.observed[0][0].rate
    lengths, others = ([len(y) for one in sets for y in one.y] for sets in (data, near.data))
    moved = [np.abs(late[k] - near.late[k]).max() for k in late] if late.keys() == near.late.keys() else [np.inf]
    return lengths == others and max(moved, default=0.0) * rate < 1.0


def _nuisance(
    problem: CalibrationProblem,
    model: Model,
    data: tuple[WhitenedData, WhitenedData],
    values: Array,
    inertial: tuple[list[Array], list[Array]],
    acting: Sequence[ActingEffect],
) -> NuisanceColumns:
    features = features_at(model, problem.parameters, acting)

    def made(which: int) -> tuple[list[Array], Array]:
        one, own, numbers = data[which], inertial[which], problem.numbers[which]
        columns = nuisance_columns(model, problem.robot, one, problem.parameters, own, features, numbers)
        return columns, one.whiten(columns)

    (_, first), (validation, second) = share_out(made, (0, 1))
    limits = np.array([parameter.limit for parameter in problem.parameters])
    joints = tuple(parameter.joint for parameter in problem.parameters)
    # Twice the widest width: below, an extra friction is how dry friction turns over.
    turned_over: dict[str, float] = {}
    for parameter in problem.parameters:
        if parameter.speeds:
            widest = 2.0 * max(parameter.speeds)
            turned_over[parameter.joint] = max(widest, turned_over.get(parameter.joint, 0.0))
    return NuisanceColumns((first, second), validation, -values, limits, joints, turned_over=turned_over)
