"""The table of a level: what was reached, what is to be reached, and what the baseline reaches on the same arms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from elastic_arm.studies.blind_challenge.answer_scoring import is_faint
from elastic_arm.studies.blind_challenge.levels.answers import KINDS, Line, expected_unknown
from elastic_arm.studies.blind_challenge.levels.level import FIELD, WORKSHOP
from elastic_arm.studies.blind_challenge.proportions import Proportion, calibration

# To reach, workshop and field; at most where the question counts what is wrong.
TARGETS = {
    "effect right": (0.93, 0.80),
    "joint right": (0.95, 0.85),
    "nothing more than ordinary: no cause": (0.98, 0.97),
    "arms with a false cause at confidence 0.9": (0.01, 0.01),
    "withheld or foreign: unknown": (0.90, 0.85),
    "two at once, both right": (0.80, 0.60),
}
AT_MOST = ("arms with a false cause at confidence 0.9",)
COVERAGE = "intervals of {} cover"
NOMINAL = 0.95
LEVEL_HEADINGS = ("question", "reached (95 % interval)", "to reach", "least squares and BIC")
COLUMNS = {WORKSHOP.name: 0, FIELD.name: 1}


def level_table(lines: Sequence[Line], withheld: Sequence[Line]) -> dict[str, Any]:
    """Return the shares of one level's answers by question, with their intervals."""
    foreign = [x for x in lines if x["foreign"]]
    own = [x for x in lines if not x["foreign"]]
    single = [x for x in own if len(x["truth"]) == 1 and x["visible"]]
    pairs = [x for x in own if len(x["truth"]) == 2]
    due = [x["unknown"] for x in withheld if x["due"]]
    shares = {
        "effect right": Proportion.of([x["effect_right"] for x in single]),
        "joint right": Proportion.of([x["joint_right"] for x in single]),
        "nothing more than ordinary: no cause": Proportion.of([x["no_cause"] for x in own if not x["truth"]]),
        "arms with a false cause at confidence 0.9": Proportion.of([x["accused"] for x in lines]),
        "withheld or foreign: unknown": Proportion.of([*due, *(expected_unknown(x) for x in foreign)]),
        "two at once, both right": Proportion.of([x["effect_right"] for x in pairs if not is_faint(x)]),
        "two at once, one of them faint": Proportion.of([x["effect_right"] for x in pairs if is_faint(x)]),
        "effect right, below ten bounds": Proportion.of(
            [x["effect_right"] for x in own if len(x["truth"]) == 1 and not x["visible"]]
        ),
    }
    for kind in KINDS:
        held = np.sum([x["coverage"][kind] for x in own] or [[0, 0]], axis=0)
        shares[COVERAGE.format(kind)] = Proportion(int(held[0]), int(held[1]))
    told = [(c, r) for x in lines for c, r in zip(x["confidence"], x["cause_right"], strict=True)]
    return {
        "shares": {name: share.to_dict() for name, share in shares.items()},
        "calibration": calibration([c for c, _ in told], [r for _, r in told]),
        "seconds": {n: _seconds([x for x in lines if x["joints_of_arm"] == n]) for n in sorted(_sizes(lines))},
        "foreign": {x["name"]: [*x["foreign"], x["verdict"], *x["named"]] for x in foreign},
        "missed": {
            x["name"]: [*x["truth"], x["verdict"], *x["named"]] for x in own if x["truth"] and not x["effect_right"]
        },
    }


def table_rows(level: str, tables: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return the rows of a level's table as text: question, what was reached, to reach, and the baseline."""
    own, baseline = tables["diagnosis"], tables.get("baseline")
    rows: list[tuple[str, ...]] = []
    for name, share in own["shares"].items():
        other = {"trials": 0} if baseline is None else baseline["shares"][name]
        if share["trials"] or other["trials"]:
            rows.append((name, _share(share), _target(name, level), _share(other)))
    for row in own["calibration"]:
        found = [r for r in (baseline or {"calibration": ()})["calibration"] if r["from"] == row["from"]]
        name = f"causes of confidence {row['from']:g} to {row['to']:g} (mean {row['mean_confidence']:.2f}) right"
        rows.append((name, _share(row), "", _share(found[0]) if found else "–"))
    for n, seconds in own["seconds"].items():
        other = "–" if baseline is None or n not in baseline["seconds"] else _time(baseline["seconds"][n])
        rows.append((f"a diagnosis of {n} joints, one core", _time(seconds), _limit(int(n)), other))
    return rows


def level_target(name: str, level: str) -> float | None:
    """Return the share that is to be reached; None where none is stated."""
    if name in TARGETS:
        return TARGETS[name][COLUMNS[level]]
    return NOMINAL if name.startswith("intervals") else None


def _sizes(lines: Sequence[Line]) -> set[int]:
    return {x["joints_of_arm"] for x in lines if x["cpu_seconds"] is not None}


def _seconds(lines: Sequence[Line]) -> dict[str, float]:
    spent = [x["cpu_seconds"] for x in lines if x["cpu_seconds"] is not None]
    return {"median": float(np.median(spent)), "longest": float(np.max(spent))}


def _share(share: Mapping[str, Any]) -> str:
    if not share["trials"]:
        return "–"
    low, high = share["interval"]
    return f"{share['hits']}/{share['trials']} = {100 * share['share']:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def _target(name: str, level: str) -> str:
    target = level_target(name, level)
    if target is None:
        return ""
    bound = "" if name not in TARGETS else "≤ " if name in AT_MOST else "≥ "
    return f"{bound}{100 * target:.0f} %"


def _time(seconds: Mapping[str, float]) -> str:
    return f"{seconds['median']:.0f} s, longest {seconds['longest']:.0f} s"


def _limit(n: int) -> str:
    return "15 s" if n <= 3 else "30 s"
