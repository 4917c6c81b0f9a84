"""What a diagnosis writes leaves no gap: the same recording against robot.yaml and the corrected
URDF or MJCF."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.cli.mujoco.corrected import Correction
from elastic_arm.diagnosis import Diagnosis, Question, diagnose
from elastic_arm.diagnosis.corrected_robot import deviations, repaired_robot
from elastic_arm.dynamics import build_model
from elastic_arm.effects import Catalogue, parse
from elastic_arm.evidence.gauss_newton import again, linear_model
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.excitation import MotionLimits, Shape, random_trajectories
from elastic_arm.mujoco import Exported
from elastic_arm.recording import Recording
from elastic_arm.robot import load_robot, save_robot
from elastic_arm.sensors import Encoder, Sensors, TorqueSensor
from elastic_arm.simulation import SimulationSettings, simulate
from tests.helpers.nightly import nightly

pytestmark = pytest.mark.slow(30)
pytest.importorskip("mujoco")

SENSORS = Sensors(
    motor_torque=TorqueSensor(noise=0.02), motor_encoder=Encoder(2e-5), link_encoder=Encoder(2e-5)
)
ONE_URDF = """<robot name="one"><link name="base"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 1 0"/>
 <limit lower="-2" upper="2" effort="50" velocity="3"/></joint>
<link name="l1"><inertial><origin xyz="0 0 0.15"/><mass value="2"/>
 <inertia ixx="0.02" iyy="0.02" izz="0.003" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
