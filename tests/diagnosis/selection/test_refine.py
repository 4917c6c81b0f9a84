"""The optimisation of nonlinear parameters, from wherever the linear fit left them."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from elastic_arm.diagnosis.selection.refine import _Axis, _scalar, _together
from elastic_arm.diagnosis.settings import RefinementSettings
from elastic_arm.effects.parameters import Parameter

SIZE = Parameter("torque", "Nm", 0.1, 10.0, neutral=0.0)
GAIN = Parameter("change", "1", -1.0, 1.0, neutral=0.0)


@pytest.mark.parametrize("parameter", [SIZE, GAIN], ids=lambda p: p.name)
@pytest.mark.parametrize("centre", [-1e3, 1e3])
def test_a_start_far_outside_the_range_is_looked_for_at_its_end(parameter: Parameter, centre: float) -> None:
    """The linear fit may give a size that no arm has: the optimum is then looked for near the end of the range."""
    target = parameter.high if centre > 0 else parameter.low
    settings = RefinementSettings()
    axis = _Axis.of(parameter, settings.range_factor)
    (found,), _ = _scalar(lambda point: (point[0] - target) ** 2, axis, centre, 0.5, settings)
    assert parameter.low - 3.0 <= found <= 3.0 * parameter.high


def test_no_value_beyond_what_recordings_allow_is_looked_for() -> None:
    """Cost falls towards larger values: the largest that is allowed is taken, however near the range's end."""
    settings = RefinementSettings()
    for most in (3.0, 1e-3):
        axis = _Axis.of(SIZE, settings.range_factor, most)
        (found,), _ = _scalar(lambda point: -point[0], axis, axis.at(2.0), 1.0, settings)
        assert found == pytest.approx(max(most, SIZE.low / settings.range_factor), rel=1e-3)


def test_a_size_of_the_wrong_sign_starts_at_the_least_one() -> None:
    """A negative size has no logarithm: the search sets out from the smallest, without a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found, _ = _together(lambda point: float(np.sum((np.array(point) - 0.5) ** 2)), [SIZE, GAIN], (-3.0, 0.2))
    np.testing.assert_allclose(found, 0.5, atol=0.2)
