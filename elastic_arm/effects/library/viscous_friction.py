"""Friction in proportion to speed."""

from elastic_arm.effects.library.friction import SIDE, chosen_side, resisting
from elastic_arm.effects.model import Confusion, Effect
from elastic_arm.effects.parameters import Parameter

EFFECT = Effect(
    id="viscous_friction",
    formula="F_v w",
    description="Friction that grows in proportion to the velocity of its side: grease, oil, seals.",
    signature="The residual is a straight line through zero over velocity, largest where the joint is fastest.",
    law=resisting(lambda w, sign, p: p["coefficient"] * w),
    parameters=(
        Parameter("coefficient", "Nm s/rad", 0.1, 200.0, neutral=0.0, least=0.0, example=(5.0, 30.0), meaning="F_v"),
    ),
    choices=(SIDE,),
    sides=("motor", "link"),
    sides_of=chosen_side,
    regime="high_speed",
    needs_motion=True,
    friction=True,
    confusions=(
        Confusion(
            "coulomb_friction",
            "the joint moves at one speed either way",
            "the same path at half and at double speed: viscous friction follows the speed, Coulomb friction does not",
        ),
    ),
)
