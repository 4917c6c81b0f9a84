"""Corrected files: a user's own MJCF or URDF with numbers changed, and nothing else."""

import difflib
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import elastic_arm.robot
from elastic_arm.dynamics import build_model
from elastic_arm.errors import RobotError
from elastic_arm.recording import write_recording
from elastic_arm.robot import Inertia, JointController, Robot, load_robot, save_robot, to_urdf
from elastic_arm.robot.kinematics import lumped
from tests.helpers.mujoco_arms import MODELS, random_motion
from tests.helpers.servo_arms import EXAMPLE, recorded, servo_arm
from tests.robot.test_mjcf import two_joints
from tests.robot.test_urdf import DRAKE
from tests.robot.test_urdf import two_joints as urdf_of_two_joints

pytest.importorskip("mujoco")

from elastic_arm.cli.mujoco.export import export
from elastic_arm.mujoco import attach, export_mjcf, export_new_mjcf, export_urdf
from elastic_arm.mujoco.changed_numbers import inertial_change, text_of
from elastic_arm.mujoco.stated_arm import stated_arm
from elastic_arm.robot.mjcf import open_mjcf

LOAD = {
    "effect": "payload",
    "joint": None,
    "parameters": {"mass": 1.5, "position": [0.02, 0.03, 0.2]},
}
FRICTION = {"effect": "coulomb_friction", "joint": "joint3", "parameters": {"torque": 2.0}}
DAMPING = {"effect": "viscous_friction", "joint": "joint1", "parameters": {"coefficient": 0.75}}
ROTOR = {"effect": "rotor_inertia_mismatch", "joint": "joint5", "parameters": {"inertia": 1.5}}
STRIBECK = {
    "effect": "stribeck_friction",
    "joint": "joint2",
    "parameters": {"torque": 1.0, "speed": 0.1},
}


@pytest.fixture
def base(tmp_path: Path) -> Path:
    """A copy of the seven-joint arm, with what it includes."""
    for name in ("arm.xml", "hand.xml"):
        shutil.copy(MODELS / name, tmp_path / name)
    return tmp_path / "arm.xml"


def corrected(base: Path, *effects: dict[str, object]) -> Robot:
    """Return the base's arm with effects in the place of those that the base states for the same
    joint."""
    robot = load_robot(base)
    taken = {(e["effect"], e["joint"]) for e in effects}
    kept = [e for e in robot.effects if (e["effect"], e["joint"]) not in taken]
    return robot.with_(effects=(*kept, *effects))


def changed_lines(before: Path, after: Path) -> list[str]:
    lines = difflib.ndiff(before.read_text().splitlines(), after.read_text().splitlines())
    return [line for line in lines if line[:2] in ("- ", "+ ")]


def test_only_the_lines_of_changed_numbers_change(base: Path) -> None:
    """Comments, order, names and layout stay; each changed element is one changed line."""
    out = base.parent / "fixed.xml"
    done = export_mjcf(corrected(base, FRICTION, DAMPING), base, out)
    assert {(c.element, c.number) for c in done.changes} == {
        ("joint3", "frictionloss"),
        ("joint3", "solreffriction"),
        ("joint1", "damping"),
    }
    lines = changed_lines(base, out)
    assert len(lines) == 4, lines
    assert '<joint name="joint1" damping="0.75"/>' in lines[1] and 'frictionloss="2"' in lines[3]


def test_what_is_written_is_the_corrected_arm(base: Path) -> None:
    """Payload and rotor inertia, lumped into the file's numbers, give the torques of the corrected
    arm."""
    out = base.parent / "fixed.xml"
    done = export_mjcf(corrected(base, LOAD, ROTOR), base, out)
    # the include changed, too
    assert [path.name for path in done.files] == ["fixed.xml", "fixed_hand.xml"]
    again, before = load_robot(out), load_robot(base)
    assert again.joints[4].armature == pytest.approx(0.045)
    point = Inertia(1.5, np.array([0.02, 0.03, 0.2]), np.zeros((3, 3)))
    joints = list(before.joints)
    joints[-1] = replace(joints[-1], link=lumped([joints[-1].link, point]))
    joints[4] = replace(joints[4], armature=0.045)
    motion = random_motion(7)
    torques = [
        build_model(r).inverse_dynamics(*motion)
        for r in (again, before.with_(joints=tuple(joints)))
    ]
    np.testing.assert_allclose(*torques, rtol=1e-7, atol=1e-7)


