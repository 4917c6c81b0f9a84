"""A simulated arm follows an excitation and is identified while it moves."""

from launch import LaunchDescription

from elastic_arm.nodes.launching import MODEL, ROBOT, SEED, TRAJECTORY, scenario


def generate_launch_description() -> LaunchDescription:
    """Simulator, trajectory generator and identifier; all stop when the trajectory has been run."""
    return scenario(
        {"trajectory": TRAJECTORY, "robot": ROBOT, "model": MODEL, "seed": SEED},
        {
            "simulator": ["robot", "model", "seed"],
            "identifier": ["robot", "model"],
            "trajectory_generator": ["trajectory"],
        },
    )
