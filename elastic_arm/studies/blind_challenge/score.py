"""The score of challenges: every share with its binomial interval, in one table per level."""

import itertools
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from elastic_arm.effects import EFFECTS, Effect
from elastic_arm.studies.blind_challenge.answers import KINDS, Line, expected_unknown, score_answer
from elastic_arm.studies.blind_challenge.campaign import (
    ANSWERS,
    WITHHELD,
    answer_path,
    catalogue_of,
    load_manifest,
    open_sealed,
)
from elastic_arm.studies.blind_challenge.draw import LOWEST

FAINT = 0.01  # of the gap: of several effects, one of less is tabled apart
NEIGHBOURS = 0.9  # a withheld effect whose gap the rest explains to this share is no test
BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)
LEAST = 1e-3  # probability that the logarithmic score takes for less
NOMINAL = 0.95
# To reach: laboratory, workshop, field, servo, position, history; at most where the question counts
# what is wrong.
TARGETS = {
    "effect right": (0.99, 0.95, 0.93, 0.75, 0.90, None),
    "nothing more than ordinary: no cause": (0.99, 0.99, 0.99, 0.98, 0.98, 0.94),
    "arms with a false cause at confidence 0.9": (0.005, 0.01, 0.01, 0.01, 0.01, 0.06),
    "withheld or foreign: unknown": (0.92, 0.95, 0.90, None, None, None),
    "two at once, both right": (0.98, 0.90, 0.80, None, None, None),
}
AT_MOST = ("arms with a false cause at confidence 0.9",)
COLUMNS = {"laboratory": 0, "workshop": 1, "field": 2, "servo": 3, "position": 4, "history": 5}
HEADINGS = ("question", "reached (95 % interval)", "to reach")
EFFECT_HEADINGS = (
    "effect",
    "right",
    "joint",
    "side",
    "intervals cover",
    "median shrink",
    "largest multiple missed",
)
SIMULATED = (
    "moved by the suite's own simulator, which shares their laws with the"
    " diagnosis and therefore gives optimistic scores: {}"
)


def proportion(outcomes: Sequence[Any]) -> dict[str, Any]:
    """Return the share of outcomes that hold, with its 95 % interval (Clopper-Pearson)."""
    hits = sum(bool(o) for o in outcomes)
    trials = len(outcomes)
    if not trials:
        return {"hits": 0, "trials": 0, "share": None, "interval": None}
    interval = binomtest(hits, trials).proportion_ci(0.95, "exact")
    return {
        "hits": hits,
        "trials": trials,
        "share": hits / trials,
        "interval": [interval.low, interval.high],
    }


def calibration(told: Sequence[tuple[float, bool]]) -> list[dict[str, Any]]:
    """Compare confidences with how often causes that had them were right, bin by bin."""
    rows = []
    for low, high in itertools.pairwise(BINS):
        inside = [(c, r) for c, r in told if low <= c and (c < high or high == BINS[-1])]
        if inside:
            mean = float(np.mean([c for c, _ in inside]))
            rows.append(
                {
                    "from": low,
                    "to": high,
                    "mean_confidence": mean,
                    **proportion([r for _, r in inside]),
                }
            )
    return rows


def score(folders: Path | Sequence[Path]) -> dict[str, Any]:
    """Open the sealed truth of one or several challenges and compare every answer with it.

    Returns a table a level, shares by effect, what was named for what, and one line an item.
    """
    lines: list[Line] = []
    withheld: list[Line] = []
    settings = []
    total = 0
    simulated = set()
    effects: dict[str, Effect] = dict(EFFECTS)
    for folder in [folders] if isinstance(folders, Path) else folders:
        manifest = load_manifest(folder)
        effects |= catalogue_of(folder)
        simulated |= set(manifest["simulated"])
        truth = open_sealed(folder, manifest["truth_sha256"])
        settings.append(manifest["settings"] | {"truth_sha256": manifest["truth_sha256"]})
        total += len(truth)
        for kind, known in ((ANSWERS, lines), (WITHHELD, withheld)):
            for entry in truth:
                path = answer_path(folder, entry["name"], kind)
                if path.is_file():
                    known.append(_line(entry, json.loads(path.read_text()), effects))
    by_effect = {}
    for effect in effects:
        alone = [x for x in lines if x["truth"] == [effect] and not x["foreign"]]
        by_effect[effect] = _effect(alone)
    levels: dict[str, dict[str, Any]] = {}
    for level in dict.fromkeys(x["level"] for x in lines):
        of_level = [x for x in lines if x["level"] == level]
        levels[level] = level_table(of_level, [x for x in withheld if x["level"] == level])
    return {
        "challenges": settings,
        "answered": len(lines),
        "open": total - len(lines),
        "simulated": sorted(simulated),
        "code": dict(Counter(x["code"] for x in lines)),
        "levels": levels,
        "by_effect": {e: row for e, row in by_effect.items() if row["right"]["trials"]},
        "items": lines,
        "withheld_items": withheld,
    }


