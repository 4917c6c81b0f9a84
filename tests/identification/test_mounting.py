"""How an arm is mounted as its torques show it, on motions made up."""

import numpy as np
import pytest
from numpy.typing import NDArray

from elastic_arm.dynamics import build_model
from elastic_arm.estimation.motion import Motion
from elastic_arm.identification import identify
from elastic_arm.identification.batch.mounting import Mounting, other_mounting, turned
from elastic_arm.robot import Robot
from elastic_arm.simulation import simulate
from examples.known_arm import varied
from tests.helpers.motions import trajectory
from tests.helpers.random_arms import random_arm

Array = NDArray[np.float64]
DOWN = np.array([0.0, 0.0, -9.81])


def motion(
    robot: Robot, gravity: Array, channel: str, size: float = 1.0, zero: float = 0.0, seed: int = 5
) -> Motion:
    """Angles of sines, with the torques of an arm under some gravity, dry friction, a zero and
    noise."""
    rng = np.random.default_rng(seed)
    n = robot.n
    t = np.linspace(0.0, 10.0, 3000)[:, None]
    w = rng.uniform(0.5, 2.0, n)
    phase = rng.uniform(-3.0, 3.0, n)
    rates = [
        size * np.sin(w * t + phase),
        size * w * np.cos(w * t + phase),
        -size * w**2 * np.sin(w * t + phase),
    ]
    arm = build_model(robot.with_(gravity=gravity), "mod3")
    rows = arm.inverse_dynamics(
        *(np.hstack([rate, rate]) if robot.elastic else rate for rate in rates)
    )
    torque = rows[:, :n] + (rows[:, n:] if robot.elastic and channel == "tau_m" else 0.0)
    friction = 0.1 * np.std(torque, axis=0) * np.sign(rates[1])
    noisy = torque + friction + rng.normal(0.0, 0.05, torque.shape)
    noisy += zero * np.mean(np.abs(torque)) * rng.standard_normal(n)
    return Motion(t[:, 0], *rates, **{channel: noisy})


def found(
    gravity: Array, *, elastic: bool = False, channel: str = "tau_m", wrong: float = 1.0
) -> Mounting | None:
    """Of an arm described as standing on the floor, with masses that are wrong by a factor."""
    robot = random_arm(4, np.random.default_rng(2), elastic=elastic).with_(gravity=DOWN)
    return other_mounting(robot, "mod3", [motion(robot, wrong * gravity, channel)])


@pytest.mark.parametrize(
    ("elastic", "channel"), [(False, "tau_m"), (False, "tau_J"), (True, "tau_J"), (True, "tau_m")]
)
def test_an_arm_on_a_wall_is_told_from_one_on_the_floor(elastic: bool, channel: str) -> None:
    """Gravity along y is found, with its size, for rigid and elastic arms and both torques."""
    mounting = found(np.array([0.0, 9.81, 0.0]), elastic=elastic, channel=channel)
    assert mounting is not None
    assert mounting.shown == pytest.approx([0.0, 9.81, 0.0], abs=0.2)
    assert "0 0 -9.81" in mounting.note and "Rx(-90°)" in mounting.note


def test_an_arm_that_hangs_from_a_ceiling_is_told_from_one_on_the_floor() -> None:
    """Its inertia tells it from torques of the wrong sign; the note names these, too, as slow
    motion does not."""
    mounting = found(-DOWN)
    assert mounting is not None
    assert mounting.shown == pytest.approx(-DOWN, abs=0.2)
    assert "torques of the wrong sign have the same effect" in mounting.note


@pytest.mark.parametrize("wrong", [0.8, 1.2])
def test_an_arm_that_stands_as_described_is_taken_as_described(wrong: float) -> None:
    """Also where its masses, and with them its weight, are off by a fifth, or it leans by six
    degrees."""
    assert found(DOWN, wrong=wrong) is None
    assert found(np.array([0.0, 9.81 * np.sin(0.1), -9.81 * np.cos(0.1)]), wrong=wrong) is None


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("size", [0.1, 1.0])
def test_zeros_of_torque_sensors_are_no_other_mounting(size: float, seed: int) -> None:
    """Half as large as the torques, of an arm that moves little or far."""
    robot = random_arm(4, np.random.default_rng(seed), elastic=False).with_(gravity=DOWN)
    assert other_mounting(robot, "mod3", [motion(robot, DOWN, "tau_m", size, 0.5, seed)]) is None


