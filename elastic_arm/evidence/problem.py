"""The problem to be explained: recordings, equations, uncertain numbers, and known effects."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics import Model, build_model
from elastic_arm.dynamics.bodies import inertial_parameters
from elastic_arm.effects import Effect, EffectInstance
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.equations.number_columns import STEP, directions_of
from elastic_arm.equations.numbers import Number
from elastic_arm.equations.places import feature_of, features, recorded_features
from elastic_arm.equations.robot_at import changed_link
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.equation_sets import EquationSet
from elastic_arm.estimation.observation import Observation
from elastic_arm.estimation.residuals import motion_noise
from elastic_arm.evidence.body import Body
from elastic_arm.evidence.keys import Key
from elastic_arm.evidence.numbers import (
    numbers_of,
    of_each_recording,
    resolved_speeds,
    unreferenced,
)
from elastic_arm.evidence.priors import Priors
from elastic_arm.robot import Inertia, Robot

Observations = tuple[Observation, ...]
# parts of the recordings
FITTED = 0
JUDGING = 1
ALL = 2


@dataclass(frozen=True)
class Problem:
    """The problem to be explained."""

    # robot, model: description and model variant
    robot: Robot
    model: str
    observed: tuple[Observations, Observations]  # fitted and validation recordings
    # layout, band: usable equations, and the band in which they are compared
    layout: EquationSet
    band: Band
    numbers: tuple[Number, ...]  # uncertain numbers
    directions: Array  # (P, K) derivative of Psi by them
    # stated, given: effects of the description, and known effects of the user
    stated: tuple[EffectInstance, ...]
    given: tuple[EffectInstance, ...]
    candidates: tuple[Feature, ...]  # effects that may act, at their places
    largest: Array  # (n,) largest torques of the joints, Nm
    far: frozenset[str]  # effects that report far-off numbers
    # candidates that every real drive has and the description does not state
    usual: frozenset[Key] = frozenset()
    held_back: bool = (
        False  # whether the validation recordings are the last parts of those that are fitted
    )

    @property
    def indices(self) -> tuple[range, range]:
        """Numbers of the fitted and of the validation recordings."""
        first, second = (len(part) for part in self.observed)
        return range(first), range(second) if self.held_back else range(first, first + second)

    def part(self, which: int) -> Observations:
        """Return the recordings of a part: fitted, validation, or both in this order."""
        return sum(self.observed, ()) if which == ALL else self.observed[which]

    @cached_property
    def described(self) -> Model:
        """The arm as it is described."""
        return build_model(self.robot, self.model)

    def motion_noise(self, which: int) -> list[list[Array]]:
        """Return what the noise of the encoders leaves in the residuals of the described arm, by
        recording of a part and stretch."""
        noise = self._motion_noise
        return [*noise[FITTED], *noise[JUDGING]] if which == ALL else noise[which]

    @cached_property
    def _motion_noise(self) -> list[list[list[Array]]]:
        return [[motion_noise(self.described, one) for one in part] for part in self.observed]

    def numbered(self, which: int) -> list[int]:
        """Return the number of the recording of each observation in a part."""
        first, second = self.indices
        return [[*first], [*second], [*first, *second]][which]

    @property
    def sources(self) -> dict[int, str]:
        """The sources of the recordings by number."""
        parts = zip(self.indices, self.observed, strict=True)
        return {
            k: one.source for indices, part in parts for k, one in zip(indices, part, strict=True)
        }

    @cached_property
    def known(self) -> tuple[tuple[Feature, EffectInstance], ...]:
        """Known effects at their places on the described arm, first those of the description."""
        equations = ArmEquations(self.robot, self.model)
        return tuple(
            (feature_of(instance, equations), instance) for instance in (*self.stated, *self.given)
        )

    @cached_property
    def bodies(self) -> dict[str, Body]:
        """The pseudo-inertias of the links as functions of their numbers, by joint."""
        found = {}
        for joint in self.robot.joints:
            own = [p for p in self.numbers if p.is_of_link and p.joint == joint.name]
            if own:
                found[joint.name] = _body(joint.link, own)
        return found

    def largest_at(self, joint: str | None) -> float:
        """Return the largest torque of a joint, or of all joints, Nm."""
        return float(
            self.largest.max()
            if joint is None
            else self.largest[self.robot.joint_names.index(joint)]
        )


def _body(link: Inertia, numbers: Sequence[Number]) -> Body:
    changed = []
    for number in numbers:
        deviation = {one.what: STEP * one.prior_std * (one is number) for one in numbers}
        changed.append(inertial_parameters(changed_link(link, deviation)))
    return Body.of(inertial_parameters(link), np.array(changed), STEP)


def uncertain_numbers(
    robot: Robot,
    model: str,
    observed: tuple[Observations, Observations],
    layout: EquationSet,
    effects: Sequence[Effect],
    known: Sequence[EffectInstance],
    largest: Array,
    priors: Priors,
    held_back: bool,
) -> tuple[tuple[Number, ...], Array]:
    """Return the uncertain numbers of an arm and its recorded channels, and the derivative of Psi
    by them.

    effects: of sensors, of numbers of the arm, and of warming friction; those of sensors and of
    warming friction have priors.
    """
    equations = ArmEquations(robot, model)
    friction = [feature_of(instance, equations) for instance in known]

    def acts(feature: Feature) -> bool:
        if not feature.effect.scales_friction:
            return True
        return any(feature.scales(one) for one in friction)

    recorded = recorded_features(features(equations, effects), observed[0][0].pieces[0])
    shown = [feature for feature in recorded if acts(feature)]
    pieces = [piece for one in observed[0] for piece in one.pieces]
    first = observed[0][0]
    turning = resolved_speeds(pieces, robot.n, first.rate)
    if first.turning is not None:
        turning = np.maximum(turning, first.turning)
    found = numbers_of(robot, shown, first.rate, priors, pieces, largest, turning, layout.sides)
    if layout.reads_torque_by_deflection:
        found = tuple(unreferenced(number, priors) for number in found)
    count = len(observed[0]) + (0 if held_back else len(observed[1]))
    found += of_each_recording(found, count, priors.between_recordings)
    return found, directions_of(robot, model, found)
