"""Writing of URDF files: a rigid arm with the same gravity and inertia, drawn with simple shapes.

A URDF has only rigid links. Rotors, wave generators and splines are merged with the links that
carry them, so masses and gravity are correct; their spins and the elasticity are lost. The armature
of a rigid joint is stated by Drake's tags. Link frames have the axes of ``O_i`` and lie on the axis
of the joint. Shapes are only visual: there are no collision shapes, because cylinders from joint to
joint touch their neighbours.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from itertools import pairwise

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.robot.description import Component, Inertia, Joint, Robot
from elastic_arm.robot.kinematics import link_placements, link_radius, lumped, moved
from elastic_arm.robot.parts import placed

_COLOURS = {
    "base_grey": "0.35 0.38 0.42 1",
    "link_blue": "0.20 0.45 0.70 1",
    "joint_orange": "0.90 0.60 0.10 1",
}
# A URDF must state effort and velocity beside a range; readers take 0 as "not stated".
_UNKNOWN = 0.0
DRAKE = "http://drake.mit.edu"
ET.register_namespace("drake", DRAKE)


def to_urdf(robot: Robot) -> str:
    """Return `robot` as URDF text; read back, it has the same rigid dynamics.

    See the module.
    """
    tree = ET.Element("robot", name=robot.name)
    tree.append(
        ET.Comment(
            " Rigid links: motors and gears are part of the links that carry them,"
            " elasticity is ignored "
        )
    )
    for name, rgba in _COLOURS.items():
        ET.SubElement(ET.SubElement(tree, "material", name=name), "color", rgba=rgba)
    radius = link_radius(robot)
    frames = [_urdf_frame(joint) for joint in robot.joints]
    bodies = bodies_with_components(robot)
    ground = _ground(robot)
    # KDL, and with it robot_state_publisher, wants a root link without inertia.
    ET.SubElement(tree, "link", name=ground)
    _fixed(tree, ground, robot.base_placement)
    onward = robot.joints[0].before[:3, 3]
    foot = -robot.base_placement[:3, :3].T @ robot.base_placement[:3, 3]
    _link(tree, "base", bodies[0], (foot, onward), None, radius)
    for i, joint in enumerate(robot.joints):
        last = i == robot.n - 1
        end = joint.after if last else joint.after @ robot.joints[i + 1].before
        placement = np.linalg.inv(frames[i])
        tip = (placement @ end)[:3, 3]
        axis = frames[i][2, :3]
        parent = ("base", *robot.link_names)[i]
        start = (
            joint.before
            if i == 0
            else np.linalg.inv(frames[i - 1]) @ robot.joints[i - 1].after @ joint.before
        )
        _link(
            tree,
            joint.link_name,
            moved(bodies[i + 1], placement @ joint.after),
            (np.zeros(3), tip),
            axis,
            radius,
        )
        _moving(tree, joint, parent, start @ frames[i], axis)
    for joint in robot.joints:
        if joint.armature is not None:
            _rotor(tree, joint.name, joint.armature)
    ET.indent(tree)
    return '<?xml version="1.0"?>\n' + ET.tostring(tree, encoding="unicode") + "\n"


def urdf_placements(robot: Robot, q: Array) -> list[tuple[str, str, Array]]:
    """Return the links of :func:`to_urdf`: parent, child, placements (N, 4, 4).

    Placements are in the parent.
    """
    joints, _ = link_placements(robot, q)
    own = [joints[:, i] @ _urdf_frame(joint) for i, joint in enumerate(robot.joints)]
    base = np.broadcast_to(robot.base_placement, own[0].shape)
    names = (_ground(robot), "base", *robot.link_names)
    inside = [base, *(np.linalg.inv(a) @ b for a, b in pairwise([base, *own]))]
    return [(*pair, placement) for pair, placement in zip(pairwise(names), inside, strict=True)]


def _ground(robot: Robot) -> str:
    return "world" if "world" not in robot.link_names else "elastic_arm_world"


def _urdf_frame(joint: Joint) -> Array:
    """Return the URDF's link frame in the turned joint frame: the axes of ``O_i`` at the joint's
    origin."""
    return placed(joint.after[:3, :3])


def bodies_with_components(robot: Robot) -> list[Inertia]:
    """Return the base, in ``O_0``, and the links, each in its ``O_i``, with what rides on them."""
    riding: dict[str, list[Inertia]] = {name: [] for name in ("base", *robot.link_names)}
    for joint in robot.joints:
        if joint.transmission is None:
            continue
        for component, _ in joint.transmission.components.values():
            own = component.carrier == joint.link_name
            placement = np.linalg.inv(joint.after) if own else joint.before
            riding[component.carrier].append(moved(_solid(component), placement))
    side = link_radius(robot)
    base = Inertia(robot.base_mass, np.zeros(3), robot.base_mass * side**2 * np.eye(3))
    links = (lumped([joint.link, *riding[joint.link_name]]) for joint in robot.joints)
    return [lumped([base, *riding["base"]]), *links]


def _solid(component: Component) -> Inertia:
    return Inertia(
        component.mass, component.position, np.diag([component.ixx, component.ixx, component.izz])
    )


def _link(
    tree: ET.Element,
    name: str,
    body: Inertia,
    bar: tuple[Array, Array],
    axis: Array | None,
    radius: float,
) -> None:
    link = ET.SubElement(tree, "link", name=name)
    if body.mass > 0.0:
        inertial = ET.SubElement(link, "inertial")
        _origin(inertial, np.eye(3), body.com)
        ET.SubElement(inertial, "mass", value=repr(float(body.mass)))
        pairs = {
            "ixx": (0, 0),
            "ixy": (0, 1),
            "ixz": (0, 2),
            "iyy": (1, 1),
            "iyz": (1, 2),
            "izz": (2, 2),
        }
        ET.SubElement(
            inertial, "inertia", {k: repr(float(body.inertia[at])) for k, at in pairs.items()}
        )
    if np.linalg.norm(bar[1] - bar[0]) > 1e-6:
        _cylinder(link, *bar, radius, "base_grey" if axis is None else "link_blue")
    if axis is not None:
        half = 1.2 * radius * axis
        _cylinder(link, -half, half, 1.2 * radius, "joint_orange")


def _cylinder(link: ET.Element, start: Array, end: Array, radius: float, material: str) -> None:
    visual = ET.SubElement(link, "visual")
    length = float(np.linalg.norm(end - start))
    x, y, z = (end - start) / length
    _origin(
        visual,
        None,
        0.5 * (start + end),
        (0.0, float(np.arctan2(np.hypot(x, y), z)), float(np.arctan2(y, x))),
    )
    geometry = ET.SubElement(visual, "geometry")
    ET.SubElement(
        geometry, "cylinder", radius=repr(round(radius, 6)), length=repr(round(length, 6))
    )
    ET.SubElement(visual, "material", name=material)


def _fixed(tree: ET.Element, ground: str, placement: Array) -> None:
    element = ET.SubElement(tree, "joint", name=f"{ground}_to_base", type="fixed")
    ET.SubElement(element, "parent", link=ground)
    ET.SubElement(element, "child", link="base")
    _origin(element, placement[:3, :3], placement[:3, 3])


def _moving(tree: ET.Element, joint: Joint, parent: str, placement: Array, axis: Array) -> None:
    limits = joint.limits
    bounded = limits.position_min is not None and limits.position_max is not None
    turning = "revolute" if bounded else "continuous"
    kind = "prismatic" if joint.prismatic else turning
    element = ET.SubElement(tree, "joint", name=joint.name, type=kind)
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=joint.link_name)
    _origin(element, placement[:3, :3], placement[:3, 3])
    ET.SubElement(element, "axis", xyz=words_of(axis))
    values = {"effort": limits.torque or _UNKNOWN, "velocity": limits.velocity or _UNKNOWN}
    if limits.position_min is not None and limits.position_max is not None:
        values |= {"lower": limits.position_min, "upper": limits.position_max}
    # Other readers refuse a slide, or a hinge of a limited range, that states no limits at all.
    if kind != "continuous" or any(values.values()):
        ET.SubElement(element, "limit", {key: repr(float(value)) for key, value in values.items()})


def _rotor(tree: ET.Element, joint: str, armature: float) -> None:
    """State the inertia of a joint's motor, kg m² at the joint: at a ratio of 1."""
    transmission = ET.SubElement(tree, "transmission", name=f"{joint}_rotor")
    ET.SubElement(transmission, "type").text = "transmission_interface/SimpleTransmission"
    ET.SubElement(transmission, "joint", name=joint)
    actuator = ET.SubElement(transmission, "actuator", name=f"{joint}_motor")
    ET.SubElement(actuator, f"{{{DRAKE}}}rotor_inertia", value=repr(float(armature)))
    ET.SubElement(actuator, f"{{{DRAKE}}}gear_ratio", value="1")


def _origin(
    element: ET.Element,
    rotation: Array | None,
    position: Array,
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> None:
    angles = rpy if rotation is None else rpy_of(rotation)
    ET.SubElement(element, "origin", xyz=words_of(position), rpy=words_of(angles))


def rpy_of(rotation: Array) -> tuple[float, float, float]:
    """Return roll, pitch, yaw, to rounding also where pitch is a right angle (roll is then 0)."""
    r = rotation
    level = float(np.hypot(r[0, 0], r[1, 0]))
    pitch = float(np.arctan2(-r[2, 0], level))
    if level < 1e-9:
        return 0.0, pitch, float(np.arctan2(-r[0, 1], r[1, 1]))
    return float(np.arctan2(r[2, 1], r[2, 2])), pitch, float(np.arctan2(r[1, 0], r[0, 0]))


def words_of(numbers: Iterable[float]) -> str:
    """Return all digits of numbers: a new file is the arm to the bit."""
    # Adding 0.0 takes the sign off negative zeros.
    return " ".join(repr(float(number) + 0.0) for number in numbers)
