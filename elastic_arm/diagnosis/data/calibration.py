"""The model at the numbers that the recordings determine, beside the effects that are known or found.

A description is wrong everywhere, and a sensor a little. Both are nuisance parameters with priors
(:mod:`.nuisance`); the residuals are linearised where these lie most probably (Gauss-Newton), and late channels are
moved back in time, so that what is left of them acts linearly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.data.nuisance import (
    PRESLIDING,
    NuisanceParameter,
    calibrated_robot,
    lags,
    nuisance_columns,
    nuisance_parameters,
)
from elastic_arm.diagnosis.result import Imperfection
from elastic_arm.diagnosis.selection.candidates import feature_of, features
from elastic_arm.diagnosis.selection.marginalisation import NuisanceColumns
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary, build_library
from elastic_arm.diagnosis.selection.stepwise import misfit
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.dynamics import Model, build_model
from elastic_arm.effects import Effect, EffectInstance
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.effects.model import SensorEffect
from elastic_arm.errors import RobotError
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.equations import EquationSet
from elastic_arm.estimation.observation import Observation
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.robot import Robot
from elastic_arm.sensors import Sensors

Array = NDArray[np.float64]
# The channels of a recording that sensors make.
SENSED = {"link_encoder": "q", "motor_encoder": "theta", "joint_torque": "tau_J", "motor_torque": "tau_m"}
Observed = Sequence[Sequence[Observation]]


@dataclass(frozen=True)
class CalibrationProblem:
    """What a calibration needs of recordings and question.

    Parameters
    ----------
    robot, model
        The description, and the variant of the model.
    observed
        The recordings of identification and validation.
    layout, band
        Usable equations, and where they are compared.
    parameters
        The nuisance parameters.
    known
        Effects that count as part of the model.
    settings
        All thresholds.
    """

    robot: Robot
    model: str
    observed: Observed
    layout: EquationSet
    band: Band
    parameters: tuple[NuisanceParameter, ...]
    known: Sequence[EffectInstance]
    settings: DiagnosisSettings


@dataclass(frozen=True)
class Linearised:
    """Residuals and columns where the nuisance parameters have certain values.

    Parameters
    ----------
    model
        The calibrated model.
    library
        Columns of known effects and candidates.
    given
        The known effects.
    values
        (k,) of the nuisance parameters, in standard deviations of their priors.
    observed
        The recordings of identification and validation, late channels moved back.
    """

    model: Model
    library: RegressorLibrary
    given: tuple[Candidate, ...]
    values: Array
    observed: tuple[tuple[Observation, ...], tuple[Observation, ...]]


def problem_of(
    robot: Robot,
    model: str,
    observed: Observed,
    layout: EquationSet,
    band: Band,
    effects: Sequence[Effect],
    known: Sequence[EffectInstance],
    settings: DiagnosisSettings,
    *,
    refit: bool,
) -> CalibrationProblem:
    """Return the problem with the nuisance parameters of an arm and its recorded channels.

    Parameters
    ----------
    robot, model
        The description, and the variant of the model.
    observed
        The recordings of identification and validation.
    layout, band
        Usable equations, and where they are compared.
    effects
        Those of sensors among them have priors.
    known
        Effects that count as part of the model.
    settings
        All thresholds.
    refit
        Whether the description is uncertain; otherwise there are no nuisance parameters.
    """
    if not refit:
        return CalibrationProblem(robot, model, observed, layout, band, (), known, settings)
    equations = ArmEquations(robot, model)
    recorded = observed[0][0].pieces[0].recorded
    shown = [f for f in features(equations, effects) if _channels(f, robot.n) <= recorded]
    parameters = nuisance_parameters(robot, settings.priors, shown, observed[0][0].rate)
    return CalibrationProblem(robot, model, observed, layout, band, parameters, known, settings)


def _channels(feature: Feature, n: int) -> set[str]:
    """Return the channels of which a sensor's effect can be seen: what it changes, and the other encoder."""
    effect = feature.effect
    assert isinstance(effect, SensorEffect)
    exact, instance = Sensors.exact(), feature.instance([1e-3])
    changed = effect.change(exact, 0, n, instance.parameters)
    found = {channel for name, channel in SENSED.items() if getattr(changed, name) != getattr(exact, name)}
    return found | ({"theta"} if "q" in found else set())


