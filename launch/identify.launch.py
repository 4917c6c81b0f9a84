"""A simulated arm follows an excitation and is identified while it moves."""

from launch import LaunchDescription

from elastic_arm.nodes.launching import (
    ARM,
    MODEL,
    ROBOT,
    SAVED,
    SEED,
    SIMULATED,
    TRAJECTORY,
    scenario,
)


def generate_launch_description() -> LaunchDescription:
    """Simulator, trajectory generator, identifier; they stop after the trajectory; the result is
    printed and saved."""
    return scenario(
        {"trajectory": TRAJECTORY, "robot": ROBOT, "model": MODEL, "seed": SEED, **SAVED, **ARM},
        {
            "simulator": ["robot", "model", "seed", *SIMULATED],
            "identifier": ["robot", "model", "save_to", "save_at_exit", "use_sim_time"],
            "trajectory_generator": ["trajectory", "rate", "use_sim_time"],
        },
    )
