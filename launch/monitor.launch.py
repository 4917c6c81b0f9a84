"""A simulated arm that differs from its model moves, and the gap between the two is diagnosed meanwhile."""

from launch import LaunchDescription

from elastic_arm.nodes.launching import EFFECTS, MODEL, ROBOT, SEED, TRAJECTORY, scenario


def generate_launch_description() -> LaunchDescription:
    """Simulator, trajectory generator and gap monitor; they go on until Ctrl-C."""
    effects = ("['coulomb_friction:joint_2:torque=6.0']", EFFECTS[1])
    repeat = ("0", "how often the trajectory is run; 0: until stopped")
    return scenario(
        {"trajectory": TRAJECTORY, "repeat": repeat, "robot": ROBOT, "model": MODEL, "effects": effects, "seed": SEED},
        {
            "simulator": ["robot", "effects", "seed"],
            "gap_monitor": ["robot", "model"],
            "trajectory_generator": ["trajectory", "repeat"],
        },
    )
