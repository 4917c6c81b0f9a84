"""Laws that elements of an MJCF state: the same motion as the project's own simulator has, without
a callback."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.effects import EFFECTS, parse
from elastic_arm.mujoco import elements, stated_arm, to_mjcf
from elastic_arm.robot import JointController, load_robot
from elastic_arm.robot.urdf import parse_urdf
from elastic_arm.robot.urdf_export import to_urdf
from elastic_arm.simulation import SimulationSettings, Simulator
from tests.helpers.motions import trajectory
from tests.helpers.mujoco_arms import played

pytest.importorskip("mujoco")
RATE, SUBSTEPS = 1000, 10
SMOOTH = (
    "stiffness_mismatch:joint_2:stiffness=0.8",
    "damping_mismatch:joint_2:damping=3",
    "rotor_inertia_mismatch:joint_1:inertia=1.3",
    "nonlinear_stiffness:joint_3:cubic=1e10",
    "backlash:joint_2:half_gap=2e-4",
    "torque_ripple:joint_1:amplitude=8,order=1,phase=0.4",
    "viscous_friction:joint_2:coefficient=20,side=link",
    "joint_spring:joint_2:stiffness=100,rest=0.3",
    "wrist_coupling:joint_3:inertia=1,viscous=10,dry=0,turns=against",
)
DRY = ("coulomb_friction:joint_2:torque=15", "coulomb_friction:joint_2:torque=15,side=link")
# Friction at a standstill comes with dry friction.
STRIBECK = tuple(f"{dry} {dry.replace('coulomb', 'stribeck')},speed=0.1" for dry in DRY)


@cache
def plain_text() -> str:
    return to_mjcf(load_robot(), timestep=1.0 / RATE / SUBSTEPS)[0]


@pytest.mark.parametrize(
    ("effects", "allowed"),
    [*((one, 1e-6) for one in SMOOTH), *((one, 0.01) for one in (*DRY, *STRIBECK))],
)
def test_a_native_law_moves_the_arm_as_in_the_simulator(effects: str, allowed: float) -> None:
    """Under the same torques for 2 s: within a share of what the effect does to the motion, 1 %
    where it is dry."""
    robot = load_robot()
    robot = robot.with_(effects=tuple(parse(text, robot).to_dict() for text in effects.split()))
    reference = trajectory(n=3, period=2.0, ramp=0.5, periods=2).evaluate(
        np.arange(2 * RATE) / RATE
    )
    settings = SimulationSettings(model="mod2", rate=RATE, substeps=SUBSTEPS)
    ours = Simulator(robot, settings, q0=reference[0][0], dq0=reference[1][0])
    start = ours.state.y.copy()
    truth, _ = ours.follow(*reference)
    text, left = to_mjcf(robot, timestep=1.0 / RATE / SUBSTEPS)
    assert not left
    # Runge-Kutta does not follow LuGre's bristles.
    texts = [
        one if "lugre" in text else one.replace('"implicitfast"', '"RK4"')
        for one in (text, plain_text())
    ]
    apart, size = (
        np.abs(played(robot, one, truth.command, start, substeps=SUBSTEPS)[:, :3] - truth.q).max()
        for one in texts
    )
    assert apart < allowed * size


def test_a_law_of_a_drive_is_left_out_of_an_arm_that_has_none() -> None:
    """Ripple of a rotor whose ratio nobody states is listed; Stribeck friction needs no drive."""
    rigid = parse_urdf(to_urdf(load_robot())).with_(effects=())
    texts = (
        "torque_ripple:joint_1:amplitude=8,order=1",
        "stribeck_friction:joint_1:torque=2,speed=0.1",
    )
    _, left = to_mjcf(rigid.with_(effects=tuple(parse(text).to_dict() for text in texts)))
    assert [one.effect.id for one, _ in left] == ["torque_ripple"]


def test_a_servo_and_a_late_torque_are_of_the_new_file(tmp_path: Path) -> None:
    """Gains, delay and limit of a controller become a <position> actuator, a late motor torque its
    sensor's delay."""
    rigid = parse_urdf(to_urdf(load_robot())).with_(effects=())
    servo = JointController(kp=300.0, kd=20.0, delay=0.01, torque=40.0)
    late = {
        "effect": "time_delay",
        "joint": "joint_2",
        "parameters": {"delay": 0.01, "channels": ["motor_torque"]},
    }
    robot = rigid.with_joint("joint_1", controller=servo).with_(effects=(late,))
    text, left = to_mjcf(robot)
    (tmp_path / "new.xml").write_text(text)
    again = load_robot(tmp_path / "new.xml")
    assert not left and again.joints[0].controller == servo
    assert [e["parameters"]["delay"] for e in again.effects if e["effect"] == "time_delay"] == [
        0.01
    ]


def test_the_table_of_the_document_is_what_happens() -> None:
    """docs/mujoco.md sorts each effect of the catalogue under what an export makes of it."""
    page = (Path(__file__).parents[2] / "docs" / "mujoco.md").read_text()
    rows = re.findall(r"^\| (native|callback|left out) \| (.*?) \|", page, re.MULTILINE)
    listed = {effect: kind for kind, cell in rows for effect in re.findall(r"`(\w+)`", cell)}
    native = {*stated_arm.RULES, *elements.RULES}
    acting = {
        e.id: "callback" if stated_arm.acts_by_law(e) else "left out" for e in EFFECTS.values()
    }
    assert listed == acting | dict.fromkeys(native, "native")
