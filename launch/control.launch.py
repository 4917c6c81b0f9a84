"""Controllers drive a simulated arm; needs ros-jazzy-ros2-control, -ros2-controllers,
-topic-based-ros2-control."""

import tempfile
from pathlib import Path

import yaml
from launch import LaunchContext, LaunchDescription
from launch.actions import OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from elastic_arm.nodes.launching import ARM, EFFECTS, NAMESPACE, ROBOT, SEED, arm_node, declared
from elastic_arm.robot import load_robot

CONTROLLER = "joint_trajectory_controller"


def generate_launch_description() -> LaunchDescription:
    """Simulator, controller manager, and a joint_trajectory_controller; they go on until Ctrl-C."""
    arguments = {"robot": ROBOT, "effects": EFFECTS, "seed": SEED, "namespace": NAMESPACE}
    arguments |= {name: ARM[name] for name in ("rate", "torque_noise")}
    arguments["control_rate"] = ("100", "cycles of the controllers a second")
    taken = ["robot", "effects", "seed", "rate", "torque_noise"]
    return LaunchDescription(
        [
            *declared(arguments),
            arm_node("simulator", taken, LaunchConfiguration("namespace")),
            OpaqueFunction(function=_controllers),
        ]
    )


def _controllers(context: LaunchContext) -> list[Node]:
    """Return the controller manager, and what loads the controller with the joints of the arm."""
    given = {
        name: LaunchConfiguration(name).perform(context)
        for name in ("robot", "namespace", "control_rate")
    }
    robot, namespace = load_robot(given["robot"] or None), given["namespace"]
    of_arm = {
        "joints": list(robot.joint_names),
        "command_interfaces": ["position", "velocity"],
        "state_interfaces": ["position", "velocity"],
    }
    file = Path(tempfile.mkdtemp(prefix="elastic_arm_")) / "controllers.yaml"
    file.write_text(yaml.safe_dump({f"/**/{CONTROLLER}": {"ros__parameters": of_arm}}))
    kind = f"{CONTROLLER}/JointTrajectoryController"
    manager = {"update_rate": int(given["control_rate"]), f"{CONTROLLER}.type": kind}
    return [
        Node(
            package="controller_manager",
            executable="ros2_control_node",
            namespace=namespace,
            # It reads the description that the simulator publishes.
            parameters=[manager],
            output="screen",
        ),
        Node(
            package="controller_manager",
            executable="spawner",
            namespace=namespace,
            arguments=[
                CONTROLLER,
                "--param-file",
                str(file),
                "--controller-manager",
                "controller_manager",
            ],
            output="screen",
        ),
    ]