def linearise(
    problem: CalibrationProblem,
    values: Array,
    candidates: Sequence[Feature],
    extra: Sequence[Candidate] = (),
    noise: float = 1.0,
) -> tuple[Linearised, list[Candidate]]:
    """Evaluate residuals and columns at values of the nuisance parameters; return them and `extra` among them.

    Parameters
    ----------
    problem
        What is calibrated.
    values
        (k,) in standard deviations of the priors.
    candidates
        What competes; with none, only the known effects are evaluated.
    extra
        Candidates of another linearisation.
    noise
        Variance at which the whitened residuals count as white noise.
    """
    robot, predicted = problem.robot, len(problem.parameters) > 0
    if predicted:
        robot = calibrated_robot(robot, problem.parameters, values)
    model = build_model(robot, problem.model)
    late = lags(problem.parameters, values, robot.joint_names)
    aligned = [tuple(o.aligned(late) for o in part) if late else tuple(part) for part in problem.observed]
    identify, validate = (
        WhitenedData(model, part, problem.layout, problem.band, predicted=predicted) for part in aligned
    )
    nuisance = _nuisance(problem, model, (identify, validate), values, noise) if predicted else None
    equations = ArmEquations(robot, problem.model)
    moved = [replace(feature, equations=equations) for feature in candidates]
    library = build_library(identify, validate, moved, problem.settings.candidates, nuisance)
    given = [_given(library, feature_of(instance, equations), instance) for instance in problem.known]
    again = [library.add(replace(c.feature, equations=equations), c.searched, fixed=c.fixed) for c in extra]
    library.close()
    return Linearised(model, library, tuple(given), values, (aligned[0], aligned[1])), again


def _nuisance(
    problem: CalibrationProblem, model: Model, data: tuple[WhitenedData, WhitenedData], values: Array, noise: float
) -> NuisanceColumns:
    columns = [nuisance_columns(model, problem.robot, one, problem.parameters) for one in data]
    white = (data[0].whiten(columns[0]), data[1].whiten(columns[1]))
    limits = np.array([parameter.limit for parameter in problem.parameters])
    joints = tuple(parameter.joint for parameter in problem.parameters)
    return NuisanceColumns(white, columns[1], -values, limits, joints, noise)


def _given(library: RegressorLibrary, feature: Feature, instance: EffectInstance) -> Candidate:
    values = [np.atleast_1d(instance.parameters[p.name]) for p in feature.searched]
    searched = tuple(float(v) for v in np.concatenate([*values, np.zeros(0)]))
    return library.add(feature, searched, fixed=feature.fixed)


def calibrate(problem: CalibrationProblem, start: Array, extra: Sequence[Candidate] = ()) -> tuple[Array, float]:
    """Return the most probable values (k,) of the nuisance parameters, and the variance of what they leave as noise.

    Gauss-Newton steps, as long as they lower the misfit; unexplained misfit counts as noise, so that what no parameter
    explains does not bend them.

    Parameters
    ----------
    problem
        What is calibrated.
    start
        (k,) where to begin.
    extra
        Effects that were found.
    """
    # Gains and offsets act linearly: they stay in the columns.
    moves = np.array([parameter.moves_model for parameter in problem.parameters], dtype=bool)
    values, best, least = start, start, np.inf
    for _ in range(problem.settings.refit.steps):
        try:
            found, again = linearise(problem, values, (), extra)
        except RobotError:  # no physical body is like that: stay where the arm still was one
            break
        selected = [*found.given, *again]
        left = misfit(found.library, selected)
        if left > problem.settings.refit.improvement * least:
            break
        best, least = values, left
        step, _ = found.library.nuisance_step(selected, effective_noise(left, problem.settings))
        values = np.where(moves, values + step, 0.0)
    return best, effective_noise(least, problem.settings)


def effective_noise(misfit: float, settings: DiagnosisSettings) -> float:
    """Return the variance at which whitened residuals count as white noise.

    What is unexplained is coloured: fewer of its rows are independent than there are.

    Parameters
    ----------
    misfit
        Mean square of the whitened residuals.
    settings
        Largest discount for colour.
    """
    return misfit * min(misfit, settings.refit.most_discount)


def imperfections(
    problem: CalibrationProblem, found: Linearised, selected: Sequence[Candidate]
) -> tuple[Imperfection, ...]:
    """Return what the recordings determine of each nuisance parameter.

    Parameters
    ----------
    problem
        What was calibrated.
    found
        Residuals and columns.
    selected
        The known effects and the causes.
    """
    if not problem.parameters:
        return ()
    left = effective_noise(misfit(found.library, selected), problem.settings)
    values, stds = found.library.nuisance_step(selected, left)
    beyond = problem.settings.refit.beyond_ordinary
    return tuple(
        Imperfection(
            p.what,
            p.joint,
            p.unit,
            float(p.neutral + (at + value) * p.prior_std),
            float(std * p.prior_std),
            p.prior_std,
            bool(abs(at + value) <= beyond + 2.0 * std),
        )
        for p, at, value, std in zip(problem.parameters, found.values, values, stds, strict=True)
        if not p.what.startswith(PRESLIDING)
    )