def _line(
    entry: Mapping[str, Any], answer: Mapping[str, Any], effects: Mapping[str, Effect]
) -> Line:
    share = min(entry["share"], default=1.0)
    multiple = min(entry["multiple"], default=LOWEST)
    faint = share < FAINT or multiple < LOWEST
    return score_answer(entry, answer, effects) | {"faint": faint}


def level_table(lines: Sequence[Line], withheld: Sequence[Line]) -> dict[str, Any]:
    """Return one level's shares of answers by question, and how good probabilities are."""
    own = [x for x in lines if not x["foreign"]]
    foreign = [x for x in lines if x["foreign"]]
    single = [x for x in own if len(x["truth"]) == 1]
    large = [x for x in single if not x["faint"]]
    none = [x for x in own if not x["truth"]]
    two = [x for x in own if len(x["truth"]) == 2 and not x["faint"]]
    three = [x for x in own if len(x["truth"]) == 3 and not x["faint"]]
    several_faint = [x for x in own if len(x["truth"]) > 1 and x["faint"]]
    single_faint = [x for x in single if x["faint"]]
    clear = [x for x in withheld if not x["faint"]]
    # Where the other effects explain nearly all, no answer is due.
    due = [x for x in clear if x["verdict"] == "unknown" or (x["shrink"] or 0.0) < NEIGHBOURS]
    shares = {
        "effect right": _share(large, "effect_right"),
        "joint right": _share(large, "joint_right"),
        "side right": _share(large, "side_right"),
        "nothing more than ordinary: no cause": _share(none, "no_cause"),
        "arms with a false cause at confidence 0.9": _share(lines, "accused"),
        "withheld or foreign: unknown": proportion([expected_unknown(x) for x in (*due, *foreign)]),
        "two at once, both right": _share(two, "effect_right"),
        "three at once, all right": _share(three, "effect_right"),
        "several at once, one of them faint": _share(several_faint, "effect_right"),
        "effect right, below ten bounds": _share(single_faint, "effect_right"),
    }
    for kind in KINDS:
        held, asked = np.sum([x["coverage"][kind] for x in own] or [[0, 0]], axis=0)
        shares[f"intervals of {kind} cover"] = proportion([True] * held + [False] * (asked - held))
    told = [(c, r) for x in lines for c, r in x["told"]]
    missed = [x for x in own if x["truth"] and not x["effect_right"]]
    squares = [(c - r) ** 2 for c, r in told]
    of_truth = [c if r else 1 - c for c, r in told]
    logarithms = [np.log(max(probability, LEAST)) for probability in of_truth]
    return {
        "shares": shares,
        "calibration": calibration([(c, r) for c, r in told if c > 0.0]),
        "brier": float(np.mean(squares)) if told else None,
        "log_score": float(-np.mean(logarithms)) if told else None,
        "seconds": _seconds(lines),
        "foreign": {x["name"]: [*x["foreign"], x["verdict"], *x["named"]] for x in foreign},
        "missed": {x["name"]: [*x["truth"], x["verdict"], *x["named"]] for x in missed},
    }


def _share(lines: Sequence[Line], question: str) -> dict[str, Any]:
    return proportion([line[question] for line in lines])


