"""A simulated arm follows an excitation and is recorded."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = {
    "trajectory": ([FindPackageShare("elastic_arm"), "/config/excitation.yaml"], "file made by `elastic-arm excite`"),
    "bag": ("recording", "folder to record into; must not exist"),
    "robot": ("", "arm file or URDF; empty: the arm of the package"),
    "effects": ("['']", "effects of the arm, such as ['coulomb_friction:joint_2:torque=13.9']"),
    "seed": ("1", "of the sensors' noise"),
}


def node(executable, parameters):
    """One of the package's nodes; when it stops, the others have no more to do."""
    return Node(
        package="elastic_arm", executable=executable, parameters=parameters, output="screen", on_exit=[Shutdown()]
    )


def generate_launch_description() -> LaunchDescription:
    """Simulator, trajectory generator and recorder; all stop when the trajectory has been run."""
    defaults = [FindPackageShare("elastic_arm"), "/config/elastic_arm.yaml"]
    arm = {
        "robot": LaunchConfiguration("robot"),
        "effects": ParameterValue(LaunchConfiguration("effects"), value_type=list[str]),
        "seed": ParameterValue(LaunchConfiguration("seed"), value_type=int),
    }
    trajectory = {"trajectory": LaunchConfiguration("trajectory")}
    bag = {"bag": LaunchConfiguration("bag")}
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(n, default_value=d, description=text) for n, (d, text) in ARGUMENTS.items()),
            node("recorder", [defaults, bag]),
            node("simulator", [defaults, arm]),
            node("trajectory_generator", [defaults, trajectory]),
        ]
    )
