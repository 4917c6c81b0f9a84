"""Dry friction."""

from elastic_arm.effects.library.friction import SIDE, chosen_side, resisting
from elastic_arm.effects.model import Confusion, Effect
from elastic_arm.effects.parameters import Parameter

EFFECT = Effect(
    id="coulomb_friction",
    formula="F_c sign(w)",
    description="Dry friction: a constant torque against the motion of its side.",
    signature="The residual jumps by twice the torque at every reversal of velocity and is flat in between.",
    law=resisting(lambda w, sign, p: p["torque"] * sign),
    parameters=(Parameter("torque", "Nm", 0.1, 100.0, neutral=0.0, least=0.0, example=(5.0, 20.0), meaning="F_c"),),
    choices=(SIDE,),
    sides=("motor", "link"),
    sides_of=chosen_side,
    regime="velocity_reversal",
    needs_motion=True,
    friction=True,
    confusions=(
        Confusion(
            "load_dependent_friction",
            "the joint torque is nearly constant",
            "reversals under clearly different loads: the jump of load-dependent friction grows with the load",
        ),
        Confusion(
            "stribeck_friction",
            "the joint is always faster than the Stribeck speed",
            "slow reversals: the Stribeck part shows near standstill only",
        ),
    ),
)
