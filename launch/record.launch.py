"""A simulated arm follows an excitation and is recorded."""

from launch import LaunchDescription

from elastic_arm.nodes.launching import EFFECTS, ROBOT, SEED, TRAJECTORY, scenario


def generate_launch_description() -> LaunchDescription:
    """Simulator, trajectory generator and recorder; all stop when the trajectory has been run."""
    bag = ("recording", "folder to record into; must not exist")
    return scenario(
        {"trajectory": TRAJECTORY, "bag": bag, "robot": ROBOT, "effects": EFFECTS, "seed": SEED},
        {
            "recorder": ["bag"],
            "simulator": ["robot", "effects", "seed"],
            "trajectory_generator": ["trajectory"],
        },
    )
