"""URDF in and out: any serial chain of revolute joints, checked against engines that nobody here
wrote."""

import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.errors import RobotError
from elastic_arm.robot import Limits, Robot, load_robot, robot_to_dict, save_robot, to_urdf
from elastic_arm.robot.kinematics import link_placements, lumped, moved
from elastic_arm.robot.urdf import parse_urdf
from tests.helpers.shared_data import DATA, needs_data

KUKA = DATA / "kuka_lwr4" / "kuka_lwr4.urdf"
KINOVA = DATA / "kinova_gen3" / "gen3_2f85.urdf"
INERTIAL = (
    '<inertial><origin xyz="0.1 0.02 -0.03" rpy="0.3 -0.2 0.5"/><mass value="2"/>'
    '<inertia ixx="0.03" ixy="0.001" ixz="-0.002" iyy="0.04" iyz="0.003" izz="0.05"/></inertial>'
)
LIMIT = '<limit lower="-1" upper="2" velocity="1.5" effort="40"/>'


def link(name: str, inertial: str = INERTIAL) -> str:
    return f'<link name="{name}">{inertial}</link>'


def joint(
    name: str,
    parent: str,
    child: str,
    kind: str = "revolute",
    inside: str = LIMIT,
    origin: str = "",
) -> str:
    place = origin or '<origin xyz="0.1 0 0.3" rpy="0 0.4 0"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child'
        f' link="{child}"/>{place}<axis xyz="0 1 0"/>{inside}</joint>'
    )


def urdf(*elements: str) -> str:
    return f'<robot name="toy">{"".join(elements)}</robot>'


def two_joints(*more: str) -> str:
    return urdf(
        link("foot"), link("a"), link("b"), joint("one", "foot", "a"), joint("two", "a", "b"), *more
    )


def random_chain(rng: np.random.Generator, joints: int) -> str:
    """A chain with axes and origins in all directions, fixed links between and at the end,
    continuous joints."""
    elements = [link("foot")]
    parent = "foot"
    for i in range(2 * joints + 1):
        child = f"link_{i}"
        mass = rng.uniform(0.5, 3.0)
        (x, y, z) = rng.uniform(0.01, 0.05, 3)
        inertia = f'ixx="{y + z}" iyy="{x + z}" izz="{x + y}" ixy="0" ixz="0" iyz="0"'
        xyz, rpy = ("{} {} {}".format(*rng.uniform(-1, 1, 3)) for _ in range(2))
        elements.append(
            f'<link name="{child}"><inertial><origin xyz="{xyz}" rpy="{rpy}"/><mass'
            f' value="{mass}"/><inertia {inertia}/></inertial></link>'
        )
        kind = "fixed" if i % 2 == 0 else ("continuous" if i % 4 == 1 else "revolute")
        xyz, rpy, axis = ("{} {} {}".format(*rng.uniform(-1, 1, 3)) for _ in range(3))
        elements.append(
            f'<joint name="joint_{i}" type="{kind}"><parent link="{parent}"/><child'
            f' link="{child}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{LIMIT}</joint>'
        )
        parent = child
    return urdf(*elements)


