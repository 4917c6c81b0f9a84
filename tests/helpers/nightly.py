"""Cases that only `make nightly` runs: the first cases of a test stand for them in every run."""

from collections.abc import Iterable
from typing import Any

import pytest


def nightly(cases: Iterable[Any]) -> list[Any]:
    """Return the cases of `pytest.mark.parametrize` with the marker `nightly`."""
    found = []
    for case in cases:
        values = case if isinstance(case, tuple) else (case,)
        found.append(pytest.param(*values, marks=pytest.mark.nightly))
    return found
