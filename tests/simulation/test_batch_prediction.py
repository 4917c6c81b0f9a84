"""Many short predictions at once agree with the simulator, one run at a time."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.effects import parse
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.estimation.motion import completed, drive_constants
from elastic_arm.robot import load_robot
from elastic_arm.sensors import Sensors
from elastic_arm.simulation import SimulationSettings, Simulator
from elastic_arm.simulation.batch_prediction import BatchPrediction
from elastic_arm.simulation.integrator import runge_kutta_step
from tests.helpers.smooth_motion import smooth_motion

ROBOT = load_robot(None)
MODEL = build_model(ROBOT, "mod3")
ONE_JOINT = """
name: one
gravity: [0, 0, -9.81]
joints:
- name: a
  dh: {{a: 0, d: 0, alpha: 0, offset: 0}}
  link:
    mass: 1.0e-3
    com: [0, 0, 0]
    inertia: {{xx: {inertia}, yy: {inertia}, zz: {inertia}, xy: 0, xz: 0, yz: 0}}
"""


@pytest.mark.parametrize("effects", [(), ("viscous_friction:joint_2:coefficient=20",)])
def test_every_start_follows_the_simulator(effects: tuple[str, ...]) -> None:
    """From each measured state on, under the same held torques, the angles are those of the
    simulator."""
    laws = [parse(text, ROBOT) for text in effects]
    motion = completed(smooth_motion(MODEL, samples=60, period=1e-3), MODEL)
    equations = ArmEquations(ROBOT, "mod3")
    batch = BatchPrediction(equations, laws, equations.nominal, drive_constants(MODEL)[0], 1e-3)
    begins = np.array([3, 17, 30])
    steps = [5, 20]
    q, theta = batch.angles(motion, begins, steps)
    torque = 0.5 * (motion.tau_m[:-1] + motion.tau_m[1:])
    simulator = Simulator(
        ROBOT,
        SimulationSettings(effects=laws, sensors=Sensors.exact(), rate=1000.0),
        rng=np.random.default_rng(0),
    )
    for k, begin in enumerate(begins):
        simulator.place(
            motion.q[begin], motion.theta[begin], motion.dq[begin], motion.dtheta[begin]
        )
        truth = simulator.drive(torque[begin : begin + 21])[0]
        np.testing.assert_allclose(q[k], truth.q[steps], atol=1e-7)
        np.testing.assert_allclose(theta[k], truth.theta[steps], atol=1e-7)


def test_an_axis_without_friction_and_gravity_is_followed(tmp_path: Path) -> None:
    """A body that nothing holds back vibrates at no frequency: under a constant torque it travels
    tau t²/2J."""
    file = tmp_path / "one.yaml"
    file.write_text(ONE_JOINT.format(inertia=1e-3))
    equations = ArmEquations(load_robot(file), "mod3")
    batch = BatchPrediction(equations, [], equations.nominal, np.ones(1), 4e-3)
    zeros = np.zeros((20, 1))
    channels = dict.fromkeys(("q", "dq", "ddq", "theta", "dtheta", "ddtheta", "tau_J"), zeros)
    motion = SimpleNamespace(t=4e-3 * np.arange(20), tau_m=zeros + 1e-3, **channels)
    q, _ = batch.angles(motion, np.array([0, 5]), [5])  # type: ignore[arg-type]
    np.testing.assert_allclose(q[:, 0, 0], 0.5 * 0.02**2, rtol=1e-9)


def test_the_step_is_of_fourth_order() -> None:
    """Halving the step of an oscillator divides its error by about sixteen."""

    def error(steps: int) -> float:
        y = np.array([1.0, 0.0])
        for _ in range(steps):
            y = runge_kutta_step(lambda at: np.array([at[1], -at[0]]), y, 1.0 / steps)
        return float(np.abs(y - [np.cos(1.0), -np.sin(1.0)]).max())

    assert 15.0 < error(10) / error(20) < 18.0


def test_strong_friction_on_a_light_link_is_followed(tmp_path: Path) -> None:
    """A joint of 1e-3 kg m² under 370 Nm s/rad, far too stiff for explicit steps, takes its speed
    at once.

    Its exact motion is w = tau/d (1 − exp(−d t/J)): after 40 ms the angle is tau/d (t − J/d).
    """
    inertia = 1e-3
    damping = 370.0
    torque = 7.4
    file = tmp_path / "one.yaml"
    file.write_text(ONE_JOINT.format(inertia=inertia))
    robot = load_robot(file)
    laws = [parse(f"viscous_friction:a:side=link,coefficient={damping}", robot)]
    equations = ArmEquations(robot, "mod3")
    batch = BatchPrediction(equations, laws, equations.nominal, np.ones(1), 4e-3)
    zeros = np.zeros((20, 1))
    channels = dict.fromkeys(("q", "dq", "ddq", "theta", "dtheta", "ddtheta", "tau_J"), zeros)
    motion = SimpleNamespace(t=4e-3 * np.arange(20), tau_m=zeros + torque, **channels)
    q, _ = batch.angles(motion, np.array([0, 5]), [5, 10])  # type: ignore[arg-type]
    exact = torque / damping * (np.array([0.02, 0.04]) - inertia / damping)
    np.testing.assert_allclose(q[:, :, 0], [exact, exact], rtol=0.01)
