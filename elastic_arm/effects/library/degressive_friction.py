"""Friction that rises with speed and levels off."""

import casadi as ca

from elastic_arm.effects.library.friction import SIDE, chosen_side, resisting
from elastic_arm.effects.model import Confusion, Effect
from elastic_arm.effects.parameters import Parameter, Role

EFFECT = Effect(
    id="degressive_friction",
    formula="F tanh(w/v)",
    description="Viscous friction that levels off: lubricant that thins as it is sheared, such as grease in a gear.",
    signature="The residual rises with velocity near standstill and is flat far above the speed v.",
    law=resisting(lambda w, sign, p: p["torque"] * ca.tanh(w / p["speed"])),
    parameters=(
        Parameter("torque", "Nm", 0.1, 100.0, neutral=0.0, least=0.0, example=(5.0, 20.0), meaning="F, at high speed"),
        Parameter(
            "speed", "rad/s", 0.05, 2.0, role=Role.SEARCHED, above=0.0, draw=(0.1, 0.5), meaning="v, where it bends"
        ),
    ),
    choices=(SIDE,),
    sides=("motor", "link"),
    sides_of=chosen_side,
    regime="high_speed",
    needs_motion=True,
    friction=True,
    confusions=(
        Confusion(
            "viscous_friction",
            "the joint stays slower than the speed at which it bends",
            "faster motion: viscous friction goes on rising",
        ),
        Confusion(
            "coulomb_friction", "the joint passes standstill quickly", "slow reversals: Coulomb friction jumps there"
        ),
    ),
)
