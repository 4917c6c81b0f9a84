"""A new MJCF of an arm: rigid, or elastic with a motor joint and a spring joint per link.

Both joints of an elastic drive turn about one axis: the first by theta, with B of (6) or (7) as
armature, the second by the deflection q - theta, with K and D. Components of the transmissions rest
on their carriers and spin relative to the ground. This is mod2, or mod1 if the splines are part of
the links. An MJCF cannot state the coupling S of mod3 by spinning rotors.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.effects import Catalogue, EffectInstance
from elastic_arm.errors import RobotError
from elastic_arm.mujoco.changed_numbers import six, text_of
from elastic_arm.mujoco.closed_loop import with_controllers
from elastic_arm.mujoco.elements import (
    DEFLECTION,
    Elements,
    delayed,
    motor_attributes,
    servo,
    sharp,
)
from elastic_arm.mujoco.left_out import left_coupling, left_effects, left_numbers
from elastic_arm.mujoco.mjcf_export import Exported
from elastic_arm.mujoco.stand_ins import StandIn, explained, stood_in
from elastic_arm.mujoco.stated_arm import Lacking, StatedArm, stated_arm
from elastic_arm.output_files import write_result
from elastic_arm.robot import Inertia, JointController, Robot
from elastic_arm.robot.kinematics import link_radius
from elastic_arm.robot.mjcf import MjcfArm, open_mjcf
from elastic_arm.robot.mjcf.drives import FIRMWARE_GAIN
from elastic_arm.robot.urdf_export import bodies_with_components, words_of

TIMESTEP = 1e-3


def export_new_mjcf(
    robot: Robot, base: None, out: Path, *, catalogue: Catalogue | None = None
) -> Exported:
    """Write an arm with its effects as a new MJCF; an OutputError if it cannot be written."""
    text, effects, stand_ins = _written(robot, catalogue, TIMESTEP)
    others = [
        replace(one, controller=None) if servo(one.controller) == one.controller else one
        for one in robot.joints
    ]
    numbers = left_numbers(robot.with_(joints=tuple(others)), "the new file has no such number")
    left = [*left_effects(robot, effects, catalogue), *numbers]
    if robot.elastic:
        left += left_coupling(
            robot, "the new file is mod2, whose rotors spin relative to the ground"
        )
    write_result(out, text)
    told = tuple(one.words(robot) for one in stand_ins)
    return Exported((out,), (), tuple(left), units=robot.units, stand_ins=told)


def to_mjcf(
    robot: Robot, *, catalogue: Catalogue | None = None, timestep: float = TIMESTEP
) -> tuple[str, tuple[tuple[EffectInstance, str], ...]]:
    """Return an arm with its effects as MJCF text, and those that it does not state, each with the
    reason."""
    text, left, _ = _written(robot, catalogue, timestep)
    return text, left


def _written(
    robot: Robot, catalogue: Catalogue | None, timestep: float
) -> tuple[str, tuple[Lacking, ...], tuple[StandIn, ...]]:
    arm = stated_arm(robot, catalogue)
    elements = Elements(robot, arm, timestep)
    arm, stand_ins = stood_in(arm, robot, elements.left)
    root = ET.Element("mujoco", model=robot.name)
    kind = (
        "elastic: a motor joint and a spring joint per drive" if robot.elastic else "rigid joints"
    )
    root.append(ET.Comment(f" {kind} "))
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    settings = {"timestep": text_of(timestep), "integrator": "implicitfast"}
    ET.SubElement(root, "option", settings, gravity=words_of(arm.gravity))
    _links(ET.SubElement(root, "worldbody"), robot, arm, elements)
    _drives(root, arm, robot, timestep)
    _elements(root, elements)
    numerics = [*(one.numeric for one in stand_ins), *_firmware_gains(robot)]
    if numerics:
        custom = ET.SubElement(root, "custom")
        for numeric in numerics:
            ET.SubElement(custom, "numeric", numeric)
    ET.indent(root)
    left = tuple(explained(elements.left, stand_ins))
    return ET.tostring(root, encoding="unicode") + "\n", left, stand_ins


def _links(world: ET.Element, robot: Robot, arm: StatedArm, elements: Elements) -> None:
    """Add base and links, each a body in the one before, with their joints and shapes.

    MuJoCo has no massless bodies that move: the joints of such links are those of the next body.
    """
    parent = ET.SubElement(world, "body", {"name": "base", **_placed(robot.base_placement)})
    bodies = _bodies(robot, arm)
    if bodies[0].mass > 0.0:
        _inertial(parent, bodies[0])
    place = np.eye(4)  # (4, 4) of the next link in the last body
    radius = link_radius(robot)
    waiting: list[tuple[int, Array]] = []  # joints of massless links, with their places
    for i, joint in enumerate(robot.joints):
        waiting.append((i, place @ joint.before))
        place = place @ joint.before @ joint.after
        if bodies[i + 1].mass == 0.0:
            continue
        body = ET.SubElement(parent, "body", {"name": joint.link_name, **_placed(place)})
        _inertial(body, bodies[i + 1])
        for k, frame in waiting:
            _joints(body, robot, arm, elements, k, np.linalg.inv(place) @ frame)
        waiting = []
        onward = robot.joints[i + 1].before[:3, 3] if i + 1 < robot.n else np.zeros(3)
        start = np.linalg.inv(joint.after)[:3, 3]
        _capsule(body, start, onward, radius)
        parent = body
        place = np.eye(4)


def playable(robot: Robot, file: Path, catalogue: Catalogue | None = None) -> MjcfArm:
    """Write an arm with its controllers as a new MJCF, and open it as MuJoCo plays it.

    What its controllers have and no actuator is in the set-points: a dead band, an integral. Raises
    a RobotError where a controller is none that follows angles.
    """
    drives = [joint.controller for joint in robot.joints]
    if not all(servo(drive) and drive and drive.feedforward == "none" for drive in drives):
        raise RobotError(
            "some joint has no position controller", "State `controller:` in the arm file"
        )
    write_result(file, to_mjcf(robot, catalogue=catalogue)[0])
    return with_controllers(open_mjcf(file), robot)


def _bodies(robot: Robot, arm: StatedArm) -> list[Inertia]:
    """Return the base and the links with what rides on them; the links as the effects have changed
    them."""
    changed = robot.with_(
        joints=tuple(
            replace(joint, link=link) for joint, link in zip(robot.joints, arm.links, strict=True)
        )
    )
    return bodies_with_components(changed)


def _joints(
    body: ET.Element, robot: Robot, arm: StatedArm, elements: Elements, i: int, frame: Array
) -> None:
    """Add joint i, whose frame stands at `frame` in the body's, and the joint that its drive winds
    by."""
    joint = robot.joints[i]
    numbers = arm.joints[i]
    where = {"pos": words_of(frame[:3, 3]), "axis": words_of(frame[:3, 2])}
    limits = joint.limits
    ranged = {}
    if limits.position_min is not None and limits.position_max is not None:
        ranged = {"range": text_of(limits.position_min, limits.position_max)}
    stated = {
        "armature": numbers.armature,
        "damping": numbers.damping,
        "frictionloss": numbers.friction_loss,
    }
    stated |= {"stiffness": numbers.stiffness, "springref": numbers.rest, "ref": numbers.zero}
    words = {name: text_of(value) for name, value in stated.items() if value}
    if numbers.friction_loss:
        words["solreffriction"] = sharp(elements.timestep)
    kind = "slide" if joint.prismatic else "hinge"
    ET.SubElement(body, "joint", {"name": joint.name, "type": kind, **where, **ranged, **words})
    if joint.transmission is not None:
        a, b, c = elements.springs[i]
        texts = {
            "stiffness": text_of(a, b, c) if c else text_of(a),
            "damping": text_of(elements.dampings[i]),
        }
        ET.SubElement(
            body, "joint", {"name": f"{joint.name}{DEFLECTION}", "type": kind, **where, **texts}
        )


def _drives(root: ET.Element, arm: StatedArm, robot: Robot, timestep: float) -> None:
    actuators = ET.SubElement(root, "actuator")
    sensors = ET.SubElement(root, "sensor")
    for joint, numbers in zip(robot.joints, arm.joints, strict=True):
        motor = f"{joint.name}_motor"
        torque = joint.limits.torque
        drive = servo(joint.controller)
        if drive is None:
            limit = {} if torque is None else {"ctrlrange": text_of(-torque, torque)}
            ET.SubElement(actuators, "motor", {"name": motor, "joint": joint.name, **limit})
        else:
            limits = [one for one in (torque, drive.torque) if one is not None]
            late = {**delayed(drive.delay, timestep), "interp": "linear"} if drive.delay else {}
            tag, stated = _servo_element(drive, min(limits, default=None))
            ET.SubElement(actuators, tag, {"name": motor, "joint": joint.name, **stated, **late})
        ET.SubElement(sensors, "jointpos", name=f"{joint.name}_theta", joint=joint.name)
        # Of the motor, not of the joint: what friction and cogging take from it is not recorded.
        late = delayed(numbers.delay, timestep) if numbers.delay else {}
        ET.SubElement(
            sensors, "actuatorfrc", {"name": f"{joint.name}_tau_m", "actuator": motor, **late}
        )


def _servo_element(drive: JointController, limit: float | None) -> tuple[str, dict[str, str]]:
    """Return name and attributes of the actuator that a servo is, with a limit of its torque."""
    if drive.stall is None:
        limited = {} if limit is None else {"forcerange": text_of(-limit, limit)}
        return "position", {"kp": text_of(drive.kp), "kv": text_of(drive.kd), **limited}
    limited = {} if limit is None else {"saturation": text_of(limit, 0.0, 0.0)}
    return "dcmotor", {"input": "pos", **motor_attributes(drive, 1.0), **limited}


def _firmware_gains(robot: Robot) -> Iterator[dict[str, str]]:
    """Yield the attributes of the <numeric> elements that state for which number in a servo's
    register its gains hold."""
    for joint in robot.joints:
        drive = servo(joint.controller)
        if drive is not None and drive.firmware_gain is not None:
            name = f"{FIRMWARE_GAIN}:{joint.name}"
            yield {"name": name, "data": text_of(drive.firmware_gain)}


def _elements(root: ET.Element, elements: Elements) -> None:
    """Add tendons and motors to a file."""
    for one in elements.found:
        section = "tendon" if one.tag == "fixed" else "actuator"
        parent = root.find(section)
        if parent is None:
            parent = ET.SubElement(root, section)
        texts = {k: v if isinstance(v, str) else text_of(v) for k, v in one.attributes.items()}
        element = ET.SubElement(parent, one.tag, texts)
        for joint, coefficient in one.joints.items():
            ET.SubElement(element, "joint", joint=joint, coef=text_of(coefficient))


def _inertial(body: ET.Element, inertia: Inertia) -> None:
    if inertia.mass > 0.0:
        mass = words_of([inertia.mass])
        moments = words_of(six(inertia))
        ET.SubElement(body, "inertial", pos=words_of(inertia.com), mass=mass, fullinertia=moments)


def _capsule(body: ET.Element, start: Array, end: Array, radius: float) -> None:
    if np.linalg.norm(end - start) > 1e-6:
        ends = text_of(*start, *end)
        seen = {"contype": "0", "conaffinity": "0", "mass": "0"}
        ET.SubElement(
            body, "geom", {"type": "capsule", "size": text_of(0.7 * radius), "fromto": ends, **seen}
        )


def _placed(placement: Array) -> dict[str, str]:
    rotation = placement[:3, :3]
    return {
        "pos": words_of(placement[:3, 3]),
        "xyaxes": words_of(np.concatenate([rotation[:, 0], rotation[:, 1]])),
    }
