"""Extra friction near standstill."""

import casadi as ca

from elastic_arm.effects.library.friction import SIDE, chosen_side, resisting
from elastic_arm.effects.model import Confusion, Effect
from elastic_arm.effects.parameters import Parameter, Role

EFFECT = Effect(
    id="stribeck_friction",
    formula="(F_s - F_c) exp(-(w/v_s)^2) sign(w)",
    description="The excess of friction near standstill over Coulomb friction, before a lubricating film builds up.",
    signature="The residual peaks on both sides of each velocity reversal and dies out above the Stribeck speed.",
    law=resisting(lambda w, sign, p: p["torque"] * ca.exp(-((w / p["speed"]) ** 2)) * sign),
    parameters=(
        Parameter("torque", "Nm", 0.1, 50.0, neutral=0.0, least=0.0, meaning="F_s - F_c, the excess at standstill"),
        Parameter("speed", "rad/s", 0.005, 0.5, role=Role.SEARCHED, above=0.0, draw=(0.02, 0.2), meaning="v_s"),
    ),
    choices=(SIDE,),
    sides=("motor", "link"),
    sides_of=chosen_side,
    regime="low_speed",
    needs_motion=True,
    friction=True,
    confusions=(
        Confusion(
            "coulomb_friction",
            "the joint never gets clearly faster than the Stribeck speed",
            "faster motion: the Stribeck part vanishes, Coulomb friction stays",
        ),
    ),
)
