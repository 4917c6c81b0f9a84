"""The bodies of the virtual prototype: every link, rotor, wave generator and spline as a body of a
MuJoCo model.

Only the robot as data is used; no dynamics code is shared with mod1 to mod3. The kinematic chain of
each joint is that of the paper's Fig. 1b: rotor, wave generator and spline each turn about the axis
of the joint on the body that carries them, and the link is attached to the spline by a bushing with
three translations and three rotations.
"""

from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any, Self

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.errors import RobotError
from elastic_arm.robot.description import Component, Joint, Robot, Transmission
from elastic_arm.robot.kinematics import link_placements
from elastic_arm.robot.mjcf.engine import engine as mujoco_engine
from elastic_arm.robot.parts import placed

BUSHING = ("x", "y", "z", "about_y", "about_x", "about_z")
"""The bushing's degrees of freedom, in the order in which they act: the paper's Ry(q_y) Rx(q_x)
Rz(q) of (3)."""


def engine() -> ModuleType:
    """Return MuJoCo, which only the virtual prototype needs."""
    return mujoco_engine("the virtual prototype needs")


@dataclass(frozen=True)
class Bushing:
    """Numbers of the bushing between spline and link that the arm file does not hold."""

    # translation_stiffness, translation_damping: The three stiff translations, N/m and N s/m; ours,
    # as the paper states only "high"
    translation_stiffness: float = 2.0e8
    translation_damping: float = 2.0e4
    # Multiplies the stiffness of bearings and translations, and their damping by its square root
    # (the damping ratio stays)
    bearing_scale: float = 1.0
    # The bushing's rotations about x and y and its translations do not move at all: the limit of a
    # stiff bushing
    locked: bool = False

    def with_translation(self, stiffness: float) -> Self:
        """Return a bushing with this translation stiffness, N/m, at the same damping ratio."""
        damping = self.translation_damping * (stiffness / self.translation_stiffness) ** 0.5
        return replace(self, translation_stiffness=stiffness, translation_damping=damping)


def build_spec(robot: Robot, bushing: Bushing) -> Any:
    """Make the engine's model specification of an elastic robot.

    Returns an MjSpec with bodies and joints named "<joint>.rotor", "<joint>.wave_generator",
    "<joint>.spline", "<joint>.link" and, for the bushing, "<joint>.x" and so on; a site "tool" at
    the last link's frame.
    """
    drives = transmissions(robot)
    mj = engine()
    spec = mj.MjSpec()
    spec.option.gravity = np.asarray(robot.gravity)
    spec.option.disableflags = mj.mjtDisableBit.mjDSBL_CONTACT
    spec.compiler.autolimits = False
    joint_frames = link_placements(robot, np.zeros(robot.n))[0][0]
    links = [spec.worldbody]  # links[i] carries joint i's components; links[0] is the ground
    placements = [np.eye(4)]  # of those bodies' frames in the world, at the zero pose
    for index, (joint, drive) in enumerate(zip(robot.joints, drives, strict=True)):
        here = np.linalg.inv(placements[index]) @ joint_frames[index]
        spline = links[index].add_body(
            name=f"{joint.name}.spline", pos=here[:3, 3], quat=quaternion(here)
        )
        _revolve(spline, drive.spline, f"{joint.name}.spline")
        link = _hang_link(spline, joint, _springs(drive, bushing))
        links.append(link)
        placements.append(joint_frames[index])
    for index, (joint, drive) in enumerate(zip(robot.joints, drives, strict=True)):
        for part, component in (("rotor", drive.rotor), ("wave_generator", drive.wave_generator)):
            carrier = carrier_index(robot, component.carrier)
            here = (
                np.linalg.inv(placements[carrier])
                @ joint_frames[index]
                @ placed(position=component.position)
            )
            body = links[carrier].add_body(
                name=f"{joint.name}.{part}", pos=here[:3, 3], quat=quaternion(here)
            )
            _revolve(body, component, f"{joint.name}.{part}")
    after = robot.joints[-1].after
    links[-1].add_site(name="tool", pos=after[:3, 3], quat=quaternion(after))
    return spec


