"""What the launch files have in common: arguments with words, and nodes of which the first to end ends the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = "elastic_arm"
EXCITATION = [FindPackageShare(PACKAGE), "/config/excitation.yaml"]
# Arguments that several launch files have: default and words.
TRAJECTORY = (EXCITATION, "file made by `elastic-arm excite`")
ROBOT = ("", "nominal arm: file (YAML) or URDF; empty: the arm of the package")
MODEL = ("mod3", "mod1, mod2 or mod3")
SEED = ("1", "of the sensors' noise")
EFFECTS = ("['']", "what the arm has more than the model, such as ['coulomb_friction:joint_2:torque=13.9']")
# What the arguments are that are no texts.
TYPES = {"seed": int, "repeat": int, "rate": float, "effects": list[str]}


def scenario(arguments: Mapping[str, tuple[Any, str]], nodes: Mapping[str, Sequence[str]]) -> LaunchDescription:
    """Return a launch of some nodes, all of which stop with the first that does.

    Parameters
    ----------
    arguments
        Default (None: it has to be given) and words of each.
    nodes
        For each node the arguments that it takes as parameters; the others are those of `config/elastic_arm.yaml`.
    """
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(n, default_value=given, description=text)
                for n, (given, text) in arguments.items()
            ),
            *(_node(name, taken) for name, taken in nodes.items()),
        ]
    )


def _node(name: str, taken: Sequence[str]) -> Node:
    defaults = [FindPackageShare(PACKAGE), "/config/elastic_arm.yaml"]
    given = {argument: _value(argument) for argument in taken}
    return Node(package=PACKAGE, executable=name, parameters=[defaults, given], output="screen", on_exit=[Shutdown()])


def _value(argument: str) -> Any:
    value = LaunchConfiguration(argument)
    return ParameterValue(value, value_type=TYPES[argument]) if argument in TYPES else value
