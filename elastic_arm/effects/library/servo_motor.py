"""The electrics of a servo, where a description states its duty's limit.

    u = limit(asked / stall, 1),   tau_m = stall u (1 - sag |u|) - kd dtheta

`asked` is the torque at rest that the firmware commands, `stall` that of full duty, kt / R times
the supply. What the drive truly makes with another number is missing in the torque that the stated
one makes.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca

from elastic_arm.effects.law import (
    Confusion,
    ControllerEffect,
    Law,
    Numbers,
    SymbolicMotion,
    amount,
    ratio,
)
from elastic_arm.effects.library.controller import made, within_duty
from elastic_arm.errors import EffectError
from elastic_arm.robot import JointController


def _of_electrics(law: Callable[[SymbolicMotion, int, Numbers], Any]) -> Law:
    """Return the law of a drive whose torque of full duty is stated."""

    def more(motion: SymbolicMotion, i: int, stated: JointController, p: Numbers) -> Any:
        if stated.stall is None:
            raise EffectError(
                f"the description states no electrics of {motion.robot.joints[i].name}",
                "State its motor in the arm file, or as a <dcmotor> in the MJCF.",
            )
        return law(motion, i, p)

    return made(more, asked=False, commanded=False)


def _sagging(motion: SymbolicMotion, i: int, p: Numbers) -> Any:
    """Return what full supply makes more, stall u |u| sag."""
    limited, duty = within_duty(motion, i)
    return p["share"] * limited * ca.fabs(duty)


def _of_constant(motion: SymbolicMotion, i: int, p: Numbers) -> Any:
    assert motion.fed is not None
    return (1.0 - p["gain"]) * (motion.tau_m[i] - motion.fed[i])


EFFECTS = (
    ControllerEffect(
        "supply_sag",
        formula="tau_m true = stall u (1 - share |u|) - kd dtheta",
        description=(
            "The supply gives less voltage the more current the motor takes: thin cables, a"
            " weak battery, the ripple of the duty's pulses."
        ),
        plain="loses a share of {share} of its supply at full duty",
        signature=(
            "The motor residual grows with the square of the duty and has its sign, in motion and"
            " at rest."
        ),
        law=_of_electrics(_sagging),
        parameters=(amount("share", "1", 0.02, 0.6, "share of the supply lost at full duty"),),
        sides=("motor",),
        regime="load",
        change=lambda controller, p: replace(
            controller, sag=min(0.99, max(0.0, controller.sag + p["share"]))
        ),
        confusions=(
            Confusion(
                "torque_constant",
                "the duty hardly varies",
                "motions at small and at large duty, or two position gains of the firmware",
            ),
            Confusion(
                "load_dependent_friction",
                "the joint always moves against its load",
                "motions with and against the load: friction changes its sign, a sag does not",
            ),
        ),
    ),
    ControllerEffect(
        "torque_constant",
        formula="kt / R true = gain * stated",
        description=(
            "The torque that the motor makes of a volt differs from the description: warm"
            " windings, other magnets, another version of the motor."
        ),
        plain="makes {gain} times the stated torque of a volt",
        signature="The motor residual is a share of the whole torque, of the back-EMF's too.",
        law=_of_electrics(_of_constant),
        parameters=(ratio("gain", 0.3, 3.0, "true / stated kt / R", above=0.0, draw=(1.6, 2.5)),),
        sides=("motor",),
        regime="load",
        change=lambda controller, p: controller.scaled(kp=p["gain"], kd=p["gain"]),
        number_of_duty="torque_scale",
        confusions=(
            Confusion(
                "supply_sag",
                "the duty hardly varies",
                "motions at small and at large duty, or two position gains of the firmware",
            ),
            Confusion(
                "velocity_gain",
                "the joint moves fast and carries little",
                "a known weight, which determines the torque of a volt",
            ),
        ),
    ),
)
