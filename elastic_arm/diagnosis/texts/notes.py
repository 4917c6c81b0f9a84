"""The notes of a diagnosis: what the reader should know besides, from each step."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from elastic_arm.diagnosis.settings import MOST_GAIN
from elastic_arm.diagnosis.texts.values import effect_at, estimates_text, log_likelihood_text, percent, size_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from elastic_arm.diagnosis.inference.estimates import Agreement, ParameterEstimate
    from elastic_arm.diagnosis.laws.general_laws import GeneralLaw
    from elastic_arm.diagnosis.result import Imperfection
    from elastic_arm.effects import EffectInstance
    from elastic_arm.estimation.effect_columns import Feature

REFITTED = (
    "The description's numbers and the sensors' gains, offsets and lags were determined from the recording together "
    "with the causes, each with a prior; an arm file with the causes has the refitted numbers."
)

COMMISSIONED = (
    "With an exact description the recording would need an unlikely number of causes, or has none. So the description "
    "was taken as that of an arm that was calibrated before: its numbers and the sensors' gains, offsets and "
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


def bare_note(joints: Sequence[str]) -> str:
    """Return the note on joints without a torque."""
    words = "without a torque, and so without an equation: nothing is said of what it alone would show"
    return f"{', '.join(joints)}: {words}."


def unseen_notes(instances: Sequence[EffectInstance], bare: Sequence[str]) -> list[str]:
    """Return notes on known effects that act in no torque that was recorded.

    Parameters
    ----------
    instances
        Those in no equation, as of the motor side where that was not recorded.
    bare
        The joints without a torque.
    """
    places: dict[str, dict[str, list[str]]] = {}
    for instance in instances:
        of_motor = "motor torque" if set(instance.sides) == {"motor"} else "channel that shows them"
        missing = "torque of the joint" if instance.joint in bare else of_motor
        places.setdefault(missing, {}).setdefault(instance.effect.id, []).append(str(instance.joint))
    found = []
    for missing, joints in places.items():
        names = "; ".join(effect_at(effect, ", ".join(at)) for effect, at in joints.items())
        found.append(f"Known, but not seen, as no {missing} was recorded: {names}. They stay as stated.")
    return found


def known_effect_note(feature: Feature, parameters: Mapping[str, ParameterEstimate]) -> str:
    """Return the note on what an effect that counts as part of the model came out as."""
    widths = {parameter.name: parameter.high - parameter.low for parameter in feature.effect.parameters}
    # As certain of any size that an arm can have.
    if any(np.any(np.array(one.std, dtype=float) > widths[name]) for name, one in parameters.items()):
        return f"Known: {_of_place(feature)}, whose size the recordings do not determine."
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
        f"{_of_place(feature)} would fit with {name} {size_text(estimate.value, estimate.std, estimate.unit)}, "
        "which no such arm has: it is no cause. The model or the channel map is wrong there, or an effect acts that "
        "the catalogue lacks."
    )


def wrong_unit_note(feature: Feature, gain: float, share: float) -> str:
    """Return the note on a torque channel that is the model's torque but for a factor that no sensor has.

    Parameters
    ----------
    feature
        The gain at its joint.
    gain, share
        Recorded over true torque, and the share of the residuals' squares there that it would take.
    """
    return (
        f"A {feature.effect.id} of {gain:.3g} at {feature.joint} would explain {percent(share)} of what is left there, "
        "and no sensor has it: check unit, sign and gear ratio of that channel."
    )


def refuted_note(
    effect: str, joint: str | None, place: str, law: GeneralLaw, gain: float, *, listed: bool = True
) -> str:
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
    listed
        Whether the cause is among those listed; numbers of the model and the sensors are not.
    """
    judged = "only stands in for a law that the catalogue lacks" if listed else "is no cause"
    return (
        f"{effect_at(effect, joint)} {judged}: a torque of {place} "
        f"({law.side}) as a smooth function of {law.argument} is likelier by {log_likelihood_text(gain)} nats."
    )


def differing_note(agreement: Agreement) -> str:
    """Return the note on what is no cause, as each recording has another size of it."""
    sizes = ", ".join(size_text(e.value, e.std) for finding in agreement.findings for e in finding.parameters.values())
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


def mixture_note(share: float, what: str, joint: str, sources: tuple[str, str]) -> str:
    """Return the note on recordings that no one arm explains, but arms of their own.

    Parameters
    ----------
    share
        Of what one arm leaves, that arms of their own explain.
    what, joint
        The number that differs most clearly.
    sources
        Two recordings between which it does.
    """
    return (
        f"The recordings are of different arms, or the arm was changed between them: arms of their own explain "
        f"{percent(share)} of what one arm leaves. Most clearly, {what} of {joint} differs between {sources[0]} and "
        f"{sources[1]}. Diagnose each by itself."
    )


def imperfection_notes(imperfections: Sequence[Imperfection]) -> list[str]:
    """Return a note on each number that is further off than ordinary arms are."""
    return [
        f"{one.what} of {one.joint} is {_in_recording(one)}{size_text(one.value, one.std, one.unit)}, "
        f"beyond what is ordinary (standard deviation {one.prior_std:.2g}).{_mistaken(one)}"
        for one in imperfections
        if not one.ordinary
    ]


def _mistaken(one: Imperfection) -> str:
    """Return the remedy where a channel reads another quantity more likely than its sensor has such a gain."""
    if not one.what.endswith("torque_gain") or 1.0 / MOST_GAIN <= one.value <= MOST_GAIN:
        return ""
    return (
        " Hardly any sensor is off by so much: check the unit, the gear ratio and the torque constant of this channel."
    )


def _of_place(feature: Feature) -> str:
    return f"{feature.effect.id} of {feature.joint or 'the whole arm'}"


def _in_recording(one: Imperfection) -> str:
    return "" if one.recording is None else f"in {one.recording}, less the first recording's, "