def test_a_file_in_another_folder_finds_its_includes(base: Path) -> None:
    """What is included and unchanged is found where it was."""
    out = base.parent / "other" / "fixed.xml"
    export_mjcf(corrected(base, DAMPING), base, out)
    assert 'file="../hand.xml"' in out.read_text()
    assert load_robot(out).n == 7


def test_what_no_number_states_is_listed(base: Path) -> None:
    """Stribeck friction is left to a law, with the reason; the friction loss in its place is said,
    and no more."""
    done = export_mjcf(corrected(base, STRIBECK), base, base.parent / "fixed.xml")
    (left,) = done.left
    assert (
        left.what == "stribeck_friction" and "attach" in left.reason and left.cost["joint2"] > 0.0
    )
    assert {change.number for change in done.changes} == {"frictionloss", "solreffriction"}
    (words,) = done.stand_ins
    assert words.startswith("stribeck friction")


SCENE = """<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <asset><model name="cobot" file="arm.xml"/></asset>
  <worldbody>
    <frame pos="1 0 0"><attach model="cobot" body="pedestal" prefix="left/"/></frame>
    <replicate count="3" offset="0 0.2 0">
      <body name="brick"><geom size="0.05" mass="1"/></body>
    </replicate>
  </worldbody>
</mujoco>
"""


def test_an_attached_arm_is_written_as_mujoco_saves_it(base: Path) -> None:
    """Bodies of <attach> have no line in the user's file: the whole model is saved, with the
    numbers changed."""
    scene, out = base.parent / "scene.xml", base.parent / "fixed.xml"
    scene.write_text(SCENE)
    chain = ("left/pedestal", "left/link6")
    robot = load_robot(scene, "left/pedestal:left/link6")
    friction = {**FRICTION, "joint": "left/joint3"}
    done = export_mjcf(robot.with_(effects=(*robot.effects, friction)), scene, out, chain=chain)
    assert {(c.element, c.number) for c in done.changes} >= {("left/joint3", "frictionloss")}
    assert any("<attach>" in note for note in done.notes)
    again = load_robot(out, "left/pedestal:left/link6")
    assert [e["parameters"] for e in again.effects if e["effect"] == "coulomb_friction"] == [
        {"torque": 2.0}
    ]
    motion = random_motion(robot.n)
    torques = [build_model(one).inverse_dynamics(*motion) for one in (again, robot)]
    np.testing.assert_allclose(*torques, rtol=1e-6, atol=1e-6)


def test_replicated_bodies_beside_the_arm_leave_the_file_as_it_is(base: Path) -> None:
    """Where the arm's own bodies stand in the file by name, others may be made by <replicate>."""
    brick = (
        '<replicate count="3" offset="0 0.2 0"><body name="brick"><geom size="0.05"'
        ' mass="1"/></body></replicate>'
    )
    base.write_text(base.read_text().replace("<worldbody>", f"<worldbody>\n    {brick}"))
    out = base.parent / "fixed.xml"
    done = export_mjcf(corrected(base, FRICTION), base, out)
    assert not done.notes
    assert len(changed_lines(base, out)) == 2
    assert brick in out.read_text()


def test_unphysical_numbers_are_refused(base: Path) -> None:
    """Friction that drives, and a link that leaves a body no positive inertia, are refused by
    name."""
    bad = {**DAMPING, "parameters": {"coefficient": -1.0}}
    with pytest.raises(RobotError, match="damping of joint1 would be -1"):
        export_mjcf(corrected(base, bad), base, base.parent / "fixed.xml")
    robot = load_robot(base)
    # less than the cover that stands on the link
    light = Inertia(0.2, np.zeros(3), 1e-3 * np.eye(3))
    joints = (replace(robot.joints[0], link=light), *robot.joints[1:])
    with pytest.raises(
        RobotError, match="leave body 'link1' without a physically possible inertia"
    ):
        export_mjcf(robot.with_(joints=joints), base, base.parent / "fixed.xml")
    assert not (base.parent / "fixed.xml").exists()


