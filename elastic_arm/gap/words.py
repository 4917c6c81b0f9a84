"""Sentences about effects: what tells two of them apart."""

from __future__ import annotations

from elastic_arm.effects import Effect

_SAME_EFFECT = "motion in which these joints move one at a time"
_OTHERWISE = "motion that covers more of the joint's range, speeds and loads, slowly and fast"


def separated_by(effect: Effect, other: Effect, joint: str | None, other_joint: str | None) -> str:
    """Return the motion that would tell two explanations apart, from the catalogue where it knows."""
    for one, two in ((effect, other), (other, effect)):
        for confusion in one.confusions:
            if confusion.effect == two.id:
                return confusion.separated_by
    return _SAME_EFFECT if effect.id == other.id and joint != other_joint else _OTHERWISE
