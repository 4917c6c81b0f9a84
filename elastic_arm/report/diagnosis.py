"""The report of a gap diagnosis: verdict first, then where, which, how far, what next."""

from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as MplFigure

from elastic_arm.diagnosis.comparison import SimulationComparison
from elastic_arm.diagnosis.context import DiagnosisContext
from elastic_arm.diagnosis.next_motion import DECISIVE
from elastic_arm.diagnosis.result import SEPARATING, Cause, Diagnosis, Imperfection
from elastic_arm.diagnosis.words import (
    REPEATED_MOTION,
    alone_text,
    cause_name,
    cause_size,
    change_text,
    effect_at,
    event_notes,
    left_text,
    listed_alternatives,
    log_likelihood_text,
    merged_notes,
    percent,
    prediction_sentence,
    probability_text,
    scale_sentence,
    share_at,
    sides_text,
    specific_first,
    summary,
    trust_text,
    unknown_sentences,
)
from elastic_arm.evidence.priors import TRUST
from elastic_arm.formatting import rounded
from elastic_arm.mujoco.replaying import Replay
from elastic_arm.report import diagnosis_figures as figures
from elastic_arm.report.comparison import sections as comparison_sections
from elastic_arm.report.html import (
    Block,
    Figure,
    Section,
    Table,
    Text,
    Written,
    fragment,
    write_report,
)
from elastic_arm.report.replay import sections as replay_sections

TONES = {"none": "good", "explained": "good", "unknown": "warn"}
DETERMINED = 0.7  # of the prior's standard deviation: the recording halves its variance
SHOWN = 4  # causes that get figures of their own
EQUATION = {
    "link": (
        "joint torque sensor against the torque that moves and supports the link",
        "tau_J − [M q″ + S theta″ + c + c1 + g]",
    ),
    "drive": (
        "joint torque sensor against the torsion of the drive",
        "tau_J − [K (theta − q) + D (theta′ − q′)]",
    ),
    "motor": (
        "motor torque against the motor's inertia and the joint torque",
        "tau_m − [Sᵀ q″ + B theta″ + c2] − tau_J",
    ),
}
# Of the motor side, where it is the only one: no sensor parts the motor from its link.
WHOLE = (
    "motor torque against the torque that moves and supports motor and link",
    "tau_m − [all terms of (1)]",
)


def write_gap_report(
    path: str | Path,
    found: Diagnosis,
    replays: Sequence[Replay] = (),
    comparison: SimulationComparison | None = None,
) -> Path:
    """Write the report of a diagnosis, with replays in MuJoCo and a comparison where there are any,
    as one file."""
    subtitle = f"{', '.join(found.identify) or 'a recording'} against {found.robot} ({found.model})"
    parts = sections(found)
    if replays:
        parts[2:2] = replay_sections(replays)
    if comparison is not None:
        parts[2:2] = comparison_sections(comparison)
    return write_report(path, "Gap diagnosis", parts, subtitle=subtitle)


def sections(found: Diagnosis) -> list[Section]:
    """Return the sections of the report, most important first."""
    context = found.context
    shown = [Section("Verdict", _verdict(found)), Section("Location of the gap", _where(found))]
    if context is not None:
        shown += [
            Section(figures.title(c), _cause(found, c, found.causes.index(c), context))
            for c in specific_first(found.causes)[:SHOWN]
        ]
        if places := figures.places_with_friction(context):
            shown.append(Section("Friction curves", _friction(found, context, places)))
        if found.unexplained:
            shown.append(Section("Unexplained residuals", _unexplained(found, context)))
    if found.proposal is not None:
        shown.append(Section("Next motion to record", _next(found)))
    sizes = Section(
        "Before and after" if found.causes else "The residuals", _sizes(found, context), folded=True
    )
    shown.append(sizes)
    if determined := _determined(found):
        shown.append(Section("Numbers of arm and sensors", _numbers(determined), folded=True))
    if found.prediction is not None:
        shown.append(Section("Prediction horizon", _prediction(found), folded=True))
    if context is not None:
        shown.append(
            Section("What the residuals depend on", [_regimes(found, context)], folded=True)
        )
    shown.append(Section("Basis of this diagnosis", _grounds(found), folded=True))
    return shown


