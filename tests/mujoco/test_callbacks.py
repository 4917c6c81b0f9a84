"""Laws in MuJoCo: the same motion as the project's own simulator has with the same effects."""

import numpy as np
import pytest

from elastic_arm.effects import parse
from elastic_arm.errors import RobotError
from elastic_arm.mujoco import attach, to_mjcf
from elastic_arm.robot import Robot, load_robot
from elastic_arm.robot.mjcf import open_mjcf
from elastic_arm.simulation import SimulationSettings, Simulator
from tests.helpers.motions import trajectory
from tests.helpers.mujoco_arms import MODELS, played
from tests.helpers.nightly import nightly

mujoco = pytest.importorskip("mujoco")

SMOOTH = (
    "transmission_error:joint_2:amplitude=2e-4,order=2",
    "torque_ripple:joint_1:amplitude=8,order=1",
    "nonlinear_stiffness:joint_3:cubic=1e10",
)


def with_effects(robot: Robot, *texts: str) -> Robot:
    return robot.with_(effects=tuple(parse(text, robot).to_dict() for text in texts))


def apart(robot: Robot, seconds: float, *, attached: bool) -> float:
    """Return by how much the elastic arm in MuJoCo and in the simulator part under the same torque,
    rad."""
    rate, substeps = 1000, 10
    reference = trajectory(n=3, period=2.0, ramp=0.5, periods=2).evaluate(
        np.arange(int(seconds * rate)) / rate
    )
    ours = Simulator(
        robot,
        SimulationSettings(model="mod2", rate=rate, substeps=substeps),
        q0=reference[0][0],
        dq0=reference[1][0],
    )
    start = ours.state.y.copy()
    truth, _ = ours.follow(*reference)
    text = to_mjcf(robot, timestep=1.0 / rate / substeps)[0].replace('"implicitfast"', '"RK4"')
    angles = played(robot, text, truth.command, start, substeps=substeps, attached=attached)
    return float(np.abs(angles[:, : robot.n] - truth.q).max())


def test_laws_act_in_mujoco_as_in_the_simulator() -> None:
    """Transmission error, ripple and a stiffening drive move the arm in MuJoCo as in the simulator,
    to 1e-6 rad."""
    robot = with_effects(load_robot(), *SMOOTH)
    assert apart(robot, 0.25, attached=True) < 1e-6
    assert apart(robot, 0.25, attached=False) > 1e-4


def test_internal_states_and_dry_friction_act_too() -> None:
    """Hysteresis, with its internal state, and friction that grows with the load follow the
    simulator, to 2 %."""
    robot = with_effects(
        load_robot(),
        "load_dependent_friction:joint_2:coefficient=0.1",
        "hysteresis:joint_3:torque=15,width=1e-4",
    )
    with_laws, without = (apart(robot, 0.25, attached=on) for on in (True, False))
    assert with_laws < 0.02 * without


LOADED = "load_dependent_friction:joint_3:coefficient=0.1"
ERROR = "transmission_error:joint_3:amplitude=2e-4"


@pytest.mark.parametrize(
    ("stated", "follows", "allowed"),
    [
        ("coulomb_friction:joint_2:torque=15", "asymmetric_friction:joint_2:asymmetry=0.3", 0.02),
        *nightly(
            [
                ("backlash:joint_3:half_gap=1e-4", LOADED, 1e-6),
                ("nonlinear_stiffness:joint_3:cubic=1e10", ERROR, 1e-6),
            ]
        ),
    ],
)
def test_laws_follow_what_the_file_states(stated, follows, allowed) -> None:
    """What scales friction or follows the joint torque finds the friction and the drive that the
    file has of itself."""
    robot = with_effects(load_robot(), stated, follows)
    with_laws, without = (apart(robot, 0.35, attached=on) for on in (True, False))
    assert with_laws < allowed * without


def test_nothing_is_left_when_detached() -> None:
    """A context manager takes the laws away again; other models are not touched."""
    arm = open_mjcf(MODELS / "arm.xml")
    robot = with_effects(arm.robot, "load_dependent_friction:joint2:coefficient=0.1")
    arm.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    data = mujoco.MjData(arm.model)
    data.qvel[:7] = 0.5
    data.qfrc_applied[1] = 10.0
    mujoco.mj_forward(arm.model, data)
    before = data.qfrc_passive.copy()
    # What is left of the torque behind the gear, where the rotor and friction take their share.
    load = 10.0 + before[1] + data.qfrc_constraint[1] - arm.model.dof_armature[1] * data.qacc[1]
    with attach(arm.model, robot) as attached:
        assert [e.effect.id for e in attached.instances] == ["load_dependent_friction"]
        mujoco.mj_forward(arm.model, data)
        assert data.qfrc_passive[1] - before[1] == pytest.approx(-0.1 * load)
        assert load > 5.0
    assert mujoco.get_mjcb_passive() is None
    mujoco.mj_forward(arm.model, data)
    np.testing.assert_array_equal(data.qfrc_passive, before)


def test_a_law_acts_once() -> None:
    """Stribeck friction is of a new file itself; to a user's own file, which has none, its law is
    added."""
    arm = open_mjcf(MODELS / "arm.xml")
    robot = with_effects(arm.robot, "stribeck_friction:joint2:torque=1,speed=0.1")
    with attach(arm.model, robot) as attached:
        assert [e.effect.id for e in attached.instances] == ["stribeck_friction"]
    with attach(mujoco.MjModel.from_xml_string(to_mjcf(robot)[0]), robot) as attached:
        assert not attached.instances


def test_a_model_of_another_arm_is_refused() -> None:
    """Joints are found by name."""
    arm = open_mjcf(MODELS / "arm.xml")
    with pytest.raises(RobotError, match="has no joint joint_1"):
        attach(arm.model, with_effects(load_robot(), SMOOTH[0]))
