"""The URDF on /robot_description, as tools that are not ours read it."""

import xml.etree.ElementTree as ET
from dataclasses import replace

import mujoco
import numpy as np
import pinocchio
import pytest

from elastic_arm.excitation.workspace import Workspace
from elastic_arm.nodes.support.description import ros_description
from elastic_arm.recording.reading import urdf_joints
from elastic_arm.robot import Robot, load_robot, to_urdf
from elastic_arm.robot.kinematics import link_placements
from elastic_arm.robot.parts import Limits
from elastic_arm.robot.urdf import parse_urdf

ARM = load_robot()


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def with_limits() -> Robot:
    limits = Limits(
        position_min=-1.0, position_max=2.0, velocity=1.2, acceleration=3.0, torque=400.0
    )
    return ARM.with_(joints=tuple(replace(joint, limits=limits) for joint in ARM.joints))


def test_pinocchio_has_a_coordinate_a_joint() -> None:
    """All joints are revolute with limits, so that nq = nv = n, and the dynamics are those of the
    plain URDF."""
    model, plain = (
        pinocchio.buildModelFromXML(text) for text in (ros_description(ARM), to_urdf(with_limits()))
    )
    assert model.nq == model.nv == ARM.n
    q, dq, ddq = np.random.default_rng(1).uniform(-1, 1, (3, ARM.n))
    torques = [pinocchio.rnea(each, each.createData(), q, dq, ddq) for each in (model, plain)]
    np.testing.assert_allclose(torques[0], torques[1], rtol=1e-9)


def test_stated_limits_are_the_description_s() -> None:
    """Position, velocity and effort are those of the arm file."""
    model = pinocchio.buildModelFromXML(ros_description(with_limits()))
    np.testing.assert_array_equal(model.lowerPositionLimit, [-1.0] * 3)
    np.testing.assert_array_equal(model.upperPositionLimit, [2.0] * 3)
    np.testing.assert_array_equal(model.velocityLimit, [1.2] * 3)
    np.testing.assert_array_equal(model.effortLimit, [400.0] * 3)


def test_the_tool_frame_is_the_last_link_s(rng: np.random.Generator) -> None:
    """tool0 stands where O_n of the description does, in any pose."""
    model = pinocchio.buildModelFromXML(ros_description(ARM))
    data = model.createData()
    for q in rng.uniform(-2, 2, (5, ARM.n)):
        pinocchio.framesForwardKinematics(model, data, q)
        expected = link_placements(ARM, q[None])[1][0, -1]
        np.testing.assert_allclose(
            data.oMf[model.getFrameId("tool0")].homogeneous, expected, atol=1e-9
        )


def test_collision_shapes_are_the_capsules_of_the_collision_check(rng: np.random.Generator) -> None:
    """Distances between links that are not neighbours, by coal, are the gaps that the excitation
    keeps."""
    text = ros_description(ARM)
    model = pinocchio.buildModelFromXML(text)
    shapes = pinocchio.buildGeomFromUrdfString(model, text, pinocchio.GeometryType.COLLISION)
    workspace = Workspace.of(ARM, floor=None)
    link_of = [
        0 if "base" in shape.name else 1 + ARM.link_names.index(shape.name.rsplit("_", 1)[0])
        for shape in shapes.geometryObjects
    ]
    pairs = {tuple(pair) for pair in workspace.pairs.tolist()}
    for a in range(len(link_of)):
        for b in range(a + 1, len(link_of)):
            if (min(link_of[a], link_of[b]), max(link_of[a], link_of[b])) in pairs:
                shapes.addCollisionPair(pinocchio.CollisionPair(a, b))
    compared = 0
    data = model.createData()
    shape_data = pinocchio.GeometryData(shapes)
    for q in rng.uniform(-2, 2, (10, ARM.n)):
        pinocchio.computeDistances(model, data, shapes, shape_data, q)
        gap = min(result.min_distance for result in shape_data.distanceResults)
        expected = float(workspace.clearance(q[None])[1][0])
        if expected > 0:
            compared += 1
            assert gap == pytest.approx(expected, abs=1e-4)
    assert compared > 3


def test_other_readers_take_it() -> None:
    """MuJoCo compiles it; read as an arm it has the same joints; ros2_control's joints do not count
    twice."""
    text = ros_description(ARM)
    assert mujoco.MjModel.from_xml_string(text).nq == ARM.n
    assert parse_urdf(text).joint_names == ARM.joint_names
    names = urdf_joints(text)
    assert [name for name in names if name in ARM.joint_names] == list(ARM.joint_names)
    control = ET.fromstring(text).find("ros2_control")
    assert [joint.get("name") for joint in control.findall("joint")] == list(ARM.joint_names)


def test_controllers_find_the_topics_of_the_arm() -> None:
    """The ros2_control block names the topics of the arm's namespace, and position and velocity as
    commands."""
    control = ET.fromstring(ros_description(ARM, "left")).find("ros2_control")
    assert control.findtext("hardware/plugin") == "topic_based_ros2_control/TopicBasedSystem"
    topics = {one.get("name"): one.text for one in control.findall("hardware/param")}
    assert topics["joint_commands_topic"] == "/left/simulator/joint_commands"
    assert topics["joint_states_topic"] == "/left/joint_states"
    own = ET.fromstring(ros_description(ARM)).find(
        "ros2_control/hardware/param[@name='joint_states_topic']"
    )
    assert own.text == "/joint_states"


def test_friction_of_the_description_is_in_dynamics() -> None:
    """Viscous and Coulomb friction that the arm file lists are damping and friction of the
    joint."""
    effects = (
        {"effect": "viscous_friction", "joint": "joint_1", "parameters": {"coefficient": 3.0}},
        {"effect": "coulomb_friction", "joint": "joint_2", "parameters": {"torque": 5.0}},
    )
    tree = ET.fromstring(ros_description(ARM.with_(effects=effects)))
    found = {joint.get("name"): joint.find("dynamics") for joint in tree.findall("joint")}
    values = [dict(found[name].items()) for name in ARM.joint_names]  # type: ignore[union-attr]
    assert values[0] == {"damping": "3.0", "friction": "0.0"}
    assert values[1] == {"damping": "0.0", "friction": "5.0"}
