"""A robot from an arm file, or an error with the file, the field, the reason and the remedy."""

import os
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from elastic_arm.errors import RobotError
from elastic_arm.input_files import explain, read_bytes, read_fields
from elastic_arm.robot.arm_file import (
    ArmEntry,
    BaseEntry,
    ComponentEntry,
    ControllerEntry,
    JointEntry,
    LinkEntry,
    OverlayEntry,
    TransmissionEntry,
)
from elastic_arm.robot.description import (
    DH,
    Bearing,
    Component,
    Inertia,
    Joint,
    JointController,
    Limits,
    Robot,
    Transmission,
)
from elastic_arm.robot.parts import located
from elastic_arm.robot.urdf import read_urdf
from elastic_arm.robot.urdf_tree import Chain

NOMINAL_ARM = Path(__file__).parent / "data" / "arm.yaml"

_TRANSMISSION_FIELDS = tuple(name for name in TransmissionEntry.model_fields if name != "bearing")
REMEDY = "Give an arm file, which starts with name, gravity, base and joints, or a URDF."
# What may stand before the first element of XML.
_BEFORE = ((b"<!--", b"-->"), (b"<?", b"?>"), (b"<!DOCTYPE", b">"))
_ELEMENT = re.compile(rb"<([A-Za-z_][\w.-]*)")
REFERENCE = "the nominal arm.yaml shows every field"


def load_robot(
    path: str | Path | None = None, chain: str | None = None, at: str | None = None
) -> Robot:
    """Read a robot description.

    Parameters
    ----------
    path
        An arm file (``.yaml``, ``.yml``), a ``.urdf``, an MJCF (``.xml``), or an overlay: YAML that
        names a ``urdf`` and adds ``transmissions`` and ``limits`` by joint. The nominal
        three-joint arm if None.
    chain
        First and last link of the arm as ``base:tip``, for a URDF or MJCF that contains more than
        the arm.
    at
        Positions of fixed joints outside the chain of an MJCF: a keyframe, or ``joint=value,…``.

    Raises
    ------
    RobotError
        If it cannot be read, or describes a physically impossible arm; names file, field, reason
        and remedy.
    """
    if not isinstance(path, str | Path | None):
        raise RobotError(
            f"path is of type {type(path).__name__}", "Give the name of a description, or None."
        )
    path = NOMINAL_ARM if path is None else Path(path)
    ends = None if chain is None else parse_chain(chain)
    if is_mjcf(path):
        from elastic_arm.robot.mjcf import read_mjcf

        return read_mjcf(path, ends, at)
    if at is not None:
        raise RobotError(f"{path}: at {at} applies only to an MJCF", "Omit it, or give the MJCF.")
    if path.suffix.lower() in (".urdf", ".xml", ".sdf", ".world"):
        return read_urdf(path, ends)
    if path.suffix.lower() == ".xacro":
        urdf = f"{path.name.split('.')[0]}.urdf"
        raise RobotError(
            f"{path} is a xacro and has to be converted to a URDF",
            f"Run: xacro {path} > {urdf}, and give the result.",
        )
    if chain is not None:
        raise RobotError(
            f"{path}: chain {chain} applies only to a URDF or MJCF",
            "Omit it, or give such a file.",
        )
    content = read_fields(path, RobotError, REMEDY)
    try:
        entry = (OverlayEntry if "urdf" in content else ArmEntry).model_validate(content)
    except ValidationError as error:
        problem, remedy = explain(error, REFERENCE)
        raise RobotError(f"{path}: {problem}", remedy) from error
    with located(f"{path}: "):
        return _overlaid(entry, path.parent) if isinstance(entry, OverlayEntry) else _robot(entry)


def is_mjcf(path: Path) -> bool:
    """Return whether a file is a MuJoCo model: XML whose first element is <mujoco>."""
    if path.suffix.lower() not in (".xml", ".mjcf") or not os.path.isfile(path):
        return False
    # Whether the rest is well formed is for MuJoCo to say.
    return _first_element(read_bytes(path, RobotError, REMEDY)) in (b"mujoco", b"mujocoinclude")


def _first_element(content: bytes) -> bytes:
    """Return the name of the first element of XML; nothing where there is none. Every byte is
    looked at once."""
    at = content.find(b"<")
    while at >= 0:
        if (match := _ELEMENT.match(content, at)) is not None:
            return match[1]
        ends = [end for begin, end in _BEFORE if content.startswith(begin, at)]
        behind = content.find(ends[0], at) if ends else at
        at = content.find(b"<", behind + 1) if behind >= 0 else -1
    return b""


def _robot(entry: ArmEntry) -> Robot:
    link_names = [j.link.name or f"link_{i + 1}" for i, j in enumerate(entry.joints)]
    joints = []
    for i, joint in enumerate(entry.joints):
        with located(f"joints[{i}]."):
            joints.append(_joint(joint, link_names[i]))
    with located("base."):
        base_dh, base_placement = _base(entry.base)
    robot = Robot(
        name=entry.name,
        joints=tuple(joints),
        gravity=np.array(entry.gravity),
        base_placement=base_placement,
        base_mass=entry.base.mass,
        base_dh=base_dh,
        total_ratios_studied=dict(entry.total_ratios_studied),
        torque_noise_std=entry.torque_noise_std,
        sample_rate=entry.sample_rate,
        effects=tuple(e.model_dump() for e in entry.effects),
    )
    return _controlled(robot, entry.controller)


