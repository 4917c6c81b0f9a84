"""The words of a diagnosis: sentences, notes, and numbers as text."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from elastic_arm.effects import Effect
from elastic_arm.formatting import rounded

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from elastic_arm.diagnosis.inference.estimates import Agreement, ParameterEstimate
    from elastic_arm.diagnosis.inference.prediction import Prediction
    from elastic_arm.diagnosis.laws.general_laws import GeneralLaw
    from elastic_arm.diagnosis.result import Alternative, Cause, Diagnosis, Imperfection
    from elastic_arm.effects import EffectInstance
    from elastic_arm.estimation.effect_columns import Feature
    from elastic_arm.formatting import JointUnits

# Of the display, no decision of the diagnosis.
DOUBTFUL = 0.9  # of a cause's and its strongest alternative's confidence: with less, both are named
WORTH_A_LINE = 0.05  # probability of an alternative that has a line of its own
NAMED = 4  # causes that the verdict names
DOUBT = 0.001  # that stays with every confidence and every alternative
_SAME_EFFECT = "motion in which these joints move one at a time"
_FAINT = "all equations together show it, on motion that no fit has seen"
_OTHERWISE = "motion that covers more of the joint's range, speeds and loads, slowly and fast"

REFITTED = (
    "The description's numbers and the sensors' gains, offsets and lags were determined from the recording together "
    "with the causes, each with a prior; an arm file with the causes has the refitted numbers."
)
COMMISSIONED = (
    "With the description taken as exact, more causes than are likely explain the recording, or none. It was "
    "therefore taken as that of an arm that was calibrated before: its numbers and the sensors' gains, offsets and "
    "lags were determined together with the causes, each with a prior; an arm file with the causes has these numbers. "
    "Where the description is further off, add --refit."
)
PRIORS_UNUSED = "The stated priors were not used, as the description was taken as exact: add --refit to use them."
STICKING = (
    "While a joint sticks, its dry friction takes any value up to that of motion. As much more was left there than "
    "elsewhere, the torque of its motor was not used at these instants."
)
LOW_PASSED = (
    "residuals are compared below that, as the motion's torques are missing above, with noise of 0.5 % of the torque, "
    "as the recording shows none"
)
REPEATED_MOTION = "The validation data repeat the motion of the fit: it is not an independent motion."


def standing_note(joint: str) -> str:
    """Return the note on a joint that does not move."""
    return f"{joint} stands still: nothing can be said of what its motion would show."


def unseen_note(instances: Sequence[EffectInstance]) -> str:
    """Return the note on known effects that act on the motor side where that was not recorded."""
    joints: dict[str, list[str]] = {}
    for instance in instances:
        joints.setdefault(instance.effect.id, []).append(str(instance.joint))
    names = [effect_at(effect, ", ".join(places)) for effect, places in joints.items()]
    return f"Known, but not seen, as no motor torque was recorded: {'; '.join(names)}. They stay as stated."


def known_effect_note(feature: Feature, parameters: Mapping[str, ParameterEstimate]) -> str:
    """Return the note on what an effect that counts as part of the model came out as."""
    fitted = f", fitted with {estimates_text(parameters)}" if parameters else ""
    return f"Known: {_of_place(feature)}{fitted}."


def small_effect_note(feature: Feature, share: float, least: float) -> str:
    """Return the note on an effect that is there beyond doubt and too small to be a cause.

    Parameters
    ----------
    feature
        The effect at its place.
    share
        Of the gap.
    least
        Share from which it would be a cause.
    """
    return f"{_of_place(feature)} shows as well, {share:.2%} of the gap: less than {least:.0%} is no cause."


def impossible_size_note(feature: Feature, name: str, estimate: ParameterEstimate) -> str:
    """Return the note on an effect that fits with a size that no such arm has.

    Parameters
    ----------
    feature
        The effect at its place.
    name, estimate
        The parameter that is out of its range.
    """
    return (
        f"{_of_place(feature)} would fit with {name} {_size(estimate.value, estimate.std)}{_unit(estimate.unit)}, "
        "which no such arm has: it is no cause. The model or the channel map is wrong there, or an effect acts that "
        "the catalogue lacks."
    )


def refuted_note(effect: str, joint: str | None, place: str, law: GeneralLaw, gain: float) -> str:
    """Return the note on a cause that a law without a form explains better.

    Parameters
    ----------
    effect, joint
        The cause.
    place
        Joint on which the law acts.
    law
        Which.
    gain
        Nats by which it is likelier.
    """
    return (
        f"{effect_at(effect, joint)} only stands in for a law that the catalogue lacks: a torque of {place} "
        f"({law.side}) as a smooth function of {law.argument} is likelier by {log_likelihood_text(gain)} nats."
    )


def differing_note(agreement: Agreement) -> str:
    """Return the note on what is no cause, as each recording has another size of it."""
    sizes = ", ".join(_size(e.value, e.std) for finding in agreement.findings for e in finding.parameters.values())
    return f"{effect_at(agreement.effect, agreement.joint)} differs between the recordings ({sizes}): it is no cause."


def crude_note(feature: Feature) -> str:
    """Return the note on a number beyond ordinary of a description that is likelier to be off everywhere."""
    return (
        f"{_of_place(feature)} is no cause: likelier, the whole description is further off than is ordinary. "
        "Wider --priors of the arm's numbers state it."
    )


def unlike_noise_note(joint: str, side: str, power: float) -> str:
    """Return the note on a residual that neither an effect nor the sensors' noise explains.

    Parameters
    ----------
    joint, side
        Where.
    power
        How many times that of the noise.
    """
    return (
        f"What is left at {joint} ({side}) beside all effects has up to {power:.2g} times the power of its sensor's "
        "noise, as the other joints' sensors have it: something acts there that the catalogue lacks, or that sensor "
        "is worse than the others."
    )


def general_law_note(place: str, law: GeneralLaw, gain: float) -> str:
    """Return the note on what is left beside the causes and follows a law that the catalogue lacks.

    Parameters
    ----------
    place
        Joint on which the law acts.
    law
        Which.
    gain
        Nats that it adds.
    """
    return (
        f"A torque of {place} ({law.side}) as a smooth function of {law.argument} explains "
        f"{log_likelihood_text(gain)} nats of what is left: no effect of the catalogue does."
    )


def _of_place(feature: Feature) -> str:
    return f"{feature.effect.id} of {feature.joint or 'the whole arm'}"


def separated_by(effect: Effect, other: Effect, joint: str | None, other_joint: str | None) -> str:
    """Return the motion that would discriminate between two effects, from the catalogue where it holds one.

    Parameters
    ----------
    effect, other
        The two.
    joint, other_joint
        Where they act; None for the whole arm.
    """
    for one, two in ((effect, other), (other, effect)):
        for confusion in one.confusions:
            if confusion.effect == two.id:
                return confusion.separated_by
    return _SAME_EFFECT if effect.id == other.id and joint != other_joint else _OTHERWISE


def verdict_sentence(found: Diagnosis) -> str:
    """Return the verdict as a sentence."""
    if found.verdict == "none":
        return "recording and model agree within the noise of the sensors."
    if not found.causes:
        places = ", ".join(f"{p.joint} ({p.side})" for p in found.unexplained[:3])
        return f"there is a gap, but no effect of the catalogue explains it; it is largest at {places}."
    named = _listed([_with_rival(cause) for cause in found.causes[:NAMED]], len(found.causes) - NAMED)
    verb = "explains" if len(found.causes) == 1 else "explain"
    if found.verdict == "explained" and found.measured_by == "likelihood":
        return f"{named} {verb} a gap that is fainter than the noise of every residual: {_FAINT}."
    if found.verdict == "explained":
        return f"{named} {verb} {percent(found.shrink)} of the gap on motion that no fit has seen."
    return f"{named} {verb} {percent(found.shrink)} of the gap; what is left has another cause."


def _with_rival(cause: Cause) -> str:
    """Return a cause by name, with the strongest alternative where the recording leaves it in doubt."""
    name = effect_at(cause.effect, cause.joint)
    other = max(cause.alternatives, key=lambda a: a.confidence, default=None)
    # Of an incomplete hypothesis all confidences are low: what counts is one against the other.
    if other is None or cause.confidence >= DOUBTFUL * (cause.confidence + other.confidence):
        return name
    return f"{name} (or {effect_at(other.effect, other.joint)}: this recording does not separate them)"


def effect_at(effect: str, joint: str | None) -> str:
    """Return an effect with its place."""
    return f"{effect} on {joint or 'the whole arm'}"


def _listed(names: list[str], more: int) -> str:
    names = [*names, f"{more} more"] if more > 0 else names
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def estimates_text(parameters: Mapping[str, ParameterEstimate], between: str = ", ") -> str:
    """Return parameters with standard deviations and units as text; what is whole or given has no deviation."""
    return between.join(f"{name} {_size(e.value, e.std)}{_unit(e.unit)}" for name, e in parameters.items())


def cause_size(cause: Cause, between: str = ", ") -> str:
    """Return a cause's parameters, and the channels it acts in, as text, with `between` between them."""
    chosen = [cause.instance.parameters[c.name] for c in cause.instance.effect.choices if c.several]
    parts = [estimates_text(cause.parameters, between), *(_chosen(value) for value in chosen)]
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


