"""Every effect of a catalogue at every place of an arm where it could show."""

from __future__ import annotations

from collections.abc import Sequence

from elastic_arm.diagnosis.selection.bearing_tilts import Tilting
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.effects.model import Effect, EffectInstance, StructuralEffect
from elastic_arm.estimation.effect_columns import Feature


def features(equations: ArmEquations, effects: Sequence[Effect]) -> list[Feature]:
    """Return every effect at every place where it adds something to this model's residuals."""
    found = [feature_of(active, equations) for effect in effects for active in effect.candidates(equations.robot)]
    return [feature for feature in found if _possible(feature) and feature.acts]


def _possible(feature: Feature) -> bool:
    """Whether the arm has what the effect acts in: without transmissions there is no drive."""
    if feature.equations.robot.elastic:
        return True
    sides = set(feature.sides)
    return ("link" in sides or sides == {"motor"}) and "link_encoder" not in feature.choices.get("channels", ())


def feature_of(active: EffectInstance, equations: ArmEquations) -> Feature:
    """Return the feature of an effect on an arm."""
    effect = active.effect
    chosen = {c.name: active.parameters[c.name] for c in effect.choices}
    kind = Tilting if isinstance(effect, StructuralEffect) else Feature
    return kind(effect, active.joint, chosen, equations)
