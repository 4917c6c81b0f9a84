"""Whether the size of an effect is one that an engineer would believe of this arm.

A file of an effect states its range for arms of some hundred Nm. What is a torque may be larger on a larger arm: up to
what its joint carries at all, and of a sensor's zero up to a tenth of it. A mass or a length grows with the arm. Beyond
that, a number is no cause but the sign of a wrong model or channel map.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.selection.hypothesis import Hypothesis, Key
from elastic_arm.diagnosis.settings import MOST_GAIN
from elastic_arm.diagnosis.texts.notes import impossible_size_note
from elastic_arm.effects.model import SensorEffect
from elastic_arm.effects.parameters import Parameter, Role
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.equations import TORQUES
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.robot import Robot

if TYPE_CHECKING:
    from elastic_arm.diagnosis.inference.estimates import ParameterEstimate

Array = NDArray[np.float64]

MOST_TORQUE = 1.0  # of the largest torque of a joint: what an effect in it may take
MOST_OFFSET = 0.1  # of the same: what the zero of a torque channel may be off
PART_OF_ARM = 0.5  # of the arm's mass, and of its reach: what an effect may add
SLACK = 1.2  # factor on every limit; convention
RANGE_FACTOR = 3.0  # how far outside its range a searched parameter may be found, as in its refinement


class PlausibleSizes:
    """The largest sizes of effects on an arm with these torques.

    Parameters
    ----------
    robot
        Its description.
    data
        Recordings of it.
    gain
        Standard deviation of the torque channels' gains: what a joint carries is known as well as they are.
    """

    def __init__(self, robot: Robot, data: Sequence[WhitenedData], gain: float = 0.0) -> None:
        self._joints = robot.joint_names
        self._mass = sum(joint.link.mass for joint in robot.joints)
        placements = [placed for joint in robot.joints for placed in (joint.before, joint.after)]
        self._reach = sum(float(np.linalg.norm(placed[:3, 3])) for placed in placements)
        self._data = data
        self._torque = (1.0 + 2.0 * gain) * np.max([_largest_torques(one) for one in data], axis=0)
        self._peaks: dict[tuple[object, ...], float] = {}

    def notes(self, hypothesis: Hypothesis, estimated: Sequence[Mapping[str, ParameterEstimate]]) -> dict[Key, str]:
        """Return a note on each cause, by key, that came out with a size that no engineer would believe.

        Parameters
        ----------
        hypothesis
            That holds the causes.
        estimated
            The parameters of each of its candidates.
        """
        found = {}
        for k in hypothesis.causes:
            feature = hypothesis.selected[k].feature
            name = self.impossible(feature, estimated[k])
            if name is not None:
                found[feature.key] = impossible_size_note(feature, name, estimated[k][name])
        return found

    def impossible(self, feature: Feature, values: Mapping[str, ParameterEstimate]) -> str | None:
        """Return the name of a parameter that is no plausible one, None where all are.

        Parameters
        ----------
        feature
            The effect at its place.
        values
            Its parameters, as estimated.
        """
        for parameter in feature.effect.parameters:
            estimate = values.get(parameter.name)
            if estimate is None or parameter.role is Role.PHASE or parameter.integer:
                continue
            value = np.atleast_1d(np.asarray(estimate.value, dtype=float))
            searched = parameter.role is Role.SEARCHED and parameter.low > 0.0
            if searched and not self._searched(parameter, value, estimate.std):
                return parameter.name
            if not searched and not self.allows(feature, parameter, value):
                return parameter.name
        return None

    @staticmethod
    def _searched(parameter: Parameter, value: Array, std: float | None) -> bool:
        """Whether a searched parameter was found near its range, and is known to a part of itself."""
        near = (parameter.low / RANGE_FACTOR <= value) & (value <= parameter.high * RANGE_FACTOR)
        return bool(near.all()) and (std is None or bool((std < value).all()))

    def allows(self, feature: Feature, parameter: Parameter, value: Array) -> bool:
        """Whether one parameter has a plausible value.

        Parameters
        ----------
        feature
            The effect at its place.
        parameter
            Which of its numbers.
        value
            As an array, (size,).
        """
        numbers = value.ravel().tolist()
        largest = max(map(abs, numbers), default=0.0)
        if parameter.unit == "1" and parameter.neutral:
            low, high = parameter.low / SLACK, parameter.high * SLACK
            if isinstance(feature.effect, SensorEffect):
                low, high = parameter.neutral / MOST_GAIN, parameter.neutral * MOST_GAIN
            return all(low <= number <= high for number in numbers)
        if parameter.inverse and min(numbers, default=parameter.low) < parameter.low / SLACK:
            return False
        if largest <= SLACK * max(abs(parameter.low), abs(parameter.high)):
            return True
        # An angle of either sign is a zero or a mounting: it may have any value.
        if parameter.unit == "rad" and parameter.low < 0.0:
            return largest <= 2.0 * np.pi
        if parameter.unit in ("kg", "m"):
            return largest <= SLACK * PART_OF_ARM * (self._mass if parameter.unit == "kg" else self._reach)
        return parameter.unit.startswith("Nm") and self._carries(feature, parameter, largest)

    def _carries(self, feature: Feature, parameter: Parameter, value: float) -> bool:
        """Whether an effect makes no more torque than its joint carries."""
        share = MOST_OFFSET if isinstance(feature.effect, SensorEffect) else MOST_TORQUE
        joints = [self._joints.index(feature.joint)] if feature.joint in self._joints else range(len(self._joints))
        limit = SLACK * share * max(self._torque[j] for j in joints)
        return value * self._column_peak(feature, parameter) <= limit

    def _column_peak(self, feature: Feature, parameter: Parameter) -> float:
        """Return the largest torque, Nm, that a unit of a linear parameter makes in the recordings."""
        if parameter.unit == "Nm":
            return 1.0
        if feature.key not in self._peaks:
            searched = [v for p in feature.searched for v in np.atleast_1d(p.start())]
            first = [columns[:, :, 0] for one in self._data for columns in one.plain(feature, searched)]
            self._peaks[feature.key] = max(float(np.abs(part).max(initial=0.0)) for part in first)
        return self._peaks[feature.key]


def typical_torques(data: WhitenedData, channel: str | None = None) -> Array:
    """Return the root mean square (n,) Nm of the measured torque of every joint: of a channel, else of the last one."""
    measured = channel or data.layout.torques[-1]
    values = np.concatenate([getattr(part.stretch.motion, measured) for part in data.parts])
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def _largest_torques(data: WhitenedData) -> Array:
    """Return the largest torque (n,) Nm of every joint, of the channels that are measured."""
    motions = [part.stretch.motion for part in data.parts]
    measured = [name for name in TORQUES if name in data.layout.torques]
    return np.max([np.abs(getattr(motion, name)).max(axis=0) for motion in motions for name in measured], axis=0)
