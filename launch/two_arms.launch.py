"""Two simulated arms in the namespaces of their names follow an excitation, each recorded into a
bag."""

from launch import LaunchDescription

from elastic_arm.nodes.launching import EFFECTS, ROBOT, TRAJECTORY, arm_node, declared, last_of

ARMS = ("left", "right")


def generate_launch_description() -> LaunchDescription:
    """For each arm simulator, trajectory generator and recorder; all stop when both have run the
    trajectory."""
    arguments = {"trajectory": TRAJECTORY, "robot": ROBOT}
    nodes = []
    ended = last_of(len(ARMS))
    for number, arm in enumerate(ARMS, 1):
        arguments[f"{arm}_effects"] = (EFFECTS[0], f"{arm} arm: {EFFECTS[1]}")
        arguments[f"{arm}_seed"] = (str(number), f"of the noise of the {arm} arm's sensors")
        arguments[f"{arm}_bag"] = (
            f"recording_{arm}",
            f"folder to record the {arm} arm into; must not exist",
        )
        renamed = {name: f"{arm}_{name}" for name in ("effects", "seed", "bag")}
        nodes += [
            arm_node("recorder", ["bag"], arm, renamed),
            arm_node("simulator", ["robot", "effects", "seed"], arm, renamed),
            arm_node("trajectory_generator", ["trajectory"], arm, on_exit=ended),
        ]
    return LaunchDescription([*declared(arguments), *nodes])
