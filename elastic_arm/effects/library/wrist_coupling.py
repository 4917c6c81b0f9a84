"""A wrist's motor that turns with the joint before its own, too."""

import casadi as ca

from elastic_arm.effects.law import (
    Choice,
    Confusion,
    Contribution,
    Effect,
    Numbers,
    SymbolicMotion,
    amount,
)
from elastic_arm.errors import EffectError

# rad/s within which its dry friction turns over. As that of one joint does where velocities are
# differences of angles.
TURNING = 0.02
TURNS = {"with": 1.0, "against": -1.0}


def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """Inertia and friction of a motor of w = dq_i +- dq_(i-1), as torques of both joints.

    With joint angles that are combinations of motor angles, q = C q_m, the torques of the joints
    are C^-T times those of the motors: what resists one motor resists every joint that turns it.
    """
    if i == 0:
        raise EffectError(
            f"wrist_coupling: {motion.robot.joint_names[0]} has no joint before it",
            "Give the later one of the two joints that share a motor.",
        )
    factor = TURNS[p["turns"]]
    rate = motion.dtheta[i] + factor * motion.dtheta[i - 1]
    acceleration = motion.ddtheta[i] + factor * motion.ddtheta[i - 1]
    torque = p["inertia"] * acceleration + p["viscous"] * rate + p["dry"] * ca.tanh(rate / TURNING)
    return motion.at(i, motor=torque) + motion.at(i - 1, motor=factor * torque)


EFFECT = Effect(
    id="wrist_coupling",
    formula="J dw/dt + b w + F tanh(w/0.02), times s on the joint before; w = dq_i + s dq_(i-1)",
    description=(
        "The motor of this joint also turns with the joint before it, as in the wrist"
        " of an industrial arm."
    ),
    plain="has a motor that also turns with the joint before it, with {dry} of dry friction",
    signature=(
        "The torque of a wrist joint depends on the motion of the next joint, and vice versa."
    ),
    law=law,
    parameters=(
        amount("dry", "Nm", 0.1, 100.0, "F, of the motor"),
        amount("viscous", "Nm s/rad", 0.1, 100.0, "b"),
        amount("inertia", "kg m²", 0.001, 10.0, "J, at the joint"),
    ),
    choices=(Choice("turns", ("with", "against"), "with"),),
    sides=("motor",),
    regime="high_speed",
    # Two joints of any arm might share a motor: a user knows which do.
    searched=False,
    confusions=(
        Confusion(
            "coulomb_friction", "the joint before does not move", "motion in which both joints turn"
        ),
        Confusion(
            "viscous_friction", "the joint before does not move", "motion in which both joints turn"
        ),
    ),
)
