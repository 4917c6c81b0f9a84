"""Remove absurd numbers from a stream of samples before they reach an estimator, which cannot
forget them."""

import numpy as np
from numpy.typing import NDArray

from elastic_arm.estimation.resampling import part
from elastic_arm.recording import Samples
from elastic_arm.recording.inspection.outliers import LARGEST, sane_limits
from elastic_arm.recording.sides import SAMPLED

# Rows that the ranges are taken from: those of the last while, some of every batch.
REMEMBERED = 2000
OF_A_BATCH = 20


class StreamScreen:
    """Removes samples that no arm can have.

    Their distance from the middle of the earlier samples is a hundred times the range of these. A
    complete recording is screened more strictly
    (:func:`~elastic_arm.recording.inspection.outliers.without_outliers`): in a stream the future is
    unknown, and an arm that starts to move has to pass.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Discard all samples."""
        self.left_out = 0
        self._remembered: dict[str, NDArray[np.float64]] = {}

    def take(self, samples: Samples) -> Samples:
        """Return the samples without absurd ones."""
        good = np.ones(len(samples), np.bool_)
        known = samples.recorded()
        for name, values in known.items():
            channel = SAMPLED[name][1]
            before = self._remembered.get(name, values[:0])
            with np.errstate(over="ignore"):
                lowest, highest = sane_limits(np.concatenate([before, values]), channel)
            beyond = np.abs(values) > LARGEST[channel]
            good &= ((values >= lowest) & (values <= highest) & ~beyond).all(axis=1)
        self.left_out += int(np.count_nonzero(~good))
        rows = np.flatnonzero(good)
        for name, values in known.items():
            chosen = values[rows[:: max(len(rows) // OF_A_BATCH, 1)]]
            before = self._remembered.get(name, values[:0])
            self._remembered[name] = np.concatenate([before, chosen])[-REMEMBERED:]
        return samples if good.all() else part(samples, rows)
