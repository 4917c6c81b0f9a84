"""Channels whose numbers are finite and yet of no arm throughout: nothing can be computed from them."""

from __future__ import annotations

import numpy as np

from elastic_arm.codegen.parallel import share_out
from elastic_arm.errors import RecordingError
from elastic_arm.recording.inspection.plausibility import listed
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array

# rad (or m), rad/s, Nm, rad/s². Angles larger than that have lost the digits that a motion is computed from; numbers of
# this size are counts of an encoder, or a channel that holds something else.
LARGEST = {"position": 1e6, "velocity": 1e6, "effort": 1e9, "acceleration": 1e9}
# Nm; the squares of smaller torques are zero, whatever they measure.
SMALLEST_TORQUE = 1e-150
_BLOCK = 16384  # samples looked at together: what a core's cache holds
_ROWS = 64  # samples taken for one row
_UNITS = {"position": "rad", "velocity": "rad/s", "effort": "Nm", "acceleration": "rad/s²"}


def require_possible(recording: Recording) -> None:
    """Refuse a recording with numbers that no arm has; single ones are to be left out before.

    Parameters
    ----------
    recording
        Without outliers.

    Raises
    ------
    RecordingError
        Naming side, channel, joints and the largest number.
    """
    channels = [
        (name, channel, values)
        for name, side in recording.measured().items()
        for channel, values in side.channels().items()
    ]
    for (name, channel, _), largest in zip(channels, share_out(lambda one: _largest(one[2]), channels), strict=True):
        beyond = largest > LARGEST[channel]
        if beyond.any():
            what = f"{name} {channel} of {listed(recording.joints, beyond)}"
            raise RecordingError(
                f"{recording.source or 'the recording'}: {what} reaches {largest.max():.3g} {_UNITS[channel]}, "
                "which is of no arm",
                "Look at its unit, and at what the channel holds",
            )
        if channel == "effort" and 0.0 < largest.max() < SMALLEST_TORQUE:
            raise RecordingError(
                f"{recording.source or 'the recording'}: {name} effort is {largest.max():.3g} Nm at most, which is "
                "of no arm",
                "Look at its unit, and at what the channel holds",
            )


def _largest(values: Array) -> Array:
    """Return the largest magnitude (n,) in each column (N, n); joints without the channel hold NaN."""
    largest = np.zeros(values.shape[1])
    for start in range(0, len(values), _BLOCK):
        block = values[start : start + _BLOCK]
        # NumPy is slow along the first axis of a narrow array: many rows are taken for one.
        rows = block.reshape(-1, _ROWS * len(largest)) if len(block) % _ROWS == 0 else block
        for extreme in (np.fmax.reduce(rows, axis=0), np.fmin.reduce(rows, axis=0)):
            found = np.fmax.reduce(np.abs(extreme.reshape(-1, len(largest))), axis=0)
            largest = np.fmax(largest, found)
    return largest
