"""MuJoCo models in: the equations of motion that MuJoCo computes, chains, and what is refused."""

import os
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.errors import RobotError
from elastic_arm.robot import JointController, Robot, load_robot
from elastic_arm.sensors import Sensors
from elastic_arm.simulation import SimulationSettings, Simulator
from tests.helpers.mujoco_arms import MODELS, mujoco_torque, random_motion, stated_torque

pytest.importorskip("mujoco")

from elastic_arm.robot.loading import is_mjcf
from elastic_arm.robot.mjcf import engine, open_mjcf

# A developer's folder of public models (as MuJoCo Menagerie has them), each beside its meshes or
# without.
PUBLIC = Path(os.environ.get("ELASTIC_ARM_MJCF_MODELS", "/nowhere"))
CHAINS = {
    "xarm7.xml": "link_base:link7",
    "aloha.xml": "left/base_link:left/gripper_link",
    "tidybot.xml": "gen3/base_link:bracelet_link",
    "z1.xml": "link00:link06",
}


def without_dry_friction(robot: Robot) -> Robot:
    return robot.with_(effects=tuple(e for e in robot.effects if e["effect"] != "coulomb_friction"))


def assert_same_torque(path: Path, chain: str | None = None, at: str | None = None) -> None:
    """Inverse dynamics are those of `mj_inverse` to 1e-9 of their size."""
    ends = None if chain is None else tuple(chain.split(":"))
    arm = open_mjcf(path, ends, at)
    motion = random_motion(arm.robot.n)
    ours = stated_torque(without_dry_friction(arm.robot), *motion)
    theirs = mujoco_torque(arm, *motion)
    assert np.abs(ours - theirs).max() < 1e-9 * max(1.0, np.abs(theirs).max())


@pytest.mark.parametrize(
    ("file", "chain", "at"),
    [
        ("arm.xml", None, None),
        ("arm.xml", None, "open"),
        ("arm.xml", None, "finger_left=0.03,finger_right=0.01"),
        ("arm.xml", "pedestal:link4", None),
        ("arm.xml", "link2:hand", "joint1=0.7"),
        ("everything.xml", None, None),
    ],
)
def test_inverse_dynamics_are_mujocos(file: str, chain: str | None, at: str | None) -> None:
    """Defaults, includes, several joints and bodies a link, held joints, springs, armature,
    gravcomp: all as MuJoCo."""
    assert_same_torque(MODELS / file, chain, at)


if PUBLIC.is_dir():

    @pytest.mark.parametrize("path", sorted(PUBLIC.rglob("*.xml")), ids=lambda path: path.name)
    def test_inverse_dynamics_of_public_models_are_mujocos(path: Path) -> None:
        """Models of a developer's folder, $ELASTIC_ARM_MJCF_MODELS, are read as MuJoCo computes
        them."""
        try:
            open_mjcf(path, tuple(CHAINS[path.name].split(":")) if path.name in CHAINS else None)
        except RobotError as error:
            pytest.skip(str(error))
        assert_same_torque(path, CHAINS.get(path.name))


RAIL = """<mujoco><worldbody><body name="carriage" pos="0.2 0.1 0.3" euler="10 20 -30">
  <joint name="rail" type="slide" axis="1 0.3 0" ref="0.4" damping="7" armature="3" stiffness="20"
         springref="0.1"/>
  <geom size=".1" pos="0.02 0.05 0" mass="5"/>
  <body name="arm" pos="0 0.1 0.3"><joint name="shoulder" axis="0 1 0.2" ref="0.2"/>
    <geom type="capsule" fromto="0 0 0 0.1 0.05 0.4" size=".04" mass="3"/>
    <body name="quill" pos="0.1 0 0.4">
      <joint name="quill" type="slide" axis="0 0.2 1" pos="0.1 0 0" ref="-0.1"/>
      <geom size=".05" pos="0 0.03 0.1" mass="1"/>
      <body name="flange" pos="0 0 0.2">
        <joint name="roll" axis="0 0 1"/><geom size=".05 .1 .02" type="box" mass="1"/>
        <body name="finger" pos="0.05 0 0.1">
          <joint name="finger" type="slide"/><geom size=".02" mass="0.1"/>
        </body>
</body></body></body></body></worldbody></mujoco>"""


