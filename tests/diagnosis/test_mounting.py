"""Gravity as torques show it, on motions made up."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from elastic_arm.diagnosis.mounting import mounting_notes
from elastic_arm.dynamics import build_model
from elastic_arm.robot import Robot
from elastic_arm.robot.synthetic import random_arm

Array = NDArray[np.float64]
DOWN = np.array([0.0, 0.0, -9.81])


class Motion:
    """Angles of sines, with the torques of an arm under some gravity, dry friction and noise."""

    def __init__(self, robot: Robot, gravity: Array, channel: str) -> None:
        rng = np.random.default_rng(5)
        t, elastic = np.linspace(0.0, 10.0, 3000)[:, None], robot.elastic
        w, phase = rng.uniform(0.5, 2.0, robot.n), rng.uniform(-3.0, 3.0, robot.n)
        self.rates = {"": np.sin(w * t + phase), "d": w * np.cos(w * t + phase), "dd": -(w**2) * np.sin(w * t + phase)}
        rows = build_model(robot.with_(gravity=gravity), "mod3").inverse_dynamics(
            *(self.coordinates(rate, elastic=elastic) for rate in self.rates)
        )
        torque = rows[:, : robot.n] + (rows[:, robot.n :] if elastic and channel == "tau_m" else 0.0)
        friction = 0.1 * np.std(torque, axis=0) * np.sign(self.rates["d"])
        setattr(self, channel, torque + friction + rng.normal(0.0, 0.05, torque.shape))

    def __len__(self) -> int:
        return len(self.rates[""])

    def coordinates(self, rate: str = "", *, elastic: bool = True) -> Array:
        """Links and motors move alike."""
        return np.hstack([self.rates[rate]] * 2) if elastic else self.rates[rate]


def notes(gravity: Array, *, elastic: bool = False, channel: str = "tau_m", wrong: float = 1.0) -> list[str]:
    """Of an arm described as standing on the floor, with masses that are wrong by a factor."""
    robot = random_arm(4, np.random.default_rng(2), elastic=elastic).with_(gravity=DOWN)
    motion: Any = Motion(robot, wrong * gravity, channel)
    return mounting_notes(robot, "mod3", [motion], channel)


@pytest.mark.parametrize(("elastic", "channel"), [(False, "tau_m"), (False, "tau_J"), (True, "tau_J"), (True, "tau_m")])
def test_an_arm_on_a_wall_is_told_from_one_on_the_floor(elastic: bool, channel: str) -> None:
    """Gravity along y is named, with its size, for rigid and elastic arms and both torques."""
    (note,) = notes(np.array([0.0, 9.81, 0.0]), elastic=elastic, channel=channel)
    shown = [float(word) for word in note.split("gravity of ")[1].split(" m/s²")[0].split()]
    assert shown == pytest.approx([0.0, 9.81, 0.0], abs=0.2)
    assert "0 0 -9.81" in note


@pytest.mark.parametrize("wrong", [0.8, 1.2])
def test_an_arm_that_stands_as_described_has_no_note(wrong: float) -> None:
    """Nor where its masses, and with them its weight, are off by a fifth, or it leans by six degrees."""
    assert notes(DOWN, wrong=wrong) == []
    assert notes(np.array([0.0, 9.81 * np.sin(0.1), -9.81 * np.cos(0.1)]), wrong=wrong) == []


def test_an_arm_that_gravity_does_not_load_shows_none() -> None:
    """Sliding axes, and a description without gravity, say nothing of it."""
    slides = random_arm(3, np.random.default_rng(3), elastic=False, prismatic=range(3)).with_(gravity=DOWN)
    sideways: Any = Motion(slides, np.array([0.0, 9.81, 0.0]), "tau_m")
    assert mounting_notes(slides, "mod3", [sideways], "tau_m") == []
    robot = random_arm(4, np.random.default_rng(2), elastic=False).with_(gravity=np.zeros(3))
    assert mounting_notes(robot, "mod3", [Motion(robot, DOWN, "tau_m")], "tau_m") == []  # type: ignore[list-item]
