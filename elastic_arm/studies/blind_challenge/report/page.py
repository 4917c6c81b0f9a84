"""The report of a challenge: what was reached, per effect, in tables and pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from elastic_arm.report.html import Block, Figure, Section, Table, Text, write_report
from elastic_arm.studies.blind_challenge import summary
from elastic_arm.studies.blind_challenge.levels.table import LEVEL_HEADINGS, table_rows
from elastic_arm.studies.blind_challenge.report import figures
from elastic_arm.studies.blind_challenge.scoring import TARGET_SECONDS, TARGET_SHRINK, TARGETS


def write_challenge_report(path: str | Path, found: dict[str, Any]) -> Path:
    """Write the report of a score as one HTML file."""
    subtitle = "; ".join(summary.challenge(c) for c in found["challenges"])
    return write_report(path, "The challenge", sections(found), subtitle=subtitle)


def sections(found: dict[str, Any]) -> list[Section]:
    """Return the sections of the report, most important first."""
    told = [_level(level, tables) for level, tables in found["levels"].items()]
    if summary.of_levels_alone(found):
        return told
    told.append(Section("What was reached", _reached(found)))
    if found["confusion"]:
        caption = "Single effects of at least ten times the bound. Red numbers: an effect taken for another."
        told.append(Section("What was named for what", [Figure(figures.confusion(found), caption), _false(found)]))
    if found["by_effect"]:
        told.append(Section("Effect by effect", [Table(*summary.effect_rows(found))]))
        told.append(Section("How small an effect may be", [Figure(figures.detection(found), DETECTION)]))
        caption = "Single effects; blue: named rightly, red: not. Validation data, over the residuals with a gap."
        told.append(Section("How far the gap shrinks", [Figure(figures.shrinkage(found), caption)]))
    if found["calibration"]:
        rows = summary.calibration_rows(found)
        blocks: list[Block] = [Figure(figures.calibration(found), CALIBRATION), Table(summary.CALIBRATION, rows)]
        told.append(Section("What a confidence is worth", blocks))
    if found["withheld"]:
        rows = summary.withheld_rows(found)
        shown: list[Block] = [Figure(figures.withheld(found), WITHHELD), Table(summary.WITHHELD, rows)]
        told.append(Section("Effects that were not in the catalogue", shown))
    return told


def _level(level: str, tables: dict[str, Any]) -> Section:
    rows = table_rows(level, tables)
    return Section(f"Level {level}", [Figure(figures.level_shares(level, tables), LEVEL), Table(LEVEL_HEADINGS, rows)])


LEVEL = "Shares with their 95 % intervals; blue: the diagnosis, orange: least squares and BIC; black: to reach."
DETECTION = (
    "The bound is the smallest size that theory allows to be known on the arm's own motion, all else known. Dots: "
    "arms; grey: fitted share; orange: the size found in 90 % of cases, and its 95 % interval. No curve where none was "
    "missed."
)
CALIBRATION = (
    "Every cause that was reported, on all arms. On the dashed line, of causes with 0.9 nine in ten are right."
)
WITHHELD = "Each arm diagnosed again, its own effect taken out of the catalogue. The right answer is then: unknown."


def _reached(found: dict[str, Any]) -> list[Block]:
    missed = [n for n, t in TARGETS.items() if (s := found["shares"][n])["trials"] and s["share"] < t]
    if found["median_shrink"] is not None and found["median_shrink"] < TARGET_SHRINK:
        missed.append("median shrink")
    if found["seconds"] and found["seconds"]["longest"] > TARGET_SECONDS:
        missed.append(f"{TARGET_SECONDS:g} s a diagnosis, at the longest")
    verdict = Text(f"Not reached: {', '.join(missed)}.", "warn") if missed else Text("All targets are reached.", "good")
    count = f"{found['answered']} arms are answered, {found['open']} are not yet."
    blocks: list[Block] = [verdict, Text(count)] if found["open"] else [verdict]
    return [*blocks, Figure(figures.shares(found)), Table(summary.QUESTIONS, summary.question_rows(found))]


def _false(found: dict[str, Any]) -> Table:
    places = {"clean": "on clean arms", "beside": "beside the true one", "instead": "instead of the true one"}
    rows = [
        [place, sum(causes.values()), ", ".join(f"{effect} {count}" for effect, count in causes.items())]
        for place, causes in ((places[k], found["false_causes"][k]) for k in places)
    ]
    return Table(["causes that no arm had", "number", "which"], rows)