# Axes at right angles: the zero of a joint behind a parallel one is another centre of mass.
TWO_URDF = f"""{ONE_URDF}
<joint name="j2" type="revolute"><origin xyz="0 0 0.3"/><parent link="l1"/><child link="l2"/>
 <axis xyz="1 0 0"/>
 <limit lower="-2" upper="2" effort="20" velocity="3"/></joint>
<link name="l2"><inertial><origin xyz="0.01 0 0.1"/><mass value="1"/>
 <inertia ixx="0.006" iyy="0.006" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
TWO_MJCF = """<mujoco><compiler angle="radian" autolimits="true"/><option timestep="0.001"/>
<worldbody><body name="base"><geom type="box" size=".05 .05 .05" mass="1"/>
<body name="l1" pos="0 0 0.1">
<joint name="j1" axis="0 1 0" range="-2 2" armature="0.05"/>
<inertial pos="0 0 0.15" mass="2" diaginertia="0.02 0.02 0.003"/>
<body name="l2" pos="0 0 0.3">
<joint name="j2" axis="0 1 0" range="-2 2" armature="0.02"/>
<inertial pos="0.01 0 0.1" mass="1" diaginertia="0.006 0.006 0.001"/>
</body></body></body></worldbody>
<actuator><motor joint="j1" ctrlrange="-50 50"/><motor joint="j2" ctrlrange="-20 20"/></actuator>
</mujoco>"""
FILES = {"two.urdf": f"{TWO_URDF}</robot>", "two.xml": TWO_MJCF}
ARMS = [
    ("two.urdf", ["payload:mass=0.5,position=0.02/0.05/0.2"]),
    ("two.xml", ["rotor_inertia_mismatch:j2:inertia=2.5"]),
    (
        "two.urdf",
        [
            "asymmetric_friction:j1:asymmetry=0.4",
            "coulomb_friction:j1:torque=0.6",
            "viscous_friction:j1:coefficient=0.5",
        ],
    ),
    ("two.xml", ["motor_torque_offset:j1:offset=2", "motor_torque_gain:j2:gain=1.3"]),
    ("two.urdf", ["time_delay:delay=0.012,channels=motor_torque"]),
    ("two.urdf", ["joint_zero:j2:offset=0.08"]),
    ("two.urdf", ["gravity_compensation:share=1"]),
]


def recorded(file: Path, effects: list[str]) -> tuple[Recording, Recording]:
    """Let an arm with effects follow two motions of 10 s."""
    robot = load_robot(file)
    shape = Shape(5, 8.0, 1.0)
    limits = MotionLimits.of(robot)
    motions = random_trajectories(
        build_model(robot), limits, 2, rng=np.random.default_rng(5), shape=shape
    )
    settings = SimulationSettings(
        effects=[parse(e, robot) for e in effects], sensors=SENSORS, rate=250.0
    )
    one, other = (
        simulate(robot, motion, settings, rng=np.random.default_rng(k), duration=10.0)
        for k, motion in enumerate(motions)
    )
    return one, other


def causes(found: Diagnosis) -> set[str]:
    return {cause.effect for cause in found.causes}


@pytest.mark.parametrize(
    ("name", "effects"),
    [ARMS[0], *nightly(ARMS[1:])],
    ids=lambda one: one if isinstance(one, str) else one[0].split(":")[0],
)
def test_what_was_written_has_no_cause_left(tmp_path: Path, name: str, effects: list[str]) -> None:
    """The effects come out, robot.yaml has none left, and the corrected file none but those that it
    lists, or what these motions do not tell from them."""
    base = tmp_path / name
    base.write_text(FILES[name])
    first, judge = recorded(base, effects)
    found = diagnose([first], Question(load_robot(base)), [judge])
    assert causes(found) == {effect.split(":")[0] for effect in effects}
    arm = repaired_robot(load_robot(base), found)
    save_robot(arm, tmp_path / "robot.yaml")
    assert not causes(diagnose([first], Question(load_robot(tmp_path / "robot.yaml")), [judge]))
    correction = Correction(base, None, None, Catalogue.default())
    written = correction.write(arm, tmp_path, deviations(found))
    assert isinstance(written, Exported)
    again = diagnose([first], Question(load_robot(written.files[0])), [judge])
    listed = {left.what for left in written.left}
    for cause in again.causes:
        assert listed & {cause.effect, *(other.effect for other in cause.alternatives)}


def test_the_corrected_arm_has_the_numbers_of_the_answer(tmp_path: Path) -> None:
    """Answered by a set that was met where a link is 6 deviations heavier, the arm has the mass
    that the set finds."""
    base = tmp_path / "two.urdf"
    base.write_text(FILES["two.urdf"])
    first, judge = recorded(base, ["coulomb_friction:j1:torque=0.3"])
    context = diagnose([first], Question(load_robot(base), refit=True), [judge]).context
    explanation, linear = context.explanation, context.explanation.linear
    heavier = [
        6.0 * ((one.what, one.joint) == ("link_mass", "j2")) for one in linear.problem.numbers
    ]
    there = Linearisation(linear.problem, linear.values + heavier, linear.acting)
    best = linear_model(there, explanation.best.model.assumed).fit(again(explanation.best, there))
    beside = replace(
        context,
        explanation=replace(explanation, linear=there, best=best),
        judging=replace(there, which=1),
    )
    own, moved = (one.model.robot.joints[1].link.mass for one in (context, beside))
    assert there.model.robot.joints[1].link.mass > 1.2 * own
    assert moved == pytest.approx(own, rel=0.02)


def test_a_zero_that_is_another_one_in_a_second_recording_is_a_change(tmp_path: Path) -> None:
    """An encoder that is referenced anew: 0.06 rad in one recording, 0.12 rad in the next, within 4
    deviations."""
    base = tmp_path / "two.urdf"
    base.write_text(FILES["two.urdf"])
    offsets = (0.06, 0.12)
    (first, judge), (_, second) = (
        recorded(base, [f"joint_zero:j2:offset={offset}"]) for offset in offsets
    )
    (change,) = diagnose([first, second], Question(load_robot(base)), [judge]).changes
    assert (change.effect, change.joint, change.parameter) == ("joint_zero", "j2", "offset")
    for (_, value, std), offset in zip(change.values, offsets, strict=True):
        assert abs(value - offset) < 4.0 * std and std < 0.005
