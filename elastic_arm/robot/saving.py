"""The arm file of a robot, which loads to the same robot."""

from pathlib import Path
from typing import Any

import numpy as np

from elastic_arm.errors import RobotError
from elastic_arm.output_files import plain, write_result, yaml_text
from elastic_arm.robot.description import Component, Joint, Robot, Transmission


def save_robot(robot: Robot, path: str | Path) -> None:
    """Write `robot` as an arm file.

    :func:`elastic_arm.robot.load_robot` reads it back to the same robot.

    Raises
    ------
    RobotError
        If the file cannot be written.
    """
    text = yaml_text(robot_to_dict(robot), default_flow_style=None)
    write_result(path, text, RobotError, "Give a writable folder")


def robot_to_dict(robot: Robot) -> dict[str, Any]:
    """Return the content of the arm file as plain data: equal for equal robots."""
    base: dict[str, Any] = {"mass": float(robot.base_mass)}
    if robot.base_dh is not None and np.array_equal(robot.base_dh.placement, robot.base_placement):
        base |= _floats(vars(robot.base_dh))
    else:
        base["placement"] = robot.base_placement.tolist()
    ratios = {total: list(map(float, split)) for total, split in robot.total_ratios_studied.items()}
    content: dict[str, Any] = {
        "name": robot.name,
        "gravity": robot.gravity.tolist(),
        "base": base,
        "joints": [_joint(j) for j in robot.joints],
        "total_ratios_studied": ratios,
        "torque_noise_std": float(robot.torque_noise_std),
        "sample_rate": float(robot.sample_rate),
    }
    if robot.effects:
        content["effects"] = [plain(effect) for effect in robot.effects]
    controllers = {}
    for joint in robot.joints:
        if joint.controller is not None:
            fields = vars(joint.controller)
            controllers[joint.name] = {k: v for k, v in fields.items() if v is not None}
    if controllers:
        content["controller"] = plain(controllers)
    return content


def _floats(numbers: dict[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in numbers.items() if value is not None}


def _joint(joint: Joint) -> dict[str, Any]:
    content: dict[str, Any] = {"name": joint.name}
    if joint.prismatic:
        content["type"] = "prismatic"
    by_row = joint.dh is not None and np.array_equal(joint.dh.placement, joint.after)
    if joint.dh is not None and by_row and np.array_equal(joint.before, np.eye(4)):
        content["dh"] = _floats(vars(joint.dh))
    else:
        content |= {"before": joint.before.tolist(), "after": joint.after.tolist()}
    t = joint.link.inertia
    names = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
    content["link"] = {
        "name": joint.link_name,
        "mass": float(joint.link.mass),
        "com": joint.link.com.tolist(),
        "inertia": {name: float(t[index]) for name, index in names.items()},
    }
    if joint.transmission is not None:
        content |= _transmission(joint.transmission)
    if joint.armature is not None:
        content["armature"] = float(joint.armature)
    limits = _floats(vars(joint.limits))
    if limits:
        content["limits"] = limits
    return content


def _transmission(transmission: Transmission) -> dict[str, Any]:
    content: dict[str, Any] = {
        name: _component(c) for name, (c, _) in transmission.components.items()
    }
    content |= {"stiffness": float(transmission.stiffness), "damping": float(transmission.damping)}
    if transmission.bearing is not None:
        content["bearing"] = _floats(vars(transmission.bearing))
    ratios = {
        "belt_ratio": transmission.belt_ratio,
        "harmonic_drive_ratio": transmission.harmonic_drive_ratio,
    }
    return content | _floats(ratios)


def _component(component: Component) -> dict[str, Any]:
    content: dict[str, Any] = _floats(
        {"mass": component.mass, "izz": component.izz, "ixx": component.ixx}
    )
    content |= {
        "carrier": component.carrier,
        "position": component.position.tolist(),
        "frame": "joint",
    }
    return content if component.kind is None else content | {"kind": component.kind}
