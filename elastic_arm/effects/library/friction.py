"""Friction: a torque that resists the velocity w of the chosen side, and what makes it larger."""

from collections.abc import Callable
from typing import Any

import casadi as ca

from elastic_arm.effects.law import (
    Choice,
    Confusion,
    Contribution,
    Effect,
    Numbers,
    SymbolicMotion,
    amount,
    searched,
    signed,
)

DRY = "coulomb_friction"
PLAIN = ("viscous_friction", DRY)  # what every joint has, in the first place
SIDE = Choice("side", ("motor", "link"), "motor")
ON_A_SIDE: dict[str, Any] = {
    "choices": (SIDE,),
    "sides": ("motor", "link"),
    "sides_of": lambda p: (p["side"],),
    "needs_motion": True,
}


def friction(id: str, torque: Callable[[ca.SX, ca.SX, Numbers], ca.SX], **words: Any) -> Effect:
    """Return friction whose torque is that of (velocity, its sign, parameters)."""

    def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
        side = p["side"]
        added: dict[str, Any] = {side: torque(motion.velocity(side)[i], motion.sign(side, i), p)}
        return motion.at(i, **added)

    return Effect(id, law=law, friction=True, **ON_A_SIDE, **words)


VISCOUS = friction(
    "viscous_friction",
    lambda w, sign, p: p["coefficient"] * w,
    formula="F_v w",
    description=("Friction proportional to the velocity of its side: grease, oil, seals."),
    plain="has viscous friction of {coefficient}",
    signature=(
        "The residual is a straight line through zero over velocity, largest where the joint is"
        " fastest."
    ),
    parameters=(amount("coefficient", "Nm s/rad", 0.1, 200.0, "F_v"),),
    regime="high_speed",
    confusions=(
        Confusion(
            DRY,
            "the joint always moves at the same speed",
            "the same path at half and twice the speed: viscous friction changes with"
            " speed, Coulomb friction does not",
        ),
    ),
)
COULOMB = friction(
    DRY,
    lambda w, sign, p: p["torque"] * sign,
    formula="F_c sign(w)",
    description="Dry friction: a constant torque against the motion of its side.",
    plain="has dry friction of {torque}",
    signature=(
        "The residual jumps by twice the torque at every reversal of velocity and is flat in"
        " between."
    ),
    parameters=(amount("torque", "Nm", 0.1, 100.0, "F_c"),),
    regime="velocity_reversal",
    confusions=(
        Confusion(
            "load_dependent_friction",
            "the joint torque is nearly constant",
            "reversals under clearly different loads: the jump of load-dependent friction grows"
            " with the load",
        ),
        Confusion(
            "stribeck_friction",
            "the joint is always faster than the Stribeck speed",
            "slow reversals: the Stribeck part is visible only near standstill",
        ),
    ),
)
STRIBECK = friction(
    "stribeck_friction",
    lambda w, sign, p: p["torque"] * ca.exp(-((w / p["speed"]) ** 2)) * sign,
    formula="(F_s - F_c) exp(-(w/v_s)^2) sign(w)",
    description=(
        "The excess of friction near standstill over Coulomb friction, before a"
        " lubricating film forms."
    ),
    plain="needs up to {torque} more to break loose below {speed}",
    signature=(
        "The residual peaks on both sides of each velocity reversal and vanishes"
        " above the Stribeck speed."
    ),
    parameters=(
        amount("torque", "Nm", 0.1, 50.0, "F_s - F_c, the excess at standstill"),
        searched("speed", "rad/s", 0.005, 0.5, "v_s", above=0.0, draw=(0.02, 0.2)),
    ),
    regime="low_speed",
    confusions=(
        Confusion(
            DRY,
            "the joint never moves clearly faster than the Stribeck speed",
            "faster motion: the Stribeck part vanishes, Coulomb friction remains",
        ),
    ),
)
DEGRESSIVE = friction(
    "degressive_friction",
    lambda w, sign, p: p["torque"] * ca.tanh(w / p["speed"]),
    formula="F tanh(w/v)",
    description=(
        "Viscous friction that saturates with speed: shear-thinning lubricant, such"
        " as grease in a gear."
    ),
    plain="has up to {torque} of friction that saturates above {speed}",
    signature="The residual rises with velocity near standstill and is flat far above the speed v.",
    parameters=(
        amount("torque", "Nm", 0.1, 100.0, "F, at high speed"),
        searched("speed", "rad/s", 0.05, 2.0, "v, speed of the bend", above=0.0, draw=(0.1, 0.5)),
    ),
    regime="high_speed",
    confusions=(
        Confusion(
            "viscous_friction",
            "the joint stays slower than the speed of the bend",
            "faster motion: viscous friction continues to rise",
        ),
        Confusion(
            DRY,
            "the joint passes standstill quickly",
            "slow reversals: Coulomb friction jumps there",
        ),
    ),
)
LOADED = Effect(
    "load_dependent_friction",
    law=lambda motion, i, p: motion.at(
        i, motor=p["coefficient"] * ca.fabs(motion.tau_J[i]) * motion.sign("motor", i)
    ),
    formula="mu abs(tau_J) sign(w)",
    description=(
        "Dry friction proportional to the torque that the drive transmits: teeth and"
        " wave bearing under load."
    ),
    plain="loses {coefficient} times the torque of its drive to friction",
    signature=(
        "The jump at a velocity reversal grows with the joint torque there; unloaded reversals show"
        " none."
    ),
    # Harmonic drives lose up to a fifth of their load, spur gears of hobby servos up to a third.
    parameters=(amount("coefficient", "1", 0.002, 0.5, "mu", draw=(0.002, 0.2)),),
    sides=("motor",),
    regime="load",
    needs_motion=True,
    friction=True,
    confusions=(
        Confusion(
            DRY, "the joint torque is nearly constant", "reversals under clearly different loads"
        ),
        Confusion(
            "motor_torque_gain",
            "the velocity seldom reverses, or the load has the sign of the velocity",
            "reversals under load: a gain gives no jump there",
        ),
    ),
)