def test_another_arm_is_refused(base: Path) -> None:
    """The base must describe the arm."""
    with pytest.raises(RobotError, match="has the joints"):
        export_mjcf(load_robot(base, "link2:link5"), base, base.parent / "fixed.xml")


def test_a_torque_delay_goes_to_the_sensor(base: Path) -> None:
    """A late motor torque is the delay of the joint's torque sensor, where the file has one, and is
    read back."""
    text = base.read_text().replace(
        "</mujoco>", '<sensor><jointactuatorfrc joint="joint2"/></sensor></mujoco>'
    )
    base.write_text(text)
    late = {
        "effect": "time_delay",
        "joint": "joint2",
        "parameters": {"delay": 0.01, "channels": ["motor_torque"]},
    }
    other = {**late, "joint": "joint3"}
    done = export_mjcf(corrected(base, late, other), base, base.parent / "fixed.xml")
    assert [(left.joint, left.reason) for left in done.left] == [
        ("joint3", "the file has no jointactuatorfrc sensor of this joint")
    ]
    (effect,) = [
        e for e in load_robot(base.parent / "fixed.xml").effects if e["effect"] == "time_delay"
    ]
    assert (effect["joint"], effect["parameters"]["delay"]) == ("joint2", 0.01)


def test_a_urdf_keeps_its_shape(tmp_path: Path) -> None:
    """A URDF's inertials, damping and friction change, nothing else does."""
    base = tmp_path / "arm.urdf"
    base.write_text(to_urdf(load_robot()))
    robot = load_robot(base)
    load = {**LOAD, "parameters": {"mass": 2.0, "position": [0.0, 0.0, 0.1]}}
    friction = {**FRICTION, "joint": "joint_2"}
    done = export_urdf(robot.with_(effects=(load, friction)), base, tmp_path / "fixed.urdf")
    assert {c.element for c in done.changes} == {"link_3", "joint_2"}
    lines = changed_lines(base, tmp_path / "fixed.urdf")
    assert len([line for line in lines if line.startswith("- ")]) == 3
    again = load_robot(tmp_path / "fixed.urdf")
    assert again.mass == pytest.approx(robot.mass + 2.0)
    assert again.effects == (
        {"effect": "coulomb_friction", "joint": "joint_2", "parameters": {"torque": 2.0}},
    )


def test_tables_show_no_rounding_of_a_solver() -> None:
    """A centre of mass of 1e-17 m beside 0.05 m is at zero."""
    joint, *_ = load_robot(None).joints
    moved = replace(joint.link, com=np.array([1e-17, 0.05, 0.0]))
    (change,) = (
        c for c in inertial_change("link", joint.link, moved) if c.number == "centre of mass"
    )
    assert change.after == (0.0, 0.05, 0.0)


