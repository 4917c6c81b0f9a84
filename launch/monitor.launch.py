"""A simulated arm that differs from its model moves, and the gap between the two is diagnosed
meanwhile."""

from launch import LaunchDescription

from elastic_arm.nodes.launching import (
    ARM,
    EFFECTS,
    MODEL,
    ROBOT,
    SEED,
    SIMULATED,
    TRAJECTORY,
    scenario,
)


def generate_launch_description() -> LaunchDescription:
    """Simulator, trajectory generator and gap monitor; they go on until Ctrl-C."""
    own = {
        "repeat": ("0", "how often the trajectory is run; 0: until stopped"),
        "effects": ("['coulomb_friction:joint_2:torque=6.0']", EFFECTS[1]),
    }
    return scenario(
        {"trajectory": TRAJECTORY, "robot": ROBOT, "model": MODEL, "seed": SEED, **own, **ARM},
        {
            "simulator": ["robot", "effects", "seed", *SIMULATED],
            "gap_monitor": ["robot", "model", "use_sim_time"],
            "trajectory_generator": ["trajectory", "repeat", "rate", "use_sim_time"],
        },
    )
