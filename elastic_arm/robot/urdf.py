"""Reading of URDF files: any serial chain of revolute and prismatic joints, with inertias of links
and limits of joints.

The root link is the base. Frames are kept: link i has the frame of the URDF, and ``before`` and
``after`` of its joint turn z into the axis of the URDF and back. A URDF has no elasticity, so the
robot has no transmissions unless an overlay adds them (:func:`elastic_arm.robot.load_robot`).
``Robot.notes`` lists everything that is read differently from the file.
"""

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.errors import RobotError
from elastic_arm.input_files import read_bytes
from elastic_arm.robot.description import Inertia, Joint, Limits, Robot
from elastic_arm.robot.kinematics import lumped, moved
from elastic_arm.robot.parts import located, nearest_tensor, placed, tensor_of
from elastic_arm.robot.urdf_elements import (
    agreed,
    attribute,
    child_of,
    motors,
    number,
    parse,
    right_angles,
    rotation,
    vector,
    z_onto,
)
from elastic_arm.robot.urdf_tree import Chain, UrdfTree

MOVING = ("revolute", "continuous", "prismatic")
# Inertias of vendors' files that miss what a body can have by no more than this share of the
# largest moment are rounded or of simplified shapes; beyond it something is wrong.
ROUNDED = 0.1
# What <dynamics> may state, and the effects, with their parameters, that these are.
DYNAMICS = {
    "damping": ("viscous_friction", "coefficient"),
    "friction": ("coulomb_friction", "torque"),
}


def read_urdf(path: str | Path, chain: Chain | None = None) -> Robot:
    """Read a URDF file; see :func:`parse_urdf`."""
    text = read_bytes(path, RobotError, "Give the path of a URDF.")
    with located(f"{path}: "):
        return parse_urdf(text, chain)


def parse_urdf(text: str | bytes, chain: Chain | None = None) -> Robot:
    """Make a robot of URDF text.

    Fixed joints join their child's inertia to their parent, continuous joints are revolute ones
    without limits, a link without inertial has no mass, and an inertia without mass none; joints of
    a gripper, which mimic one another, are held at zero. Where `chain` names first and last link,
    what stands on the last one and all other moving branches are left out. Each such reading leaves
    a sentence in ``Robot.notes``. Raises a RobotError if it is no URDF of a serial chain of joints;
    it names the element, the reason and the remedy.
    """
    return _Reading(parse(text), chain).robot()


