"""Elements of a URDF: its XML, checked attributes, and rotations in its convention."""

import xml.etree.ElementTree as ET

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.errors import RobotError

# An angle this near a right angle is one that was written with few digits (1.5708, 3.1416); taken
# as it stands, it would make parameters seem identifiable that are not.
_RIGHT_ANGLE = 1e-5
# Tags of Drake, ROS 1 and ros2_control that state turns of a motor per turn of its joint.
_RATIOS = ("gear_ratio", "mechanicalReduction", "mechanical_reduction")
_DIGITS = (
    1e-3  # of a number, by which two statements of it may differ: digits that were not written
)
_XACRO = "http://www.ros.org/wiki/xacro", "http://ros.org/wiki/xacro", "http://wiki.ros.org/xacro"


def parse(text: str | bytes) -> ET.Element:
    """Return the root element of a URDF."""
    try:
        tree = ET.fromstring(text)
    except (ET.ParseError, LookupError, ValueError) as error:
        # The last two for encodings that nobody knows, and for text that is none of the encoding it
        # claims.
        raise RobotError(f"is not valid XML ({error})", "Give a URDF file") from error
    if tree.tag != "robot":
        remedy = "Give a URDF file" + (
            "; pysdf's sdf2urdf.py converts an SDF" if tree.tag == "sdf" else ""
        )
        raise RobotError(f"is not a URDF: its root element is <{tree.tag}>, not <robot>", remedy)
    macros = tuple(f"{{{namespace}}}" for namespace in _XACRO)
    if any(isinstance(e.tag, str) and e.tag.startswith(macros) for e in tree.iter()):
        raise RobotError("contains xacro macros", "Expand them first: xacro FILE > arm.urdf")
    return tree


def by_name(tree: ET.Element, tag: str) -> dict[str, ET.Element]:
    """Return the elements of one kind by their names."""
    found = {}
    for element in tree.findall(tag):
        name = element.get("name")
        if not name:
            raise RobotError(f"a {tag} has no name", f"Name every {tag}")
        if name in found:
            raise RobotError(f"two {tag}s are named {name!r}", f"Give every {tag} a unique name")
        found[name] = element
    return found


def motors(tree: ET.Element) -> dict[str, tuple[float | None, float]]:
    """Return rotor inertia (kg m²) and ratio by joint.

    The inertia is None where none is stated, the ratio 0 where motors are coupled.

    As Drake's tags in <actuator> state them, or as the reduction of ROS 1 and ros2_control, in
    <actuator> or <joint>. Whoever states it, a joint has one ratio and one rotor: statements that
    differ are a RobotError.
    """
    stated: dict[str, dict[str, list[tuple[str, float]]]] = {}
    coupled: set[str] = set()
    for transmission in tree.iter("transmission"):
        joints = {str(joint.get("name")) for joint in transmission.iter("joint")}
        found = _statements(transmission)
        for joint in joints:
            of_joint = stated.setdefault(joint, {"rotor_inertia": [], "ratio": []})
            for quantity, statements in found.items():
                of_joint[quantity] += statements
        # Of a differential each motor moves several joints: none has an inertia of its own.
        coupled |= joints if len(joints) > 1 else set()
    alone = {joint: numbers for joint, numbers in stated.items() if joint not in coupled}
    inertias = {joint: _one(numbers["rotor_inertia"], joint) for joint, numbers in alone.items()}
    ratios = {joint: _one(numbers["ratio"], joint) for joint, numbers in alone.items()}
    unstated = {joint: 1.0 if ratio is None else ratio for joint, ratio in ratios.items()}
    return {
        joint: (None, 0.0) if joint in coupled else (inertias[joint], unstated[joint])
        for joint in stated
    }


