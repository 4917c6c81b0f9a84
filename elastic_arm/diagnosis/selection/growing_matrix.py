"""Symmetric matrices of products of columns, to which further columns are added."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SPARE = 1.5  # room over what is filled, so that few extensions copy the matrix


class GrowingMatrix:
    """A symmetric matrix that grows at its border."""

    def __init__(self) -> None:
        self._store, self._count = np.empty((0, 0)), 0

    @property
    def filled(self) -> Array:
        """The matrix (m, m), as a view."""
        return self._store[: self._count, : self._count]

    def extend(self, border: Array) -> None:
        """Add the last columns (m, k), and as many rows."""
        old, now = self._count, len(border)
        if now > len(self._store):
            room = int(SPARE * now)
            store = np.empty((room, room))
            store[:old, :old] = self.filled
            self._store = store
        self._store[:now, old:now] = border
        self._store[old:now, :old] = border[:old].T
        self._count = now
