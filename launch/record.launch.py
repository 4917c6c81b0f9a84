"""A simulated arm follows an excitation and is recorded."""

from launch import LaunchDescription

from elastic_arm.nodes.launching import ARM, EFFECTS, ROBOT, SEED, SIMULATED, TRAJECTORY, scenario


def generate_launch_description() -> LaunchDescription:
    """Simulator, trajectory generator and recorder; all stop when the trajectory has been run."""
    bag = ("recording", "folder to record into; must not exist")
    return scenario(
        {
            "trajectory": TRAJECTORY,
            "bag": bag,
            "robot": ROBOT,
            "effects": EFFECTS,
            "seed": SEED,
            **ARM,
        },
        {
            "recorder": ["bag", "use_sim_time"],
            "simulator": ["robot", "effects", "seed", *SIMULATED],
            "trajectory_generator": ["trajectory", "rate", "use_sim_time"],
        },
    )
