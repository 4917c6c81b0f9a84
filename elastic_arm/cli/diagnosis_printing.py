"""A diagnosis on a terminal: sentences, tables of causes and gaps, and what to do next."""

from collections.abc import Sequence
from itertools import chain
from pathlib import Path

from rich.markup import escape

from elastic_arm.cli.console import err, new_table, out
from elastic_arm.diagnosis.comparison import SimulationComparison
from elastic_arm.diagnosis.first_look import FirstLook
from elastic_arm.diagnosis.result import SEPARATING, Cause, Diagnosis, Proposal
from elastic_arm.diagnosis.search_words import search_words
from elastic_arm.diagnosis.words import (
    alone_text,
    cause_name,
    cause_size,
    change_text,
    effect_at,
    gap_at,
    left_text,
    listed,
    listed_alternatives,
    log_likelihood_text,
    merged_notes,
    prediction_sentence,
    probability_text,
    regime_text,
    scale_sentence,
    sides_text,
    sizes_of,
    specific_first,
    summary,
    trust_text,
    unknown_sentences,
)
from elastic_arm.estimation.equation_sets import SIDES

ROBOT = "robot.yaml"
COLOURS = {"none": "green", "explained": "cyan", "unknown": "yellow"}


def print_first_look(look: FirstLook) -> None:
    """Print, before the search, where the gap lies and the friction of each joint, as progress."""
    effects = list(dict.fromkeys(chain.from_iterable(look.friction.values())))
    numbers = ("noise", "described", "fitted")
    table = new_table("joint", "side", *numbers, *effects, right=numbers, whole=("joint", "side"))
    for joint, side in look.described:
        place = joint, side
        sizes = [f"{one[place]:.3g}" for one in (look.noise, look.described, look.fitted)]
        own = look.friction.get(place, {})
        # The effect is the heading, and its one parameter needs no name.
        each = [", ".join(sizes_of(own.get(effect, {}))) for effect in effects]
        table.add_row(escape(joint), side, *sizes, *map(escape, each))
    err.print(
        f"first look, before the search: residuals, RMS in {look.units.over('Nm')}, as described"
        " and with a linear fit of ordinary deviations and friction"
    )
    err.print(table)


def print_diagnosis(found: Diagnosis) -> None:
    """Print what was found in words, then causes, changes, what is left, and notes."""
    if found.made:
        out.print(f"[yellow]scale:[/] {escape(scale_sentence(found))}")
    first, *more = summary(found)
    out.print(
        "[bold"
        f" {COLOURS[found.verdict]}]{found.verdict}[/]{escape(first.removeprefix(found.verdict))}"
    )
    for sentence in more:
        out.print(escape(sentence))
    if found.causes:
        _print_causes(specific_first(found.causes))
    if found.shrink_by_place:
        _print_places(found)
    for cause in found.causes:
        _print_alternatives(cause)
    for change in found.changes:
        out.print(f"[yellow]changed:[/] {escape(change_text(change))}")
    for place in found.unexplained:
        size = left_text(place, found.units)
        out.print(
            f"unexplained: {escape(place.joint)}, {place.side} side, {size}:"
            f" {regime_text(place.regime)}"
        )
    for sentence in unknown_sentences(found):
        out.print(f"what now: {escape(sentence)}")
    if found.prediction is not None and (found.causes or found.prediction.reason):
        out.print(f"prediction: {escape(prediction_sentence(found, found.prediction))}")
    if found.proposal is not None:
        _print_proposal(found.proposal)
    out.print(f"trust in the description: {escape(trust_text(found.trust))}")
    for note in merged_notes(found.notes):
        out.print(f"note: {escape(note)}")


def print_written(folder: Path) -> None:
    """Print the files that are there now."""
    further = [name for name in (ROBOT, SEPARATING) if (folder / name).exists()]
    out.print(
        f"written: {escape(str(folder))}/{', '.join(['diagnosis.json', 'report.html', *further])}"
    )


