"""What fits best with a number that no arm has gives way to what it is known to be confused with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.recording import Recording, Side
from elastic_arm.robot import load_robot
from tests.helpers.linear_axis import AXIS

RATE, STEPS, MASS, FRICTION = 500, 10, 80.0, 20.0  # Hz, steps a sample, kg, N
BENDS = 0.006  # m/s: far slower than any curve of the catalogue
ENCODER = 2e-8  # m: accelerations have hardly any noise


def recording(seed: int) -> Recording:
    """Return a linear axis whose dry friction turns over within a few mm/s, integrated by hand."""
    t, rng = np.arange(10 * RATE) / RATE, np.random.default_rng(seed)
    pace = 1.0 + 0.7 * seed
    wanted = 0.1 * np.sin(pace * t) * np.tanh(t) + 0.04 * np.sin(3.3 * pace * t)
    position, force, q, v = np.empty_like(t), np.empty_like(t), 0.0, 0.0
    for k, goal in enumerate(wanted):
        position[k], force[k] = q, 240.0 * (60.0 * (goal - q) - v)
        for _ in range(STEPS):
            v += (force[k] - FRICTION * np.tanh(v / BENDS)) / MASS / RATE / STEPS
            q += v / RATE / STEPS
    # The drive holds its command from each sample to the next: recorded is the mean of the two that a sample bounds.
    mean = 0.5 * (force + np.concatenate([force[:1], force[:-1]])) + rng.normal(0.0, 0.35, len(t))
    stamps = np.rint(1e9 * t).astype(np.int64)
    motor = Side(stamps, (position + rng.normal(0.0, ENCODER, len(t)))[:, None], effort=mean[:, None])
    return Recording(("axis",), motor=motor, source=f"axis {seed}")


@pytest.mark.slow(8)
def test_friction_that_bends_at_no_speed_of_a_catalogue_is_coulomb_friction(tmp_path: Path) -> None:
    """The curve that fits best bends at 6 mm/s, which no arm's does: Coulomb friction is named, and sized to 5 %."""
    (tmp_path / "axis.yaml").write_text(AXIS)
    found = diagnose([recording(0)], Question(load_robot(tmp_path / "axis.yaml")), [recording(1)])
    assert found.verdict == "explained"
    assert [cause.effect for cause in found.causes] == ["coulomb_friction"]
    assert found.causes[0].parameters["torque"].value == pytest.approx(FRICTION, rel=0.05)
    assert found.causes[0].confidence > 0.9