@pytest.mark.usefixtures("compiled_here")
def test_slides_within_the_arm_are_prismatic_joints(tmp_path: Path) -> None:
    """A rail, and a quill before the last hinge, are joints of the arm, as MuJoCo moves them; a
    finger is held."""
    path = tmp_path / "rail.xml"
    path.write_text(RAIL)
    robot = load_robot(path)
    assert [joint.prismatic for joint in robot.joints] == [True, False, True, False]
    assert any("finger" in note for note in robot.notes)
    assert_same_torque(path)


@pytest.mark.usefixtures("compiled_here")
def test_where_all_joints_slide_they_are_the_arm(tmp_path: Path) -> None:
    """A gantry has no hinge: its slides are its joints."""
    path = tmp_path / "gantry.xml"
    part = '<body name="{0}"><joint name="{0}" type="slide" axis="{1}"/><geom size=".1"/>{2}</body>'
    gantry = part.format("x", "1 0 0", part.format("y", "0 1 0", part.format("z", "0 0 1", "")))
    path.write_text(f"<mujoco><worldbody>{gantry}</worldbody></mujoco>")
    assert load_robot(path).joint_names == ("x", "y", "z")
    assert_same_torque(path)


@pytest.mark.usefixtures("compiled_here")
def test_friction_loss_is_coulomb_friction() -> None:
    """Where the joints move fast, MuJoCo's friction loss is Coulomb friction of the stated size."""
    arm = open_mjcf(MODELS / "everything.xml")
    q, dq, ddq = random_motion(3)
    dq = np.where(np.abs(dq) < 0.5, 0.5, dq)
    ours = stated_torque(arm.robot, q, dq, 0.01 * ddq)
    theirs = mujoco_torque(arm, q, dq, 0.01 * ddq, friction_loss=True)
    assert np.abs(ours - theirs).max() < 1e-9 * np.abs(theirs).max()


@pytest.mark.usefixtures("compiled_here")
def test_limits_come_from_ranges_and_actuators() -> None:
    """Ranges are position limits, the force range times the gear the torque limit."""
    joints = {joint.name: joint for joint in load_robot(MODELS / "arm.xml").joints}
    assert (joints["joint2"].limits.position_min, joints["joint2"].limits.torque) == (-1.7, 150.0)
    assert joints["joint5"].armature == 0.03
    roll = load_robot(MODELS / "everything.xml").joints[-1]
    assert roll.limits.torque == 30.0
    assert roll.armature == pytest.approx(1e-4 * 30.0**2)


@pytest.mark.usefixtures("compiled_here")
def test_what_is_held_is_noted() -> None:
    """Fingers are held and named; a chain may begin and end anywhere."""
    robot = load_robot(MODELS / "arm.xml")
    assert robot.n == 7 and any("finger_left" in note for note in robot.notes)
    assert load_robot(MODELS / "arm.xml", "link2:link5").joint_names == (
        "joint3",
        "joint4",
        "joint5",
    )


def test_meshes_without_files_are_left_out_where_inertia_is_stated(tmp_path: Path) -> None:
    """A model whose meshes are not at hand is read all the same, unless a moving body's inertia
    comes from them."""
    text = (MODELS / "arm.xml").read_text()
    text = text.replace(
        "<worldbody>", '<asset><mesh name="shell" file="shell.stl"/></asset><worldbody>'
    )
    text = text.replace('<geom fromto="0 0 -0.2 0 0 0"/>', '<geom type="mesh" mesh="shell"/>')
    (tmp_path / "arm.xml").write_text(text)
    (tmp_path / "hand.xml").write_text((MODELS / "hand.xml").read_text())
    assert any("mesh" in note for note in load_robot(tmp_path / "arm.xml").notes)
    weighing = (
        '<inertial mass="4.9" pos="0.004 0.002 -0.05" fullinertia="0.07 0.068 0.02 -0.0001 0.004'
        ' 0.006"/>'
    )
    assert weighing in text
    (tmp_path / "arm.xml").write_text(text.replace(weighing, ""))
    with pytest.raises(RobotError, match=r"link1 need them for their inertia.*<inertial>"):
        load_robot(tmp_path / "arm.xml")


