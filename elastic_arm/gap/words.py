"""Sentences about effects: what tells two of them apart."""

from __future__ import annotations

from typing import TYPE_CHECKING

from elastic_arm.effects import Effect

if TYPE_CHECKING:
    from elastic_arm.gap.result import Diagnosis

_SAME_EFFECT = "motion in which these joints move one at a time"
_OTHERWISE = "motion that covers more of the joint's range, speeds and loads, slowly and fast"


def separated_by(effect: Effect, other: Effect, joint: str | None, other_joint: str | None) -> str:
    """Return the motion that would tell two explanations apart, from the catalogue where it knows."""
    for one, two in ((effect, other), (other, effect)):
        for confusion in one.confusions:
            if confusion.effect == two.id:
                return confusion.separated_by
    return _SAME_EFFECT if effect.id == other.id and joint != other_joint else _OTHERWISE


def meaning(found: Diagnosis) -> str:
    """Return the verdict as a sentence."""
    if found.verdict == "none":
        return "recording and model agree within the noise of the sensors."
    if not found.causes:
        places = ", ".join(f"{p.joint} ({p.side})" for p in found.unexplained[:3])
        return f"there is a gap, but no effect of the catalogue explains it; it is largest at {places}."
    named = ", ".join(f"{c.effect} on {c.joint or 'the whole arm'}" for c in found.causes)
    if found.verdict == "explained":
        return f"{named} explains {_percent(found.shrink)} of the gap on motion that no fit has seen."
    return f"{named} explains {_percent(found.shrink)} of the gap; what is left has another cause."


def _percent(share: float | None) -> str:
    return f"{100 * (share or 0.0):.1f} %"
