"""Common parts of the launch files: arguments with descriptions, and nodes of which the first to
end stops the others."""

from collections.abc import Mapping, Sequence
from typing import Any

from launch import Action, LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = "elastic_arm"
EXCITATION = [FindPackageShare(PACKAGE), "/config/excitation.yaml"]
# Arguments that several launch files have: default and words.
TRAJECTORY = (EXCITATION, "trajectory file from `elastic-arm excite`")
ROBOT = ("", "nominal arm: file (YAML) or URDF; empty: the arm of the package")
MODEL = ("mod3", "mod1, mod2 or mod3")
SEED = ("1", "seed of the sensor noise")
EFFECTS = (
    "['']",
    "effects of the true arm, such as ['coulomb_friction:joint_2:torque=13.9']",
)
NAMESPACE = ("", "namespace of all nodes: left for /left/joint_states and so on")
SAVED = {
    "save_to": ("identified", "folder for identification.json"),
    "save_at_exit": ("true", "whether the result is printed and saved at the end"),
}
# Those of a simulated arm: of the simulator, and what the other nodes make of them.
ARM = {
    "rate": ("1000.0", "samples and reference points per second"),
    "real_time_factor": (
        "1.0",
        "simulated time per real time; with a value other than 1: with /clock",
    ),
    "torque_noise": ("0.26", "standard deviation of the torque sensors, Nm"),
    "use_sim_time": (
        PythonExpression(
            ["'false' if float('", LaunchConfiguration("real_time_factor"), "') == 1.0 else 'true'"]
        ),
        "whether the other nodes use /clock; by default if the arm publishes it",
    ),
}
SIMULATED = ("rate", "real_time_factor", "torque_noise")
# What the arguments are that are no texts.
TYPES = {
    "seed": int,
    "repeat": int,
    "rate": float,
    "real_time_factor": float,
    "torque_noise": float,
    "use_sim_time": bool,
    "save_at_exit": bool,
    "effects": list[str],
}


def scenario(
    arguments: Mapping[str, tuple[Any, str]], nodes: Mapping[str, Sequence[str]]
) -> LaunchDescription:
    """Return a launch of some nodes, all of which stop with the first that does.

    arguments: default (None: it has to be given) and words of each; `namespace` is added; nodes:
    for each node the arguments that it takes as parameters; the others are those of
    `config/elastic_arm.yaml`.
    """
    namespace = LaunchConfiguration("namespace")
    return LaunchDescription(
        [
            *declared({**arguments, "namespace": NAMESPACE}),
            *(arm_node(name, nodes[name], namespace) for name in nodes),
        ]
    )


def declared(arguments: Mapping[str, tuple[Any, str]]) -> list[DeclareLaunchArgument]:
    """Return declarations of arguments, each with its default and description.

    An argument with the default None has to be given.
    """
    return [
        DeclareLaunchArgument(name, default_value=given, description=text)
        for name, (given, text) in arguments.items()
    ]


def arm_node(
    name: str,
    taken: Sequence[str],
    namespace: Any,
    renamed: Mapping[str, str] | None = None,
    on_exit: Action | None = None,
) -> Node:
    """Return a node of the package.

    taken: arguments of the launch that it takes as parameters; renamed: parameters that have
    another name among the arguments; on_exit: what happens when it ends; the launch ends as well by
    default.
    """
    defaults = [FindPackageShare(PACKAGE), "/config/elastic_arm.yaml"]
    given = {
        parameter: _value(parameter, (renamed or {}).get(parameter, parameter))
        for parameter in taken
    }
    return Node(
        package=PACKAGE,
        executable=name,
        namespace=namespace,
        parameters=[defaults, given],
        output="screen",
        on_exit=[on_exit or Shutdown()],
    )


def last_of(count: int) -> Action:
    """Return an action that ends the launch when it is called for the last of `count` nodes."""
    ended = iter(range(1, count + 1))

    def end(context: LaunchContext) -> list[Action]:
        return [Shutdown()] if next(ended) == count else []

    return OpaqueFunction(function=end)


def _value(parameter: str, argument: str) -> Any:
    value = LaunchConfiguration(argument)
    return ParameterValue(value, value_type=TYPES[parameter]) if parameter in TYPES else value