def test_a_urdf_lists_what_it_has_no_number_for(tmp_path: Path) -> None:
    """Springs, delays and drives of an exported arm are named with their size and the missing
    torque; armatures are in the file."""
    rigid = load_robot(MODELS / "arm.xml")
    spring = {
        "effect": "joint_spring",
        "joint": "joint2",
        "parameters": {"stiffness": 80.0, "rest": 0.0},
    }
    late = {
        "effect": "time_delay",
        "joint": "joint2",
        "parameters": {"delay": 0.01, "channels": ["motor_torque"]},
    }
    done = export_urdf(rigid.with_(effects=(spring, late)), None, tmp_path / "new.urdf")
    left = {(one.what, one.joint): one for one in done.left}
    assert set(left) == {
        *(("controller", joint.name) for joint in rigid.joints if joint.controller),
        ("joint_spring", "joint2"),
        ("time_delay", "joint2"),
    }
    found = [joint.armature or 0.0 for joint in load_robot(tmp_path / "new.urdf").joints]
    assert found == pytest.approx([joint.armature or 0.0 for joint in rigid.joints])
    assert found[4] == pytest.approx(0.03)
    assert (
        left["joint_spring", "joint2"].cost["joint2"] > 10.0
        and not left["time_delay", "joint2"].cost
    )
    spring["joint"] = "joint_1"
    rotor = {"effect": "rotor_inertia_mismatch", "joint": "joint_1", "parameters": {"inertia": 1.5}}
    elastic = export_urdf(
        load_robot().with_(effects=(spring, rotor)), None, tmp_path / "elastic.urdf"
    )
    kinds = {one.what for one in elastic.left}
    assert kinds == {"drive", "bearing", "joint_spring"}
    gear = load_robot().joints[0].transmission
    inertias = (
        gear.rotor.izz * gear.r_tot**2,
        gear.wave_generator.izz * gear.harmonic_drive_ratio**2,
        gear.spline.izz,
    )
    written = load_robot(tmp_path / "elastic.urdf").joints[0].armature
    assert written == pytest.approx(1.5 * sum(inertias))


PLAIN = """<robot name="one"><link name="base"/>
  <!-- the only joint -->
  <joint name="j" type="revolute"><parent link="base"/><child link="l"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="5" velocity="2"/></joint>
  <link name="l"><inertial><mass value="1"/>
    <inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  {}
</robot>"""
ROS_1 = (
    '<transmission name="t"><joint name="j"/><actuator name="m">'
    "<mechanicalReduction>50</mechanicalReduction></actuator></transmission>"
)
ROS_2 = (
    '<ros2_control name="h" type="system"><transmission name="t"><actuator name="m"/>'
    '<joint name="j"><mechanical_reduction>-80</mechanical_reduction></joint>'
    "</transmission></ros2_control>"
)


@pytest.mark.parametrize(
    ("stated", "ratio", "of_drake"),
    [
        ("", 1.0, {"gear_ratio": "1"}),
        (ROS_1, 50.0, {"gear_ratio": "50"}),
        (ROS_2, 80.0, {"gear_ratio": "-80"}),
        (DRAKE, 100.0, {"gear_ratio": "100"}),
        (DRAKE + ROS_2.replace("-80", "100"), 100.0, {"gear_ratio": "100"}),
        (DRAKE.replace(' value="6e-5"/>', ">6e-5</drake:rotor_inertia>"), 100.0, {}),
    ],
)
def test_a_corrected_urdf_carries_the_motors_inertia(
    tmp_path: Path, stated: str, ratio: float, of_drake: dict[str, str]
) -> None:
    """Drake's tags hold 2.28 kg m², at the ratio that Drake, ROS or ros2_control states; all else
    stays, and nothing is left out."""
    text = PLAIN.format(stated)
    if "drake:" in text:
        text = text.replace("<robot ", '<robot xmlns:drake="https://drake.mit.edu/" ')
    base, out = tmp_path / "one.urdf", tmp_path / "fixed.urdf"
    base.write_text(text)
    robot = load_robot(base).with_joint("j", armature=2.28)
    done = export_urdf(robot, base, out)
    assert not done.left and [(one.number, one.after) for one in done.changes] == [
        ("armature", (2.28,))
    ]
    assert load_robot(out).joints[0].armature == pytest.approx(2.28, rel=1e-9)
    written = out.read_text()
    assert f"{2.28 / ratio**2:.10g}" in written and "<!-- the only joint -->" in written
    # Drake knows its tags by their prefix, directly below <robot>.
    for tag, value in of_drake.items():
        assert f"<drake:{tag} " in written and f'value="{value}"' in written
    kept = [line for line in text.splitlines() if line not in written.splitlines()]
    assert len(kept) <= 2, kept
    # Written once more, nothing changes.
    assert not export_urdf(load_robot(out), out, tmp_path / "again.urdf").changes


