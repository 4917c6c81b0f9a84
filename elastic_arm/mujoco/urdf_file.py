"""A user's own URDF with the numbers of a corrected arm, or a new one; all else stays as it was."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from elastic_arm.arrays import Array
from elastic_arm.effects import Catalogue, EffectInstance, robot_effects
from elastic_arm.effects.library.base_tilt import tilt
from elastic_arm.errors import RobotError
from elastic_arm.identification.batch.mounting import tilt_of
from elastic_arm.input_files import read_bytes
from elastic_arm.mujoco.changed_numbers import (
    Change,
    Deviations,
    body_after,
    differs,
    inertial_change,
    joint_changes,
    six,
    text_of,
)
from elastic_arm.mujoco.left_out import Left, Motion, left_effects, left_numbers
from elastic_arm.mujoco.mjcf_export import Exported, require_same_joints
from elastic_arm.mujoco.shape import ShapedXml, append_last
from elastic_arm.mujoco.stand_ins import explained, stood_in
from elastic_arm.mujoco.stated_arm import StatedArm, stated_arm
from elastic_arm.mujoco.urdf_rotors import state_rotor
from elastic_arm.output_files import write_result
from elastic_arm.robot import Inertia, Robot, parse_urdf, to_urdf
from elastic_arm.robot.kinematics import moved
from elastic_arm.robot.parts import located, nearest_tensor, placed, tensor_of
from elastic_arm.robot.urdf_elements import motors, rotation, vector
from elastic_arm.robot.urdf_export import rpy_of
from elastic_arm.robot.urdf_tree import Chain

# Attribute of <dynamics> by the field of a joint's numbers.
_ATTRIBUTES = {"damping": "damping", "friction_loss": "friction"}
_NO_NUMBER = "a URDF has no number for it"
Motor = tuple[float | None, float]  # inertia of a rotor, kg m², and its ratio
_MOUNTING = "a URDF does not state how its first link is mounted"


def export_urdf(
    robot: Robot,
    base: Path | None,
    out: Path,
    *,
    chain: Chain | None = None,
    deviations: Deviations | None = None,
    catalogue: Catalogue | None = None,
    motion: Motion | None = None,
) -> Exported:
    """Write a URDF with the numbers of an arm: inertials, damping and friction of joints.

    Without `base`, the user's file, it is a new one of simple shapes; all else is as in
    :func:`~elastic_arm.mujoco.export_mjcf`. Raises a RobotError if the arm is another one, or its
    numbers are of no physical body, and an OutputError if the file cannot be written.
    """
    text = (
        to_urdf(robot.with_(effects=())).encode()
        if base is None
        else read_bytes(base, RobotError, "Give the URDF that the arm was read from.")
    )
    document = ShapedXml(text, str(base or robot.name))
    root = document.root
    with located(f"{base or robot.name}: "):
        arm = parse_urdf(text, chain)
        if base is not None:
            require_same_joints(robot, arm, base)
        numbers = robot if base is not None else arm.with_(effects=robot.effects)
        whole = stated_arm(robot, catalogue)
        ratios = motors(root)
        after = _with_rotors(
            stated_arm(numbers, catalogue, base=arm.base_placement), arm, whole, ratios
        )
        before = stated_arm(arm, catalogue)
        after, stand_ins = stood_in(after, numbers, after.left, motion)
        left = explained(after.left, stand_ins) + [(one, _NO_NUMBER) for one in after.delays]
        changes = [
            *_joints(root, robot, arm, before, after, deviations),
            *_links(root, arm, before, after),
        ]
        if not numbers.elastic:
            springs = [
                one for one in robot_effects(numbers, catalogue) if one.effect.id == "joint_spring"
            ]
            left += [(spring, _NO_NUMBER) for spring in springs]
        if not np.allclose(before.gravity, after.gravity, rtol=0.0, atol=1e-9):
            left.append((_mounting(before.gravity, after.gravity), _MOUNTING))
        _check(document.text(), chain, after)
    write_result(out, document.text())
    as_placed = numbers.with_(base_placement=arm.base_placement)
    listed = [
        *left_effects(as_placed, left, catalogue),
        *_numbers_left(robot, whole, after),
    ]
    told = tuple(one.words(robot) for one in stand_ins)
    return Exported((out,), tuple(changes), tuple(listed), units=robot.units, stand_ins=told)


def _mounting(before: Array, after: Array) -> EffectInstance:
    """Return the tilt of the base under which what is straight down by the file is felt as `after`
    (3,)."""
    if not np.isclose(np.linalg.norm(before), np.linalg.norm(after)):
        raise RobotError(
            "gravity changes, and a URDF does not state it", "Tilt the joint that carries the base"
        )
    return tilt(*tilt_of(after))


def _with_rotors(
    after: StatedArm, arm: Robot, whole: StatedArm, ratios: Mapping[str, Motor]
) -> StatedArm:
    """Return the numbers of the file with the motor inertia of the whole arm, where it can be
    stated.

    Motors that move several joints have none of one joint.
    """
    for i, joint in enumerate(arm.joints):
        _, ratio = ratios.get(joint.name, (None, 1.0))
        armature = whole.joints[i].armature if ratio else 0.0
        after = after.with_joint(i, armature=armature - after.joints[i].armature)
    return after


def _numbers_left(robot: Robot, whole: StatedArm, after: StatedArm) -> Iterator[Left]:
    """Yield motor inertia that the file cannot state, elasticity and controllers."""
    missing = [
        all_of.armature - of_file.armature
        for all_of, of_file in zip(whole.joints, after.joints, strict=True)
    ]
    yield from left_numbers(robot, _NO_NUMBER, armatures=missing, elasticity=True)


def _joints(
    root: Any,
    robot: Robot,
    arm: Robot,
    before: StatedArm,
    after: StatedArm,
    deviations: Deviations | None,
) -> list[Change]:
    changes = []
    ratios = motors(root)
    for (i, field), change in joint_changes(arm, before, after, deviations).items():
        attribute = _ATTRIBUTES.get(field)
        joint = next(e for e in root.findall("joint") if e.get("name") == change.element)
        if field == "zero":
            changes.append(_turned(joint, -change.after[0]))
        if field == "armature":
            gear = robot.joints[i].transmission
            ratio = gear.r_tot if gear is not None else 1.0
            _, stated = ratios.get(change.element, (None, ratio))
            state_rotor(root, change.element, change.after[0], stated)
            changes.append(change)
        if attribute is None:
            continue
        dynamics = joint.find("dynamics")
        if dynamics is None:
            dynamics = append_last(joint, "dynamics")
        dynamics.set(attribute, text_of(change.after[0]))
        changes.append(replace(change, number=attribute))
    return changes


def _turned(joint: Any, by: float) -> Change:
    """Turn, or slide, where a joint stands about its axis, rad or m: the change of its zero."""
    xyz, rpy = _origin(joint)
    axis = joint.find("axis")
    direction = vector("1 0 0" if axis is None else axis.get("xyz", "1 0 0"), "axis")
    direction = direction / np.linalg.norm(direction)
    stands = rotation(*rpy)
    if joint.get("type") == "prismatic":
        number = "origin xyz"
        unit = "m"
        before = xyz
        xyz = xyz + by * stands @ direction
        after = xyz
    else:
        number = "origin rpy"
        unit = "rad"
        before = rpy
        after = rpy = np.array(rpy_of(stands @ Rotation.from_rotvec(by * direction).as_matrix()))
    _child(joint, "origin", xyz=text_of(*xyz), rpy=text_of(*rpy))
    return Change(
        str(joint.get("name")), number, unit, tuple(map(float, before)), tuple(map(float, after))
    )


def _links(root: Any, arm: Robot, before: StatedArm, after: StatedArm) -> list[Change]:
    changes = []
    for i, joint in enumerate(arm.joints):
        if not differs(before.links[i], after.links[i]):
            continue
        link = next(e for e in root.findall("link") if e.get("name") == joint.link_name)
        own = _own(link)
        new = body_after(own, before.links[i], after.links[i], joint.link_name)
        inertial = link.find("inertial")
        if inertial is None:
            inertial = append_last(link, "inertial")
        xx, yy, zz, xy, xz, yz = map(text_of, six(new))
        _child(inertial, "origin", xyz=text_of(*new.com), rpy="0 0 0")
        _child(inertial, "mass", value=text_of(new.mass))
        _child(inertial, "inertia", ixx=xx, ixy=xy, ixz=xz, iyy=yy, iyz=yz, izz=zz)
        changes += inertial_change(joint.link_name, own, new)
    return changes


def _own(link: Any) -> Inertia:
    """Return what a link itself weighs, in its frame."""
    inertial = link.find("inertial")
    if inertial is None:
        return Inertia(0.0)
    mass = float(inertial.find("mass").get("value"))
    values = inertial.find("inertia")
    tensor = tensor_of(float(values.get(key)) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    xyz, rpy = _origin(inertial)
    return moved(Inertia(mass, inertia=nearest_tensor(tensor)[0]), placed(rotation(*rpy), xyz))


def _origin(element: Any) -> tuple[Array, Array]:
    """Return position and angles of an element's origin."""
    origin = element.find("origin")
    stated = [None if origin is None else origin.get(key) for key in ("xyz", "rpy")]
    xyz, rpy = (vector(text or "0 0 0", "origin") for text in stated)
    return xyz, rpy


def _child(parent: Any, tag: str, **attributes: str) -> None:
    child = parent.find(tag)
    if child is None:
        child = append_last(parent, tag)
    for name, value in attributes.items():
        child.set(name, value)


def _check(text: str, chain: Chain | None, wanted: StatedArm) -> None:
    again = stated_arm(parse_urdf(text, chain))
    for i, (read, meant) in enumerate(zip(again.links, wanted.links, strict=True)):
        if not np.allclose(read.mass, meant.mass, rtol=1e-6) or not np.allclose(
            read.com, meant.com, atol=1e-7
        ):
            raise RobotError(
                f"link {i + 1} of the written file is not the intended one",
                "Please report it with the file",
            )
    for i, (own, asked) in enumerate(zip(again.joints, wanted.joints, strict=True)):
        if not np.isclose(own.armature, asked.armature, rtol=1e-6, atol=1e-12):
            raise RobotError(
                f"the motor inertia of joint {i + 1} of the written file is not what was meant",
                "Please report it with the file",
            )
