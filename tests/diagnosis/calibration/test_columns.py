"""Columns of nuisance parameters."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elastic_arm.diagnosis.calibration.columns import _drive_entries, _turnover
from elastic_arm.diagnosis.calibration.nuisance import NuisanceParameter
from elastic_arm.dynamics import build_model
from elastic_arm.estimation.motion import CompletedMotion, Motion
from elastic_arm.robot import load_robot


@pytest.mark.parametrize("acceleration", [0.4, -0.4, 2.5])
def test_friction_that_turns_over_late_has_the_impulse_of_one_shape(acceleration: float) -> None:
    """A velocity 8e-4 rad/s off at reversals shifts friction in time: below the band that is the impulse of one column.

    The ratio of the two impulses is 8e-4 over the width, whatever the acceleration.
    """
    t = np.arange(-0.2, 0.2, 1e-5)
    w, early, width = acceleration * t, 8e-4, 2e-3
    shifted = np.sign(w + early * np.sign(acceleration)) - np.sign(w)
    column = _turnover(w, t, (width,))
    assert shifted.sum() / column.sum() == pytest.approx(early / width, rel=0.01)


def test_friction_that_turns_over_gradually_has_no_impulse() -> None:
    """The shapes between two widths of the sign function are odd in the velocity."""
    t = np.linspace(-0.2, 0.2, 4001)
    column = _turnover(0.7 * t, t, (5e-4, 2e-3))
    assert abs(column.sum()) < 1e-9 * np.abs(column).sum()


def test_the_column_of_a_damping_is_the_rate_at_which_the_spring_is_wound(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hysteresis carries a part of the load: where it turns over, the load changes more than the spring is wound."""
    t = np.arange(4000) / 1000.0
    robot = load_robot(None)
    model, gear = build_model(robot, "mod3"), robot.joints[1].transmission
    assert gear is not None
    wound = np.outer(2e-3 * np.sin(3 * t), np.ones(robot.n))
    load = gear.stiffness * wound + 12.0 * np.tanh(wound / 1e-4)
    signals = SimpleNamespace(values={"wound": wound, "tau_J": load}, model_torques={"tau_J": load})
    monkeypatch.setattr("elastic_arm.diagnosis.calibration.columns.predicted_torques", lambda *_: (load, load))
    part: Any = SimpleNamespace(signals=signals, stretch=SimpleNamespace(quiet=Motion(t)))
    damping = NuisanceParameter("damping", "joint_2", "1", 0.4, 1.0)
    column = _drive_entries(model, robot, part, [damping], ()).dense()[:, robot.n + 1, 0]
    assert column == pytest.approx(0.4 * gear.damping * 6e-3 * np.cos(3 * t), abs=1e-3 * 0.4 * gear.damping * 6e-3)


@pytest.mark.parametrize(("side", "row"), [("link", 1), ("motor", 7)])
def test_friction_turns_over_in_the_equation_of_its_own_side(side: str, row: int) -> None:
    """By the velocity of that side; the other equations do not show it."""
    t, robot = np.arange(2000) / 1000.0, load_robot(None)
    velocity = {"link": np.outer(0.5 * np.sin(7 * t), np.ones(robot.n)), "motor": np.outer(np.cos(5 * t), [1, 1, 1])}
    none = np.zeros_like(velocity["link"])
    quiet = CompletedMotion(t, none, velocity["link"], none, none, velocity["motor"], none, none, none)
    part: Any = SimpleNamespace(signals=None, stretch=SimpleNamespace(quiet=quiet))
    turnover = NuisanceParameter("presliding", "joint_2", "Nm", 2.0, 0.0, speeds=(5e-4, 2e-3), side=side)
    columns = _drive_entries(build_model(robot, "mod3"), robot, part, [turnover], ()).dense()[:, :, 0]
    assert columns[:, row] == pytest.approx(2.0 * _turnover(velocity[side][:, 1], t, (5e-4, 2e-3)))
    assert not np.delete(columns, row, axis=1).any()