def test_a_motor_of_several_joints_has_no_inertia_of_one(tmp_path: Path) -> None:
    """A differential's armatures are named as left out: no joint has them alone."""
    both = (
        '<transmission name="t"><joint name="one"/><joint name="two"/><actuator name="m"/>'
        "</transmission></robot>"
    )
    base = tmp_path / "two.urdf"
    base.write_text(urdf_of_two_joints().replace("</robot>", both))
    robot = load_robot(base).with_joint("two", armature=0.5)
    (left,) = export_urdf(robot, base, tmp_path / "fixed.urdf").left
    # 0.5 rad at 2 rad/s: accelerations of 2 rad/s² times a sine.
    assert (left.what, left.numbers) == ("armature", {"armature": 0.5})
    assert left.cost == {"two": pytest.approx(0.5 * np.sqrt(2.0), rel=0.01)}


def test_what_the_whole_arm_has_is_listed(base: Path) -> None:
    """A URDF has no number for how its base is turned, an MJCF without torque sensors none for a
    delay of the arm."""
    urdf = base.parent / "arm.urdf"
    urdf.write_text(to_urdf(load_robot(base)))
    robot, turn = load_robot(urdf), np.eye(4)
    turn[:3, :3] = Rotation.from_euler("x", 0.7).as_matrix()
    (left,) = export_urdf(
        robot.with_(base_placement=turn @ robot.base_placement), urdf, urdf.with_stem("fixed")
    ).left
    assert (left.what, left.numbers) == (
        "base_tilt",
        {"x": pytest.approx(0.7), "y": pytest.approx(0.0)},
    )
    assert left.cost["joint2"] > 1.0
    late = {
        "effect": "time_delay",
        "joint": None,
        "parameters": {"delay": 0.01, "channels": ["motor_torque"]},
    }
    (left,) = export_mjcf(corrected(base, late), base, base.parent / "fixed.xml").left
    assert (left.what, left.joint) == ("time_delay", None)


def test_a_new_mjcf_lists_what_it_has_no_number_for(tmp_path: Path) -> None:
    """Bearings, the rotors' coupling and a controller that is no MuJoCo servo are not in the new
    file, and named."""
    robot = load_robot()
    robot = robot.with_joint("joint_2", controller=JointController(kp=100.0, ki=1.0))
    done = export_new_mjcf(robot, None, tmp_path / "new.xml")
    assert {one.what for one in done.left} == {"bearing", "controller", "inertia_coupling"}
    (coupling,) = (one for one in done.left if one.what == "inertia_coupling")
    assert max(coupling.cost.values()) > 0.1


@pytest.mark.parametrize(
    ("name", "asked", "found"),
    [
        ("x.urdf", None, "urdf"),
        ("x.xml", None, "mjcf"),
        ("x.mjcf", None, "mjcf"),
        ("x.xml", "urdf", "urdf"),
        ("x.urdf", "mjcf", None),
        ("x.mjcf", "urdf", None),
        ("x.c", None, "c"),
        ("x.py", "python", "python"),
        ("x.casadi", None, "casadi"),
        ("x.py", "c", None),
        ("x.yaml", None, None),
    ],
)
def test_the_format_goes_by_the_ending(
    tmp_path: Path, name: str, asked: str | None, found: str | None
) -> None:
    """`elastic-arm export --out x.urdf` writes a URDF; an ending of another format is refused."""
    arguments = ["--out", str(tmp_path / name), *([] if asked is None else ["--to", asked])]
    app = typer.Typer()
    app.command()(export)
    result = CliRunner().invoke(
        app, [str(Path(elastic_arm.robot.__file__).parent / "data" / "arm.yaml"), *arguments]
    )
    if found is None:
        assert (
            result.exit_code == 2
            and "extension" in result.stderr
            and not (tmp_path / name).exists()
        )
    else:
        roots = {"urdf": "<robot", "mjcf": "<mujoco", "c": "void x_torque("}
        root = {**roots, "python": "def torque(q", "casadi": ""}[found]
        assert result.exit_code == 0 and root in (tmp_path / name).read_text()
        assert "bearing" in result.output