BODY = '<body name="a"><joint name="j" {joint}/><geom size=".1"/>{inside}</body>'
CHILD = '<body name="b" pos="0.3 0 0"><joint name="k"/><geom size=".1"/></body>'


@pytest.mark.parametrize(
    ("joint", "inside", "rest", "words"),
    [
        ('type="ball"', CHILD, "", "is a ball joint"),
        (
            "",
            CHILD + CHILD.replace('"b"', '"c"').replace('"k"', '"l"'),
            "",
            "branches .* --chain base:tip",
        ),
        ("", CHILD, '<equality><connect body1="b" anchor="0.1 0 0"/></equality>', "closes a loop"),
        (
            "",
            CHILD,
            '<equality><joint joint1="j" joint2="k"/></equality>',
            "contains no moving hinge|couples joint",
        ),
        (
            "",
            CHILD,
            (
                '<tendon><fixed name="t"><joint joint="j" coef="1"/><joint joint="k"'
                ' coef="1"/></fixed></tendon>'
            ),
            "tendon 't'",
        ),
        (
            "",
            CHILD,
            '<actuator><muscle name="m" joint="j" lengthrange="0 1"/></actuator>',
            "is a muscle",
        ),
        ('damping="1 2"', CHILD, "", "higher order"),
    ],
)
def test_what_no_serial_arm_has_is_refused_by_name(
    tmp_path: Path, joint: str, inside: str, rest: str, words: str
) -> None:
    """Ball joints, branches, loops, tendons, muscles: one line names what it is, and what to do."""
    path = tmp_path / "model.xml"
    path.write_text(
        f"<mujoco><worldbody>{BODY.format(joint=joint, inside=inside)}</worldbody>{rest}</mujoco>"
    )
    with pytest.raises(RobotError, match=words) as error:
        load_robot(path)
    assert "\n" not in str(error.value) and str(path) in str(error.value)


@pytest.mark.usefixtures("compiled_here")
@pytest.mark.parametrize(
    ("chain", "at", "words"),
    [
        ("link1:link9", None, "unknown body 'link9'.*link"),
        ("link4:link1", None, "is not a descendant of"),
        (None, "elbow=1", "cannot read 'elbow=1'.*open"),
        (None, "joint1=x", "cannot read"),
    ],
)
def test_unknown_ends_and_positions_are_refused(
    chain: str | None, at: str | None, words: str
) -> None:
    """A chain's ends and what is held are names of the model."""
    with pytest.raises(RobotError, match=words):
        load_robot(MODELS / "arm.xml", chain, at)


def test_broken_models_are_refused_in_one_line(tmp_path: Path) -> None:
    """What MuJoCo refuses is refused with its own words."""
    path = tmp_path / "model.xml"
    path.write_text("<mujoco><worldbody><body><joint typo='1'/></body></worldbody></mujoco>")
    with pytest.raises(RobotError, match="MuJoCo rejects it") as error:
        load_robot(path)
    assert "\n" not in str(error.value)


@pytest.mark.usefixtures("compiled_here")
def test_an_arm_file_keeps_armatures_and_effects(tmp_path: Path) -> None:
    """A model saved as an arm file is the same arm."""
    from elastic_arm.robot import save_robot

    robot = load_robot(MODELS / "everything.xml")
    save_robot(robot, tmp_path / "arm.yaml")
    again = load_robot(tmp_path / "arm.yaml")
    motion = random_motion(3)
    np.testing.assert_allclose(
        stated_torque(again, *motion), stated_torque(robot, *motion), atol=1e-12
    )
    with pytest.raises(RobotError, match="armature and a transmission"):
        replace(load_robot().joints[0], armature=0.1)


