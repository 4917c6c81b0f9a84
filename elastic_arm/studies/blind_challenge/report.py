"""The report of a challenge: shares of right answers, and calibration of confidences."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure as MplFigure

from elastic_arm.report.html import Figure, Section, Table, write_report
from elastic_arm.report.style import BLUE, GREEN, GREY, VERMILION, drawing
from elastic_arm.studies.blind_challenge.score import (
    AT_MOST,
    EFFECT_HEADINGS,
    HEADINGS,
    challenge,
    effect_rows,
    table_rows,
    target,
)


def write_challenge_report(path: str | Path, found: Mapping[str, Any]) -> Path:
    """Write the report of a score as one HTML file."""
    sections = []
    for level, table in found["levels"].items():
        caption = "Shares with their 95 % intervals; mark: target."
        blocks: list[Any] = [
            Figure(shares(level, table), caption),
            Table(HEADINGS, table_rows(level, table)),
        ]
        if table["calibration"]:
            caption = (
                "All reported causes. On the dashed line, nine in ten causes with 0.9 are right."
            )
            blocks.append(Figure(reliability(table), caption))
        sections.append(Section(f"Level {level}", blocks))
    if found["by_effect"]:
        sections.append(Section("Results by effect", [Table(EFFECT_HEADINGS, effect_rows(found))]))
    subtitle = "; ".join(challenge(c) for c in found["challenges"])
    return write_report(path, "The challenge", sections, subtitle=subtitle)


def shares(level: str, table: Mapping[str, Any]) -> MplFigure:
    """Draw every share with its interval, and what is to be reached."""
    named = [(name, s) for name, s in table["shares"].items() if s["trials"]]
    with drawing(size=(8.6, 0.8 + 0.3 * len(named))) as (figure, axes):
        ax = axes[0, 0]
        for row, (name, s) in enumerate(named):
            wanted = target(name, level)
            colour = GREY
            if wanted is not None:
                good = s["share"] <= wanted if name in AT_MOST else s["share"] >= wanted
                colour = GREEN if good else VERMILION
            ax.plot(
                [100 * v for v in s["interval"]], [row, row], color=colour, linewidth=3, alpha=0.45
            )
            ax.plot(100 * s["share"], row, "o", color=colour)
            if wanted is not None:
                ax.plot(100 * wanted, row, "|", color="black", markersize=12, markeredgewidth=1.8)
        ax.set_yticks(
            range(len(named)), [f"{name}  ({s['hits']}/{s['trials']})" for name, s in named]
        )
        ax.invert_yaxis()
        ax.set(xlim=(-1, 101), xlabel="%, with 95 % binomial interval; mark: target")
    return figure


def reliability(table: Mapping[str, Any]) -> MplFigure:
    """Draw the share of causes that were right over the confidence that they were given."""
    with drawing(size=(4.6, 3.9)) as (figure, axes):
        ax = axes[0, 0]
        ax.plot([0, 1], [0, 1], color=GREY, linewidth=1.0, linestyle="--")
        for row in table["calibration"]:
            ax.plot(
                [row["mean_confidence"]] * 2, row["interval"], color=BLUE, alpha=0.4, linewidth=3
            )
            ax.plot(row["mean_confidence"], row["share"], "o", color=BLUE)
        ax.set(
            xlim=(0, 1.03),
            ylim=(0, 1.03),
            xlabel="confidence",
            ylabel="share of causes that were right",
        )
    return figure
