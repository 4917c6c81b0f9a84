"""The result of a diagnosis in words, for the screen and the report."""

from __future__ import annotations

from typing import TYPE_CHECKING

from elastic_arm.diagnosis.corrected_robot import holds_any
from elastic_arm.diagnosis.settings import AgreementSettings
from elastic_arm.diagnosis.texts.values import chosen, effect_at, estimates_text, listed, percent, probability_text
from elastic_arm.effects.model import MODELS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from elastic_arm.diagnosis.inference.estimates import Agreement
    from elastic_arm.diagnosis.inference.prediction import Prediction
    from elastic_arm.diagnosis.result import Alternative, Cause, Diagnosis

# Of the display, no decision of the diagnosis.
DOUBTFUL = 0.9  # of a cause's and its strongest alternative's confidence: with less, both are named
WORTH_A_LINE = 0.05  # probability of an alternative that has a line of its own
NAMED = 4  # causes that the verdict names
_FAINT = "all equations together show it, on motion that no fit has seen"


def verdict_sentence(found: Diagnosis) -> str:
    """Return the verdict as a sentence."""
    if found.verdict == "none":
        return "recording and model agree within the noise of the sensors."
    if not found.causes:
        places = ", ".join(f"{p.joint} ({p.side})" for p in found.unexplained[:3])
        return f"there is a gap, but no effect of the catalogue explains it; it is largest at {places}."
    named = listed([_with_rival(cause, found.causes) for cause in found.causes[:NAMED]], len(found.causes) - NAMED)
    standing_in = [_name(cause, found.causes) for cause in found.causes if cause.stands_in]
    # What only stands in for a cause explains nothing.
    verb = "take away" if standing_in else "explain"
    if len(found.causes) == 1:
        verb = "takes away" if standing_in else "explains"
    but = f", but {_only_stand_in(standing_in, found.causes)}" if standing_in else ""
    if found.verdict == "explained" and found.measured_by == "likelihood":
        return f"{named} {verb} a gap that is fainter than the noise of every residual: {_FAINT}{but}."
    if found.verdict == "explained":
        return f"{named} {verb} {percent(found.shrink)} of the gap on motion that no fit has seen{but}."
    left = "" if len(standing_in) == len(found.causes) else "; what is left has another cause"
    return f"{named} {verb} {percent(found.shrink)} of the gap{but}{left}."


def _only_stand_in(names: Sequence[str], causes: Sequence[Cause]) -> str:
    """Return that some causes only stand in for something else; without names where it is all of them."""
    subject = "" if len(names) == len(causes) else f"{listed(names)} "
    return f"{subject}only {'stands' if len(names) == 1 else 'stand'} in for something else"


def held_text(cause: Cause) -> str:
    """Return where the corrected arm has a cause, and where not."""
    if cause.held_as == "variant":
        return f"part of {next(model for model in MODELS if model not in cause.instance.effect.lacked_by)}"
    return {"effect": "in robot.yaml", "number": "number in robot.yaml", None: "not in robot.yaml"}[cause.held_as]


def left_out_note(causes: Sequence[Cause]) -> str:
    """Return which causes the corrected arm leaves out though the figures of the gap hold them; empty for none."""
    names = [effect_at(cause.effect, cause.joint) for cause in causes if cause.held_as is None]
    if not names:
        return ""
    it, stand = ("it", "stands") if len(names) == 1 else ("them", "stand")
    left_out = f"robot.yaml and the prediction leave {it} out"
    if not holds_any(causes):
        left_out = f"the prediction leaves {it} out, and there is no robot.yaml, as it would hold no cause"
    return (
        f"{listed(names)} only {stand} in for something else: {left_out}. "
        f"The gap after, and how far it shrinks, are those with {it} added."
    )


def _name(cause: Cause, causes: Sequence[Cause]) -> str:
    """Return a cause by effect and joint; with its channels where another cause has the same two."""
    name, alike = effect_at(cause.effect, cause.joint), [(one.effect, one.joint) for one in causes]
    several = [choice.name for choice in cause.instance.effect.choices if choice.several]
    if not several or alike.count((cause.effect, cause.joint)) < 2:
        return name
    return f"{name} ({', '.join(chosen(cause.instance.parameters[choice]) for choice in several)})"


def _with_rival(cause: Cause, causes: Sequence[Cause]) -> str:
    """Return a cause by name, with the strongest alternative where the recording leaves it in doubt.

    Parameters
    ----------
    cause, causes
        The cause, and all that are named.
    """
    name = _name(cause, causes)
    other = max(cause.alternatives, key=lambda a: a.confidence, default=None)
    # Of an incomplete hypothesis all confidences are low: what counts is one against the other.
    if other is None or cause.confidence >= DOUBTFUL * (cause.confidence + other.confidence):
        return name
    return f"{name} (or {effect_at(other.effect, other.joint)}: this recording does not separate them)"


def cause_size(cause: Cause, between: str = ", ") -> str:
    """Return a cause's parameters, and the channels it acts in, as text, with `between` between them."""
    several = [choice.name for choice in cause.instance.effect.choices if choice.several]
    parts = [estimates_text(cause.parameters, between), *(chosen(cause.instance.parameters[name]) for name in several)]
    return between.join(part for part in parts if part) or "no free size"


