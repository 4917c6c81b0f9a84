"""The spline as a body of its own (mod1 folds it into the link)."""

from collections.abc import Mapping
from typing import Any

from elastic_arm.effects.model import Effect, Scope
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.errors import EffectError


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """What mod2 has beyond mod1."""
    if motion.equations.model_name != "mod1":
        raise EffectError(
            f"spline_inertia is part of {motion.equations.model_name} already",
            "Leave it out, or take mod1 as the model.",
        )
    return motion.everywhere(motion.left_side("mod2") - motion.left_side("mod1"))


EFFECT = Effect(
    id="spline_inertia",
    formula="left side of (1) in mod2 - in mod1",
    description="The splines' inertia turns with the motor, not with the link; mod1 folds it into the link.",
    signature="Small residuals in proportion to the accelerations on link and motor side, of known size.",
    law=law,
    scope=Scope.ARM,
    sides=("link", "motor"),
    regime="acceleration",
    needs_motion=True,
    lacked_by=("mod1",),
)
