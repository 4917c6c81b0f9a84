"""Columns without their leading null rows."""

from typing import NamedTuple

import numpy as np

from elastic_arm.arrays import Array


class Tail(NamedTuple):
    """Columns (rows, k) that are null in their first rows."""

    start: int  # number of these rows
    columns: Array  # (rows from there on, k); each column stands in memory as a whole

    @property
    def whole(self) -> Array:
        """The columns with all rows, each in memory as a whole."""
        if not self.start:
            return self.columns
        length, count = self.columns.shape
        found = np.zeros((count, self.start + length))
        found[:, self.start :] = self.columns.T
        return found.T

    def copy(self) -> "Tail":
        """Return it in memory of its own."""
        return Tail(self.start, self.columns.copy(order="K"))
