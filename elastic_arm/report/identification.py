"""Figures and sections of an identification's report."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure as MplFigure
from matplotlib.patches import Patch

from elastic_arm.arrays import Array
from elastic_arm.estimation.motion import Motion
from elastic_arm.formatting import rounded
from elastic_arm.identification import Estimate, Identification
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.result import COMPARED
from elastic_arm.identification.verdict import POORLY, WELL
from elastic_arm.report.html import Block, Figure, Section, Table, Text, Written, fragment
from elastic_arm.report.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    VERMILION,
    draw_signal,
    drawing,
    label_times,
)

COLOURS = {"well": GREEN, "poorly": ORANGE, "not": VERMILION}
VERDICTS = {
    "well": f"well determined, up to {WELL:.0%}",
    "poorly": f"poorly determined, up to {POORLY:.0%}",
    "not": "not determined",
}
GAPS = " Gaps: while a joint sticks, the torque is undetermined within its dry friction."


def identifiability(result: Identification) -> MplFigure:
    """Draw the relative standard deviation of each base parameter, worst at the top."""
    order = np.argsort([e.relative_std for e in result.estimates])
    chosen = [result.estimates[k] for k in order]
    with drawing(size=(8.4, 0.9 + 0.19 * len(chosen))) as (figure, axes):
        ax = axes[0, 0]
        widths = [max(min(e.relative_std, 1e3), 1e-9) for e in chosen]
        ax.barh(
            range(len(chosen)),
            widths,
            left=0,
            color=[COLOURS[e.verdict] for e in chosen],
            height=0.7,
        )
        ax.set_yticks(range(len(chosen)), [e.short for e in chosen], fontsize=6.5)
        ax.set_xscale("log")
        for limit in (WELL, POORLY):
            ax.axvline(limit, color=GREY, lw=1.0, ls="--")
        ax.set_xlabel("standard deviation relative to the usual size of the parameter")
        ax.set_ylim(-0.8, len(chosen) - 0.2)
        keys = [Patch(color=colour, label=VERDICTS[verdict]) for verdict, colour in COLOURS.items()]
        figure.legend(handles=keys, loc="outside upper center", ncols=len(keys))
    return figure


def overview(result: Identification) -> MplFigure:
    """Draw how well each parameter is determined."""
    return identifiability(result)


def head(result: Identification) -> str:
    """Return verdict and parameters as HTML, friction first."""
    return fragment(
        [*_verdict(result), _parameters(sorted(result.estimates, key=lambda e: not e.is_friction))]
    )


def torques(equations: BaseRegression, motion: Motion, result: Identification) -> MplFigure:
    """Draw measured torques, what the nominal and the identified arm predict, and what is left."""
    measured = equations.measured(motion)
    sides = [side for side in equations.sides if side != "link"] or list(equations.sides)
    nominal = _predicted(equations, motion, equations.described)
    found = _predicted(equations, motion, result.Psi_base)
    with drawing(
        equations.n, len(sides), size=(4.6 * len(sides), 1.7 * equations.n), sharex=True
    ) as (figure, axes):
        for column, side in enumerate(sides):
            for i, joint in enumerate(equations.joints):
                ax = axes[i, column]
                draw_signal(
                    ax,
                    motion.t,
                    measured[side][:, i],
                    color=GREY,
                    lw=2.4,
                    alpha=0.6,
                    label="measured",
                )
                draw_signal(
                    ax, motion.t, nominal[side][:, i], color=ORANGE, lw=0.9, label="nominal arm"
                )
                draw_signal(ax, motion.t, found[side][:, i], color=BLUE, lw=0.9, label="identified")
                ax.set_title(
                    f"{joint}, {COMPARED[side]} [{result.units.at(joint, 'Nm')}]", loc="left"
                )
        label_times(figure, axes, 3)
    return figure


def _predicted(equations: BaseRegression, motion: Motion, Psi_base: Array) -> dict[str, Array]:
    """Return what base parameters predict, side -> (N, n) Nm, with a gap where a joint sticks: no
    law states that."""
    predicted = equations.predict(motion, Psi_base)
    left_out = equations.left_out(motion)
    return {side: np.where(left_out[side], np.nan, values) for side, values in predicted.items()}


def residuals(equations: BaseRegression, motion: Motion, result: Identification) -> MplFigure:
    """Draw what the identified arm leaves, per joint and equation."""
    measured = equations.measured(motion)
    found = _predicted(equations, motion, result.Psi_base)
    with drawing(equations.n, 1, size=(8.4, 1.35 * equations.n), sharex=True) as (figure, axes):
        for i, joint in enumerate(equations.joints):
            for side, colour in zip(equations.sides, (BLUE, VERMILION, GREEN), strict=False):
                left = measured[side][:, i] - found[side][:, i]
                draw_signal(axes[i, 0], motion.t, left, color=colour, lw=0.7, label=COMPARED[side])
            axes[i, 0].set_title(f"{joint}, residual [{result.units.at(joint, 'Nm')}]", loc="left")
        label_times(figure, axes, 3)
    return figure


def sections(
    result: Identification, equations: BaseRegression | None = None, motion: Motion | None = None
) -> Sequence[Section]:
    """Return the report: verdict first, then parameters, fit and validation."""
    said: list[Section] = [Section("Information in the recording", _verdict(result))]
    laws = [e for e in result.estimates if e.is_friction]
    combinations = [e for e in result.estimates if not e.is_friction]
    if laws:
        said.append(Section("Friction and other effects", [_parameters(laws)]))
    said.append(
        Section(
            "Base parameters",
            [_parameters(combinations, "All parameter combinations that the equations determine.")],
        )
    )
    full = Table(
        ("parameter", "in full"), [[e.short, e.name] for e in combinations if e.name != e.short]
    )
    said.append(Section("Base parameters in full", [full], folded=True))
    caption = (
        "Dashed: limits above which a parameter counts as poorly determined and as not determined."
    )
    said.append(
        Section(
            "Accuracy of each parameter", [Figure(identifiability(result), caption)], folded=True
        )
    )
    if equations is not None and motion is not None:
        predicted = "Measured torques and predictions of both arms."
        left = "Residuals of the identified arm, in the band of the filter."
        gaps = "" if motion.stuck is None else GAPS
        drawn = [
            Figure(torques(equations, motion, result), predicted + gaps),
            Figure(residuals(equations, motion, result), left + gaps),
        ]
        said.append(Section("Fit", [_noise(result), *drawn]))
    else:
        said.append(Section("Fit", [_noise(result)]))
    if result.validation:
        said.append(Section("Validation on held-out recordings", [_validation(result)]))
    return said


def _verdict(result: Identification) -> list[Block]:
    open_ = any(e.verdict == "not" for e in result.estimates)
    blocks: list[Block] = [Text("\n".join(result.summary()), "warn" if open_ else "good")]
    if result.excitation["poor"]:
        reasons = "; ".join(result.excitation["reasons"])
        blocks.append(
            Text(
                f"Before the fit, the motion alone shows that the excitation is poor: {reasons}.",
                "bad",
            )
        )
    blocks += [
        Text(f"Not determined by the data: {direction}", "warn")
        for direction in result.undetermined
    ]
    blocks += [Text(sentence(note)) for note in result.notes]
    if result.consistency is not None:
        blocks.append(
            Text(
                "All parameters were completed such that every body is physically possible, with a"
                f" trust of {result.consistency['trust']:.0%} in the nominal arm (the value with"
                " the"
                " highest likelihood)."
            )
        )
    return blocks


def _parameters(estimates: Sequence[Estimate], caption: str = "") -> Table:
    header = ("parameter", "unit", "identified", "± std", "nominal", "determined")
    rows = [
        [
            e.short,
            e.unit.replace("^2", "²"),
            *map(Written, rounded(e.value, e.std)),
            e.nominal,
            e.verdict,
        ]
        for e in estimates
    ]
    return Table(header, rows, caption, digits=6)


def _noise(result: Identification) -> Table:
    rows = [
        [COMPARED[side], *map(by_joint.get, result.joints)]
        for side, by_joint in result.noise.items()
    ]
    how = (
        f"{result.samples:,} samples; derivatives: {', '.join(dict.fromkeys(result.derivatives))}; "
    )
    unit = result.units.over("Nm")
    caption = (
        how
        + f"condition number {result.condition:.3g}. Standard deviation of the residuals, {unit}."
    )
    return Table(("equation", *result.joints), rows, caption)


def _validation(result: Identification) -> Table:
    rows = [
        [recording, arm, COMPARED[side], *map(by_joint.get, result.joints)]
        for recording, arms in (result.validation or {}).items()
        for arm, by_side in arms.items()
        for side, by_joint in by_side.items()
    ]
    caption = f"Root of the mean square residual, {result.units.over('Nm')}."
    return Table(("recording", "arm", "equation", *result.joints), rows, caption)


def sentence(note: str) -> str:
    """Return a note as a sentence.

    A name of a file, recording or joint at its beginning stays as it is.
    """
    first = note.partition(" ")[0]
    return f"{note[:1].upper() if first.isalpha() else note[:1]}{note[1:]}.".replace("..", ".")
