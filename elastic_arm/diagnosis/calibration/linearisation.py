"""Residuals and columns of a model at certain values of its nuisance parameters.

A description is wrong everywhere, and a sensor a little. Both are nuisance parameters with priors
(:mod:`.nuisance`), in which the residuals are linear nearby. Late channels are moved back in time, so that what is left
of them acts linearly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.calibration.calibrated_robot import nearest_robot
from elastic_arm.diagnosis.calibration.channels import gains, lags
from elastic_arm.diagnosis.calibration.columns import (
    calibrated_parameters,
    directions_of,
    inertial_columns,
    nuisance_columns,
)
from elastic_arm.diagnosis.calibration.nuisance import (
    NuisanceParameter,
    motor_inertia_scales,
    nuisance_parameters,
    of_each_recording,
    unreferenced,
)
from elastic_arm.diagnosis.selection.candidates import feature_of, features, recorded_features
from elastic_arm.diagnosis.selection.library_building import beside_friction, build_library
from elastic_arm.diagnosis.selection.marginalisation import NuisanceColumns
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.dynamics import Model, build_model
from elastic_arm.effects import Effect, EffectInstance
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.effect_columns import ActingEffect, Feature
from elastic_arm.estimation.equations import EquationSet
from elastic_arm.estimation.observation import Observation
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.robot import Robot

Array = NDArray[np.float64]
Observations = tuple[Observation, ...]
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
    directions
        (P, k) derivative of Psi by them.
    known
        Effects that count as part of the model.
    settings
        All thresholds.
    sticking_removed
        Whether what friction may be while a joint sticks is removed.
    held_back
        Whether the recordings of validation are the last parts of those of identification.
    """

    robot: Robot
    model: str
    observed: Observed
    layout: EquationSet
    band: Band
    parameters: tuple[NuisanceParameter, ...]
    directions: Array
    known: Sequence[EffectInstance]
    settings: DiagnosisSettings
    sticking_removed: bool = False
    held_back: bool = False

    @property
    def numbers(self) -> tuple[range, range]:
        """Numbers of the recordings of identification and validation."""
        first, second = (len(part) for part in self.observed)
        return range(first), range(second) if self.held_back else range(first, first + second)

    @property
    def sources(self) -> dict[int, str]:
        """The recordings, by number."""
        parts = zip(self.numbers, self.observed, strict=True)
        return {k: one.source for numbers, part in parts for k, one in zip(numbers, part, strict=True)}

    def source(self, parameter: NuisanceParameter) -> str | None:
        """Return the recording in which alone a nuisance parameter acts; None where it acts in all."""
        return None if parameter.recording is None else self.sources[parameter.recording]

    @cached_property
    def features(self) -> tuple[Feature, ...]:
        """The features of the known effects, on the arm as it is described."""
        equations = ArmEquations(self.robot, self.model)
        return tuple(feature_of(instance, equations) for instance in self.known)

    def extended(self, parameters: Sequence[NuisanceParameter]) -> CalibrationProblem:
        """Return the problem with further nuisance parameters, none of which is a number of the arm."""
        directions = np.pad(self.directions, ((0, 0), (0, len(parameters))))
        return replace(self, parameters=(*self.parameters, *parameters), directions=directions)

    @property
    def scales_friction(self) -> bool:
        """Whether the friction that is known may change with temperature."""
        return any(p.feature is not None and p.feature.effect.scales_friction for p in self.parameters)


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


