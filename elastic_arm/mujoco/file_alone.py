"""The file of a corrected servo arm as its users load it: without what no number of it states.

Friction laws by step, a dead band, an integral and a supply that sags are in robot.yaml alone.
Where a joint has any of them, the numbers that the file does hold are fitted for the file as it is:

    kp and kd, kd, armature, dry friction, viscous friction

They start from the arm with its laws, with friction loss and damping in the place of its laws. Each
is as far from there as a description ordinarily is, and friction as far as its own size.
"""

from collections.abc import Iterator, Sequence

from elastic_arm.diagnosis.words import listed
from elastic_arm.evidence.priors import Priors
from elastic_arm.mujoco.closed_loop import beside_actuators, with_controllers
from elastic_arm.mujoco.left_out import Left
from elastic_arm.mujoco.refinable import FRICTION, Moved, Refinable, by_words
from elastic_arm.mujoco.servo_numbers import within_prior
from elastic_arm.robot import Robot
from elastic_arm.robot.mjcf import MjcfArm

DRY, VISCOUS = "coulomb_friction", "viscous_friction"


def unstated(arm: MjcfArm, robot: Robot) -> tuple[str, ...]:
    """Return the joints of a robot of which its file, opened, does not state all that acts in
    closed loop."""
    whole = with_controllers(arm, robot)
    beside = beside_actuators(whole)
    for law in whole.laws:
        beside[list(law.joint_indices(robot))] = True
    return tuple(name for name, more in zip(robot.joint_names, beside, strict=True) if more)


def file_numbers(robot: Robot, joints: Sequence[str]) -> tuple[Refinable, ...]:
    """Return the numbers of some joints that a file states, to be fitted; robot: as read of it."""
    return tuple(number for name in joints for number in _numbers(robot, name))


def _numbers(robot: Robot, name: str) -> Iterator[Refinable]:
    priors = Priors()
    joint = robot.joints[robot.joint_names.index(name)]
    if joint.controller is None:
        return
    yield within_prior("scale", name, priors.controller)
    if joint.controller.kd:
        yield within_prior("kd", name, priors.gain_ratio)
    if joint.armature:
        yield within_prior("armature", name, priors.rotor)
    for effect in robot.effects:
        if effect["effect"] in (DRY, VISCOUS) and effect["joint"] == name:
            size = float(effect["parameters"][FRICTION[effect["effect"]]])
            if size > 0.0:
                yield within_prior(effect["effect"], name, size, least=-size)


def refined_words(left: Sequence[Left], moved: Sequence[Moved]) -> tuple[str, ...]:
    """Return a sentence for each joint whose file has other numbers in the place of what it does
    not state, `left`."""
    found = []
    for name in dict.fromkeys(str(one.number.joint) for one in moved):
        own = [by_words(one) for one in moved if one.number.joint == name]
        laws = [one.what.replace("_", " ") for one in left if one.joint in (name, None)]
        found.append(
            f"{listed(laws)} of {name} cannot be stated in the file. Its numbers are refined"
            f" without it, by simulations of the fitted recordings: {listed(own)}"
        )
    return tuple(found)