def test_what_was_left_out_when_an_arm_was_read_is_said_of_its_file(tmp_path: Path) -> None:
    """Cogging of a motor, which a rigid arm cannot hold, is not in the URDF either."""
    motor = (
        '<dcmotor name="m" joint="j1" motorconst="0.05" resistance="1" gear="100" cogging="0.03 6'
        ' 0"/>'
    )
    app = typer.Typer()
    app.command()(export)
    result = CliRunner().invoke(
        app, [str(two_joints(tmp_path, actuator=motor)), "--out", str(tmp_path / "x.urdf")]
    )
    assert result.exit_code == 0 and "cogging of actuator m, 3 Nm at j1" in result.output


def test_the_limit_of_a_servo_is_written_as_forcerange(tmp_path: Path) -> None:
    """A drive that was found to give less torque has that in the corrected file; a dead band is
    named as left out."""
    (tmp_path / "arm.xml").write_text((EXAMPLE / "arm.xml").read_text())
    robot = load_robot(tmp_path / "arm.xml")
    pan, lift = (robot.joints[k].controller for k in (0, 1))
    assert pan is not None and lift is not None
    robot = robot.with_joint("pan", controller=replace(pan, torque=1.5))
    robot = robot.with_joint("lift", controller=replace(lift, dead_band=0.02))
    done = export_mjcf(robot, tmp_path / "arm.xml", tmp_path / "new.xml")
    assert [(one.element, one.number, one.after) for one in done.changes] == [
        ("pan", "forcerange", (1.5,))
    ]
    assert [(one.what, one.joint) for one in done.left] == [("controller", "lift")]
    assert load_robot(tmp_path / "new.xml").joints[0].controller == replace(pan, torque=1.5)


@pytest.mark.parametrize("angle", ["radian", "degree"])
def test_a_spring_is_written_as_stiffness_and_springref(base: Path, angle: str) -> None:
    """A joint spring that was found is in the corrected file, in the units of its compiler, and
    read back."""
    base.write_text(base.read_text().replace('angle="radian"', f'angle="{angle}"'))
    spring = {
        "effect": "joint_spring",
        "joint": "joint2",
        "parameters": {"stiffness": 80.0, "rest": 0.3},
    }
    done = export_mjcf(corrected(base, spring), base, base.parent / "fixed.xml")
    assert {(c.element, c.number, c.after) for c in done.changes} == {
        ("joint2", "stiffness", (80.0,)),
        ("joint2", "springref", (0.3,)),
    }
    (again,) = [
        e for e in load_robot(base.parent / "fixed.xml").effects if e["effect"] == "joint_spring"
    ]
    assert again["parameters"] == {"stiffness": 80.0, "rest": pytest.approx(0.3)}


def test_carried_weight_that_a_file_does_not_state_is_listed(base: Path) -> None:
    """Weight carried by something outside is in the file as gravcomp or, where it was found, named
    with its torque."""
    carried = {
        "effect": "carried_weight",
        "joint": "joint2",
        "parameters": {"mass": 1.0, "position": [0.0, 0.0, 0.1]},
    }
    done = export_mjcf(corrected(base, carried), base, base.parent / "fixed.xml")
    assert [(one.what, one.joint) for one in done.left] == [("carried_weight", "joint2")]


ZERO = {"effect": "joint_zero", "joint": "joint2", "parameters": {"offset": 0.05}}


def torques_with_zero(robot: Robot, i: int, offset: float) -> tuple[np.ndarray, np.ndarray]:
    """Return q, dq, ddq of a motion, and the torques of the arm at the angles of joint i less the
    offset."""
    motion = random_motion(robot.n)
    described = motion[0] - offset * (np.arange(robot.n) == i)
    return motion, build_model(robot).inverse_dynamics(described, *motion[1:])