def _print_causes(causes: Sequence[Cause]) -> None:
    # On a screen a line for a parameter, the sides below the joint; in a pipe a line for a cause.
    where, between = (("joint, side",), "\n") if out.is_terminal else (("joint", "side"), ", ")
    numbers = ("gap", "probability")
    table = new_table(
        "cause", *where, "size", *numbers, right=numbers, whole=("cause", *where, *numbers)
    )
    for cause in causes:
        place = [escape(cause.joint or "whole arm"), sides_text(cause)]
        at = ["\n".join(place)] if out.is_terminal else place
        size = escape(cause_size(cause, between))
        shares = (alone_text(cause), probability_text(cause.confidence))
        table.add_row(escape(cause_name(cause)), *at, size, *shares)
    out.print(table)
    if any(cause.rejected for cause in causes):
        out.print("[dim]rejected: the arm moves worse with it in closed loop; it is not written[/]")
    out.print(
        "[dim]gap: share that this cause alone removes; probability: that the cause is present[/]"
    )


def _print_alternatives(cause: Cause) -> None:
    instead = f"alternative to {escape(effect_at(cause.effect, cause.joint))}:"
    likely, faint = listed_alternatives(cause)
    for other in likely:
        name = escape(effect_at(other.effect, other.joint))
        odds = probability_text(other.confidence)
        separator = escape(other.file or other.separated_by)
        out.print(f"{instead} {name} ({odds}); separated by: {separator}")
    if faint:
        out.print(f"{instead} {escape(faint)}")


def _print_places(found: Diagnosis) -> None:
    """Print how far the gap of each joint with a gap shrinks."""
    compared = {side for _, side in found.before.rmse}
    sides = [side for side in SIDES if side in compared]
    with_gap = {joint for (joint, _), share in found.shrink_by_place.items() if share is not None}
    apart = [joint for joint in found.joints if joint in with_gap]
    numbers = "as described → with ordinary deviations"
    sizes = "without → with causes" if found.causes else numbers
    if apart:
        shown = [f"{side} side" for side in sides]
        table = new_table("joint", *shown, right=shown, whole=("joint", *shown))
        for joint in apart:
            cells = [gap_at(found, joint, side) for side in sides]
            # On a screen the share stands below the sizes: three sides and a long name would not
            # fit otherwise.
            table.add_row(
                escape(joint),
                *(cell.replace(" (", "\n(") if out.is_terminal else cell for cell in cells),
            )
        out.print(
            f"residuals in {found.units.over('Nm')} below {found.band:.3g} Hz, {sizes} (removed"
            " share of the residual's own gap):"
        )
        out.print(table)
    if agreeing := [joint for joint in found.joints if joint not in apart]:
        out.print(f"no significant gap at {escape(listed(agreeing))}")


def print_comparison(comparison: SimulationComparison | None) -> None:
    """Print where a real and a simulated recording differ, and which effect is in which."""
    if comparison is None:
        return
    found = comparison.difference
    table = new_table("real − simulated, RMS", *found.joints, right=found.joints)
    for one in found.channels:
        pairs = zip(one.rms, one.share, strict=True)
        table.add_row(one.channel, *(f"{rms:.3g} ({100 * share:.2g} %)" for rms, share in pairs))
    out.print(table)
    for effect, place, where, real, simulated in comparison.rows():
        out.print(
            f"{escape(effect)}, {escape(place)}: in {where} ({escape(real)} / {escape(simulated)})"
        )


def _print_proposal(proposal: Proposal) -> None:
    for pair in proposal.pairs:
        names = " and ".join(effect_at(*place) for place in (pair.cause, pair.alternative))
        here = log_likelihood_text(pair.here)
        expected = log_likelihood_text(pair.expected)
        advice = f"no motion was found that separates {names}"
        if pair.decides:
            advice = f"record {SEPARATING} ({proposal.seconds:g} s) to separate {names}"
        out.print(
            f"next: {escape(advice)} (expected log-likelihood ratio {expected}; this recording:"
            f" {here})"
        )


def print_search(found: Diagnosis) -> None:
    """Print the search: the sets that were scored, what the best one lacks, and the moves."""
    if found.context is not None:
        for line in search_words(found.context.explanation, found.context.reasons):
            out.print(escape(line))


def print_also_written(names: Sequence[str]) -> None:
    """Print the files that were written because they were asked for."""
    if names:
        out.print(f"also written: {escape(', '.join(names))}")
