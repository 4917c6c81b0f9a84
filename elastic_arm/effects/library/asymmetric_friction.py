"""Friction that differs by direction."""

from collections.abc import Mapping
from typing import Any

from elastic_arm.effects.library.friction import SIDE, chosen_side
from elastic_arm.effects.model import Confusion, Effect
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Parameter


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """a sign(w) times the friction of the side."""
    side = p["side"]
    added: dict[str, Any] = {side: p["asymmetry"] * motion.sign(side, i) * motion.friction(side)[i]}
    return motion.at(i, **added)


EFFECT = Effect(
    id="asymmetric_friction",
    formula="the side's friction times 1 + a sign(w)",
    description="Dry and viscous friction are larger in one direction than in the other, as in most gears.",
    signature="The residual rises with speed at other slopes to both sides, and its jump at a reversal is off centre.",
    law=law,
    parameters=(
        Parameter(
            "asymmetry",
            "1",
            -0.9,
            0.9,
            neutral=0.0,
            above=-1.0,
            draw=(0.2, 0.5),
            example=(0.2, 0.4),
            meaning="a, half the difference over the mean",
        ),
    ),
    choices=(SIDE,),
    sides=("motor", "link"),
    sides_of=chosen_side,
    regime="velocity_reversal",
    needs_motion=True,
    scales_friction=True,
    confusions=(
        Confusion(
            "motor_torque_offset",
            "friction is dry: what both directions differ by is a constant",
            "motion at several speeds, or a torque read at rest with brakes on",
        ),
    ),
)
