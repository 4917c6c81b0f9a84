"""Weight that something outside the model carries."""

from collections.abc import Mapping
from typing import Any

import casadi as ca

from elastic_arm.effects.model import Effect
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Parameter, Role


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """Minus the weight of a mass that link i carries; its inertia stays."""
    rest = ca.SX(*motion.x.shape)
    moment = p["mass"] * p["position"]
    return motion.everywhere(motion.equations.carried_body(i, -p["mass"], -moment, ca.SX(3, 3), motion.x, rest, rest))


EFFECT = Effect(
    id="carried_weight",
    formula="- weight of m at p in O_i",
    description="Something that has no inertia carries a part of a link's weight, as a MuJoCo body's gravcomp does.",
    signature="The residual follows the pose as gravity does, with the opposite sign.",
    law=law,
    parameters=(
        Parameter("mass", "kg", 0.05, 50.0, neutral=0.0, meaning="m"),
        Parameter("position", "m", -0.5, 0.5, role=Role.SEARCHED, default=(0.0, 0.0, 0.0), size=3, meaning="p, in O_i"),
    ),
    sides=("link",),
    regime="position",
    # Where a description or a user states it: a recording shows it as a payload or load that has no inertia.
    searched=False,
)
