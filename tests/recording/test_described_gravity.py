"""Torques against the gravity of the description: wrong signs and mountings are found, right ones are not blamed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from elastic_arm.cli.options import ClockChoice, read_by_clock
from elastic_arm.dynamics import build_model
from elastic_arm.recording import Recording, Side, write_recording
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.inspection.described_gravity import contradicted_gravity, wrong_signs
from elastic_arm.robot import Robot
from elastic_arm.robot.synthetic import random_arm

Array = NDArray[np.float64]
DOWN = np.array([0.0, 0.0, -9.81])
RATE = 200.0


def arm(seed: int = 2, *, elastic: bool = False) -> Robot:
    """An arm of four joints that stands on the floor."""
    return random_arm(4, np.random.default_rng(seed), elastic=elastic).with_(gravity=DOWN)


def recorded(
    robot: Robot,
    gravity: Array = DOWN,
    side: str = "link",
    speed: float = 1.0,
    flipped: Sequence[int] = (),
    seconds: float = 20.0,
) -> Recording:
    """Sines, with torques of the arm under some gravity, friction, zeros and noise; `flipped` have the other sign."""
    rng, n = np.random.default_rng(5), robot.n
    t = np.arange(round(seconds * RATE))[:, None] / RATE
    w, phase = speed * rng.uniform(0.5, 2.0, (2, n)), rng.uniform(-3.0, 3.0, (2, n))
    rates = [sum(0.6 * w[k] ** d * np.sin(w[k] * t + phase[k] + d * np.pi / 2) for k in range(2)) for d in range(3)]
    true = robot.with_(gravity=gravity)
    rows = build_model(true, "mod3").inverse_dynamics(*(np.hstack([r, r]) if robot.elastic else r for r in rates))
    torque = 1.2 * (rows[:, :n] + (rows[:, n:] if robot.elastic and side == "motor" else 0.0))
    friction = 0.1 * np.std(torque, axis=0) * np.sign(rates[1])
    torque += friction + rng.normal(0.0, 0.1, torque.shape) + rng.normal(0.0, 0.5, n)
    torque[:, list(flipped)] *= -1.0
    stamp_ns = 10**18 + np.rint(1e9 * t[:, 0]).astype(np.int64)
    position, effort = Side(stamp_ns, rates[0], rates[1]), Side(stamp_ns, effort=torque)
    if side == "motor":
        return Recording(robot.joint_names, link=position, motor=effort)
    return Recording(robot.joint_names, link=position.beside(effort))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("speed", [0.3, 1.0, 4.0])
def test_right_signs_are_not_blamed(seed: int, speed: float) -> None:
    """However fast the arm moves: torques of inertia run against gravity where links point upwards."""
    assert contradicted_gravity(recorded(arm(seed), speed=speed), arm(seed)) == []


@pytest.mark.parametrize(("side", "elastic"), [("link", False), ("motor", False), ("link", True), ("motor", True)])
def test_a_joint_of_the_wrong_sign_is_named(side: str, elastic: bool) -> None:
    """With the factor of its gravity, and the joints whose sign is right; of rigid and of elastic arms."""
    robot = arm(elastic=elastic)
    (words,) = wrong_signs(recorded(robot, side=side, flipped=[1]), robot)
    assert words.startswith(f"{side} effort of joint_2 runs against the gravity that the description predicts")
    assert "measured gravity is -1.2" in words and "has the described sign: check the sign of joint_2" in words


@pytest.mark.parametrize("which", ["all signs", "the mounting"])
def test_signs_of_all_torques_and_an_arm_upside_down_are_said_together(which: str) -> None:
    """Gravity is the same in both, so that both are named."""
    robot, gravity = arm(), DOWN if which == "all signs" else -DOWN
    (words,) = wrong_signs(recorded(robot, gravity, speed=0.3, flipped=range(4) if which == "all signs" else ()), robot)
    assert "either all torques have the wrong sign" in words and "hangs upside down" in words


def test_an_arm_on_a_wall_has_no_torques_of_the_wrong_sign() -> None:
    """Its gravity is stated by the check of the bag; the commands that fit look for the mounting themselves."""
    robot = arm()
    recording = recorded(robot, np.array([0.0, 9.81, 0.0]))
    (finding,) = contradicted_gravity(recording, robot)
    assert finding.code == "mounting" and "where the description has 0 0 -9.81" in finding.message
    assert wrong_signs(recording, robot) == []


def test_little_is_concluded_from_little() -> None:
    """A single sweep through half a period may be anything; less than a second of samples is not looked at."""
    robot = arm()
    assert contradicted_gravity(recorded(robot, flipped=range(4), seconds=0.9), robot) == []
    weightless = robot.with_(gravity=np.zeros(3))
    assert contradicted_gravity(recorded(robot, flipped=[1]), weightless) == []


def test_check_and_the_commands_that_fit_say_so(tmp_path: Path) -> None:
    """One finding of `bag check --robot`, and a note of the recording that `identify` and `diagnose` read."""
    robot = arm()
    bag = write_recording(tmp_path / "bag", recorded(robot, flipped=[1]))
    (finding,) = [finding for finding in check_bag(bag, robot=robot).findings if finding.code == "gravity_sign"]
    assert not check_bag(bag, robot=robot).ok
    notes = read_by_clock(bag, None, robot, ClockChoice.auto).notes
    assert f"{bag}: {finding.message}." in notes
