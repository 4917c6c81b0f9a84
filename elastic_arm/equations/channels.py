"""Lags and gains of channels at given numbers."""

from collections.abc import Sequence

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.equations.numbers import Number


def lags(parameters: Sequence[Number], values: Array, joints: Sequence[str]) -> dict[str, Array]:
    """Return the lag of each channel, (n,) s, at these values of the numbers.

    values: (k,) in units of the priors' standard deviations.
    """
    late = [(p, p.value(x)) for p, x in zip(parameters, values, strict=True) if p.is_lag]
    return _by_channel(late, joints)


def gains(parameters: Sequence[Number], values: Array, joints: Sequence[str]) -> dict[str, Array]:
    """Return the gain of each torque channel, (n,), at these values of the numbers.

    values: (k,) in units of the priors' standard deviations.
    """
    scaled = [(p, p.value(x)) for p, x in zip(parameters, values, strict=True) if p.is_gain]
    return _by_channel(scaled, joints)


def _by_channel(numbers: Sequence[tuple[Number, float]], joints: Sequence[str]) -> dict[str, Array]:
    """Return the values of numbers, (n,) by channel; joints without a number are as described."""
    found: dict[str, Array] = {}
    for number, value in numbers:
        if number.channel is not None:
            of_joints = found.setdefault(number.channel, np.full(len(joints), number.neutral))
            of_joints[joints.index(number.joint)] = value
    return found
