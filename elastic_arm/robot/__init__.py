"""The arm as data: arm file and URDF in and out."""

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
    require_robot,
)
from elastic_arm.robot.exchange import with_joints_of
from elastic_arm.robot.loading import load_robot
from elastic_arm.robot.saving import robot_to_dict, save_robot
from elastic_arm.robot.urdf import parse_urdf
from elastic_arm.robot.urdf_export import to_urdf

__all__ = [
    "DH",
    "Bearing",
    "Component",
    "Inertia",
    "Joint",
    "JointController",
    "Limits",
    "Robot",
    "Transmission",
    "load_robot",
    "parse_urdf",
    "require_robot",
    "robot_to_dict",
    "save_robot",
    "to_urdf",
    "with_joints_of",
]
