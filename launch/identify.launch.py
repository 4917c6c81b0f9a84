"""A simulated arm follows an excitation and is identified while it moves."""

from launch import LaunchDescription

from elastic_arm.nodes.launching import ARM, MODEL, ROBOT, SEED, SIMULATED, TRAJECTORY, scenario


def generate_launch_description() -> LaunchDescription:
    """Simulator, trajectory generator and identifier; all stop when the trajectory has been run."""
    return scenario(
        {"trajectory": TRAJECTORY, "robot": ROBOT, "model": MODEL, "seed": SEED, **ARM},
        {
            "simulator": ["robot", "model", "seed", *SIMULATED],
            "identifier": ["robot", "model", "use_sim_time"],
            "trajectory_generator": ["trajectory", "rate", "use_sim_time"],
        },
    )
