"""A recorded arm is identified again, live, from its bag."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, RegisterEventHandler, Shutdown
from launch.event_handlers import OnProcessExit
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


def generate_launch_description() -> LaunchDescription:
    """Replayer and identifier; both stop at the end of the bag."""
    defaults = [FindPackageShare("elastic_arm"), "/config/elastic_arm.yaml"]
    robot = {"robot": LaunchConfiguration("robot"), "model": LaunchConfiguration("model")}
    bag = {"bag": LaunchConfiguration("bag"), "rate": ParameterValue(LaunchConfiguration("rate"), value_type=float)}
    replayer = Node(package="elastic_arm", executable="replayer", parameters=[defaults, bag], output="screen")
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(n, default_value=d, description=text) for n, (d, text) in ARGUMENTS.items()),
            Node(package="elastic_arm", executable="identifier", parameters=[defaults, robot], output="screen"),
            replayer,
            RegisterEventHandler(OnProcessExit(target_action=replayer, on_exit=[Shutdown()])),
        ]
    )