def test_a_joint_zero_is_where_a_model_is_drawn(base: Path) -> None:
    """The corrected MJCF has the offset as `ref`: read back, it moves as the arm whose encoders are
    off."""
    robot = load_robot(base)
    done = export_mjcf(corrected(base, ZERO), base, base.parent / "fixed.xml")
    assert [(c.element, c.number) for c in done.changes] == [("joint2", "ref")] and not done.left
    again = load_robot(base.parent / "fixed.xml")
    motion, expected = torques_with_zero(robot, 1, 0.05)
    np.testing.assert_allclose(
        build_model(again).inverse_dynamics(*motion), expected, rtol=1e-6, atol=1e-6
    )


@pytest.mark.parametrize("with_base", [True, False])
def test_a_joint_zero_turns_the_origin_of_a_urdfs_joint(tmp_path: Path, with_base: bool) -> None:
    """In a URDF, the user's or a new one, the joint stands turned about its axis by the offset."""
    own = tmp_path / "arm.urdf"
    own.write_text(to_urdf(load_robot()))
    robot = load_robot(own)
    wrong = robot.with_(effects=({**ZERO, "joint": "joint_2"},))
    done = export_urdf(wrong, own if with_base else None, tmp_path / "fixed.urdf")
    assert [(c.element, c.number) for c in done.changes] == [("joint_2", "origin rpy")]
    motion, expected = torques_with_zero(robot, 1, 0.05)
    found = build_model(load_robot(tmp_path / "fixed.urdf")).inverse_dynamics(*motion)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)


DEGRESSIVE = {
    "effect": "degressive_friction",
    "joint": "joint2",
    "parameters": {"torque": 1.7, "speed": 0.05},
}


def test_friction_that_levels_off_is_written_as_the_nearest_numbers(base: Path) -> None:
    """Of 1.7 Nm that bend at 0.05 rad/s, friction loss and damping together make 1.7 Nm within a
    tenth from 0.2 on."""
    out = base.parent / "fixed.xml"
    robot = corrected(base, DEGRESSIVE)
    done = export_mjcf(robot, base, out)
    before, after = (stated_arm(load_robot(path)).joints[1] for path in (base, out))
    speed = np.linspace(0.2, 1.0, 9)  # rad/s
    made = after.friction_loss - before.friction_loss + (after.damping - before.damping) * speed
    np.testing.assert_allclose(made, 1.7, rtol=0.1)
    (words,) = done.stand_ins
    assert "1.7 Nm" in words and "friction loss" in words


def test_numbers_in_the_place_of_a_law_follow_the_motion(base: Path) -> None:
    """Far below the speed at which it bends, such friction is damping of torque / speed and no
    friction loss."""
    robot = corrected(base, DEGRESSIVE)
    t = np.linspace(0.0, 2.0 * np.pi, 200)[:, None] + np.zeros(7)
    slow = 0.01 * np.sin(t), 0.01 * np.cos(t), -0.01 * np.sin(t)
    export_mjcf(robot, base, base.parent / "fixed.xml", motion=slow)
    before, after = (
        stated_arm(load_robot(base.parent / name)).joints[1] for name in ("arm.xml", "fixed.xml")
    )
    assert after.damping - before.damping == pytest.approx(1.7 / 0.05, rel=0.05)
    assert after.friction_loss < 0.02


def test_laws_that_act_take_the_numbers_in_their_place_away(base: Path) -> None:
    """With the law attached the model has the friction that it had; exported anew, no note of the
    numbers stays."""
    out, again = base.parent / "fixed.xml", base.parent / "again.xml"
    robot = corrected(base, DEGRESSIVE)
    export_mjcf(robot, base, out)
    own, stood = open_mjcf(base).model, open_mjcf(out).model
    written = stood.dof_frictionloss.copy()
    with attach(stood, robot):
        np.testing.assert_allclose(stood.dof_frictionloss, own.dof_frictionloss, atol=1e-9)
        np.testing.assert_allclose(stood.dof_damping, own.dof_damping, atol=1e-9)
    np.testing.assert_array_equal(stood.dof_frictionloss, written)
    assert "in_place_of" in out.read_text()
    export_mjcf(load_robot(out), out, again)
    assert "in_place_of" not in again.read_text()