def listed_alternatives(cause: Cause) -> tuple[list[Alternative], str]:
    """Return the alternatives that are worth a line each, and the others summed up in words, empty for none."""
    likely = [other for other in cause.alternatives if other.confidence >= WORTH_A_LINE]
    faint = [other for other in cause.alternatives if other.confidence < WORTH_A_LINE]
    if len(faint) < 2:
        return [*likely, *faint], ""
    names = _listed([effect_at(other.effect, other.joint) for other in faint[:NAMED]], len(faint) - NAMED)
    return likely, f"{names} ({probability_text(sum(other.confidence for other in faint))} together)"


def instance_text(instance: EffectInstance) -> str:
    """Return all that an effect was given, with units."""
    numbers = [f"{p.name} {_size(instance.parameters[p.name], 0.0)}{_unit(p.unit)}" for p in instance.effect.parameters]
    choices = [f"{c.name} {_chosen(instance.parameters[c.name])}" for c in instance.effect.choices]
    return ", ".join([*numbers, *choices])


def _chosen(value: object) -> str:
    return " and ".join(value) if isinstance(value, tuple) else str(value)


def _size(value: Any, std: Any) -> str:
    """Return a number, or a vector of them, with the digits that its standard deviation warrants."""
    vector = isinstance(value, list | tuple)
    values = list(value) if vector else [value]
    stds = list(std) if isinstance(std, list | tuple) else [std] * len(values)
    parts = zip(*(_pair(v, s) for v, s in zip(values, stds, strict=True)), strict=True)
    number, deviation = (f"({', '.join(part)})" if vector else part[0] for part in parts)
    return number if all(s == 0.0 for s in stds) else f"{number} ± {deviation}"


