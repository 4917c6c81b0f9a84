"""Friction that changes as the joint warms up."""

from collections.abc import Mapping
from typing import Any

from elastic_arm.effects.library.friction import SIDE, chosen_side
from elastic_arm.effects.model import Confusion, Effect
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Parameter


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """r (t - t_mid) / T times the friction of the side."""
    side = p["side"]
    added: dict[str, Any] = {side: p["change"] * motion.progress * motion.friction(side)[i]}
    return motion.at(i, **added)


EFFECT = Effect(
    id="thermal_friction",
    formula="the side's friction times 1 + r (t - t_mid) / T, T the length of the recording",
    description="Friction that changes over the recording: grease thins as the joint warms up.",
    signature="The residual of a friction that is right on average: of one sign at the begin, of the other at the end.",
    law=law,
    parameters=(
        Parameter(
            "change",
            "1",
            -1.0,
            1.0,
            neutral=0.0,
            above=-2.0,
            draw=(0.6, 1.0),
            example=(-0.4, -0.2),
            meaning="r, end - begin",
        ),
    ),
    choices=(SIDE,),
    sides=("motor", "link"),
    sides_of=chosen_side,
    regime="drift",
    needs_motion=True,
    in_time=True,
    scales_friction=True,
    prior=lambda rate: 0.05,  # friction that was known before changes by up to 10 % in a run, as two deviations
    confusions=(
        Confusion(
            "viscous_friction",
            "the joint moves faster towards one end of the recording",
            "the same motion at the begin and at the end",
        ),
    ),
)