def assert_same_dynamics(robot: Robot, text: str) -> None:
    """Inverse dynamics and mass matrix are those of Pinocchio's own reading of `text`, to 1e-9."""
    model = build_model(robot, engine="numpy")
    peer = pinocchio.buildModelFromXML(text)
    data = peer.createData()
    q, dq, ddq = np.random.default_rng(5).normal(size=(3, 12, robot.n))
    tau = model.inverse_dynamics(q, dq, ddq)
    M = model.mass_matrix(q)
    for k in range(len(q)):
        # Pinocchio holds a continuous joint's angle as its cosine and sine.
        own = [
            [a] if j.nq == 1 else [np.cos(a), np.sin(a)]
            for j, a in zip(peer.joints[1:], q[k], strict=True)
        ]
        configuration = np.concatenate(own)
        expected = pinocchio.rnea(peer, data, configuration, dq[k], ddq[k])
        np.testing.assert_allclose(tau[k], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
        upper = np.triu(pinocchio.crba(peer, data, configuration))
        np.testing.assert_allclose(np.triu(M[k]), upper, rtol=1e-9, atol=1e-9 * np.abs(upper).max())


@pytest.mark.skipif(not KUKA.exists(), reason=f"{KUKA} is not there")
def test_the_kuka_arm_moves_as_in_pinocchio() -> None:
    """The URDF of a real seven-joint arm gives the rigid dynamics of Pinocchio's own parser."""
    robot = load_robot(KUKA)
    assert robot.n == 7
    assert not robot.elastic
    assert robot.joints[1].limits.torque == 176
    # Its <transmission>s state rotors, which Pinocchio's parser leaves out.
    links = robot.with_(joints=tuple(replace(joint, armature=None) for joint in robot.joints))
    assert_same_dynamics(links, KUKA.read_text())


@pytest.mark.parametrize("joints", [2, 4])
def test_a_chain_in_all_directions_moves_as_in_pinocchio(joints: int) -> None:
    """Axes off z, turned inertials, fixed links between joints and continuous joints give
    Pinocchio's dynamics."""
    text = random_chain(np.random.default_rng(joints), joints)
    robot = parse_urdf(text)
    assert robot.n == joints
    assert_same_dynamics(robot, text)


def test_a_robot_written_as_urdf_and_read_again_moves_the_same() -> None:
    """Robot -> URDF -> robot keeps frames, inertias and limits, and the text becomes a fixed
    point."""
    robot = parse_urdf(random_chain(np.random.default_rng(9), 3))
    text = to_urdf(robot)
    again = parse_urdf(text)
    assert again.joint_names == robot.joint_names
    assert again.mass == pytest.approx(robot.mass, rel=1e-12)
    for one, other in zip(robot.joints, again.joints, strict=True):
        np.testing.assert_allclose(other.before, one.before, atol=1e-12)
        np.testing.assert_allclose(other.after, one.after, atol=1e-12)
        np.testing.assert_allclose(other.link.inertia, one.link.inertia, atol=1e-12)
        assert other.limits == one.limits
    assert_same_dynamics(robot, text)


def test_the_elastic_arm_as_urdf_carries_its_motors() -> None:
    """In an elastic arm's URDF, motors and gears ride on their carriers: mass and gravity torques
    are the arm's."""
    robot = load_robot()
    text = to_urdf(robot)
    rigid = parse_urdf(text)
    assert rigid.mass == pytest.approx(robot.mass, rel=1e-12)
    q = np.random.default_rng(1).uniform(-3, 3, (10, robot.n))
    still = np.zeros((10, 2 * robot.n))
    x = np.hstack([q, q])
    gravity = build_model(robot, engine="numpy").inverse_dynamics(x, still, still)
    expected = gravity[:, : robot.n] + gravity[:, robot.n :]
    found = build_model(rigid, engine="numpy").inverse_dynamics(
        q, still[:, : robot.n], still[:, : robot.n]
    )
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    assert_same_dynamics(rigid, text)


def test_mujoco_takes_the_urdf_and_agrees() -> None:
    """MuJoCo compiles the exported URDF and computes the same inverse dynamics."""
    text = to_urdf(load_robot())
    rigid = parse_urdf(text)
    engine = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(engine)
    q, dq, ddq = np.random.default_rng(2).normal(size=(3, 8, rigid.n))
    found = build_model(rigid, engine="numpy").inverse_dynamics(q, dq, ddq)
    for k in range(len(q)):
        data.qpos[:] = q[k]
        data.qvel[:] = dq[k]
        data.qacc[:] = ddq[k]
        mujoco.mj_inverse(engine, data)
        np.testing.assert_allclose(found[k], data.qfrc_inverse, atol=1e-9 * np.abs(found[k]).max())


def test_link_frames_stand_where_pinocchio_puts_them() -> None:
    """Forward kinematics over arrays of poses agrees with Pinocchio's."""
    text = random_chain(np.random.default_rng(4), 3)
    robot = parse_urdf(text)
    peer = pinocchio.buildModelFromXML(text)
    data = peer.createData()
    q = np.random.default_rng(4).uniform(-1, 2, (5, robot.n))
    _, links = link_placements(robot, q)
    for k in range(len(q)):
        own = [
            [a] if j.nq == 1 else [np.cos(a), np.sin(a)]
            for j, a in zip(peer.joints[1:], q[k], strict=True)
        ]
        pinocchio.framesForwardKinematics(peer, data, np.concatenate(own))
        for i, name in enumerate(robot.link_names):
            expected = data.oMf[peer.getFrameId(name)].homogeneous
            np.testing.assert_allclose(links[k, i], expected, atol=1e-12)


def test_lumping_bodies_keeps_mass_centre_and_inertia_about_any_point() -> None:
    """Two joined bodies have the inertia about a far point that they have one by one."""
    robot = parse_urdf(two_joints())
    bodies = [j.link for j in robot.joints]
    shift = np.eye(4)
    shift[:3, 3] = [0.3, -0.5, 0.7]
    bodies[1] = moved(bodies[1], shift)

    def about_origin(body: object) -> np.ndarray:
        c = body.com  # type: ignore[attr-defined]
        return body.inertia + body.mass * (c @ c * np.eye(3) - np.outer(c, c))  # type: ignore[attr-defined]

    whole = lumped(bodies)
    np.testing.assert_allclose(about_origin(whole), sum(map(about_origin, bodies)), rtol=1e-13)
    np.testing.assert_allclose(
        whole.mass * whole.com, sum(b.mass * b.com for b in bodies), rtol=1e-13
    )


def test_a_fixed_link_is_part_of_its_parent_and_said() -> None:
    """A tool on a fixed joint adds its mass to the last link, and a note tells."""
    plain = parse_urdf(two_joints())
    tooled = parse_urdf(two_joints(link("tool"), joint("flange", "b", "tool", "fixed", "")))
    assert tooled.n == plain.n
    assert tooled.joints[-1].link.mass == pytest.approx(plain.joints[-1].link.mass + 2.0)
    assert any("'flange' is fixed" in note and "'tool'" in note for note in tooled.notes)
    assert plain.notes == ()


def test_continuous_joints_and_unstated_limits_are_said() -> None:
    """A continuous joint has no range, a limit of 0 counts as unknown, and both leave a note."""
    text = urdf(
        link("foot"),
        link("a"),
        link("b"),
        joint("one", "foot", "a", "continuous", ""),
        joint("two", "a", "b", inside='<limit lower="-1" upper="1" velocity="0" effort="0"/>'),
    )
    robot = parse_urdf(text)
    assert robot.joints[0].limits.position_min is None
    assert robot.joints[1].limits.velocity is None
    assert robot.joints[1].limits.torque is None
    assert any("'one' is continuous" in note for note in robot.notes)
    assert any("'two' has the velocity limit 0" in note for note in robot.notes)


def test_a_link_without_inertial_counts_as_massless_and_is_said() -> None:
    """A dummy link between two joints has no mass, and a note tells."""
    robot = parse_urdf(two_joints().replace(link("a"), link("a", "")))
    assert robot.joints[0].link.mass == 0.0
    assert any("'a' has no inertial" in note for note in robot.notes)


def test_right_angles_written_with_few_digits_are_exact() -> None:
    """1.5708 is taken as pi/2, so that no parameter seems identifiable only because of the missing
    digits."""
    place = '<origin xyz="0 0 0.3" rpy="1.5708 0 3.1416"/>'
    robot = parse_urdf(two_joints().replace('<origin xyz="0.1 0 0.3" rpy="0 0.4 0"/>', place))
    entries = np.abs(robot.joints[0].before[:3, :3])
    assert set(entries.ravel()) == {0.0, 1.0}
    assert any("1.5708" in note for note in robot.notes)


def with_gripper(kind: str = "revolute") -> str:
    """Two joints and a gripper on a flange: a finger, a second one that mimics it, and a tip on the
    first."""
    finger = joint("left", "palm", "left_finger", kind)
    return two_joints(
        link("flange", ""),
        joint("mount", "b", "flange", "fixed", ""),
        link("palm"),
        joint("hand", "flange", "palm", "fixed", ""),
        link("left_finger"),
        link("right_finger"),
        link("tip"),
        finger,
        joint(
            "right", "palm", "right_finger", kind, '<mimic joint="left" multiplier="-1"/>' + LIMIT
        ),
        joint("tips", "left_finger", "tip", kind, '<mimic joint="left"/>' + LIMIT),
    )


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_gripper_is_held_at_zero_and_a_note_names_it(kind: str) -> None:
    """Joints that mimic one another are part of the link that carries them, as where they are
    fixed."""
    robot = parse_urdf(with_gripper(kind))
    assert robot.joint_names == ("one", "two")
    assert_same_dynamics(
        robot, re.sub(r'("(?:left|right|tips)" type=)"\w+"', r'\1"fixed"', with_gripper(kind))
    )
    assert any(
        "left, right, tips mimic one another" in note and "(6 kg)" in note for note in robot.notes
    )


def test_an_inertia_that_a_body_just_cannot_have_is_made_one() -> None:
    """A moment little beyond the sum of the other two is taken as the nearest that a body has, and
    a note names it."""
    robot = parse_urdf(two_joints().replace('izz="0.05"', 'izz="0.072"'))
    moments = np.linalg.eigvalsh(robot.joints[0].link.inertia)
    assert moments[2] * (1 + 1e-6) < moments[0] + moments[1] < moments[2] * (1 + 1e-3)
    assert moments == pytest.approx([0.03, 0.04, 0.072], rel=0.05)
    assert [
        note for note in robot.notes if "link 'a': its inertia is physically impossible" in note
    ]


def test_what_rests_may_state_any_inertia() -> None:
    """Of the base the mass alone counts: an antenna whose inertia no body has leaves the arm as it
    is."""
    antenna = link("antenna").replace('ixx="0.03"', 'ixx="-0.03"')
    robot = parse_urdf(two_joints(antenna, joint("aerial", "foot", "antenna", "fixed", "")))
    assert robot.base_mass == pytest.approx(parse_urdf(two_joints()).base_mass + 2.0)
    assert_same_dynamics(robot, two_joints())


def test_prismatic_joints_have_the_dynamics_of_pinocchio() -> None:
    """A linear axis under an arm, and one within it, slide along the axis that the URDF names;
    limits are kept."""
    text = two_joints(link("c"), joint("three", "b", "c")).replace(
        '"two" type="revolute"', '"two" type="prismatic"'
    )
    robot = parse_urdf(text)
    assert [joint.prismatic for joint in robot.joints] == [False, True, False]
    assert (
        robot.joints[1].limits.position_max
        == parse_urdf(two_joints()).joints[1].limits.position_max
    )
    assert_same_dynamics(robot, text)
    assert_same_dynamics(robot, to_urdf(robot))


def test_a_slide_without_limits_is_written_for_other_readers() -> None:
    """Pinocchio refuses a prismatic joint that states none: it is written with unknown ones."""
    given = parse_urdf(two_joints().replace('"two" type="revolute"', '"two" type="prismatic"'))
    first, slide = given.joints
    robot = given.with_(joints=(first, replace(slide, limits=Limits())))
    assert parse_urdf(to_urdf(robot)).joints[1].limits == Limits()
    assert_same_dynamics(robot, to_urdf(robot))


def test_a_chain_leaves_out_what_stands_on_its_tip() -> None:
    """With the flange as tip the gripper is no part of the arm, and a note names its links and
    mass."""
    robot = parse_urdf(with_gripper("planar"), ("foot", "flange"))
    assert_same_dynamics(robot, two_joints())
    assert any("left_finger, palm, right_finger, tip (8 kg)" in note for note in robot.notes)


def test_a_chain_leaves_out_other_branches_and_keeps_gravity() -> None:
    """One arm of two on a tilted torso: its dynamics are those of Pinocchio with the torso and the
    other arm fixed."""
    text = urdf(
        link("foot"),
        link("torso"),
        link("a"),
        link("b"),
        link("c"),
        link("camera"),
        joint("mast", "foot", "torso", "fixed", "", '<origin xyz="0 0 1" rpy="0.4 0.3 -0.2"/>'),
        joint("one", "torso", "a"),
        joint("two", "a", "b"),
        joint("other", "torso", "c"),
        joint("eye", "a", "camera", "fixed", ""),
    )
    robot = parse_urdf(text, ("torso", "b"))
    assert robot.joint_names == ("one", "two")
    assert_same_dynamics(robot, text.replace('"other" type="revolute"', '"other" type="fixed"'))


@pytest.mark.parametrize(
    ("chain", "problem"),
    [(("foot", "no"), "unknown link 'no'"), (("b", "a"), "'a' is not a descendant of 'b'")],
)
def test_a_chain_that_is_no_path_is_refused(chain: tuple[str, str], problem: str) -> None:
    """Links that are not there, or not one on the other, make no arm."""
    with pytest.raises(RobotError) as caught:
        parse_urdf(two_joints(), chain)
    assert problem in caught.value.problem


def test_an_inertia_without_mass_counts_for_nothing() -> None:
    """A frame with mass 0 and a stray inertia is massless, and a note names it."""
    stray = INERTIAL.replace('mass value="2"', 'mass value="0"')
    robot = parse_urdf(two_joints().replace(link("a"), link("a", stray)))
    assert robot.joints[0].link.mass == 0.0
    assert not robot.joints[0].link.inertia.any()
    assert any("'a' has an inertia but no mass" in note for note in robot.notes)


@pytest.mark.skipif(not KINOVA.exists(), reason=f"{KINOVA} is not there")
@pytest.mark.parametrize(
    ("chain", "mass"), [(None, 1.857), ("gen3_base_link:gen3_end_effector_link", 0.936)]
)
def test_the_kinova_arm_with_its_gripper_loads(chain: str | None, mass: float) -> None:
    """A vendor's URDF with a gripper and a camera loads as it is, or without the gripper by its
    chain."""
    robot = load_robot(KINOVA, chain)
    assert robot.n == 7
    assert robot.joints[-1].link.mass == pytest.approx(mass, abs=0.001)
    assert build_model(robot, engine="numpy").dof == 7


REFUSED = {
    "floating": (
        two_joints().replace('name="one" type="revolute"', 'name="one" type="floating"'),
        "'one' is floating",
    ),
    "planar": (
        two_joints().replace('name="one" type="revolute"', 'name="one" type="planar"'),
        "'one' is planar",
    ),
    "mimic": (
        two_joints(link("c"), joint("three", "b", "c", inside='<mimic joint="one"/>')),
        "'three' mimics",
    ),
    "branch": (two_joints(link("c"), joint("three", "a", "c")), "branches: joints 'two', 'three'"),
    "two parents": (
        two_joints(joint("three", "foot", "b")),
        "link 'b' is the child of joints 'two' and 'three'",
    ),
    "loop": (
        two_joints(link("c"), link("d"), joint("x", "c", "d"), joint("y", "d", "c")),
        "c, d form a loop",
    ),
    "two roots": (two_joints(link("lost")), "2 (foot, lost)"),
    "unknown link": (
        two_joints(joint("three", "b", "nowhere")),
        "'three' refers to the link 'nowhere'",
    ),
    "twice": (two_joints(link("a")), "two links are named 'a'"),
    "nothing moves": (urdf(link("foot")), "contains no moving joint"),
    "negative mass": (
        two_joints().replace('mass value="2"', 'mass value="-2"', 1),
        "link 'foot': mass is -2",
    ),
    "no mass": (two_joints().replace('<mass value="2"/>', "", 1), "has no <mass>"),
    "triangle": (two_joints().replace('izz="0.05"', 'izz="0.5"'), "triangle inequality"),
    "no number": (two_joints().replace('ixx="0.03"', 'ixx="big"', 1), "ixx is 'big'"),
    "axis": (
        two_joints().replace('axis xyz="0 1 0"', 'axis xyz="0 0 0"', 1),
        "'one' has the axis 0 0 0",
    ),
    "limits": (
        two_joints().replace('lower="-1"', 'lower="3"', 1),
        "joint 'one': position_min 3 is not below",
    ),
    "massless end": (
        two_joints().replace(link("b"), link("b", "")),
        "link 'b' and the bodies fixed to it have no mass",
    ),
    "no child": (two_joints().replace('<child link="a"/>', ""), "has no <child>"),
    "not XML": ("<robot", "is not valid XML"),
    "not URDF": ("<mujoco/>", "its root element is <mujoco>"),
    "xacro": (
        '<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/></robot>',
        "xacro macros",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_no_serial_arm_is_refused_by_name(what: str) -> None:
    """What cannot be handled raises an error that names the element and says what to do."""
    text, problem = REFUSED[what]
    with pytest.raises(RobotError) as caught:
        parse_urdf(text)
    assert problem in caught.value.problem
    assert caught.value.remedy


def test_errors_name_the_file(tmp_path: Path) -> None:
    """An error met in a file begins with its path; a missing file is said so."""
    path = tmp_path / "arm.urdf"
    path.write_text(REFUSED["loop"][0])
    with pytest.raises(RobotError, match=r"arm\.urdf: links c, d form a loop"):
        load_robot(path)
    with pytest.raises(RobotError, match="no such file"):
        load_robot(tmp_path / "none.urdf")


TRANSMISSION = """
    rotor: {mass: 0.4, izz: 1.0e-5, ixx: 1.0e-5, carrier: CARRIER}
    wave_generator: {mass: 0.1, izz: 1.0e-5, ixx: 1.0e-5, carrier: CARRIER}
    spline: {mass: 0.2, izz: 1.0e-4, ixx: 1.0e-4, carrier: CARRIER, kind: flex}
    stiffness: 8.0e3
    damping: 5.0
    belt_ratio: 1.0
    harmonic_drive_ratio: 100.0
"""


def overlay(*joints: tuple[str, str], more: str = "") -> str:
    parts = [f"  {name}:{TRANSMISSION.replace('CARRIER', carrier)}" for name, carrier in joints]
    return "urdf: arm.urdf\n" + ("transmissions:\n" + "".join(parts) if parts else "") + more


def test_an_overlay_makes_a_urdf_arm_elastic(tmp_path: Path) -> None:
    """YAML that names a URDF and gives transmissions and limits by joint makes an elastic robot,
    which saves."""
    (tmp_path / "arm.urdf").write_text(two_joints())
    path = tmp_path / "arm.yaml"
    path.write_text(
        overlay(
            ("one", "base"),
            ("two", "a"),
            more="limits: {two: {acceleration: 3.0}}\nname: springy\n",
        )
    )
    robot = load_robot(path)
    assert robot.elastic
    assert robot.name == "springy"
    assert robot.joints[1].limits.acceleration == 3.0
    assert robot.joints[1].limits.velocity == 1.5
    assert build_model(robot, engine="numpy").dof == 4
    save_robot(robot, tmp_path / "saved.yaml")
    assert robot_to_dict(load_robot(tmp_path / "saved.yaml")) == robot_to_dict(robot)


def test_an_overlay_states_the_armature_of_rigid_joints(tmp_path: Path) -> None:
    """Over that of the URDF; not beside a transmission, nor of an unknown joint."""
    (tmp_path / "arm.urdf").write_text(two_joints())
    file = tmp_path / "overlay.yaml"
    file.write_text("urdf: arm.urdf\narmature: {two: 0.25}\n")
    robot = load_robot(file)
    assert [joint.armature for joint in robot.joints] == [None, 0.25]
    save_robot(robot, tmp_path / "saved.yaml")
    assert load_robot(tmp_path / "saved.yaml").joints[1].armature == 0.25
    file.write_text("urdf: arm.urdf\narmature: {three: 0.25}\n")
    with pytest.raises(RobotError, match=r"armature\.three: .* no joint 'three'"):
        load_robot(file)
    file.write_text("urdf: arm.urdf\narmature: {two: -1}\n")
    with pytest.raises(RobotError, match=r"armature\.two"):
        load_robot(file)
    file.write_text(overlay(("one", "base"), ("two", "a"), more="armature: {two: 0.25}\n"))
    with pytest.raises(RobotError, match=r"armature\.two: the joint has a transmission"):
        load_robot(file)


def test_the_documented_overlay_loads(tmp_path: Path) -> None:
    """The example of docs/robots.md is an overlay that loads, on a URDF with joints of its
    names."""
    text = (Path(__file__).parents[2] / "docs" / "robots.md").read_text()
    (tmp_path / "overlay.yaml").write_text(text.split("```yaml\n")[1].split("```")[0])
    urdf = (
        two_joints()
        .replace('"one"', '"shoulder"')
        .replace('"two"', '"elbow"')
        .replace('"a"', '"upper_arm"')
    )
    urdf = urdf.replace('"foot"', '"base_link"').replace('"b"', '"tool_link"')
    (tmp_path / "arm.urdf").write_text(urdf)
    robot = load_robot(tmp_path / "overlay.yaml")
    assert robot.joint_names == ("shoulder", "elbow")
    assert [joint.transmission.r_tot for joint in robot.joints] == [100.0, 100.0]
    assert robot.joints[1].limits.torque == 60.0
    assert robot.torque_noise_std == 0.1


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (overlay(("one", "base")), "joints two have no transmission"),
        (
            overlay(("one", "base"), ("three", "a")),
            "transmissions.three: the URDF has no such joint",
        ),
        (overlay(("one", "base"), ("two", "base")), "two.rotor.carrier is 'base'"),
        (overlay(more="limits: {four: {velocity: 1}}\n"), "limits.four"),
        (overlay(more="masses: 3\n"), "masses"),
        (overlay().replace("arm.urdf", "gone.urdf"), "gone.urdf: no such file"),
    ],
)
def test_a_wrong_overlay_is_refused_by_name(tmp_path: Path, content: str, problem: str) -> None:
    """An overlay that does not fit its URDF raises an error that names the joint or field."""
    (tmp_path / "arm.urdf").write_text(two_joints())
    path = tmp_path / "arm.yaml"
    path.write_text(content)
    with pytest.raises(RobotError) as caught:
        load_robot(path)
    assert problem in str(caught.value)


def test_dynamics_of_a_joint_are_friction_of_that_size() -> None:
    """<dynamics damping friction> is viscous and Coulomb friction; zero is none, and less is
    refused."""
    text = to_urdf(load_robot()).replace(
        "<axis", '<dynamics damping="1.5" friction="0.5"/><axis', 1
    )
    viscous, dry = parse_urdf(text).effects
    assert (viscous["effect"], viscous["joint"], viscous["parameters"]) == (
        "viscous_friction",
        "joint_1",
        {"coefficient": 1.5},
    )
    assert (dry["effect"], dry["parameters"]) == ("coulomb_friction", {"torque": 0.5})
    assert parse_urdf(text.replace('"1.5"', '"0"').replace('"0.5"', '"0.0"')).effects == ()
    with pytest.raises(RobotError, match="joint 'joint_1': dynamics damping is -1"):
        parse_urdf(text.replace('"1.5"', '"-1"'))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("length", ["1e200", "1e-8", "-1e200"])
def test_an_axis_of_any_length_is_a_direction(length: str) -> None:
    """Its square may be beyond all numbers."""
    arm = parse_urdf(two_joints().replace('axis xyz="0 1 0"', f'axis xyz="0 {length} 0"'))
    unit = parse_urdf(
        two_joints().replace('axis xyz="0 1 0"', f'axis xyz="0 {"-" * (length[0] == "-")}1 0"')
    )
    for one, other in zip(arm.joints, unit.joints, strict=True):
        np.testing.assert_array_equal(one.before, other.before)


MOTOR = """<robot name="one" xmlns:drake="https://drake.mit.edu/"><link name="base"/>
<joint name="j" type="revolute"><parent link="base"/><child link="l"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="5" velocity="2"/></joint>
<link name="l"><inertial><mass value="1"/>
<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>{}</robot>"""
DRAKE = (
    '<transmission name="t"><joint name="j"/><actuator name="m"><drake:gear_ratio value="100"/>'
    '<drake:rotor_inertia value="6e-5"/></actuator></transmission>'
)
ROS_1 = (
    '<transmission name="t"><joint name="j"><hardwareInterface>x</hardwareInterface></joint>'
    '<actuator name="m"><mechanicalReduction>50</mechanicalReduction></actuator></transmission>'
)
ROS_2 = (
    '<ros2_control name="h" type="system"><transmission name="t"><actuator name="m"/>'
    '<joint name="j"><mechanical_reduction>50</mechanical_reduction></joint>'
    "</transmission></ros2_control>"
)


def test_drakes_rotor_is_the_armature() -> None:
    """Rotor inertia times the square of the gear ratio is what the joint feels; unstated it is
    unknown."""
    robot = parse_urdf(MOTOR.format(DRAKE))
    assert robot.joints[0].armature == pytest.approx(0.6) and any(
        "6e-05 kg m²" in note for note in robot.notes
    )
    assert parse_urdf(MOTOR.format("")).joints[0].armature is None
    assert parse_urdf(MOTOR.format(DRAKE.replace("6e-5", "0"))).joints[0].armature == 0.0
    with pytest.raises(RobotError, match="rotor_inertia is -1"):
        parse_urdf(MOTOR.format(DRAKE.replace("6e-5", "-1")))


BOTH = DRAKE.replace("</actuator>", "<mechanicalReduction>{}</mechanicalReduction></actuator>")


def test_a_ratio_that_two_tags_state_is_one_number() -> None:
    """Drake's tag and ROS's, in one transmission or in two, are one reduction: 0.6 kg m², not
    6000."""
    apart = DRAKE + ROS_1.replace(">50<", ">100<")
    of_joint = DRAKE.replace("<joint", "<mechanical_reduction>100</mechanical_reduction><joint")
    for stated in (
        BOTH.format(100),
        BOTH.format("1e2"),
        BOTH.format(-100),
        apart,
        of_joint,
        DRAKE + DRAKE,
    ):
        assert parse_urdf(MOTOR.format(stated)).joints[0].armature == pytest.approx(0.6)


@needs_data
def test_a_ratio_that_two_tags_of_a_real_arm_state_is_one_number() -> None:
    """The same of a description that somebody published."""
    data = DATA / "public_reports_2" / "drake_and_reduction" / "drake_both.urdf"
    assert [joint.armature for joint in load_robot(data).joints] == pytest.approx([3.2] * 6)


@pytest.mark.parametrize(
    ("stated", "words"),
    [
        (
            BOTH.format(80),
            "'j' has two values for one number: .*gear_ratio is 100, .*mechanicalReduction is 80",
        ),
        (BOTH.format(1), "gear_ratio is 100, .*mechanicalReduction is 1"),
        (DRAKE + ROS_2, "gear_ratio is 100, .*mechanical_reduction is 50"),
        (DRAKE + DRAKE.replace("6e-5", "7e-5"), "rotor_inertia is 6e-05, .*rotor_inertia is 7e-05"),
        (DRAKE.replace('"100"', '"0"'), "gear_ratio is 0"),
    ],
)
def test_statements_that_contradict_each_other_are_refused(stated: str, words: str) -> None:
    """None of two ratios or rotors is taken in silence."""
    with pytest.raises(RobotError, match=words):
        parse_urdf(MOTOR.format(stated))


@pytest.mark.parametrize(
    ("element", "other"),
    [
        (
            '<limit lower="-1" upper="1" effort="5" velocity="2"/>',
            '<limit upper="2" lower="-1" effort="5" velocity="2"/>',
        ),
        ('<mass value="1"/>', '<mass value="2"/>'),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 0 1"/>'),
    ],
)
def test_an_element_that_comes_twice_states_one_thing(element: str, other: str) -> None:
    """Limits, axes and masses that are stated again are the same, or they are refused."""
    urdf = MOTOR.format("")
    again = element.replace('="1"', '="1.0"').replace("xyz=", " xyz=")
    assert parse_urdf(urdf.replace(element, element + again)).joints[0].limits.torque == 5.0
    with pytest.raises(RobotError, match=f"2 different <{element[1:].split()[0]}>"):
        parse_urdf(urdf.replace(element, element + other))


@pytest.mark.parametrize("transmission", [ROS_1, ROS_2])
def test_a_reduction_without_a_rotor_is_named(transmission: str) -> None:
    """ros_control's and ros2_control's reductions are no number of the model by themselves, and the
    notes say so."""
    robot = parse_urdf(MOTOR.format(transmission))
    assert robot.joints[0].armature is None
    assert any("reduction of 50" in note and "'j'" in note for note in robot.notes)


def test_an_overlays_transmission_takes_the_place_of_the_urdfs(tmp_path: Path) -> None:
    """Beside the rotor of an overlay the URDF's armature, and the notes on it, are gone."""
    (tmp_path / "arm.urdf").write_text(MOTOR.format(DRAKE))
    body = "{mass: 0.1, izz: 1.0e-5, ixx: 1.0e-5, carrier: base}"
    parts = ", ".join(f"{name}: {body}" for name in ("rotor", "wave_generator", "spline"))
    numbers = "stiffness: 8.0e+3, damping: 5.0, belt_ratio: 1.0, harmonic_drive_ratio: 100.0"
    (tmp_path / "over.yaml").write_text(
        f"urdf: arm.urdf\ntransmissions: {{j: {{{parts}, {numbers}}}}}\n"
    )
    robot = load_robot(tmp_path / "over.yaml")
    assert (
        robot.elastic
        and robot.joints[0].armature is None
        and not any("armature" in note for note in robot.notes)
    )


def test_transmissions_that_no_joint_has_are_named() -> None:
    """One that couples several joints, and one of a joint that the file has not."""
    both = ROS_2.replace('<joint name="j">', '<joint name="k"/><joint name="j">')
    robot = parse_urdf(MOTOR.format(both))
    assert robot.joints[0].armature is None and any(
        "'j': it couples several joints" in note for note in robot.notes
    )
    robot = parse_urdf(MOTOR.format(DRAKE.replace('name="j"', 'name="jj"')))
    assert robot.joints[0].armature is None and any(
        "'jj': it is ignored" in note for note in robot.notes
    )
