"""The run of samples that is coming in: which of them count, and the first in motion, by which the rest is placed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from elastic_arm.estimation.resampling import Grid, Placing, joined, part
from elastic_arm.recording import Samples

# Length of the first samples in motion, s, from which clock and smoother are chosen.
CALIBRATION_SECONDS = 4.0
# A joint that has left its first position by so much is in motion, rad: a standing arm shows no bandwidth.
MOVED = 0.01
# Of an arm that stands longer before its first motion, the last seconds are kept, and no more samples than these.
STANDING_SECONDS = 60.0
CAPACITY = 200_000
# Samples this far behind are no stragglers, s: the clock was set back, or those before were stamped in the future.
SET_BACK = 1.0


@dataclass
class IncomingRun:
    """Samples without a jump back in time."""

    buffer: Samples | None = None  # Samples that are not on the grid yet
    placing: Placing | None = None  # Puts them there
    # points of the grid that wait for the smoother, or are part of its next window
    run: list[Grid] = field(default_factory=list)
    # since, last: time of the first sample that is held, and of the last one that came
    since: float = np.inf
    last: float = -np.inf

    @property
    def waiting(self) -> int:
        """Samples that are in no equation yet."""
        return sum(map(len, self.run)) + (0 if self.buffer is None else len(self.buffer))

    def is_before(self, samples: Samples) -> bool:
        """Return whether samples belong to another run, as time has jumped back."""
        return bool(samples.t[-1] < max(self.since, self.last - SET_BACK))

    def take(self, samples: Samples) -> Samples:
        """Keep the samples that are later than those before; return them."""
        newest = np.maximum.accumulate(np.concatenate([[self.last], samples.t]))[:-1]
        good = samples.t > newest
        kept = samples if good.all() else part(samples, np.flatnonzero(good))
        if len(kept):
            self.since = min(self.since, float(kept.t[0]))
            self.last = float(kept.t[-1])
            self.buffer = kept if self.buffer is None else joined(self.buffer, kept)
        return kept

    def first_in_motion(self, wait: bool) -> Samples | None:
        """Return the samples from which clock and smoother are chosen; None where there are none."""
        if self.buffer is None:
            return None
        onset = _onset(self.buffer)
        self.buffer = kept = part(self.buffer, self.buffer.t >= onset - STANDING_SECONDS)
        if wait and kept.t[-1] < onset + CALIBRATION_SECONDS:
            self.buffer = part(kept, slice(-CAPACITY, None))
            return None
        since = min(onset, max(kept.t[-1] - CALIBRATION_SECONDS, kept.t[0]))
        return part(kept, (kept.t >= since) & (kept.t <= since + CALIBRATION_SECONDS))


def _onset(samples: Samples) -> float:
    """Return the time at which the first joint leaves its first position; that of the last sample where all stand."""
    position = samples.q if samples.q is not None else samples.theta
    if position is None:
        return float(samples.t[-1])
    moves = (np.abs(position - position[0]) > MOVED).any(axis=1)
    return float(samples.t[np.argmax(moves) if moves.any() else -1])
