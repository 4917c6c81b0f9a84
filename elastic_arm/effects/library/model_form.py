"""What a model variant lacks of mod3: effects of known size, without a free parameter."""

from typing import Any

from elastic_arm.effects.law import Confusion, Contribution, Effect, Numbers, Scope, SymbolicMotion
from elastic_arm.errors import EffectError


def _form(id: str, poorer: str, richer: str, lacked_by: tuple[str, ...], **words: Any) -> Effect:
    def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
        if motion.equations.model_name not in lacked_by:
            raise EffectError(
                f"{id} is already part of {motion.equations.model_name}",
                f"Omit it, or use {' or '.join(lacked_by)} as the model.",
            )
        return motion.everywhere(motion.left_side(richer) - motion.left_side(poorer))

    places: dict[str, Any] = {
        "scope": Scope.ARM,
        "sides": ("link", "motor"),
        "regime": "acceleration",
    }
    return Effect(id, law=law, needs_motion=True, lacked_by=lacked_by, **places, **words)


ALIKE = "link and motor of joint 1 move alike: S_11 then acts like a change of M_11 and B_11"

EFFECTS = (
    _form(
        "spline_inertia",
        "mod1",
        "mod2",
        ("mod1",),
        formula="left side of (1) in mod2 - in mod1",
        description=(
            "The inertia of the splines rotates with the motor, not with the link; mod1"
            " merges it into the link."
        ),
        plain="has splines that rotate with the motor, not with the link",
        signature=(
            "Small residuals proportional to the accelerations of link and motor side, of"
            " known size."
        ),
    ),
    _form(
        "inertia_coupling",
        "mod2",
        "mod3",
        ("mod1", "mod2"),
        formula="S theta'' + c1 on the link side, S' q'' + c2 on the motor side (5), (8)",
        description=(
            "Spinning rotors and wave generators act back on the links that carry them;"
            " mod1 and mod2 neglect this."
        ),
        plain="has spinning rotors that act back on the links that carry them",
        signature=(
            "Residuals proportional to accelerations of other joints and of the other"
            " side, of known size."
        ),
        confusions=(
            Confusion(
                "rotor_inertia_mismatch",
                ALIKE,
                "motion with large deflection of joint 1: fast enough for link and motor"
                " accelerations to differ",
            ),
            Confusion("link_inertia_mismatch", ALIKE, "motion with large deflection of joint 1"),
        ),
    ),
)