@pytest.mark.parametrize("seed", [0, 12])
def test_a_swing_of_an_arm_whose_masses_are_off_shows_no_other_mounting(seed: int) -> None:
    """Within 1.5 s of slow motion other directions of gravity take up what masses and friction
    leave, by chance."""
    robot = random_arm(4, np.random.default_rng(seed), elastic=False).with_(gravity=DOWN)
    recorded = motion(varied(robot, np.random.default_rng(seed)), DOWN, "tau_m", seed=seed)
    assert other_mounting(robot, "mod3", [recorded[:450]]) is None


@pytest.mark.parametrize(
    "reversed_", [slice(None), slice(0, 1), slice(1, 2)], ids=["all", "the first", "the second"]
)
@pytest.mark.parametrize("seed", range(2))
def test_torques_of_the_wrong_sign_are_no_other_mounting(seed: int, reversed_: slice) -> None:
    """Of all joints or of one."""
    robot = random_arm(4, np.random.default_rng(seed), elastic=False).with_(gravity=DOWN)
    recorded = motion(robot, DOWN, "tau_m", seed=seed)
    assert recorded.tau_m is not None
    recorded.tau_m[:, reversed_] *= -1.0
    assert other_mounting(robot, "mod3", [recorded]) is None


def test_gravity_that_is_described_upwards_is_left_as_it_is() -> None:
    """Turns are those of gravity straight down."""
    robot = random_arm(4, np.random.default_rng(2), elastic=False).with_(gravity=-DOWN)
    assert (
        other_mounting(robot, "mod3", [motion(robot, np.array([0.0, 9.81, 0.0]), "tau_m")]) is None
    )


def test_an_arm_that_gravity_does_not_load_shows_none() -> None:
    """Sliding axes, and a description without gravity, say nothing of it."""
    slides = random_arm(3, np.random.default_rng(3), elastic=False, prismatic=range(3)).with_(
        gravity=DOWN
    )
    assert (
        other_mounting(slides, "mod3", [motion(slides, np.array([0.0, 9.81, 0.0]), "tau_m")])
        is None
    )
    robot = random_arm(4, np.random.default_rng(2), elastic=False).with_(gravity=np.zeros(3))
    assert other_mounting(robot, "mod3", [motion(robot, DOWN, "tau_m")]) is None


@pytest.mark.parametrize(("x", "y"), [(0.0, 1.5), (-1.0, 0.4), (0.3, -2.5), (np.pi / 2, 0.0)])
def test_the_arm_as_mounted_feels_the_gravity_that_its_torques_show(x: float, y: float) -> None:
    """In its first frame, wherever its base stands in the description."""
    robot = random_arm(3, np.random.default_rng(1), elastic=False).with_(gravity=DOWN)
    turn = turned(x, y)
    mounting = Mounting(x, y, turn.T @ DOWN, DOWN)
    mounted = mounting.of(robot)
    base = robot.base_placement[:3, :3]
    felt = mounted.base_placement[:3, :3].T @ DOWN
    assert felt == pytest.approx(base.T @ mounting.shown)


def test_a_further_tilt_and_the_mounting_are_one_turn() -> None:
    """Under both together the arm feels gravity as under the turn that is stated."""
    mounting = Mounting(0.2, 1.4, DOWN, DOWN)
    total = mounting.tilted(0.02, -0.03)
    felt = turned(0.2, 1.4).T @ turned(0.02, -0.03).T @ DOWN
    together = turned(*total).T @ DOWN
    assert together == pytest.approx(felt)
    assert mounting.tilted(0.0, 0.0) == pytest.approx((0.2, 1.4))


@pytest.mark.nightly
def test_an_arm_described_on_its_side_is_identified_as_it_stands() -> None:
    """A note states it, and what is left is what a description of the true mounting leaves."""
    robot = random_arm(3, np.random.default_rng(4), elastic=False).with_(gravity=DOWN)
    recording = simulate(robot, trajectory(seed=3), rng=np.random.default_rng(1))
    turn = np.eye(4)
    turn[:3, :3] = turned(np.pi / 2, 0.0)
    described = robot.with_(base_placement=turn @ robot.base_placement)
    found = identify(recording, described)
    upright = identify(recording, robot)
    assert any("mounted differently" in note for note in found.notes)
    assert not any("mounted differently" in note for note in upright.notes)
    for equation, errors in upright.noise.items():
        assert found.noise[equation] == pytest.approx(errors, rel=0.05)
