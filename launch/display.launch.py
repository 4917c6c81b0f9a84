"""A simulated arm follows an excitation and is shown in RViz; needs robot_state_publisher and
rviz2."""

from launch import LaunchContext, LaunchDescription
from launch.actions import OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from elastic_arm.nodes.launching import NAMESPACE, PACKAGE, ROBOT, TRAJECTORY, arm_node, declared
from elastic_arm.nodes.support.description import ros_description
from elastic_arm.robot import load_robot


def generate_launch_description() -> LaunchDescription:
    """Simulator, trajectory generator, robot_state_publisher and RViz; all stop with the first that
    does."""
    arguments = {
        "trajectory": TRAJECTORY,
        "repeat": ("0", "how often the trajectory is run; 0: until stopped"),
        "robot": ROBOT,
        "namespace": NAMESPACE,
        "rviz": ("true", "whether to start RViz"),
    }
    namespace = LaunchConfiguration("namespace")
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        namespace=namespace,
        arguments=["-d", [FindPackageShare(PACKAGE), "/layouts/display.rviz"]],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    return LaunchDescription(
        [
            *declared(arguments),
            arm_node("simulator", ["robot"], namespace),
            arm_node("trajectory_generator", ["trajectory", "repeat"], namespace),
            OpaqueFunction(function=_state_publisher),
            rviz,
        ]
    )


def _state_publisher(context: LaunchContext) -> list[Node]:
    """Return what makes transforms of joint states; the simulator publishes the description
    itself."""
    robot, namespace = (
        LaunchConfiguration(name).perform(context) for name in ("robot", "namespace")
    )
    description = ros_description(load_robot(robot or None), namespace)
    prefix = f"{namespace.strip('/')}/" if namespace.strip("/") else ""
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            namespace=namespace,
            parameters=[{"robot_description": description, "frame_prefix": prefix}],
            remappings=[("robot_description", "~/robot_description")],
        )
    ]
