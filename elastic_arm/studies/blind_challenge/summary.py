"""Tables of a score, for the terminal, the report and the documents alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from elastic_arm.studies.blind_challenge.levels.table import LEVEL_HEADINGS, table_rows
from elastic_arm.studies.blind_challenge.scoring import TARGET_SECONDS, TARGET_SHRINK, TARGETS

QUESTIONS = ("question", "right", "of", "share", "95 % interval", "to reach")
EFFECTS = (
    "effect", "right", "joint", "side", "alone", "intervals", "shrink", "missed at", "90 % detected at", "bound",
)  # fmt: skip
SIMULATED = "moved by the suite's own simulator, which shares their laws with the diagnosis and so flatters it: {}"
CALIBRATION = ("confidence", "mean", "right", "share", "95 % interval")
PAGE = """# Results of the challenge

Written by `elastic-arm challenge score`; how it is run again: [challenge.md](challenge.md).

{challenges}
- {answers}
{simulated}
{questions}

## Single effects

Of at least ten times the bound. *Missed at*: the largest multiple of the bound that was missed.
*90 % detected at*: multiple of the bound with its 95 % interval, and the size that this is at the typical bound; where
nothing was missed, what the number of cases allows to say.

{effects}

## Each effect taken out of the catalogue

{withheld}

## Causes that no arm had

{false_causes}

## Confidence, and the share of causes that were right

{calibration}
"""
WITHHELD = ("withheld", "unknown where due", "explained by others", "by", "said instead of unknown")


def question_rows(found: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return a row a question, as text."""
    rows: list[tuple[str, ...]] = [
        (name, str(s["hits"]), str(s["trials"]), percent(s["share"]), interval(s), _target(TARGETS.get(name)))
        for name, s in found["shares"].items()
        if s["trials"]
    ]
    below = found["below"]["effect right"]
    if below["trials"]:
        rows.append(("effect right, below ten bounds", *_counts(below), ""))
    if found["median_shrink"] is not None:
        without = f" ({found['faint']} faint gaps apart)" if found["faint"] else ""
        shrink = f"{found['median_shrink']:.4f}"
        rows.append((f"median shrink, single effects{without}", "", "", shrink, "", f"{TARGET_SHRINK}"))
    if found["seconds"]:
        text = f"{found['seconds']['median']:.1f} s, longest {found['seconds']['longest']:.1f} s"
        rows.append(("a diagnosis, one core", "", "", text, "", f"{TARGET_SECONDS:g} s"))
    return rows


