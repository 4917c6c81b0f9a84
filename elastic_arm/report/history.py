"""The report of a history: what changed, and a plot of each number over the recordings."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as MplFigure

from elastic_arm.diagnosis.history import Course
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.diagnosis.words import effect_at, probability_text, step_text
from elastic_arm.report.html import Figure, Section, Table, Text, write_report
from elastic_arm.report.style import BLUE, VERMILION, drawing


def write_history_report(
    path: Path, found: Diagnosis, numbers: Sequence[Course], dates: Sequence[str]
) -> Path:
    """Write what changed of an arm over recordings, each number drawn over them, and notes.

    Raises an OutputError if the file cannot be written.
    """
    steps = [
        Text(f"Changed: {step_text(one, found.identify)}.", "warn")
        for one in numbers
        if one.step is not None
    ]
    rest = "No other changes" if steps else "No changes"
    sections = [Section("Changes", [*steps, Text(f"{rest} detected.", "good")])]
    for one in numbers:
        sized = one.sized
        caption = f"Bars: 95 % intervals. Probability of a change: {probability_text(one.changed)}."
        title = effect_at(sized.effect.replace("_", " "), sized.joint)
        sections.append(Section(title, [Figure(drawn(one, dates), caption)]))
    table = Table(["recording", "start, UTC"], list(zip(found.identify, dates, strict=True)))
    sections.append(Section("Recordings", [table, *map(Text, found.notes)], folded=True))
    return write_report(path, "History", sections, subtitle=f"{found.robot}, {found.model}")


def drawn(one: Course, dates: Sequence[str]) -> MplFigure:
    """Draw a number over the recordings, in order, with its levels before and after a change."""
    sized = one.sized
    k = np.arange(len(dates))
    with drawing(size=(8.4, 2.6)) as (figure, axes):
        ax = axes[0, 0]
        ax.errorbar(k, sized.values, 1.96 * sized.stds, fmt="o", color=BLUE, capsize=3)
        if (step := one.step) is not None:
            ends = [
                (-0.5, step.after + 0.5, step.before_value),
                (step.until - 0.5, len(k) - 0.5, step.after_value),
            ]
            for first, last, level in ends:
                ax.hlines(level, first, last, color=VERMILION)
        ax.set_xticks(k, [date.replace(" ", "\n") for date in dates], fontsize=7)
        ax.set_ylabel(f"{sized.parameter} [{sized.unit}]")
    return figure
