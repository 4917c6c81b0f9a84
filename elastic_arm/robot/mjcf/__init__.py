"""The arm in a MuJoCo model (MJCF)."""

from elastic_arm.robot.mjcf.engine import engine
from elastic_arm.robot.mjcf.reading import MjcfArm, open_mjcf, read_mjcf

__all__ = ["MjcfArm", "engine", "open_mjcf", "read_mjcf"]