def table_rows(level: str, table: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return the rows of a level's table as text: question, what was reached, and to reach."""
    rows = [
        (name, text(share), _target(name, level))
        for name, share in table["shares"].items()
        if share["trials"]
    ]
    for row in table["calibration"]:
        mean = f"mean {row['mean_confidence']:.2f}"
        name = f"causes of confidence {row['from']:g} to {row['to']:g} ({mean}) right"
        rows.append((name, text(row), ""))
    if table["brier"] is not None:
        scores = f"{table['brier']:.3f}, {table['log_score']:.3f}"
        rows.append(("Brier score, logarithmic score", scores, ""))
    for n, seconds in table["seconds"].items():
        spent = f"{seconds['median']:.0f} s, longest {seconds['longest']:.0f} s"
        rows.append((f"a diagnosis of {n} joints, one core", spent, ""))
    return rows


def effect_rows(found: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return a row an effect, as text."""
    rows = []
    for effect, row in found["by_effect"].items():
        shares = [row[name] for name in ("right", "joint", "side", "intervals")]
        shrink = "–" if row["shrink"] is None else f"{row['shrink']:.3f}"
        missed = "–" if row["missed"] is None else f"{row['missed']:.0f}"
        texts = [f"{share['hits']}/{share['trials']}" for share in shares]
        rows.append((effect, *texts, shrink, missed))
    return rows


def markdown(found: Mapping[str, Any]) -> str:
    """Return the tables as a document."""
    states = ", ".join(map(str, found["code"]))
    parts = [
        "# Results of the challenge",
        "Written by `elastic-arm challenge score`; how: [challenge.md](challenge.md).",
    ]
    parts.append(
        "\n".join(
            [*(f"- {challenge(c)}" for c in found["challenges"]), f"- state of the code: {states}"]
        )
    )
    if found["simulated"]:
        parts.append(SIMULATED.format(", ".join(found["simulated"])))
    for level, table in found["levels"].items():
        parts += [f"## Level {level}", _table(HEADINGS, table_rows(level, table))]
        for what in ("foreign", "missed"):
            if table[what]:
                said = "; ".join(
                    f"{name}: {', '.join(words)}" for name, words in table[what].items()
                )
                parts.append(f"{what.capitalize()}: {said}.")
    parts += ["## Single effects", _table(EFFECT_HEADINGS, effect_rows(found))]
    return "\n\n".join(parts) + "\n"


def challenge(settings: Mapping[str, Any]) -> str:
    """Return what a challenge consists of, in a line."""
    kinds = ("per_effect", "clean", "pairs", "triples", "foreign")
    counts = ", ".join(f"{settings[k]} {k.replace('_', ' ')}" for k in kinds if settings[k])
    low, high = settings["ratio"]
    only = f", only {', '.join(settings['effects'])}" if settings["effects"] else ""
    return (
        f"{settings['level']}, seed {settings['seed']}: {counts}; sizes {low:g} to {high:g}"
        f" bounds{only}; truth {settings['truth_sha256'][:12]}"
    )


def text(share: Mapping[str, Any]) -> str:
    """Return a share with its interval as text."""
    if not share["trials"]:
        return "–"
    low, high = (f"{100 * v:.0f}" for v in share["interval"])
    return f"{share['hits']}/{share['trials']} = {100 * share['share']:.0f} % ({low} to {high})"


def target(name: str, level: str) -> float | None:
    """Return the share that is to be reached; None where none is stated."""
    if name in TARGETS:
        return TARGETS[name][COLUMNS[level]]
    return NOMINAL if name == "intervals of causes cover" else None


def _target(name: str, level: str) -> str:
    value = target(name, level)
    if value is None:
        return ""
    at_least = "≥ " if name in TARGETS else ""
    bound = "≤ " if name in AT_MOST else at_least
    return f"{bound}{100 * value:g} %"


def _effect(lines: Sequence[Line]) -> dict[str, Any]:
    large = [x for x in lines if not x["faint"]]
    shrinks = [x["shrink"] for x in large if x["shrink"] is not None]
    missed = [x["multiple"] for x in lines if not x["effect_right"]]
    held, asked = np.sum([x["coverage"]["causes"] for x in large] or [[0, 0]], axis=0)
    return {
        "right": _share(large, "effect_right"),
        "joint": _share(large, "joint_right"),
        "side": _share(large, "side_right"),
        "intervals": proportion([True] * held + [False] * (asked - held)),
        "shrink": float(np.median(shrinks)) if shrinks else None,
        "missed": max(missed, default=None),
    }


def _seconds(lines: Sequence[Line]) -> dict[str, dict[str, float]]:
    spent: dict[int, list[float]] = {}
    for x in lines:
        spent.setdefault(x["joints_of_arm"], []).append(x["cpu_seconds"] or 0.0)
    found = {}
    for joints, seconds in sorted(spent.items()):
        found[str(joints)] = {"median": float(np.median(seconds)), "longest": max(seconds)}
    return found


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