def _pair(value: float, std: float | None) -> tuple[str, str]:
    return (f"{value:.4g}", "?") if std is None else rounded(value, std)


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"


def percent(share: float | None) -> str:
    """Return a share of the gap as text; none is zero."""
    return f"{round(100 * (share or 0.0), 1) + 0.0:.1f} %"  # + 0.0: no "-0.0"


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
    sizes = [size.rmse[place] for size in ((found.before, found.after) if found.causes else (found.before,))]
    return f"{' → '.join(f'{size:.3g}' for size in sizes)} ({share_at(found, joint, side)})"


def share_at(found: Diagnosis, joint: str, side: str) -> str:
    """Return the share of a residual's own gap that is gone, as text.

    Parameters
    ----------
    found
        The diagnosis.
    joint, side
        Which residual.
    """
    share = found.shrink_by_place.get((joint, side))
    if share is None or not found.causes:
        return "no clear gap" if share is None else "gap"
    return "larger" if percent(share).startswith("-") else f"{percent(share)} gone"


def probability_text(probability: float) -> str:
    """Return a probability as text that never claims certainty."""
    if not DOUBT <= probability <= 1.0 - DOUBT:
        return f"< {percent(DOUBT)}" if probability < DOUBT else f"> {percent(1.0 - DOUBT)}"
    return f"{100 * probability:.{0 if 0.01 <= probability <= 0.99 else 1}f} %"