def scaling(
    id: str, factor: Callable[[SymbolicMotion, int, Numbers], ca.SX], **words: Any
) -> Effect:
    """Return what adds a factor of (motion, joint, parameters) times the friction of the side."""

    def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
        added: dict[str, Any] = {p["side"]: factor(motion, i, p) * motion.friction(p["side"])[i]}
        return motion.at(i, **added)

    return Effect(id, law=law, scales_friction=True, **ON_A_SIDE, **words)


THERMAL = scaling(
    "thermal_friction",
    lambda motion, i, p: p["change"] * motion.progress,
    formula="the side's friction times 1 + r (t - t_mid) / T, T the length of the recording",
    description="Friction that changes during the recording: grease becomes thinner as the"
    " joint warms up.",
    plain="has friction that changes by a share of {change} over the recording",
    signature=(
        "The residual of a friction that is correct on average: one sign at the"
        " beginning, the other at the end."
    ),
    parameters=(signed("change", "1", 1.0, "r", above=-2.0, draw=(0.6, 1.0)),),
    regime="drift",
    in_time=True,
    prior=lambda rate: (
        0.05
    ),  # friction that was known before changes by up to 10 % in a run, as two deviations
    confusions=(
        Confusion(
            "viscous_friction",
            "the joint moves faster towards one end of the recording",
            "the same motion at the beginning and at the end",
        ),
    ),
)
ASYMMETRIC = scaling(
    "asymmetric_friction",
    lambda motion, i, p: p["asymmetry"] * motion.sign(p["side"], i),
    formula="the side's friction times 1 + a sign(w)",
    description=("Dry and viscous friction differ between the two directions, as in most gears."),
    plain="has friction that is larger than average in the positive direction by a"
    " share of {asymmetry}",
    signature=(
        "The residual rises with speed at different slopes in the two directions, and"
        " its jump at a reversal is not centred."
    ),
    parameters=(signed("asymmetry", "1", 0.9, "a", above=-1.0, draw=(0.2, 0.5)),),
    regime="velocity_reversal",
    confusions=(
        Confusion(
            "motor_torque_offset",
            "friction is dry: the difference between the directions is a constant",
            "motion at several speeds, or a torque read at rest with brakes on",
        ),
    ),
)

EFFECTS = (VISCOUS, COULOMB, STRIBECK, DEGRESSIVE, LOADED, THERMAL, ASYMMETRIC)