def test_zero_has_no_sign() -> None:
    """A gain of minus nothing is written as 0."""
    assert text_of(-0.0, 1.5, -2.0) == "0 1.5 -2"


def test_a_gain_leaves_the_limit_and_a_damping_ratio_gives_way(tmp_path: Path) -> None:
    """With another kp the forcerange stays; kv, which a dampratio made of kp and masses, is written
    as it was."""
    text = (
        (EXAMPLE / "arm.xml")
        .read_text()
        .replace('kv="0.6" joint="lift"', 'dampratio="0.8" joint="lift"')
    )
    (tmp_path / "arm.xml").write_text(text)
    robot = load_robot(tmp_path / "arm.xml")
    lift = robot.joints[1].controller
    assert lift is not None
    changed = replace(lift, kp=1.2 * lift.kp)
    heavier = replace(robot.joints[2].link, mass=1.3 * robot.joints[2].link.mass)
    robot = robot.with_joint("lift", controller=changed).with_joint("elbow", link=heavier)
    done = export_mjcf(robot, tmp_path / "arm.xml", tmp_path / "new.xml")
    assert "forcerange" not in {change.number for change in done.changes}
    found = load_robot(tmp_path / "new.xml").joints[1].controller
    assert found is not None
    assert (found.kp, found.kd, found.torque) == (
        pytest.approx(changed.kp),
        pytest.approx(lift.kd),
        lift.torque,
    )


def test_a_new_file_has_the_limit_of_a_servo_with_a_dead_band(tmp_path: Path) -> None:
    """3.72 Nm that robot.yaml states are the new file's forcerange; the dead band is listed with
    its size."""
    robot = load_robot(EXAMPLE / "arm.xml")
    pan = robot.joints[0].controller
    assert pan is not None
    robot = robot.with_joint("pan", controller=replace(pan, torque=3.72, dead_band=0.02))
    save_robot(robot, tmp_path / "robot.yaml")
    done = export_new_mjcf(load_robot(tmp_path / "robot.yaml"), None, tmp_path / "new.xml")
    found = load_robot(tmp_path / "new.xml").joints[0].controller
    assert found is not None and (found.kp, found.torque) == (pytest.approx(pan.kp), 3.72)
    (left,) = [one for one in done.left if one.what == "controller"]
    assert left.joint == "pan" and left.numbers["dead_band"] == 0.02


def test_an_export_is_played_beside_its_base(tmp_path: Path) -> None:
    """With --validate the errors of both files under recorded commands are printed: those of the
    right kp are small."""
    true = servo_arm({'kp="17.8" kv="0.6" joint="lift"': 'kp="23" kv="0.6" joint="lift"'})
    write_recording(tmp_path / "bag", recorded(true, 100.0, 14))
    save_robot(true.robot, tmp_path / "robot.yaml")
    app = typer.Typer()
    app.command()(export)
    base, out = EXAMPLE / "arm.xml", tmp_path / "new.xml"
    words = [
        tmp_path / "robot.yaml",
        "--base",
        base,
        "--out",
        out,
        "--validate",
        tmp_path / "bag",
        "--json",
    ]
    done = CliRunner().invoke(app, list(map(str, words)))
    assert done.exit_code == 0, done.output
    lift = json.loads(done.output)["closed_loop"]["lift"]
    assert lift["described"] > 5e-3 and lift["corrected"] < 5e-4
    assert lift["alone"] == lift["corrected"]
    law = {
        "effect": "load_dependent_friction",
        "joint": "lift",
        "parameters": {"coefficient": 0.3},
    }
    save_robot(true.robot.with_(effects=(*true.robot.effects, law)), tmp_path / "robot.yaml")
    done = CliRunner().invoke(app, [*map(str, words), "--force"])
    lift = json.loads(done.output)["closed_loop"]["lift"]
    assert abs(lift["alone"] - lift["corrected"]) > 1e-3
    refused = CliRunner().invoke(
        app, [*map(str, words[:1]), "--out", str(tmp_path / "o.xml"), *map(str, words[5:7])]
    )
    assert refused.exit_code == 2 and "Give it with --base" in refused.output
