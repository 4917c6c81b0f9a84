"""An arm in which some joints are those of another one."""

from collections.abc import Collection
from typing import Any

from elastic_arm.robot.description import Robot


def with_joints_of(robot: Robot, other: Robot, names: Collection[str]) -> Robot:
    """Return an arm with some joints of another arm.

    Links, controllers and effects of these joints come along.

    names: of these joints; other names change nothing. Both arms have the same joints.
    """

    def of_these(effect: Any) -> bool:
        return effect["joint"] in names

    pairs = zip(robot.joints, other.joints, strict=True)
    joints = [theirs if own.name in names else own for own, theirs in pairs]
    kept = [effect for effect in robot.effects if not of_these(effect)]
    added = [effect for effect in other.effects if of_these(effect)]
    return robot.with_(joints=tuple(joints), effects=(*kept, *added))