@dataclass(frozen=True)
class Linearised:
    """An expansion with the columns of known effects and candidates.

    Parameters
    ----------
    expansion
        Model, residuals and their derivatives.
    library
        Columns of known effects and candidates.
    given
        The known effects.
    """

    expansion: Expansion
    library: RegressorLibrary
    given: tuple[Candidate, ...]

    @property
    def values(self) -> Array:
        """Values (k,) of the nuisance parameters, in standard deviations of their priors."""
        return self.expansion.values


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
    held_back: bool,
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
        Of sensors, of the arm's numbers and of warming friction; those of the first and the last have priors.
    known
        Effects that count as part of the model.
    settings
        All thresholds.
    refit
        Whether the description is uncertain; otherwise there are no nuisance parameters.
    held_back
        Whether the recordings of validation are the last parts of those of identification.
    """
    exact = CalibrationProblem(
        robot, model, observed, layout, band, (), np.zeros((0, 0)), known, settings, held_back=held_back
    )
    if not refit:
        return exact
    equations = ArmEquations(robot, model)
    friction = [feature_of(instance, equations) for instance in known]
    shown = [
        feature
        for feature in recorded_features(features(equations, effects), observed[0][0].pieces[0])
        if not feature.effect.scales_friction or any(feature.scales(one) for one in friction)
    ]
    inertias = motor_inertia_scales([piece for one in observed[0] for piece in one.pieces])
    first, turning = observed[0][0], observed[0][0].turning
    parameters = nuisance_parameters(robot, shown, first.rate, settings.priors, settings.refit, inertias, turning)
    if layout.reads_torque_by_deflection:
        parameters = tuple(unreferenced(parameter) for parameter in parameters)
    parameters += of_each_recording(parameters, exact.numbers[1].stop, settings.priors.between_recordings)
    directions = directions_of(robot, model, parameters)
    return replace(exact, parameters=parameters, directions=directions, sticking_removed=True)


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
    identify, validate = (
        WhitenedData(
            model,
            part,
            problem.layout,
            problem.band,
            predicted=len(parameters) > 0,
            sticking_removed=problem.sticking_removed,
            acting=acting,
            near=other,
        )
        for part, other in zip(corrected, near.data if near else (None, None), strict=True)
    )
    seen, data = (corrected[0], corrected[1]), (identify, validate)
    if not parameters:
        return Expansion(model, values, seen, data, None)
    inertial = None if near is None else near.inertial
    if near is None or inertial is None or not _alike(data, late, near):
        first, second = (inertial_columns(model, one, parameters, problem.directions) for one in data)
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
    columns = [
        nuisance_columns(model, problem.robot, one, problem.parameters, own, acting, numbers)
        for one, own, numbers in zip(data, inertial, problem.numbers, strict=True)
    ]
    white = (data[0].whiten(columns[0]), data[1].whiten(columns[1]))
    limits = np.array([parameter.limit for parameter in problem.parameters])
    joints = tuple(parameter.joint for parameter in problem.parameters)
    # Twice the widest width: below, an extra friction is how dry friction turns over.
    turned_over: dict[str, float] = {}
    for parameter in problem.parameters:
        if parameter.speeds:
            widest = 2.0 * max(parameter.speeds)
            turned_over[parameter.joint] = max(widest, turned_over.get(parameter.joint, 0.0))
    return NuisanceColumns(white, columns[1], -values, limits, joints, turned_over=turned_over)


def linearise(
    problem: CalibrationProblem,
    expansion: Expansion,
    candidates: Sequence[Feature],
    extra: Sequence[Candidate] = (),
    noise: float = 1.0,
) -> tuple[Linearised, list[Candidate]]:
    """Add the columns of effects to an expansion; return them and `extra` among them.

    Parameters
    ----------
    problem
        What is calibrated.
    expansion
        Where it is linearised.
    candidates
        What competes; with none, only the known effects are evaluated.
    extra
        Candidates of another linearisation.
    noise
        Variance at which the whitened residuals count as white noise.
    """
    nuisance = None if expansion.nuisance is None else replace(expansion.nuisance, noise=noise)
    equations = ArmEquations(expansion.model.robot, problem.model)
    moved = [feature.at(equations) for feature in candidates]
    library = build_library(*expansion.data, moved, problem.settings.candidates, nuisance)
    given = [
        _given(library, feature.at(equations), instance)
        for feature, instance in zip(problem.features, problem.known, strict=True)
    ]
    again = [library.add(c.feature.at(equations), c.searched, fixed=c.fixed) for c in extra]
    library.candidates.extend((*given, *again))
    library.close()
    return Linearised(expansion, library, tuple(given)), again


def _given(library: RegressorLibrary, feature: Feature, instance: EffectInstance) -> Candidate:
    values = [np.atleast_1d(instance.parameters[p.name]) for p in feature.searched]
    searched = tuple(float(v) for v in np.concatenate([*values, np.zeros(0)]))
    if feature.effect.scales_friction:
        feature = beside_friction(library, feature)
    return library.add(feature, searched, fixed=feature.fixed)