def overview(found: Diagnosis) -> MplFigure:
    """Draw where the gap lies."""
    return figures.gap_map(found)


def head(found: Diagnosis) -> str:
    """Return the verdict as HTML."""
    return fragment(_verdict(found))


def _verdict(found: Diagnosis) -> list[Block]:
    blocks: list[Block] = [Text(f"Scale: {scale_sentence(found)}", "warn")] if found.made else []
    blocks.append(Text("\n".join(summary(found)), TONES[found.verdict]))
    if found.causes:
        rows: list[list[object]] = [
            [cause_name(c), c.joint or "whole arm", sides_text(c), cause_size(c),
             Written(alone_text(c)), Written(probability_text(c.confidence))]
            for c in specific_first(found.causes)
        ]  # fmt: skip
        header = ["cause", "where", "visible on", "size", "share of the gap", "probability"]
        blocks.append(Table(header, rows))
    if found.closed_loop:
        blocks.append(_closed_loop(found))
    blocks += [
        Text(f"Between recordings {change_text(change)}.", "warn") for change in found.changes
    ]
    if found.prediction is not None and found.prediction.before and found.causes:
        blocks.append(Text(prediction_sentence(found, found.prediction)))
    others: list[list[object]] = []
    for cause in found.causes:
        name = effect_at(cause.effect, cause.joint)
        likely, faint = listed_alternatives(cause)
        for a in likely:
            told = a.file or a.separated_by
            others.append(
                [name, effect_at(a.effect, a.joint), Written(probability_text(a.confidence)), told]
            )
        others += [[name, faint, "", ""]] if faint else []
    if others:
        header = ["named cause", "alternative", "probability", "separated by"]
        blocks.append(
            Table(header, others, "This recording does not separate these with certainty")
        )
    return blocks


def _closed_loop(found: Diagnosis) -> Table:
    """Return the errors of a commanded arm under the recorded commands."""
    rows: list[list[object]] = []
    for joint, one in found.closed_loop.items():
        sizes = (one.described, one.corrected, one.alone, one.refused)
        cells = ["" if size is None else f"{1e3 * size:.4g}" for size in sizes]
        rows.append([joint, *cells, f"m{one.unit}"])
    models = ["description", "robot.yaml", "corrected MJCF alone", "all corrections, rejected"]
    header = ["joint", *models, "unit"]
    return Table(
        header,
        rows,
        "Errors of angles in MuJoCo under the commands of the validation recordings, RMS",
    )


def _where(found: Diagnosis) -> list[Block]:
    sides = figures.shown_sides(found)
    equations = {1: "one equation", 2: "two equations", 3: "three equations"}[len(sides)]
    text = (
        f"Each joint has {equations} with one residual each: the measured value minus the"
        " value of the model. The map shows the residual relative to the noise of the sensors,"
        f" on validation data between 0 and {found.band:.3g} Hz: 1× is noise only, red is a"
        " gap."
    )
    rows = [[side, *(WHOLE if sides == ("motor",) else EQUATION[side])] for side in sides]
    blocks: list[Block] = [Text(text)]
    if found.causes and found.shrink is not None:
        low, high = found.shrink_interval or (np.nan, np.nan)
        share = percent(found.shrink)
        taken = f"reduce the gap by {share} (95 % interval {percent(low)} to {percent(high)})"
        taken = "increase the total gap" if share.startswith("-") else taken
        what = (
            f"All causes together {taken}, measured as power above the sensor noise on the"
            " validation recordings."
        )
        blocks.append(Text(what))
    return [
        *blocks,
        Figure(figures.gap_map(found)),
        Table(["side", "compares", "residual, Nm"], rows),
    ]


