"""A simulated arm follows an excitation and is identified while it moves."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, RegisterEventHandler, Shutdown
from launch.event_handlers import OnProcessExit
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = {
    "trajectory": (None, "trajectory file, made by `elastic-arm excite`"),
    "robot": ("", "arm file or URDF; empty: the arm of the package"),
    "model": ("mod3", "mod1, mod2 or mod3, of the arm and of the identification"),
    "seed": ("1", "of the sensors' noise"),
}


def generate_launch_description() -> LaunchDescription:
    """Simulator, trajectory generator and identifier; all stop when the trajectory has been run."""
    defaults = [FindPackageShare("elastic_arm"), "/config/elastic_arm.yaml"]
    robot = {"robot": LaunchConfiguration("robot"), "model": LaunchConfiguration("model")}
    seed = {"seed": ParameterValue(LaunchConfiguration("seed"), value_type=int)}
    trajectory = {"trajectory": LaunchConfiguration("trajectory")}
    generator = Node(package="elastic_arm", executable="trajectory_generator", parameters=[defaults, trajectory])
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(n, default_value=d, description=text) for n, (d, text) in ARGUMENTS.items()),
            Node(package="elastic_arm", executable="simulator", parameters=[defaults, robot, seed], output="screen"),
            Node(package="elastic_arm", executable="identifier", parameters=[defaults, robot], output="screen"),
            generator,
            RegisterEventHandler(OnProcessExit(target_action=generator, on_exit=[Shutdown()])),
        ]
    )