def _controlled(robot: Robot, entries: Mapping[str, ControllerEntry]) -> Robot:
    for name, entry in entries.items():
        with located(f"controller.{name}: "):
            robot = robot.with_joint(name, controller=JointController(**entry.numbers()))
    return robot


def _overlaid(entry: OverlayEntry, folder: Path) -> Robot:
    """Return the URDF's robot with what the overlay adds; limits that it does not state stay the
    URDF's."""
    robot = read_urdf(
        folder / entry.urdf, None if entry.chain is None else parse_chain(entry.chain)
    )
    for name in entry.transmissions:
        if name not in robot.joint_names:
            known = ", ".join(robot.joint_names)
            raise RobotError(
                f"transmissions.{name}: the URDF has no such joint", f"Use one of {known}."
            )
    joints = []
    for joint in robot.joints:
        with located(f"transmissions.{joint.name}."):
            given = entry.transmissions.get(joint.name)
            gear = None if given is None else _transmission(given)
            # The rotor of a transmission holds the motor's inertia.
            joints.append(
                replace(joint, transmission=gear, armature=joint.armature if gear is None else None)
            )
    robot = robot.with_(joints=tuple(joints))
    for name, armature in entry.armature.items():
        with located(f"armature.{name}: "):
            if name in entry.transmissions:
                problem = "the joint has a transmission, whose rotor is its motor"
                raise RobotError(problem, "State the inertia there, as izz of the rotor")
            robot = robot.with_joint(name, armature=armature)
    for name, limits in entry.limits.items():
        with located(f"limits.{name}: "):
            stated = limits.model_dump(exclude_unset=True)
            changed = [joint.limits for joint in robot.joints if joint.name == name]
            robot = robot.with_joint(
                name, limits=replace(changed[0], **stated) if changed else Limits(**stated)
            )
    others = entry.model_dump(
        exclude={"urdf", "chain", "transmissions", "armature", "limits", "controller"},
        exclude_none=True,
    )
    notes = tuple(
        note for note in robot.notes if not (robot.elastic and note.startswith("<transmission>"))
    )
    return _controlled(robot.with_(**others, notes=notes), entry.controller)


def parse_chain(text: str) -> Chain:
    """Return the names of base and tip."""
    first, colon, last = text.partition(":")
    if not (first and colon and last):
        raise RobotError(
            f"chain is {text!r}", "Give the first and last link of the arm as base:tip."
        )
    return first, last


def _base(entry: BaseEntry) -> tuple[DH | None, np.ndarray]:
    row = (entry.a, entry.d, entry.alpha, entry.offset)
    if entry.placement is not None:
        if any(number is not None for number in row):
            raise RobotError("placement: conflicts with a, d, alpha or offset", "Keep one of them")
        return None, np.array(entry.placement)
    dh = DH(*(0.0 if number is None else number for number in row))
    return dh, dh.placement


def _joint(entry: JointEntry, link_name: str) -> Joint:
    with located("link."):
        link = _inertia(entry.link)
    transmission = _transmission(entry)
    with located("limits."):
        limits = Limits(**entry.limits.model_dump())
    placed = entry.before is not None or entry.after is not None
    if (entry.dh is not None) == placed:
        raise RobotError(
            "dh: conflicts with before or after" if placed else "dh: missing field",
            "Place the joint by a dh row, or by the 4x4 matrices before and after",
        )
    rest: dict[str, Any] = {
        "limits": limits,
        "transmission": transmission,
        "armature": entry.armature,
    }
    rest["prismatic"] = entry.type == "prismatic"
    if entry.dh is not None:
        return Joint.from_dh(entry.name, link_name, link, DH(**entry.dh.model_dump()), **rest)
    for what in ("before", "after"):
        if getattr(entry, what) is not None:
            rest[what] = np.array(getattr(entry, what))
    return Joint(entry.name, link_name, link, **rest)


def _inertia(entry: LinkEntry) -> Inertia:
    i = entry.inertia
    tensor = np.array([[i.xx, i.xy, i.xz], [i.xy, i.yy, i.yz], [i.xz, i.yz, i.zz]])
    return Inertia(entry.mass, np.array(entry.com), tensor)


def _transmission(entry: TransmissionEntry) -> Transmission | None:
    given = [
        name for name in (*_TRANSMISSION_FIELDS, "bearing") if getattr(entry, name) is not None
    ]
    missing = [name for name in _TRANSMISSION_FIELDS if getattr(entry, name) is None]
    if not given:
        return None
    if missing:
        raise RobotError(
            f"{', '.join(missing)}: missing field ({given[0]} is present)",
            "Describe the whole transmission, or omit it",
        )
    parts: dict[str, Any] = {name: getattr(entry, name) for name in _TRANSMISSION_FIELDS}
    for name, part in parts.items():
        if isinstance(part, ComponentEntry):
            with located(f"{name}."):
                parts[name] = _component(part)
    if entry.bearing is not None:
        with located("bearing."):
            parts["bearing"] = Bearing(entry.bearing.stiffness, entry.bearing.damping)
    return Transmission(**parts)


def _component(entry: ComponentEntry) -> Component:
    return Component(
        entry.mass, entry.ixx, entry.izz, entry.carrier, np.array(entry.position), entry.kind
    )