ARM = """<mujoco><worldbody><body name="b">
<joint name="{name}" axis="0 0 1"/><geom size=".1" mass="1"/>{inside}</body>
</worldbody>{more}</mujoco>"""
HOSTILE = {
    "a pipe": ("j", "", '<include file="pipe.xml"/>', "pipe or a device"),
    "a pipe of a field": (
        "j",
        "",
        '<asset><hfield name="h" file="pipe.xml" size="1 1 1 1"/></asset>',
        "pipe or a",
    ),
    "a picture of 10 GB": (
        "j",
        "",
        '<asset><texture name="t" type="2d" builtin="flat" width="60000" height="60000"/></asset>',
        "memory",
    ),
    "a field of 14 GB": (
        "j",
        "",
        '<asset><hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/></asset>',
        "rejects",
    ),
    "two billion keyframes": ("j", "", '<size nkey="2000000000"/>', "s of processor"),
    "copies without end": (
        "j",
        '<replicate count="100000" offset="1 0 0"><geom size=".1"/></replicate>',
        "",
        "processor",
    ),
    "100 joints in a row": (
        "j",
        '<body><joint/><geom size=".1"/>' * 100 + "</body>" * 100,
        "",
        "100 joints|101 joints",
    ),
    "half a character": ("&#xd800;", "", "", "not valid UTF-8"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_models_are_refused_within_the_limits(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """MuJoCo compiles in a process of its own: what takes too much ends in one line, and nothing is
    waited for."""
    monkeypatch.setattr(sys.modules["elastic_arm.robot.mjcf.engine"], "SECONDS", 2)
    os.mkfifo(tmp_path / "pipe.xml")
    named, inside, more, reason = HOSTILE[name]
    file = tmp_path / "a.xml"
    file.write_text(ARM.format(name=named, inside=inside, more=more))
    with pytest.raises(RobotError, match=reason) as caught:
        load_robot(file)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{file}: ")


@pytest.mark.parametrize(
    "text", ["<!--" * 300_000, "<?" * 300_000, "<!DOCTYPE" * 300_000, "<" * 300_000]
)
def test_what_stands_before_the_first_element_is_looked_at_once(tmp_path: Path, text: str) -> None:
    """Comments that do not end."""
    (tmp_path / "a.xml").write_text(text)
    begin = time.process_time()
    assert not is_mjcf(tmp_path / "a.xml")
    assert time.process_time() - begin < 2.0


@pytest.mark.parametrize(
    "before",
    ["<?xml version='1.0'?>", "<!-- <robot> -->", "<!DOCTYPE mujoco>", "<!-- a --><!-- b -->\n"],
)
def test_comments_before_the_first_element_are_skipped(tmp_path: Path, before: str) -> None:
    """As they are by XML."""
    (tmp_path / "a.xml").write_text(f"{before}<mujoco/>")
    assert is_mjcf(tmp_path / "a.xml")
    (tmp_path / "a.xml").write_text(f"{before}<robot/>")
    assert not is_mjcf(tmp_path / "a.xml")


def test_a_keyframe_that_is_no_text_is_refused(tmp_path: Path) -> None:
    """A name from the command line need not be UTF-8."""
    (tmp_path / "a.xml").write_text(ARM.format(name="j", inside="", more=""))
    with pytest.raises(RobotError, match="is not text"):
        load_robot(tmp_path / "a.xml", at="a\udcffb")


TWO = """<mujoco><compiler angle="radian" autolimits="true"/><option timestep="0.001"/>
<default><joint damping="0.2" frictionloss="0.3" {armature}/></default><worldbody>
<body name="l1" pos="0 0 0.1"><joint name="j1" axis="0 1 0" range="-2 2"/>
<inertial pos="0 0 0.15" mass="2" diaginertia="0.02 0.02 0.003"/>
<body name="l2" pos="0 0 0.3"><joint name="j2" axis="0 1 0" range="-2 2"/>{play}
<inertial pos="0 0 0.1" mass="1" diaginertia="0.006 0.006 0.001"/></body></body></worldbody>
<actuator>{actuator}</actuator></mujoco>"""


def two_joints(
    tmp_path: Path, armature: str = 'armature="0.05"', play: str = "", actuator: str = ""
) -> Path:
    path = tmp_path / "two.xml"
    path.write_text(TWO.format(armature=armature, play=play, actuator=actuator))
    return path


@pytest.mark.usefixtures("compiled_here")
def test_a_second_hinge_of_small_range_is_play(tmp_path: Path) -> None:
    """MuJoCo's backlash is no joint of the arm: it is held in its middle and named, the rest is as
    without it."""
    path = two_joints(
        tmp_path, play='<joint name="slack" axis="0 1 0" range="-0.02 0.01" armature="0.001"/>'
    )
    robot = load_robot(path)
    plain = load_robot(two_joints(tmp_path))
    assert robot.joint_names == ("j1", "j2") and robot.effects == plain.effects
    (note,) = (note for note in robot.notes if "slack" in note)
    assert "play of ±0.015 rad in j2" in note and "backlash:j2:half_gap=0.015" in note
    slack = '<joint name="slack" axis="0 1 0" range="-0.01 0.01" armature="0.001"/>'
    two_joints(tmp_path, play=slack)
    assert_same_torque(path)
    path.write_text(
        two_joints(tmp_path).read_text().replace('<joint name="j2"', f'{slack}<joint name="j2"')
    )
    assert load_robot(path).joint_names == ("j1", "j2")
    assert_same_torque(path)


@pytest.mark.usefixtures("compiled_here")
@pytest.mark.parametrize(
    "play", ['<joint name="k" axis="1 0 0" range="-1 1"/>', '<joint name="k" axis="0 1 0"/>']
)
def test_another_joint_of_one_body_is_a_joint(tmp_path: Path, play: str) -> None:
    """Hinges about other axes, and those as wide, turn the arm."""
    assert load_robot(two_joints(tmp_path, play=play)).joint_names == ("j1", "j2", "k")


@pytest.mark.usefixtures("compiled_here")
def test_motor_inertia_is_unknown_where_a_file_states_none(tmp_path: Path) -> None:
    """An armature that is 0 in the file is 0; one that the file does not speak of is not known."""
    assert [j.armature for j in load_robot(two_joints(tmp_path, armature="")).joints] == [
        None,
        None,
    ]
    assert [
        j.armature for j in load_robot(two_joints(tmp_path, armature='armature="0"')).joints
    ] == [0.0, 0.0]
    assert [j.armature for j in load_robot(two_joints(tmp_path)).joints] == [0.05, 0.05]
    unknown = (
        load_robot(two_joints(tmp_path, armature=""))
        .with_joint("j1", armature=0.1)
        .with_armatures()
    )
    assert [j.armature for j in unknown.joints] == [0.1, 0.0]


@pytest.mark.usefixtures("compiled_here")
def test_friction_of_a_dc_motor_is_friction_of_its_joint(tmp_path: Path) -> None:
    """LuGre friction is Coulomb and Stribeck friction by the gear; what a rigid arm cannot hold is
    named."""
    motor = '<dcmotor name="m" joint="j1" motorconst="0.05" resistance="1" gear="100" {}/>'
    stated = motor.format('lugre="1000 1 0.01 0.02 0.1" cogging="0.03 6 0"')
    robot = load_robot(two_joints(tmp_path, actuator=stated))
    found = {(e["effect"], e["joint"]): e["parameters"] for e in robot.effects}
    assert found["coulomb_friction", "j1"] == {"torque": pytest.approx(0.3 + 1.0)}
    assert found["stribeck_friction", "j1"] == {
        "torque": pytest.approx(1.0),
        "speed": pytest.approx(0.001),
    }
    words = " ".join(robot.notes)
    assert (
        "bristles are ignored" in words and "3 Nm at j1 and 6 waves" in words and "voltage" in words
    )
    plain = load_robot(two_joints(tmp_path, actuator=motor.format("")))
    assert not any(
        e["effect"] == "stribeck_friction" for e in plain.effects
    ) and "LuGre" not in " ".join(plain.notes)
    electrical = motor.format(
        'inductance="0.001 0" saturation="5 0 24" thermal="0.1 0.2 0.3 0.004 20 30"'
    )
    notes = load_robot(two_joints(tmp_path, actuator=electrical)).notes
    assert any(
        "inductance, limit of the voltage, thermal resistance of actuator m: ignored" in one
        for one in notes
    )


SERVOS = {
    (
        '<position joint="{0}" kp="50" kv="4" gear="2" forcerange="-10 10" delay="0.004"'
        ' nsample="9"/>'
    ): JointController("position", kp=200.0, kd=16.0, torque=20.0, delay=0.004),
    '<velocity joint="{0}" kv="7"/>': JointController("velocity", kd=7.0),
    '<general joint="{0}" gainprm="60" biastype="affine" biasprm="0 -60 -3"/>': JointController(
        kp=60.0, kd=3.0
    ),
    '<pid joint="{0}" kp="60" kv="5" ki="9"/>': JointController("both", kp=60.0, kd=5.0, ki=9.0),
}


@pytest.mark.usefixtures("compiled_here")
@pytest.mark.parametrize("actuator", SERVOS)
def test_servos_are_controllers(tmp_path: Path, actuator: str) -> None:
    """Actuators that feed back angle and speed are the joints' controllers, at the joint's side of
    their gear."""
    robot = load_robot(two_joints(tmp_path, actuator=actuator.format("j1") + actuator.format("j2")))
    assert all(joint.controller == SERVOS[actuator] for joint in robot.joints)


@pytest.mark.usefixtures("compiled_here")
@pytest.mark.parametrize(
    "actuator", [a for a, drive in SERVOS.items() if not drive.delay and drive.mode == "position"]
)
def test_a_servo_moves_the_arm_as_in_mujoco(tmp_path: Path, actuator: str) -> None:
    """A step of the set-point turns the simulated arm as MuJoCo turns it, dry friction left out."""
    path = two_joints(tmp_path, actuator=actuator.format("j1") + actuator.format("j2"))
    path.write_text(
        path.read_text()
        .replace('frictionloss="0.3"', "")
        .replace("<option ", '<option integrator="RK4" ')
    )
    arm = open_mjcf(path)
    target = np.array([0.4, -0.3])
    simulator = Simulator(arm.robot, SimulationSettings(sensors=Sensors.exact()), q0=np.zeros(2))
    constant = np.tile(target, (1000, 1))
    ours, _ = simulator.follow(constant, 0.0 * constant, 0.0 * constant)
    data = engine().MjData(arm.model)
    theirs = []
    for _ in range(1000):
        theirs.append(data.qpos[arm.positions].copy())
        data.ctrl[:] = target
        engine().mj_step(arm.model, data)
    assert np.abs(ours.q - theirs).max() < 4e-3 and np.ptp(ours.q, axis=0).min() > 0.1


@pytest.mark.usefixtures("compiled_here")
@pytest.mark.parametrize(
    "actuator",
    [
        '<position name="servo" joint="j1" kp="60" timeconst="0.1"/>',
        '<general name="servo" joint="j1" gainprm="50" biastype="affine" biasprm="0 -60 -3"/>',
        '<pid name="servo" joint="j1" kp="60" kv="5" ki="9" imax="2"/>',
        '<position joint="j1" kp="60" name="servo"/><velocity joint="j1" kv="3" name="damper"/>',
    ],
)
def test_other_controllers_are_named_as_left_out(tmp_path: Path, actuator: str) -> None:
    """Filters, scaled set-points, limited integrals and several actuators of one joint are not
    dropped silently."""
    robot = load_robot(two_joints(tmp_path, actuator=actuator))
    assert robot.joints[0].controller is None
    assert any("controller of j1 (servo" in note and "ignored" in note for note in robot.notes)