def _statements(transmission: ET.Element) -> dict[str, list[tuple[str, float]]]:
    """Return what a <transmission> states of a rotor's inertia and of a ratio: tag and number of
    each."""
    found: dict[str, list[tuple[str, float]]] = {"rotor_inertia": [], "ratio": []}
    for element in transmission.iter():
        tag = str(element.tag).rpartition("}")[2].rpartition(":")[2]
        if tag != "rotor_inertia" and tag not in _RATIOS:
            continue
        quantity = "rotor_inertia" if tag == "rotor_inertia" else "ratio"
        what = f"transmission {transmission.get('name')!r}: {tag}"
        value = number(element.get("value") or element.text or "", what)
        if quantity == "rotor_inertia" and value < 0.0:
            raise RobotError(f"{what} is {value:g}", "Give zero or more")
        if quantity == "ratio" and value == 0.0:
            raise RobotError(f"{what} is 0", "Give the turns of the motor per turn of the joint")
        found[quantity].append((what, value))
    return found


def _one(statements: list[tuple[str, float]], joint: str) -> float | None:
    """Return the number that all statements of one quantity of a joint agree on; None where there
    is none."""
    if not statements:
        return None
    first, value = statements[0]
    for other, also in statements[1:]:
        # A sign is which way a motor turns, and no part of what it weighs.
        if abs(abs(also) - abs(value)) > _DIGITS * max(abs(also), abs(value)):
            raise RobotError(
                f"joint {joint!r} has two values for one number: {first} is {value:g}, {other}"
                f" is {also:g}",
                "State it once, or with the same value everywhere",
            )
    return value


def agreed(element: ET.Element, tag: str, where: str) -> ET.Element | None:
    """Return the child of an element, or None.

    Children that state different numbers are an error.
    """
    children = element.findall(tag)
    if any(_content(child) != _content(children[0]) for child in children[1:]):
        raise RobotError(f"{where} has {len(children)} different <{tag}>", "Keep the correct one")
    return children[0] if children else None


def _content(element: ET.Element) -> tuple[object, ...]:
    """Return what an element states: equal numbers are one, however they are written."""
    stated = sorted((key, _words(text)) for key, text in element.attrib.items())
    return element.tag, _words(element.text or ""), stated, [_content(child) for child in element]


def _words(text: str) -> tuple[str, ...]:
    words = text.split()
    try:
        return tuple(repr(float(word)) for word in words)
    except ValueError:
        return tuple(words)


def child_of(element: ET.Element, tag: str, where: str) -> ET.Element:
    """Return the child of an element that must be there."""
    child = agreed(element, tag, where)
    if child is None:
        raise RobotError(
            f"{where} has no <{tag}>",
            f"Add it, as the URDF specification requires it for <{element.tag}>",
        )
    return child


def attribute(element: ET.Element, key: str, where: str) -> str:
    """Return an attribute that must be there."""
    value = element.get(key)
    if value is None:
        raise RobotError(f"{where}: <{element.tag}> has no {key}", "Add it")
    return value


def number(text: str, what: str) -> float:
    """Return the number that a text holds."""
    return float(vector(text, what, 1)[0])


def vector(text: str | None, what: str, size: int = 3) -> Array:
    """Return the finite numbers that a text holds."""
    try:
        vector = np.array([float(word) for word in (text or "").split()])
    except ValueError as error:
        raise RobotError(f"{what} is {text!r}", "Give numbers") from error
    if len(vector) != size or not np.isfinite(vector).all():
        raise RobotError(
            f"{what} is {text!r}", f"Give {size} finite number{'s' if size > 1 else ''}"
        )
    return vector


def right_angles(angles: Array) -> Array:
    """Return angles, rad, with those next to a multiple of a right angle made exact."""
    exact = np.round(angles / (0.5 * np.pi)) * (0.5 * np.pi)
    return np.where(np.abs(angles - exact) < _RIGHT_ANGLE, exact, angles)


def rotation(roll: float, pitch: float, yaw: float) -> Array:
    """Rz(yaw) Ry(pitch) Rx(roll), the URDF's convention."""
    cr, cp, cy = np.cos(np.array([roll, pitch, yaw]))
    sr, sp, sy = np.sin(np.array([roll, pitch, yaw]))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def z_onto(axis: Array) -> Array:
    """Return the smallest rotation that takes z onto the unit vector `axis`."""
    x, y, z = axis
    if z < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    k = 1.0 / (1.0 + z)
    return np.array(
        [[1.0 - k * x * x, -k * x * y, x], [-k * x * y, 1.0 - k * y * y, y], [-x, -y, z]]
    )
