"""What a calibration needs of recordings and question: equations, nuisance parameters, known effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.calibration.columns import directions_of
from elastic_arm.diagnosis.calibration.nuisance import (
    NuisanceParameter,
    motor_inertia_scales,
    nuisance_parameters,
    of_each_recording,
    unreferenced,
)
from elastic_arm.diagnosis.selection.candidates import feature_of, features, recorded_features
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.effects import Effect, EffectInstance
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.equations import EquationSet
from elastic_arm.estimation.observation import Observation
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
    scales
        (R,) by how many times more each whitened row scatters than noise, beside the others; None where all do alike.
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
    scales: Array | None = None

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
    parameters = nuisance_parameters(
        robot, shown, first.rate, settings.priors, settings.refit, inertias, turning, layout.sides
    )
    if layout.reads_torque_by_deflection:
        parameters = tuple(unreferenced(parameter) for parameter in parameters)
    parameters += of_each_recording(parameters, exact.numbers[1].stop, settings.priors.between_recordings)
    directions = directions_of(robot, model, parameters)
    return replace(exact, parameters=parameters, directions=directions, sticking_removed=True)
