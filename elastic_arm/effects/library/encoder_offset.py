"""A link encoder with a wrong zero beside the motor encoder."""

from collections.abc import Mapping
from typing import Any

from elastic_arm.effects.library.sensor_error import changing, offset
from elastic_arm.effects.model import Confusion, Effect, SensorEffect
from elastic_arm.effects.motion import Contribution, SymbolicMotion


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """K times the offset: the deflection is read too small by it."""
    motion.gear(i)
    return motion.at(i, drive=motion.K[i] * p["offset"])


EFFECT: Effect = SensorEffect(
    id="encoder_offset",
    formula="link encoder = true + offset, beside the motor encoder",
    description="The zeros of link and motor encoder do not agree.",
    signature="The drive residual is a constant: at rest without load the drive seems wound up.",
    law=law,
    parameters=(offset("rad", 0.01),),
    sides=("drive",),
    regime="always",
    change=changing("link_encoder", offset="offset"),
    prior=lambda rate: 1e-5,
    set_at_start=True,
    confusions=(
        Confusion(
            "backlash", "the joint is loaded one way throughout", "motion in which the joint torque changes sign"
        ),
        Confusion("joint_torque_offset", "only the drive equation can be used", "the link or motor equation"),
    ),
)