def effect_rows(found: dict[str, Any]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return headings, and a row an effect, as text."""
    rows = []
    for effect, row in found["by_effect"].items():
        detected = row["detected"]
        rows.append(
            (
                effect,
                *(_of(row[q]) for q in ("effect right", "joint right", "side right", "no false cause beside")),
                _of(row["intervals cover"]),
                "–" if row["median shrink"] is None else f"{row['median shrink']:.3f}",
                "–" if row["largest multiple missed"] is None else f"{row['largest multiple missed']:.0f}",
                _detected(detected, row["unit"]),
                "–" if row["bound"] is None else quantity(row["bound"], row["unit"]),
            )
        )
    return EFFECTS, rows


def withheld_rows(found: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return a row an effect that was taken out of the catalogue, as text."""
    return [
        (
            effect,
            _of(r["unknown where due"]),
            str(r["explained by others"]),
            _list(r["by whom"]),
            _list(r["instead of unknown"]),
        )
        for effect, r in found["withheld"].items()
    ]


LEVEL = """## Level {level}

{challenges}
- {answers}

{table}

Effects of no catalogue, and what was said: {foreign}.

Missed: {missed}.
"""


def of_levels_alone(found: dict[str, Any]) -> bool:
    """Whether nothing of the laboratory was answered."""
    return bool(found["levels"]) and all("level" in x for x in found["items"])


def level_sections(found: dict[str, Any]) -> str:
    """Return a section for each level but the laboratory, as part of a document."""
    states = ", ".join(str(state) for state in found["code"])
    return "\n".join(
        LEVEL.format(
            level=level,
            challenges="\n".join(f"- {challenge(c)}" for c in found["challenges"] if c.get("level") == level),
            answers=f"state of the code: {states}",
            table=_table(LEVEL_HEADINGS, table_rows(level, tables)),
            foreign=_said(tables["diagnosis"]["foreign"]),
            missed=_said(tables["diagnosis"]["missed"]),
        )
        for level, tables in found["levels"].items()
    )


def _said(answers: dict[str, list[str]]) -> str:
    """Return what each arm had, and the verdict with the causes."""
    return "; ".join(f"{name}: {', '.join(what)}" for name, what in answers.items()) or "none"


def markdown(found: dict[str, Any]) -> str:
    """Return the tables as a document."""
    if of_levels_alone(found):
        return level_sections(found)
    states = ", ".join(str(state) for state in found["code"])
    return PAGE.format(
        challenges="\n".join(f"- {challenge(c)}" for c in found["challenges"]),
        answers=f"{found['answered']} answers, {found['open']} open; state of the code: {states}",
        simulated=f"- {SIMULATED.format(', '.join(own))}\n" if (own := found.get("simulated")) else "",
        questions=_table(QUESTIONS, question_rows(found)),
        effects=_table(*effect_rows(found)),
        withheld=_table(WITHHELD, withheld_rows(found)) if found["withheld"] else "Not run.",
        false_causes="\n".join(f"- {where}: {_list(counts)}" for where, counts in found["false_causes"].items()),
        calibration=_table(CALIBRATION, calibration_rows(found)),
    ) + (f"\n{sections}" if (sections := level_sections(found)) else "")


def calibration_rows(found: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return a row a bin of confidences, as text."""
    return [
        (f"{r['from']:g} to {r['to']:g}", f"{r['mean_confidence']:.3f}", _of(r), percent(r["share"]), interval(r))
        for r in found["calibration"]
    ]


def challenge(settings: dict[str, Any]) -> str:
    """Return what a challenge consists of, in a line."""
    kinds = ("per_effect", "clean", "pairs", "triples", "foreign")
    counts = ", ".join(f"{settings[k]} {k.replace('_', ' ')}" for k in kinds if settings.get(k))
    low, high = settings["ratio"]
    return (
        f"seed {settings['seed']}: {counts}; {settings['seconds']:g} + {settings['validate_seconds']:g} s, sizes "
        f"{low:g} to {high:g} bounds{', only ' + ', '.join(settings['effects']) if settings['effects'] else ''}; "
        f"truth {settings['truth_sha256'][:12]}"
    )


def percent(share: float | None) -> str:
    """Return a share as text."""
    return "–" if share is None else f"{100 * share:.4g} %" if share == 1.0 else f"{100 * share:.1f} %"


def interval(share: dict[str, Any]) -> str:
    """Return a share's interval as text."""
    return "–" if share["interval"] is None else " to ".join(percent(v) for v in share["interval"])


def quantity(value: float, unit: str | None) -> str:
    """Return a number with its unit."""
    return f"{value:.2g}" + (f" {unit}" if unit and unit != "1" else "")


def _counts(share: dict[str, Any]) -> tuple[str, str, str, str]:
    return str(share["hits"]), str(share["trials"]), percent(share["share"]), interval(share)


def _of(share: dict[str, Any]) -> str:
    return f"{share['hits']}/{share['trials']}" if share["trials"] else "–"


def _target(value: float | None) -> str:
    return "" if value is None else percent(value)


def _list(counts: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items()) or "–"


def _detected(detected: dict[str, Any] | None, unit: str | None) -> str:
    if detected is None:
        return "–"
    low, high = detected["interval"]
    size = "" if detected["size"] is None else f" = {quantity(detected['size'], unit)}"
    if not detected["misses"]:
        return f"below {_multiple(high)}"
    return f"{_multiple(detected['multiple'])} ({_multiple(low)} to {_multiple(high)}){size}"


def _multiple(value: float) -> str:
    return f"{value:.0f}" if value >= 10.0 else f"{value:.1f}"


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
