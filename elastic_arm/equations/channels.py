"""Lags and gains of channels at values of the numbers."""

from collections.abc import Sequence

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.equations.numbers import Number


def lags(parameters: Sequence[Number], values: Array, joints: Sequence[str]) -> dict[str, Array]:
    """Return by how much each channel is late, (n,) s by channel, at these values of the numbers.

    values: (k,) in units of the priors' standard deviations.
    """
    return _by_channel([p.is_lag for p in parameters], parameters, values, joints)


def gains(parameters: Sequence[Number], values: Array, joints: Sequence[str]) -> dict[str, Array]:
    """Return the gains of torque channels, (n,) by channel, at these values of the numbers.

    values: (k,) in units of the priors' standard deviations.
    """
    return _by_channel([p.is_gain for p in parameters], parameters, values, joints)


def _by_channel(
    chosen: Sequence[bool], parameters: Sequence[Number], values: Array, joints: Sequence[str]
) -> dict[str, Array]:
    """Return values of the chosen parameters, (n,) by channel in their units; as described where a
    joint has none."""
    found: dict[str, Array] = {}
    for one, parameter, value in zip(chosen, parameters, values, strict=True):
        if one and (channel := parameter.channel) is not None:
            of_joints = found.setdefault(channel, np.full(len(joints), parameter.neutral))
            of_joints[joints.index(parameter.joint)] = parameter.value(value)
    return found
