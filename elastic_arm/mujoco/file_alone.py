"""The file of a corrected servo arm without the laws that it cannot state, as its users load it.

Friction laws by step, a dead band, an integral and a sagging supply are only in robot.yaml. For
joints with any of them, the numbers in the file are fitted for the file without these laws:

    kp and kd, kd, armature, dry friction, viscous friction

The fit starts from the arm with its laws, where friction loss and damping replace the friction
laws. The priors are the ordinary deviations of a description, and for friction its own size.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence

from elastic_arm.diagnosis.words import listed
from elastic_arm.evidence.priors import Priors
from elastic_arm.mujoco.closed_loop import beside_actuators, with_controllers
from elastic_arm.mujoco.refinable import FRICTION, Moved, Refinable, by_words
from elastic_arm.mujoco.servo_numbers import within_prior
from elastic_arm.robot import Robot
from elastic_arm.robot.mjcf import MjcfArm

DRY = "coulomb_friction"
VISCOUS = "viscous_friction"
# Numbers of a controller that set-points have to hold, in words.
BESIDE = {"dead_band": "dead band", "ki": "integral", "sag": "sag of the supply"}


def unstated(arm: MjcfArm, robot: Robot) -> dict[str, tuple[str, ...]]:
    """Return what acts in closed loop of a robot and its file, opened, does not state: in words, by
    joint."""
    whole = with_controllers(arm, robot)
    found = {}
    for i, (joint, beside) in enumerate(zip(robot.joints, beside_actuators(whole), strict=True)):
        laws = [law.effect.id for law in whole.laws if i in law.joint_indices(robot)]
        words = [name.replace("_", " ") for name in laws]
        if beside:
            own = [text for name, text in BESIDE.items() if getattr(joint.controller, name)]
            words += own or ["limit of the duty"]
        if words:
            found[joint.name] = tuple(words)
    return found


def file_numbers(robot: Robot, joints: Iterable[str], priors: Priors) -> tuple[Refinable, ...]:
    """Return the numbers of some joints that a file states, to be fitted; robot: as read of it."""
    return tuple(number for name in joints for number in _numbers(robot, name, priors))


def _numbers(robot: Robot, name: str, priors: Priors) -> Iterator[Refinable]:
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


def refined_words(lacking: Mapping[str, Sequence[str]], moved: Sequence[Moved]) -> tuple[str, ...]:
    """Return a sentence for each joint whose file has other numbers in the place of what it does
    not state, `lacking`."""
    found = []
    for name in dict.fromkeys(str(one.number.joint) for one in moved):
        own = [by_words(one) for one in moved if one.number.joint == name]
        found.append(
            f"The file cannot state {listed(lacking[name])} of {name}. The numbers that it states"
            f" are refined for the file alone, in simulations of the fitted recordings:"
            f" {listed(own)}"
        )
    return tuple(found)
