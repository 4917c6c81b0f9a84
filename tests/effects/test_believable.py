"""Which values of a parameter an arm may have."""

from __future__ import annotations

import pytest

from elastic_arm.effects import EFFECTS


@pytest.mark.parametrize(("value", "std", "believed"), [(0.07, 0.0, False), (0.07, 0.02, True), (0.02, 0.02, False)])
def test_an_uncertain_ratio_is_believed_where_its_interval_reaches_the_range(
    value: float, std: float, believed: bool
) -> None:
    """A damping of 0.07 +- 0.02 may be the tenth that the catalogue has; 0.02 +- 0.02 may not."""
    assert EFFECTS["damping_mismatch"].parameters[0].believable(value, 1.2, std) is believed
