"""Sizes that an engineer would believe of an arm, on torques made up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elastic_arm.diagnosis.inference.estimates import ParameterEstimate
from elastic_arm.diagnosis.selection.plausible_size import PlausibleSizes
from elastic_arm.effects import EFFECTS
from elastic_arm.robot import load_robot

ROBOT = load_robot(None)


def sizes(torque: float, gain: float = 0.0) -> PlausibleSizes:
    """Of an arm whose joints carry up to so many Nm, and turn at up to 0.5 rad/s; how uncertain the gain of that is."""
    motion = SimpleNamespace(tau_m=np.full((10, ROBOT.n), torque))
    data: Any = SimpleNamespace(
        parts=[SimpleNamespace(stretch=SimpleNamespace(motion=motion))],
        layout=SimpleNamespace(torques=("tau_m",)),
        plain=lambda feature, searched: [np.full((10, 3 * ROBOT.n, 1), 0.5)],
    )
    return PlausibleSizes(ROBOT, [data], gain)


def allows(effect: str, carried: float, **values: float) -> bool:
    feature: Any = SimpleNamespace(effect=EFFECTS[effect], joint="joint_2", key=(effect,), searched=())
    estimates = {name: ParameterEstimate(value, 0.01 * abs(value), "") for name, value in values.items()}
    return sizes(carried).impossible(feature, estimates) is None


@pytest.mark.parametrize(
    ("effect", "values", "expected"),
    [
        ("coulomb_friction", {"torque": 355.0}, True),
        ("viscous_friction", {"coefficient": 2050.0}, True),
        ("coulomb_friction", {"torque": 9000.0}, False),
        ("motor_torque_offset", {"offset": -1330.0}, False),
        ("motor_torque_gain", {"gain": 1.05}, True),
        ("motor_torque_gain", {"gain": 1.85}, False),
        ("joint_torque_gain", {"gain": 15.3}, False),
        ("rotor_inertia_mismatch", {"inertia": 30.0}, False),
        ("stribeck_friction", {"torque": 10.0, "speed": 0.0}, False),
        ("stribeck_friction", {"torque": 10.0, "speed": 0.1}, True),
        ("encoder_offset", {"offset": 0.4}, True),
        ("encoder_eccentricity", {"amplitude": 0.4, "phase": 1.0}, False),
        ("torque_lowpass", {"cutoff": 2.0}, True),
        ("torque_lowpass", {"cutoff": 0.06}, False),
    ],
)
def test_sizes_on_a_large_arm(effect: str, values: dict[str, float], expected: bool) -> None:
    """A joint of 5000 Nm may have friction of hundreds of Nm; no sensor is off by a quarter of that or by 85 %."""
    assert allows(effect, 5000.0, **values) == expected


@pytest.mark.parametrize(
    ("speed", "std", "expected"),
    [(1.1, 0.07, True), (2.3, 0.15, True), (20.0, 370.0, False), (1.5, 3.0, False)],
    ids=["in its range", "at its end", "far beyond it", "in it, and not determined"],
)
def test_a_bend_that_no_speed_reached_shows_is_no_number_of_an_arm(speed: float, std: float, expected: bool) -> None:
    """Friction that bends at 20 rad/s is straight wherever a joint turns, and one at 1.5 ± 3 rad/s may be."""
    feature: Any = SimpleNamespace(effect=EFFECTS["degressive_friction"], joint="joint_2", key=(), searched=())
    values = {"torque": ParameterEstimate(5.0, 1.0, "Nm"), "speed": ParameterEstimate(speed, std, "rad/s")}
    assert sizes(50.0).impossible(feature, values) == (None if expected else "speed")


def test_the_same_friction_is_too_much_for_a_small_arm() -> None:
    """Friction of 355 Nm in a joint that carries 50 Nm is no friction."""
    assert not allows("coulomb_friction", 50.0, torque=355.0)


def test_a_searched_number_that_is_not_determined_is_none() -> None:
    """A Stribeck speed within its range, known to a million rad/s, is not known."""
    feature: Any = SimpleNamespace(effect=EFFECTS["stribeck_friction"], joint="joint_2", key=("s",), searched=())
    values = {"torque": ParameterEstimate(10.0, 0.1, "Nm"), "speed": ParameterEstimate(0.1, 7.9e6, "rad/s")}
    assert sizes(500.0).impossible(feature, values) == "speed"


def test_currents_leave_room_for_the_torque_constant() -> None:
    """Friction of 140 of 100 Nm is no friction, unless the torques are currents, whose constant may be off by 30 %."""
    feature: Any = SimpleNamespace(effect=EFFECTS["coulomb_friction"], joint="joint_2", key=("dry",), searched=())
    estimate = {"torque": ParameterEstimate(140.0, 1.0, "Nm")}
    assert sizes(100.0).impossible(feature, estimate) == "torque"
    assert sizes(100.0, 0.15).impossible(feature, estimate) is None