def transmissions(robot: Robot) -> list[Transmission]:
    """Return every joint's transmission.

    A robot from which no prototype can be built is refused, with the joint's name.
    """
    found = []
    for index, joint in enumerate(robot.joints):
        transmission = joint.transmission
        if transmission is None:
            raise RobotError(
                f"{joint.name} of {robot.name} has no transmission",
                "The virtual prototype needs rotor, wave generator, spline and stiffness of every"
                " joint (an arm file)",
            )
        if transmission.bearing is None:
            raise RobotError(
                f"{joint.name} of {robot.name} has no bearing",
                "Add 'bearing: {stiffness: …, damping: …}' (Nm/rad, Nm s/rad) to this joint in the"
                " arm file",
            )
        if carrier_index(robot, transmission.spline.carrier) != index:
            raise RobotError(
                f"the spline of {joint.name} is carried by {transmission.spline.carrier}",
                "The virtual prototype needs each output spline on the link before its joint;"
                " set 'carrier' accordingly",
            )
        found.append(transmission)
    return found


def carrier_index(robot: Robot, carrier: str) -> int:
    """Return 0 for the base and i + 1 for the link of joint i."""
    return 0 if carrier == "base" else 1 + robot.link_names.index(carrier)


def quaternion(placement: Array) -> Array:
    """Return the rotation of a placement (4, 4) as the engine's quaternion (w, x, y, z)."""
    result = np.empty(4)
    engine().mju_mat2Quat(result, np.ascontiguousarray(placement[:3, :3]).ravel())
    return result


def _revolve(body: Any, component: Component, name: str) -> None:
    """Give a body the inertia of a solid of revolution and a hinge about its axis."""
    body.explicitinertial = True
    body.mass = component.mass
    # unset, the engine takes the body's own placement
    body.ipos = [0.0, 0.0, 0.0]
    body.iquat = [1.0, 0.0, 0.0, 0.0]
    body.inertia = [component.ixx, component.ixx, component.izz]
    body.add_joint(name=name, type=engine().mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])


def _springs(drive: Transmission, bushing: Bushing) -> list[tuple[float, float]]:
    """Return stiffness and damping of the bushing's six axes, in the order of :data:`BUSHING`."""
    assert drive.bearing is not None  # transmissions() has seen to it
    scale = bushing.bearing_scale
    tilt = (drive.bearing.stiffness * scale, drive.bearing.damping * scale**0.5)
    slide = (bushing.translation_stiffness * scale, bushing.translation_damping * scale**0.5)
    return [slide, slide, slide, tilt, tilt, (drive.stiffness, drive.damping)]


def _hang_link(spline: Any, joint: Joint, springs: list[tuple[float, float]]) -> Any:
    """Hang the joint's link on its spline by the six springs and dampers of the bushing."""
    mj = engine()
    link = spline.add_body(name=f"{joint.name}.link")
    rotation = joint.after[:3, :3]
    offset = joint.after[:3, 3]
    inertia = rotation @ joint.link.inertia @ rotation.T
    link.explicitinertial = True
    link.mass = joint.link.mass
    link.ipos = rotation @ joint.link.com + offset
    link.fullinertia = [*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    kinds = [mj.mjtJoint.mjJNT_SLIDE] * 3 + [mj.mjtJoint.mjJNT_HINGE] * 3
    axes = np.eye(3)[[0, 1, 2, 1, 0, 2]]
    for name, kind, axis, (stiffness, damping) in zip(BUSHING, kinds, axes, springs, strict=True):
        added = link.add_joint(name=f"{joint.name}.{name}", type=kind, axis=axis)
        added.stiffness = [stiffness, 0.0, 0.0]  # the engine's polynomial; linear here
        added.damping = [damping, 0.0, 0.0]
    return link
