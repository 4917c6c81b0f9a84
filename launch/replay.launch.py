"""A recorded arm is identified again, live, from its bag."""

from launch import LaunchDescription

from elastic_arm.nodes.launching import MODEL, ROBOT, scenario


def generate_launch_description() -> LaunchDescription:
    """Replayer and identifier; both stop at the end of the bag."""
    bag = (None, "rosbag2 folder or .mcap file")
    rate = ("1.0", "times the speed of the recording")
    clock = ("true", "whether the identifier goes by the replayer's /clock")
    return scenario(
        {"bag": bag, "rate": rate, "robot": ROBOT, "model": MODEL, "use_sim_time": clock},
        {"identifier": ["robot", "model", "use_sim_time"], "replayer": ["bag", "rate"]},
    )