def _cause(found: Diagnosis, cause: Cause, k: int, context: DiagnosisContext) -> list[Block]:
    effect = cause.instance.effect
    row = _loudest(context, k)
    side = context.validate.layout.sides[row // len(found.joints)]
    joint = found.joints[row % len(found.joints)]
    caption = (
        f"{joint}, {side} side, on validation data. Grey: residual of the uncorrected model."
        " Orange: contribution of this cause. Blue: residual after adding only this cause."
        " Drag to zoom, double-click to reset."
    )
    return [
        Text(f"{effect.description} Law: {effect.formula}."),
        Text(f"Signature: {effect.signature}"),
        *figures.residual_blocks(
            found, context, row, context.alone[k], cause.effect, effect.regime
        ),
        Text(caption),
    ]


def _friction(found: Diagnosis, context: DiagnosisContext, places: Sequence[int]) -> list[Block]:
    text = (
        "Grey: friction by the validation data, after everything else that was found is removed."
        " Blue: friction of the model, which includes how it turns over after a reversal and how"
        " its curve bends."
    )
    return [Text(text), Figure(figures.friction_curves(found, context, places))]


def _unexplained(found: Diagnosis, context: DiagnosisContext) -> list[Block]:
    rows = [
        [p.joint, p.side, p.regime.replace("_", " "), left_text(p, found.units)]
        for p in found.unexplained
    ]
    first = found.unexplained[0]
    sides = context.validate.layout.sides
    n = len(found.joints)
    row = sides.index(first.side) * n + found.joints.index(first.joint)
    added = "all causes together" if found.causes else None
    caption = f"{first.joint}, {first.side} side: the place with the largest remaining residual."
    return [
        Text("Residuals that no effect of the catalogue explains, the largest first.", "warn"),
        *map(Text, unknown_sentences(found)),
        Table(["joint", "side", "follows", "left"], rows),
        *map(Text, event_notes(found.events)),
        Text(caption),
        *figures.residual_blocks(found, context, row, context.after, added),
    ]


def _determined(found: Diagnosis) -> list[Imperfection]:
    """Return the numbers of which the recordings say clearly more than their priors, as narrow as
    trust makes them."""
    trust = (
        TRUST[max(found.trust, key=lambda name: found.trust[name])].factor if found.trust else 1.0
    )
    return [one for one in found.imperfections if one.std < DETERMINED * trust * one.prior_std]


def _numbers(determined: Sequence[Imperfection]) -> list[Block]:
    text = (
        "Numbers of the description and of the sensors that the recording determines together"
        " with the causes."
    )
    rows = [
        [
            one.joint,
            _number(one),
            *map(Written, rounded(one.value, one.std)),
            one.unit.replace("1", ""),
            one.prior_std,
            one.ordinary,
        ]
        for one in determined
    ]
    header = ["joint", "number", "value", "± std", "unit", "prior std", "usual"]
    return [Text(text), Table(header, rows, digits=2)]


def _number(one: Imperfection) -> str:
    what = one.what.replace("_", " ")
    return what if one.recording is None else f"{what}, {one.recording} minus the first recording"


def _sizes(found: Diagnosis, context: DiagnosisContext | None) -> list[Block]:
    shown = {"": found.before}
    if found.causes:
        shown = {" before": found.before, " after": found.after}
    rows = []
    for joint, side in product(found.joints, figures.shown_sides(found)):
        if (joint, side) in found.before.rmse:
            rmse = [size.rmse[joint, side] for size in shown.values()]
            peak = [size.peak[joint, side] for size in shown.values()]
            share = share_at(found, joint, side)
            rows.append([joint, side, found.noise[joint, side], *rmse, *peak, share])
    header = [
        "joint",
        "side",
        "noise",
        *(f"rmse{when}" for when in shown),
        *(f"max{when}" for when in shown),
        "own gap",
    ]
    table = Table(
        header, rows, f"{found.units.over('Nm')}, validation data, 0 to {found.band:.3g} Hz", 3
    )
    if context is None:
        return [table]
    how = Text(
        "On the longest interval of validation data. Drag over a plot to zoom, double-click"
        " to reset."
    )
    return [table, how, *figures.before_and_after(found, context)]


def _prediction(found: Diagnosis) -> list[Block]:
    prediction = found.prediction
    if prediction is None or prediction.before is None or prediction.after is None:
        return [Text(f"Not available: {prediction.reason if prediction else ''}.", "warn")]
    text = (
        f"The simulation starts at {prediction.starts} times of the validation data from the"
        " measured state and is driven by the measured motor torque. The root mean square of"
        " predicted minus measured angle shows over which horizon the model can be trusted."
    )
    shown = {"": prediction.before}
    if any(cause.acts for cause in found.causes):
        shown = {", before": prediction.before, ", after": prediction.after}
    header = ["joint", "angle"]
    for horizon in prediction.horizons:
        header += [f"{1e3 * horizon:g} ms{when}" for when in shown]
    rows = []
    for joint, side in prediction.before:
        errors = np.array([size[joint, side] for size in shown.values()])
        rows.append([joint, side, *(1e6 * errors).T.ravel().tolist()])
    unit = found.units.over("µrad")
    drawing = Figure(figures.horizons(prediction, found.joints, unit))
    gone = [Text(prediction_sentence(found, prediction), "warn")] if prediction.reason else []
    return [Text(text), *gone, drawing, Table(header, rows, f"Prediction error, {unit}", 2)]


def _next(found: Diagnosis) -> list[Block]:
    proposal = found.proposal
    assert proposal is not None
    rows = [
        [
            effect_at(*pair.cause),
            effect_at(*pair.alternative),
            log_likelihood_text(pair.here),
            log_likelihood_text(pair.expected),
            pair.decides,
        ]
        for pair in proposal.pairs
    ]
    header = ["cause", "alternative", "this recording", "proposed motion", "expected to separate"]
    caption = (
        f"Log-likelihood ratio between the two; from {DECISIVE:g} the recording separates them"
    )
    table = Table(header, rows, caption)
    notes: list[Block] = [Text(f"Limits: {'; '.join(proposal.notes)}.")] if proposal.notes else []
    if proposal.trajectory is None or not proposal.worthwhile:
        text = (
            "No motion within the limits was found that is expected to separate these: another"
            " sensor is needed."
        )
        return [Text(text, "warn"), table, *notes]
    text = (
        f"Record this motion of {proposal.trajectory.duration:g} s, the best of"
        f" {proposal.candidates} candidates, and diagnose it: {SEPARATING}, for `elastic-arm"
        " simulate --trajectory` and the trajectory node."
    )
    return [Text(text), table, Figure(figures.motion(proposal.trajectory, found)), *notes]


def _regimes(found: Diagnosis, context: DiagnosisContext) -> Table:
    places = product(context.validate.layout.sides, found.joints)
    names = list(context.regimes[0])
    rows = []
    for (side, joint), shares in zip(places, context.regimes, strict=True):
        cells = [f"{100 * shares[name]:.0f} %" if shares[name] > 0.02 else "" for name in names]
        rows.append([joint, side, *cells])
    header = ["joint", "side", *(name.replace("_", " ") for name in names)]
    return Table(
        header,
        rows,
        "Share of the power of a residual, before, that each regime explains; shares overlap",
    )


def _grounds(found: Diagnosis) -> list[Block]:
    fitted = ", ".join(found.identify) or "the first two thirds"
    judged = ", ".join(found.validate) or "the last third"
    if found.context is not None and found.context.held_back:
        text = (
            f"Causes are selected on all of {fitted}, their sizes are estimated on the first two"
            " thirds, and the last third is used for validation."
        )
    else:
        text = (
            f"Causes are selected on all recordings, their sizes are estimated on {fitted}, and"
            f" the gap is measured on {judged}."
        )
    blocks: list[Block] = [
        Text(text),
        Text(f"Trust in the description: {trust_text(found.trust)}."),
    ]
    for note in merged_notes(found.notes):
        blocks.append(Text(note, "warn" if note == REPEATED_MOTION else "plain"))
    return blocks


def _loudest(context: DiagnosisContext, k: int) -> int:
    """Return the row in which a cause does most."""
    pairs = zip(context.before, context.alone[k], strict=True)
    removed = [((before - alone) ** 2).sum(axis=0) for before, alone in pairs]
    return int(np.argmax(np.sum(removed, axis=0)))
