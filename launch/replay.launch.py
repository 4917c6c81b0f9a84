"""A recorded arm is identified again, live, from its bag."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = {
    "bag": (None, "rosbag2 folder or .mcap file"),
    "rate": ("1.0", "times the speed of the recording"),
    "robot": ("", "nominal arm file or URDF; empty: the arm of the package"),
    "model": ("mod3", "mod1, mod2 or mod3"),
}


def node(executable, parameters):
    """One of the package's nodes; when it stops, the others have no more to do."""
    return Node(
        package="elastic_arm", executable=executable, parameters=parameters, output="screen", on_exit=[Shutdown()]
    )


def generate_launch_description() -> LaunchDescription:
    """Replayer and identifier; both stop at the end of the bag."""
    defaults = [FindPackageShare("elastic_arm"), "/config/elastic_arm.yaml"]
    robot = {"robot": LaunchConfiguration("robot"), "model": LaunchConfiguration("model")}
    bag = {"bag": LaunchConfiguration("bag"), "rate": ParameterValue(LaunchConfiguration("rate"), value_type=float)}
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(n, default_value=d, description=text) for n, (d, text) in ARGUMENTS.items()),
            node("identifier", [defaults, robot]),
            node("replayer", [defaults, bag]),
        ]
    )
