"""The controller of a simulated arm: commanded often enough at any sample rate, and as the
description states it."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.excitation import FourierTrajectory
from elastic_arm.robot import Inertia, JointController, Robot, load_robot, robot_to_dict, save_robot
from elastic_arm.sensors import Sensors
from elastic_arm.simulation import Controller, SimulationSettings, Simulator
from elastic_arm.simulation.controller import tuned


@pytest.fixture(scope="module")
def arm():
    return load_robot(None)


@pytest.fixture(scope="module")
def light_wrist():
    """Six stiff joints whose last links weigh a hundredth of the first: a shoulder turns them
    fast."""
    links = [replace(joint, transmission=None) for joint in load_robot(None).joints]
    joints = []
    for k in range(6):
        size = 1.0 if k < 3 else 0.01
        own = links[k % 3].link
        link = Inertia(size * own.mass, np.sqrt(size) * own.com, size**2 * own.inertia)
        joints.append(
            replace(links[k % 3], name=f"joint_{k + 1}", link_name=f"link_{k + 1}", link=link)
        )
    return Robot("light_wrist", tuple(joints))


def controlled(robot, **numbers):
    """The arm with the same controller at every joint."""
    drive = JointController(**numbers)
    return robot.with_(joints=tuple(replace(joint, controller=drive) for joint in robot.joints))


def motion(n, rate, seconds=4.0):
    a, b = np.random.default_rng(0).uniform(-0.4, 0.4, (2, n, 3))
    return FourierTrajectory(2 * np.pi / 4.0, a, b, np.zeros(n), seconds, 0.4).evaluate(
        np.arange(round(seconds * rate) + 1) / rate
    )


def follow(robot, rate, reference, **settings):
    given = SimulationSettings(rate=rate, sensors=Sensors.exact(), **settings)
    simulator = Simulator(robot, given, q0=reference[0][0], dq0=reference[1][0])
    return simulator.follow(*reference)[0]


@pytest.mark.parametrize("rate", [1000.0, 125.0, 50.0])
def test_a_stiff_arm_follows_its_reference_at_any_sample_rate(light_wrist, rate):
    """Joints that turn one another faster than samples come are commanded in between: within 3 % of
    the swing."""
    reference = motion(6, rate)
    off = np.abs(follow(light_wrist, rate, reference).theta - reference[0]).max(axis=0)
    assert (off < 0.03 * np.ptp(reference[0], axis=0)).all()


def test_torques_at_a_low_rate_are_means_over_the_samples(light_wrist):
    """Without drives tau_J, integrated with the motion, is the mean of the commands given from
    sample to sample."""
    truth = follow(light_wrist, 125.0, motion(6, 125.0))
    assert (
        np.allclose(truth.tau_J, truth.tau_m, rtol=0.0, atol=1e-9)
        and np.ptp(truth.tau_m, axis=0).min() > 0.1
    )
    assert not np.allclose(
        truth.tau_m[1:], 0.5 * (truth.command[1:] + truth.command[:-1]), atol=0.1
    )


@pytest.mark.parametrize("bearings", [False, True])
@pytest.mark.parametrize("rate", [125.0, 30.0])
def test_steps_follow_the_fastest_eigenvalue(arm, bearings, rate):
    """Drives and bearings of an elastic arm are integrated at any sample rate to the motion at 4
    kHz."""
    slow = follow(arm, rate, motion(3, rate), bearings=bearings)
    fast = follow(arm, 30.0 * 125.0, motion(3, 30.0 * 125.0), bearings=bearings)
    every = round(30.0 * 125.0 / rate)
    apart = np.abs(slow.q - fast.q[::every][: len(slow.q)]).max(axis=0)
    assert (apart < 0.02 * np.ptp(fast.q, axis=0)).all()


def test_many_commands_a_sample_step_as_they_roll(light_wrist):
    """Engines agree, and a live arm has the bits of a run, where the drives are commanded between
    samples."""
    reference = motion(6, 125.0, 1.0)
    robot = controlled(
        light_wrist, mode="both", kp=3000.0, kd=150.0, ki=500.0, delay=0.008, feedforward="gravity"
    )
    settings = SimulationSettings(rate=125.0, sensors=Sensors.exact())
    simulators = [
        Simulator(robot, replace(settings, engine=e), q0=reference[0][0])
        for e in ("c", "c", "casadi")
    ]
    assert simulators[0].controller.commands > 1
    whole = simulators[0].follow(*reference)[0]
    steps = [
        simulators[1].step(tuple(values[k] for values in reference))[0]
        for k in range(len(reference[0]))
    ]
    for name in ("x", "tau_J", "tau_m", "command"):
        assert np.array_equal(
            getattr(whole, name), np.concatenate([getattr(step, name) for step in steps])
        )
    other = simulators[2].follow(*reference)[0]
    assert np.allclose(other.x, whole.x, atol=1e-9) and np.allclose(
        other.tau_m, whole.tau_m, atol=1e-5
    )


def weight(robot, q):
    """Torque of gravity on the joints at rest (n,)."""
    x = np.tile(q, 2 if robot.elastic else 1)[None]
    return build_model(robot, engine="numpy").inverse_dynamics(x, 0.0 * x, 0.0 * x)[0, : robot.n]


def settled(robot, target, seconds=3.0):
    constant = np.tile(target, (round(1000 * seconds), 1))
    return follow(robot, 1000.0, (constant, 0.0 * constant, 0.0 * constant))


def test_a_position_servo_sags_by_the_weight_over_its_gain(arm):
    """kp (r - theta) carries gravity; an integral or gravity fed forward takes the sag away."""
    target = np.array([0.3, 0.5, 0.4])
    gains = {"kp": 2e4, "kd": 4e3}
    sagged = settled(controlled(arm, **gains), target).theta[-1] - target
    assert (
        np.allclose(sagged, -weight(arm, target + sagged) / 2e4, atol=3e-5)
        and np.abs(sagged).max() > 5e-3
    )
    for more in ({"feedforward": "gravity"}, {"ki": 4e4}):
        left = settled(controlled(arm, **gains, **more), target, 6.0).theta[-1] - target
        assert np.abs(left).max() < 0.02 * np.abs(sagged).max()


def test_a_delay_of_the_command_shifts_the_motion(arm):
    """With d of 40 samples the motor turns as without, 40 samples later."""
    reference = motion(3, 1000.0, 2.0)
    reference = (reference[0] - reference[0][0], reference[1], reference[2])
    still = tuple(np.vstack([np.tile(v[:1] * (v is reference[0]), (200, 1)), v]) for v in reference)
    free = arm.with_(gravity=np.zeros(3))
    one, two = (
        follow(controlled(free, mode="both", kp=2e4, kd=4e3, delay=d), 1000.0, still)
        for d in (0.0, 0.04)
    )
    assert np.allclose(two.theta[40:], one.theta[:-40], atol=1e-9) and np.ptp(one.theta) > 0.1


def test_commanded_speeds_are_followed_and_positions_alone_lag(arm):
    """A velocity drive turns at the speed asked for; a position servo lags by kd over kp times
    it."""
    t = np.arange(2000)[:, None] / 1000.0
    speed = np.array([0.2, 0.0, 0.0])
    reference = (t * speed, np.tile(speed, (len(t), 1)), np.zeros((len(t), 3)))
    turned = follow(
        controlled(arm, mode="velocity", kd=4e3, feedforward="gravity"), 1000.0, reference
    )
    assert turned.dtheta[-1, 0] == pytest.approx(0.2, rel=1e-3)
    lagging = follow(controlled(arm, kp=2e4, kd=4e3, feedforward="gravity"), 1000.0, reference)
    assert (reference[0] - lagging.theta)[-1, 0] == pytest.approx(0.2 * 4e3 / 2e4, rel=0.02)


def test_a_drive_gives_no_more_than_its_torque(arm):
    """The limit of the controller counts beside the joint's own, and the integral rests there."""
    robot = controlled(arm, kp=2e4, kd=4e3, ki=1e5, torque=100.0, feedforward="gravity")
    constant = np.tile(np.array([1.0, 0.0, 0.0]), (3000, 1))
    simulator = Simulator(
        robot.with_(gravity=np.zeros(3)), SimulationSettings(sensors=Sensors.exact())
    )
    truth, _ = simulator.follow(constant[:100], 0.0 * constant[:100], 0.0 * constant[:100])
    assert (truth.command[:, 0] == 100.0).all() and simulator.state.integral[0] == 0.0
    later, _ = simulator.follow(constant, 0.0 * constant, 0.0 * constant)
    assert np.abs(later.command).max() == 100.0 and simulator.state.integral[0] != 0.0


def test_a_stated_controller_is_saved_with_the_arm(arm, tmp_path):
    """The controller block of an arm file is read, written, and drives the simulated arm."""
    robot = controlled(
        arm, mode="both", kp=2e4, kd=4e3, ki=10.0, delay=0.01, torque=500.0, feedforward="model"
    )
    save_robot(robot, tmp_path / "arm.yaml")
    again = load_robot(tmp_path / "arm.yaml")
    assert (
        robot_to_dict(again) == robot_to_dict(robot)
        and again.joints[1].controller == robot.joints[1].controller
    )
    assert Simulator(again).controller.kp == pytest.approx(np.full(3, 2e4))


def test_a_users_own_controller_is_held_for_a_sample(arm):
    """Gains that are handed in are simulated as they are, whatever a sampled loop makes of them."""
    own = Controller(np.full(3, 1e3), np.full(3, 1e2))
    simulator = Simulator(arm, SimulationSettings(controller=own, rate=20.0))
    assert simulator.controller.commands == 1 and tuned(arm).commands == 1
