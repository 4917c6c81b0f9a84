"""The arm in the form that ROS tools need: a URDF with limits, a tool frame, collision shapes and a
ros2_control block.

`elastic_arm.robot.to_urdf` writes the arm alone, so that reading it gives the same arm again. The
additions here are for MoveIt, RViz, Pinocchio and ros2_control.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from elastic_arm.nodes.following.joint_limits import JointLimits
from elastic_arm.robot import Joint, Robot, to_urdf
from elastic_arm.robot.kinematics import link_points
from elastic_arm.robot.urdf import DYNAMICS
from elastic_arm.robot.urdf_elements import rotation, vector

TOOL = "tool0"
# Of the cylinders between joints: those are what the collision check of `elastic-arm excite` looks
# at, as capsules.
_BARS = ("base_grey", "link_blue")
# Topics of a controller, relative to the arm's namespace.
COMMANDS = "simulator/joint_commands"
STATES = "joint_states"
# Every command is sent, small steps too: without one the arm would stand at the last one that was.
_HARDWARE = """
<hardware>
  <plugin>topic_based_ros2_control/TopicBasedSystem</plugin>
  <param name="joint_commands_topic">{commands}</param>
  <param name="joint_states_topic">{states}</param>
  <param name="trigger_joint_command_threshold">-1</param>
</hardware>
"""
_JOINT = """
<joint>
  <command_interface name="position">
    <param name="min">{low}</param>
    <param name="max">{high}</param>
  </command_interface>
  <command_interface name="velocity">
    <param name="min">-{fastest}</param>
    <param name="max">{fastest}</param>
  </command_interface>
  <state_interface name="position"/>
  <state_interface name="velocity"/>
  <state_interface name="effort"/>
</joint>
"""


def ros_description(robot: Robot, namespace: str = "") -> str:
    """Return the URDF that nodes of a namespace publish on `robot_description`.

    All joints are revolute with limits; missing limits have the same defaults as for goals.
    """
    tree = ET.fromstring(to_urdf(robot))
    limits = JointLimits.of(robot, assumed=True)
    for i, joint in enumerate(robot.joints):
        element = next(each for each in tree.findall("joint") if each.get("name") == joint.name)
        element.set("type", "revolute")
        _set_limits(
            element,
            joint,
            (limits.low[i], limits.high[i], limits.velocity[i], _effort(robot, joint)),
        )
        ET.SubElement(element, "dynamics", _friction(robot.effects, joint.name))
    for link in tree.findall("link"):
        for visual in link.findall("visual"):
            _add_capsule(link, visual)
    _add_tool(tree, robot)
    _add_control(tree, robot, limits, namespace)
    ET.indent(tree)
    return '<?xml version="1.0"?>\n' + ET.tostring(tree, encoding="unicode") + "\n"


def _set_limits(
    element: ET.Element, joint: Joint, values: tuple[float, float, float, float]
) -> None:
    for found in element.findall("limit"):
        element.remove(found)
    if None in (
        joint.limits.position_min,
        joint.limits.position_max,
        joint.limits.velocity,
        joint.limits.torque,
    ):
        element.append(
            ET.Comment(" defaults replace what the description of the arm does not state ")
        )
    names = ("lower", "upper", "velocity", "effort")
    ET.SubElement(
        element, "limit", {name: _text(value) for name, value in zip(names, values, strict=True)}
    )


def _effort(robot: Robot, joint: Joint) -> float:
    """Return the torque limit of a joint, Nm; by default twice the torque of its weight when
    stretched out."""
    if joint.limits.torque is not None:
        return joint.limits.torque
    reach = np.linalg.norm(
        np.diff(link_points(robot, np.zeros((1, robot.n)))[0, 1:], axis=0), axis=1
    ).sum()
    weight = (robot.mass - robot.base_mass) * np.linalg.norm(robot.gravity)
    return float(f"{2.0 * weight * reach:.2g}")


def _friction(effects: Iterable[Mapping[str, Any]], joint: str) -> dict[str, str]:
    """Return the attributes of <dynamics>, which become effects when the URDF is read."""
    found = dict.fromkeys(DYNAMICS, 0.0)
    for effect in effects:
        for attribute, (name, parameter) in DYNAMICS.items():
            if (effect["effect"], effect["joint"]) == (name, joint):
                found[attribute] += float(effect["parameters"].get(parameter, 0.0))
    return {name: _text(value) for name, value in found.items()}


def _add_capsule(link: ET.Element, visual: ET.Element) -> None:
    """Add a collision shape along a bar: a cylinder with a sphere at each end, because URDF has no
    capsules."""
    cylinder = visual.find("geometry/cylinder")
    material = visual.find("material")
    origin = visual.find("origin")
    if cylinder is None or material is None or origin is None or material.get("name") not in _BARS:
        return
    centre = vector(origin.get("xyz"), "visual: xyz")
    along = rotation(*vector(origin.get("rpy"), "visual: rpy"))[:, 2]
    half = 0.5 * float(cylinder.get("length", "0")) * along
    _collision(link, dict(origin.items()), "cylinder", dict(cylinder.items()))
    for end in (centre - half, centre + half):
        xyz = " ".join(_text(number) for number in end)
        _collision(
            link, {"xyz": xyz, "rpy": "0 0 0"}, "sphere", {"radius": cylinder.get("radius", "0")}
        )


def _collision(link: ET.Element, origin: dict[str, str], shape: str, size: dict[str, str]) -> None:
    collision = ET.SubElement(link, "collision")
    ET.SubElement(collision, "origin", origin)
    ET.SubElement(ET.SubElement(collision, "geometry"), shape, size)


def _add_tool(tree: ET.Element, robot: Robot) -> None:
    """Add the frame O_n of the last link as a link without mass."""
    if TOOL in robot.link_names:
        return
    last = robot.joints[-1]
    ET.SubElement(tree, "link", name=TOOL)
    joint = ET.SubElement(tree, "joint", name=f"{last.link_name}_to_{TOOL}", type="fixed")
    ET.SubElement(joint, "parent", link=last.link_name)
    ET.SubElement(joint, "child", link=TOOL)
    position = last.after[:3, :3].T @ last.after[:3, 3]
    ET.SubElement(joint, "origin", xyz=" ".join(_text(number) for number in position), rpy="0 0 0")


def _add_control(tree: ET.Element, robot: Robot, limits: JointLimits, namespace: str) -> None:
    prefix = f"/{namespace.strip('/')}/".replace("//", "/")
    topics = {"commands": prefix + COMMANDS, "states": prefix + STATES}
    control = ET.SubElement(tree, "ros2_control", name=robot.name, type="system")
    control.append(ET.fromstring(_HARDWARE.format(**topics)))
    for i, name in enumerate(robot.joint_names):
        bounds = {"low": limits.low[i], "high": limits.high[i], "fastest": limits.velocity[i]}
        texts = {bound: _text(value) for bound, value in bounds.items()}
        joint = ET.fromstring(_JOINT.format(**texts))
        joint.set("name", name)
        control.append(joint)


def _text(number: float) -> str:
    return repr(round(float(number), 12) + 0.0)
