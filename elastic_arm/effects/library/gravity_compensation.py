"""A recorded torque from which gravity has been taken, wholly or in part."""

import casadi as ca

from elastic_arm.effects.law import (
    Choice,
    Confusion,
    Contribution,
    Effect,
    Numbers,
    Parameter,
    Scope,
    SymbolicMotion,
)
from elastic_arm.effects.library.sensor_error import TORQUES, misread, sides_of


def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """Minus the share of g_i in the named torques, g by the model.

    In a simulated arm the amplifier adds that share to the motor torque that is commanded and
    recorded.
    """
    g = motion.equations.gravity_columns(motion.x) @ ca.DM(motion.robot.gravity)
    total = motion.nothing()
    for channel in p["channels"]:
        total += misread(channel, lambda motion, i, p: -p["share"] * g[i])(motion, i, p)
    return total


EFFECT = Effect(
    id="gravity_compensation",
    formula="recorded torque = true - share * g_i(q)",
    description=(
        "The controller compensates gravity itself, and the recorded torque lacks"
        " this part, wholly or partly."
    ),
    plain="records a torque that lacks {share} times its weight",
    signature=(
        "The residual is the predicted weight with the opposite sign; inertia is fully visible."
    ),
    law=law,
    parameters=(
        Parameter(
            "share",
            "1",
            0.02,
            1.2,
            neutral=0.0,
            draw=(0.2, 1.0),
            meaning="1 if all gravity is missing",
        ),
    ),
    choices=(Choice("channels", TORQUES, ("motor_torque",), several=True),),
    scope=Scope.EACH_OR_ARM,
    sides=("link", "drive", "motor"),
    sides_of=sides_of,
    regime="load",
    confusions=(
        Confusion(
            "motor_torque_gain",
            "hardly any load other than gravity acts on the joint",
            "fast motion or friction, which a gain also scales",
        ),
        Confusion(
            "link_inertia_mismatch",
            "the arm moves slowly, so that inertia is not visible",
            "fast motion: a lighter link also has less inertia",
        ),
    ),
)
