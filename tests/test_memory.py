"""Memory that is kept for the next array."""

from __future__ import annotations

import sys

import numpy as np

from elastic_arm.memory import keep_memory


def test_large_arrays_are_made_as_before_where_memory_is_kept():
    """glibc takes the settings, any other library is left alone, and arrays hold what they are given."""
    assert isinstance(keep_memory(), bool)
    made = [np.full(1 << 22, float(k)) for k in range(3)]
    del made[1]
    again = np.zeros(1 << 22)
    assert not again.any()
    assert (made[0] == 0.0).all() and (made[1] == 2.0).all()
    assert sys.platform.startswith("linux") or not keep_memory()
