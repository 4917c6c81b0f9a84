"""A simulated arm follows an excitation and is identified while it moves."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = {
    "trajectory": ([FindPackageShare("elastic_arm"), "/config/excitation.yaml"], "file made by `elastic-arm excite`"),
    "robot": ("", "arm file or URDF; empty: the arm of the package"),
    "model": ("mod3", "mod1, mod2 or mod3, of the arm and of the identification"),
    "seed": ("1", "of the sensors' noise"),
}


def node(executable, parameters):
    """One of the package's nodes; when it stops, the others have no more to do."""
    return Node(
        package="elastic_arm", executable=executable, parameters=parameters, output="screen", on_exit=[Shutdown()]
    )


def generate_launch_description() -> LaunchDescription:
    """Simulator, trajectory generator and identifier; all stop when the trajectory has been run."""
    defaults = [FindPackageShare("elastic_arm"), "/config/elastic_arm.yaml"]
    robot = {"robot": LaunchConfiguration("robot"), "model": LaunchConfiguration("model")}
    seed = {"seed": ParameterValue(LaunchConfiguration("seed"), value_type=int)}
    trajectory = {"trajectory": LaunchConfiguration("trajectory")}
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(n, default_value=d, description=text) for n, (d, text) in ARGUMENTS.items()),
            node("simulator", [defaults, robot, seed]),
            node("identifier", [defaults, robot]),
            node("trajectory_generator", [defaults, trajectory]),
        ]
    )