def negative_shrink_note(causes: Sequence[Cause]) -> str:
    """Return what a share below zero means, where one of the causes has such a share alone."""
    if all(percent(cause.shrink)[0] != "-" for cause in causes):
        return ""
    return "Only beside others: alone such a cause makes the gap larger."


def prediction_sentence(prediction: Prediction, units: JointUnits) -> str:
    """Return in a sentence how far the prediction error of the worst angle falls, or why that is not known."""
    before, after = prediction.before or {}, prediction.after or {}
    if prediction.reason:
        return f"{prediction.reason[0].upper()}{prediction.reason[1:]}."
    joint, side = max(before, key=lambda place: before[place][-1])
    unit = units.at(joint, "rad")
    errors = [_travel(size[joint, side][-1], unit) for size in (before, after)]
    horizon = f"{1e3 * prediction.horizons[-1]:g} ms"
    return (
        f"Driven by the measured torque, the model errs by {errors[0]} after {horizon} at the worst angle "
        f"({joint}, {side}); with the causes added, by {errors[1]}."
    )


def _travel(value: float, unit: str) -> str:
    """Return an angle, or the travel of a prismatic joint, with the prefix that suits it."""
    prefix, factor = next(((p, f) for p, f in (("", 1.0), ("m", 1e3)) if value * f >= 1.0), ("µ", 1e6))
    return f"{value * factor:.3g} {prefix}{unit}"


def agreement_text(agreement: Agreement) -> str:
    """Return in words whether a cause is of one size in all recordings."""
    spread = agreement.spread
    if not agreement.comparable:
        return "cannot be compared over the recordings: each alone determines its size too poorly"
    if agreement.agrees:
        return "agrees over the recordings" + (f": sizes within {percent(spread)} of their mean" if spread else "")
    absent = [f for f in agreement.findings if not f.gain > 0.0]
    if absent:
        return f"does not agree over the recordings: it shows in {len(agreement.findings) - len(absent)} of them alone"
    apart = "more than their mean" if spread is None or spread >= 1.0 else f"up to {percent(spread)} of their mean"
    doubt = ", which reduces its confidence" if agreement.odds > WORTH_A_LINE else ""
    return f"does not agree over the recordings: sizes differ by {apart}{doubt}"


def log_likelihood_text(value: float) -> str:
    """Return a log-likelihood with two digits; differences below a tenth are none."""
    large = f"{float(f'{value:.2g}'):,.0f}".replace(",", "\u202f")
    return "0" if value < 0.1 else f"{value:.2g}" if value < 100 else large


def imperfection_notes(imperfections: Sequence[Imperfection]) -> list[str]:
    """Return a note on each number that is further off than ordinary arms are."""
    return [
        f"{one.what} of {one.joint} is {_in_recording(one)}{_size(one.value, one.std)}{_unit(one.unit)}, "
        f"beyond what is ordinary (standard deviation {one.prior_std:.2g})."
        for one in imperfections
        if not one.ordinary
    ]


def _in_recording(one: Imperfection) -> str:
    return "" if one.recording is None else f"in {one.recording}, less the first recording's, "
