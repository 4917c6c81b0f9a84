"""A mass on the last link that the model does not know."""

from collections.abc import Mapping
from typing import Any

import casadi as ca

from elastic_arm.effects.model import Confusion, Effect, Scope
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Parameter, Role

NUMBERS = (
    Parameter("mass", "kg", 0.05, 50.0, neutral=0.0, least=0.0, meaning="m"),
    Parameter(
        "position",
        "m",
        -0.5,
        0.5,
        role=Role.SEARCHED,
        default=(0.0, 0.0, 0.0),
        size=3,
        draw=(-0.15, 0.15),
        meaning="p, in the link's frame O_i",
    ),
)


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """Weight and inertia of a point mass fixed to link i."""
    mass, position = p["mass"], p["position"]
    inertia = mass * (ca.sumsqr(position) * ca.SX.eye(3) - position @ position.T)
    return motion.everywhere(motion.carried_body(i, mass, mass * position, inertia))


EFFECT = Effect(
    id="payload",
    formula="a point mass m at p in O_n, fixed to the last link",
    description="A tool or workpiece that the model does not know of.",
    signature="Extra weight and inertia on the last link, felt by the link side of every joint before it.",
    law=law,
    parameters=NUMBERS,
    scope=Scope.LAST,
    sides=("link",),
    regime="load",
    confusions=(
        Confusion(
            "link_inertia_mismatch",
            "always: both change the last link; a payload changes it by a point mass",
            "only knowing what was mounted; a change that no point mass makes is a mismatch",
        ),
    ),
)