def sides_text(cause: Cause) -> str:
    """Return the sides on which a cause shows; those of one drive that the recording does not separate by "or"."""
    friction = any(choice.name == "side" for choice in cause.instance.effect.choices)
    return (" or " if friction else ", ").join(cause.sides)


def alone_text(cause: Cause) -> str:
    """Return by how much a cause shrinks the gap alone; one that helps only beside the others has no number."""
    if percent(cause.shrink).startswith("-"):
        return "only beside others"
    return f"{percent(cause.shrink)}{' (minor)' if cause.minor else ''}"


def negative_shrink_note(causes: Sequence[Cause]) -> str:
    """Return what a share below zero means, where one of the causes has such a share alone."""
    if all(percent(cause.shrink)[0] != "-" for cause in causes):
        return ""
    return "Only beside others: alone such a cause makes the gap larger."


def listed_alternatives(cause: Cause) -> tuple[list[Alternative], str]:
    """Return the alternatives that are worth a line each, and the others summed up in words, empty for none."""
    likely = [other for other in cause.alternatives if other.confidence >= WORTH_A_LINE]
    faint = [other for other in cause.alternatives if other.confidence < WORTH_A_LINE]
    if len(faint) < 2:
        return [*likely, *faint], ""
    names = listed([effect_at(other.effect, other.joint) for other in faint[:NAMED]], len(faint) - NAMED)
    return likely, f"{names} ({probability_text(sum(other.confidence for other in faint))} together)"


def gap_at(found: Diagnosis, joint: str, side: str) -> str:
    """Return the size of a residual without and with the causes, and the share of its own gap that is gone.

    Parameters
    ----------
    found
        The diagnosis.
    joint, side
        Which residual; "–" where there is no such equation.
    """
    place = (joint, side)
    if place not in found.before.rmse:
        return "–"
    sizes = f"{found.before.rmse[place]:.3g}"
    if found.causes:
        sizes += f" → {found.after.rmse[place]:.3g}"
    return f"{sizes} ({share_at(found, joint, side)})"


def share_at(found: Diagnosis, joint: str, side: str) -> str:
    """Return the share of a residual's own gap that is gone, as text.

    Parameters
    ----------
    found
        The diagnosis.
    joint, side
        Which residual.
    """
    share, place = found.shrink_by_place.get((joint, side)), (joint, side)
    if share is None:
        return "no clear gap"
    if not found.causes:
        return "gap"
    if not percent(share).startswith("-"):
        return f"{percent(share)} gone"
    # A gap that is clear at low frequencies alone is measured there.
    smaller = found.after.rmse[place] < found.before.rmse[place]
    return "larger where it stands out of the noise" if smaller else "larger"


def prediction_sentence(found: Diagnosis, prediction: Prediction) -> str:
    """Return in a sentence how far the prediction error of the worst angle falls, or why that is not known."""
    before, after = prediction.before or {}, prediction.after or {}
    if prediction.reason:
        return f"{prediction.reason[0].upper()}{prediction.reason[1:]}."
    joint, side = max(before, key=lambda place: before[place][-1])
    unit = found.units.at(joint, "rad")
    errors = [_travel(size[joint, side][-1], unit) for size in (before, after)]
    model = "model with its refitted numbers" if found.imperfections else "model"
    horizon = f"{1e3 * prediction.horizons[-1]:g} ms"
    sentence = f"Driven by the measured torque, the {model} errs by {errors[0]} after {horizon} at the worst angle"
    added = f"; with {added_causes(found.causes)} added, by {errors[1]}" if any(c.acts for c in found.causes) else ""
    return f"{sentence} ({joint}, {side}){added}."


def added_causes(causes: Sequence[Cause]) -> str:
    """Return in words which causes the prediction has that is made with them."""
    acting = [cause for cause in causes if cause.acts]
    if len(acting) == len(causes):
        return "the causes"
    return listed([effect_at(cause.effect, cause.joint) for cause in acting[:NAMED]], len(acting) - NAMED)


def _travel(value: float, unit: str) -> str:
    """Return an angle, or the travel of a prismatic joint, with the prefix that suits it."""
    prefix, factor = next(((p, f) for p, f in (("", 1.0), ("m", 1e3)) if value * f >= 1.0), ("µ", 1e6))
    return f"{value * factor:.3g} {prefix}{unit}"


def agreement_text(agreement: Agreement) -> str:
    """Return in words whether a cause is of one size in all recordings."""
    spread, showing = agreement.spread, sum(f.gain > 0.0 for f in agreement.findings)
    if not showing:
        return "cannot be compared over the recordings: it shows in none of them alone"
    if not agreement.comparable:
        return "cannot be compared over the recordings: each alone determines its size too poorly"
    apart = "more than their mean" if spread is None or spread >= 1.0 else f"up to {percent(spread)} of their mean"
    if agreement.agrees:
        # Closer values count as equal, however small their deviations are.
        why = ", within their deviations" if spread and spread >= AgreementSettings().alike else ""
        return f"agrees over the recordings: sizes differ by {apart}{why}" if spread else "agrees over the recordings"
    if showing < len(agreement.findings):
        return f"does not agree over the recordings: it shows in {showing} of {len(agreement.findings)} alone"
    doubt = ", which reduces its confidence" if agreement.odds > WORTH_A_LINE else ""
    return f"does not agree over the recordings: sizes differ by {apart}, beyond their deviations{doubt}"