class _Reading:
    """One pass over a URDF, from the root link outward."""

    def __init__(self, root: ET.Element, chain: Chain | None) -> None:
        self._element = root
        self._tree = UrdfTree(root, chain)
        self._notes: list[str] = self._tree.notes()
        self._motors = motors(root)
        self._used: set[str] = set()
        self._resting = True

    def robot(self) -> Robot:
        base, onward = self._rigid(self._tree.first, np.eye(4))
        self._resting = False
        joints: list[Joint] = []
        while (step := self._only(onward)) is not None:
            element, carried = step
            joint, onward = self._joint(element, carried)
            joints.append(joint)
        if not joints:
            raise RobotError(
                "the URDF contains no moving joint",
                "Describe at least one revolute or prismatic joint",
            )
        self._note_unused()
        if joints[-1].link.mass == 0.0:
            raise RobotError(
                f"link {joints[-1].link_name!r} and the bodies fixed to it have no mass",
                "Give the last link an <inertial>, or make its joint fixed",
            )
        name = self._element.get("name") or "robot"
        stand = self._stand()
        effects = tuple(effect for joint in joints for effect in self._friction(joint.name))
        return Robot(
            name,
            tuple(joints),
            base_placement=stand,
            base_mass=base.mass,
            effects=effects,
            notes=tuple(self._notes),
        )

    def _friction(self, name: str) -> list[dict[str, Any]]:
        """Return damping and friction that <dynamics> states as effects of that size."""
        element = agreed(self._tree.joints[name], "dynamics", f"joint {name!r}")
        found = []
        for key, (effect, parameter) in DYNAMICS.items():
            if element is not None and element.get(key):
                value = number(str(element.get(key)), f"joint {name!r}: dynamics {key}")
                if value < 0.0:
                    raise RobotError(
                        f"joint {name!r}: dynamics {key} is {value:g}",
                        "Give zero or a positive number",
                    )
                found += (
                    [{"effect": effect, "joint": name, "parameters": {parameter: value}}]
                    if value
                    else []
                )
        return found

    def _stand(self) -> Array:
        """Return where the arm's first link stands in the root link, whose frame gravity is given
        in."""
        placement = np.eye(4)
        for name in self._tree.path_to(self._tree.first):
            placement = placement @ self._origin(self._tree.joints[name], f"joint {name!r}")
        return placement

    def _rigid(self, link: str, placement: Array) -> tuple[Inertia, list[tuple[ET.Element, Array]]]:
        """Gather a link at `placement` and all that is fixed to it; return also the moving joints
        it carries."""
        bodies = [self._inertia(link, placement)]
        onward = []
        for element in self._tree.children[link]:
            name = str(element.get("name"))
            child = self._moves(element)
            if name in self._tree.left_out:
                continue
            if self._tree.moves(name):
                onward.append((element, placement))
                continue
            body, further = self._rigid(child, placement @ self._origin(element, f"joint {name!r}"))
            if body.mass > 0.0 and name not in self._tree.held:
                self._notes.append(
                    f"joint {name!r} is fixed: link {child!r} ({body.mass:g} kg) is part of"
                    f" {link!r}"
                )
            bodies.append(body)
            onward += further
        return lumped(bodies), onward

    def _only(self, onward: list[tuple[ET.Element, Array]]) -> tuple[ET.Element, Array] | None:
        if len(onward) > 1:
            names = ", ".join(repr(element.get("name")) for element, _ in onward)
            raise RobotError(
                f"the chain branches: joints {names} move relative to the same body",
                "Give the arm's first and last link (chain base:tip), or make the joints of"
                " the other branches fixed",
            )
        return onward[0] if onward else None

    def _joint(
        self, element: ET.Element, carried: Array
    ) -> tuple[Joint, list[tuple[ET.Element, Array]]]:
        name = str(element.get("name"))
        child = self._moves(element)
        kind = element.get("type")
        if kind not in MOVING:
            raise RobotError(
                f"joint {name!r} is {kind or 'without type'}",
                "Only revolute, continuous, prismatic and fixed joints are supported: make it"
                " fixed or remove it",
            )
        if element.find("mimic") is not None:
            raise RobotError(f"joint {name!r} mimics another", "Make it fixed or remove its branch")
        turn = placed(z_onto(self._axis(element, name)))
        body, onward = self._rigid(child, np.eye(4))
        if body.mass == 0.0 and onward:
            self._notes.append(f"link {child!r} has no inertial and is treated as massless")
        before = carried @ self._origin(element, f"joint {name!r}") @ turn
        with located(f"joint {name!r}: "):
            inertia, ratio = self._motors.get(name, (None, 1.0))
            self._used.add(name)
            rest: dict[str, Any] = {"armature": None if inertia is None else inertia * ratio**2}
            rest |= {"limits": self._limits(element, name), "prismatic": kind == "prismatic"}
            return Joint(name, child, body, before, turn.T, **rest), onward

    def _moves(self, element: ET.Element) -> str:
        return str(child_of(element, "child", str(element.get("name"))).get("link"))

    def _inertia(self, link: str, placement: Array) -> Inertia:
        where = f"link {link!r}"
        inertial = agreed(self._tree.links[link], "inertial", where)
        if inertial is None:
            return Inertia(0.0)
        mass = number(
            attribute(child_of(inertial, "mass", where), "value", where), f"{where}: mass"
        )
        values = child_of(inertial, "inertia", where)
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        tensor = tensor_of(number(attribute(values, key, where), f"{where}: {key}") for key in keys)
        origin = self._origin(inertial, where)
        with located(f"{where}: "):
            if self._resting:
                # Of what stands still the mass alone counts; antennas and covers may state inertias
                # that no body has.
                return Inertia(mass)
            if mass == 0.0:
                if tensor.any():
                    self._notes.append(
                        f"{where} has an inertia but no mass and is treated as massless"
                    )
                return Inertia(0.0)
            nearest, off = nearest_tensor(tensor)
            if 0.0 < off <= ROUNDED:
                self._notes.append(
                    f"{where}: its inertia is physically impossible, by {off:.1%}: the nearest"
                    " possible inertia is used"
                )
                tensor = nearest
            return moved(Inertia(mass, inertia=tensor), placement @ origin)

    def _limits(self, element: ET.Element, name: str) -> Limits:
        limit = agreed(element, "limit", f"joint {name!r}")
        # A limit that is infinite is none.
        given: dict[str, float | None] = {}
        for what, value in ({} if limit is None else limit).items():
            where = f"joint {name!r}: limit {what}"
            given[what] = None if _endless(value) else number(value, where)
        lower = given.get("lower", 0.0)
        upper = given.get("upper", 0.0)
        bounded = element.get("type") != "continuous" and lower != upper
        if element.get("type") == "continuous":
            self._notes.append(f"joint {name!r} is continuous: it has no position limits")
        elif not bounded:
            self._notes.append(f"joint {name!r} has no range: its position limits are unknown")
        for key in ("velocity", "effort"):
            if given.get(key) == 0.0:
                self._notes.append(
                    f"joint {name!r} has the {key} limit 0, which is treated as unknown"
                )
        return Limits(
            position_min=lower if bounded else None,
            position_max=upper if bounded else None,
            velocity=given.get("velocity") or None,
            torque=given.get("effort") or None,
        )

    def _axis(self, element: ET.Element, name: str) -> Array:
        axis = agreed(element, "axis", f"joint {name!r}")
        direction = (
            np.array([1.0, 0.0, 0.0])
            if axis is None
            else vector(axis.get("xyz"), f"joint {name!r}: axis")
        )
        largest = float(np.abs(direction).max())
        if largest < 1e-9:
            raise RobotError(
                f"joint {name!r} has the axis 0 0 0",
                "Give the axis of rotation or translation",
            )
        direction = direction / largest  # whose square may be beyond all numbers
        return direction / np.linalg.norm(direction)

    def _origin(self, element: ET.Element, where: str) -> Array:
        origins = element.findall("origin")
        if len(origins) > 1:
            self._notes.append(f"{where} has {len(origins)} origins: the first one is used")
        if not origins:
            return np.eye(4)
        position, written = (
            vector(origins[0].get(key, "0 0 0"), f"{where}: origin {key}") for key in ("xyz", "rpy")
        )
        angles = right_angles(written)
        if not np.allclose(angles, written, rtol=0.0, atol=1e-10):
            self._notes.append(
                f"{where}: rpy {origins[0].get('rpy')} is interpreted as exact right angles"
            )
        return placed(rotation(*angles), position)

    def _note_unused(self) -> None:
        if self._motors:
            self._notes.append(
                "<transmission> contains no stiffness: the joints are treated as rigid"
            )
        for name, (inertia, ratio) in self._motors.items():
            words = ""
            if name not in self._used:
                # Of a joint beside the arm, such as a gripper's, nothing is needed.
                words = (
                    ""
                    if name in self._tree.joints
                    else "it is ignored, as the file has no such joint"
                )
            elif inertia is not None:
                words = (
                    f"rotor inertia {inertia:g} kg m² with a ratio of {ratio:g} gives its armature"
                )
            elif ratio == 0.0:
                words = "it couples several joints and is ignored; use `coupling` in a channel map"
            elif ratio != 1.0:
                words = (
                    f"its reduction of {ratio:g} is ignored, as there is no rotor inertia"
                    " (drake:rotor_inertia)"
                )
            if words:
                self._notes.append(f"<transmission> of joint {name!r}: {words}")


def _endless(text: str) -> bool:
    return text.strip().lower().lstrip("+-") in ("inf", "infinity", ".inf")
