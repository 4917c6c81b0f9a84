"""Columns without their leading null rows."""

from typing import NamedTuple

import numpy as np

from elastic_arm.arrays import Array


class Tail(NamedTuple):
    """Columns (rows, k) whose first rows are null."""

    start: int  # number of null rows
    columns: Array  # (other rows, k); each column is contiguous in memory

    @property
    def whole(self) -> Array:
        """The columns with all rows, each contiguous in memory."""
        if not self.start:
            return self.columns
        length, count = self.columns.shape
        found = np.zeros((count, self.start + length))
        found[:, self.start :] = self.columns.T
        return found.T

    def copy(self) -> "Tail":
        """Return a copy."""
        return Tail(self.start, self.columns.copy(order="K"))
