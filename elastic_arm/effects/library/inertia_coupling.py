"""The low-inertia coupling S (mod1 and mod2 leave it out)."""

from collections.abc import Mapping
from typing import Any

from elastic_arm.effects.model import Confusion, Effect, Scope
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.errors import EffectError


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """What mod3 has beyond mod2: S, c1, c2."""
    if motion.equations.model_name == "mod3":
        raise EffectError(
            "inertia_coupling is part of mod3 already", "Leave it out, or take mod1 or mod2 as the model."
        )
    return motion.everywhere(motion.left_side("mod3") - motion.left_side("mod2"))


EFFECT = Effect(
    id="inertia_coupling",
    formula="S theta'' + c1 on the link side, S' q'' + c2 on the motor side (5), (8)",
    description="Spinning rotors and wave generators react on the links that carry them; mod1 and mod2 leave this out.",
    signature="Residuals in proportion to accelerations of other joints and of the other side, of known size.",
    law=law,
    scope=Scope.ARM,
    sides=("link", "motor"),
    regime="acceleration",
    needs_motion=True,
    lacked_by=("mod1", "mod2"),
    confusions=(
        Confusion(
            "rotor_inertia_mismatch",
            "link and motor of joint 1 move alike: S_11 then acts like a change of M_11 and B_11",
            "motion that winds the drive of joint 1: fast enough for link and motor accelerations to differ",
        ),
        Confusion(
            "link_inertia_mismatch",
            "link and motor of joint 1 move alike: S_11 then acts like a change of M_11 and B_11",
            "motion that winds the drive of joint 1",
        ),
    ),
)
