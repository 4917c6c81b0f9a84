"""Pictures of a challenge's score."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from elastic_arm.report.style import BLUE, GREEN, GREY, ORANGE, SKY, VERMILION, new_figure, style
from elastic_arm.studies.blind_challenge.levels.table import level_target
from elastic_arm.studies.blind_challenge.proportions import DETECTED, DetectionCurve
from elastic_arm.studies.blind_challenge.scoring import TARGETS

COLUMNS = 5
MADE_UP = ("wrong joint", "unknown", "none")  # answers that name no effect, or not in the right place


def shares(found: dict[str, Any]) -> Figure:
    """Every share with its interval, and what is to be reached."""
    named = [(name, s) for name, s in found["shares"].items() if s["trials"]]
    with style():
        figure, axes = new_figure(size=(8.6, 0.6 + 0.3 * len(named)))
        ax = axes[0, 0]
        for row, (name, s) in enumerate(named):
            target = TARGETS.get(name)
            low, high = s["interval"]
            colour = GREY if target is None else (GREEN if s["share"] >= target else VERMILION)
            ax.plot([100 * low, 100 * high], [row, row], color=colour, linewidth=3, alpha=0.45, solid_capstyle="butt")
            ax.plot(100 * s["share"], row, "o", color=colour)
            if target is not None:
                ax.plot(100 * target, row, "|", color="black", markersize=12, markeredgewidth=1.8)
        ax.set_yticks(range(len(named)), [f"{name}  ({s['hits']}/{s['trials']})" for name, s in named])
        ax.invert_yaxis()
        ax.set_xlim(0, 101)
        ax.set_xlabel("%, with 95 % binomial interval; mark: to reach")
        return figure


def level_shares(level: str, tables: dict[str, Any]) -> Figure:
    """Every share of a level with its interval, of the diagnosis and of the baseline, and what is to be reached."""
    named = [name for name, share in tables["diagnosis"]["shares"].items() if share["trials"]]
    with style():
        figure, axes = new_figure(size=(8.6, 0.8 + 0.4 * len(named)))
        ax = axes[0, 0]
        for shift, kind, colour in ((-0.13, "diagnosis", BLUE), (0.13, "baseline", ORANGE)):
            shares = tables[kind]["shares"] if kind in tables else {}
            for row, name in enumerate(named):
                if (share := shares.get(name)) and share["trials"]:
                    low, high = (100 * v for v in share["interval"])
                    ax.plot([low, high], [row + shift] * 2, color=colour, linewidth=3, alpha=0.45)
                    ax.plot(100 * share["share"], row + shift, "o", color=colour)
        for row, name in enumerate(named):
            if (target := level_target(name, level)) is not None:
                ax.plot(100 * target, row, "|", color="black", markersize=16, markeredgewidth=1.8)
        ax.set_yticks(range(len(named)), named)
        ax.invert_yaxis()
        ax.set_xlim(-1, 101)
        ax.set_xlabel("%, with 95 % binomial interval; mark: to reach")
        return figure


def confusion(found: dict[str, Any]) -> Figure:
    """What was named for what was there, in shares of each row."""
    table = found["confusion"]
    rows = [e for e in found["by_effect"] if e in table]
    columns = [*rows, *(n for n in _others(table) if n not in rows)]
    counts = np.array([[table[r].get(c, 0) for c in columns] for r in rows], dtype=float)
    part = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
    with style():
        figure, axes = new_figure(size=(3.2 + 0.27 * len(columns), 2.6 + 0.25 * len(rows)))
        ax = axes[0, 0]
        ax.imshow(part, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
        ax.grid(visible=False)
        for (r, c), count in np.ndenumerate(counts):
            if count:
                right = c < len(rows) and rows[r] == columns[c]
                colour = "white" if part[r, c] > 0.5 else ("black" if right else VERMILION)
                ax.text(c, r, f"{count:.0f}", ha="center", va="center", fontsize=7, color=colour)
        ax.set_xticks(range(len(columns)), [_words(c) for c in columns], rotation=60, ha="right", fontsize=7)
        ax.set_yticks(range(len(rows)), [_words(r) for r in rows], fontsize=7)
        ax.set_xlabel("named, or declared as an alternative")
        ax.set_ylabel("what the arm had")
        return figure


def detection(found: dict[str, Any]) -> Figure:
    """Found or missed over the size in multiples of the bound, with the fitted curve, an effect a panel."""
    effects = list(found["by_effect"])
    rows = -(-len(effects) // COLUMNS)
    with style():
        figure, axes = new_figure(rows, COLUMNS, size=(2.25 * COLUMNS, 1.35 * rows + 0.4), sharex=True, sharey=True)
        for ax, effect in zip(axes.flat, effects, strict=False):
            _curve(ax, found, effect)
        for ax in axes.flat[len(effects) :]:
            ax.set_visible(False)
        for ax in axes[-1]:
            ax.set_xlabel("size / bound")
        for ax in axes[:, 0]:
            ax.set_ylabel("found")
        return figure


def _curve(ax: Any, found: dict[str, Any], effect: str) -> None:
    own = [x for x in found["items"] if x["truth"] == [effect]]
    rng = np.random.default_rng(0)
    for x in own:
        height = float(x["effect_right"]) + 0.05 * rng.uniform(-1, 1)
        ax.plot(
            min(x["multiple"], 900.0),
            height,
            ".",
            color=BLUE if x["effect_right"] else VERMILION,
            markersize=5,
            alpha=0.7,
        )
    fit = found["by_effect"][effect]["detected"]
    if fit is not None and fit["misses"]:
        size = np.geomspace(1.0, 1000.0, 200)
        curve = DetectionCurve(fit["middle"], fit["slope"], fit["multiple"], *fit["interval"])
        ax.plot(size, curve(size), color=GREY, linewidth=1.0)
        ax.axvspan(*np.clip(fit["interval"], 1.0, 1000.0), color=ORANGE, alpha=0.15, linewidth=0)
        ax.plot(fit["multiple"], DETECTED, "o", color=ORANGE, markersize=4)
    ax.set_xscale("log")
    ax.set_xlim(1.0, 1000.0)
    ax.set_ylim(-0.15, 1.15)
    ax.set_yticks([0, 1], ["no", "yes"])
    ax.set_title(_words(effect), fontsize=8, loc="left")


def calibration(found: dict[str, Any]) -> Figure:
    """Share of causes that were right over the confidence that they were given."""
    with style():
        figure, axes = new_figure(size=(4.6, 3.9))
        ax = axes[0, 0]
        ax.plot([0, 1], [0, 1], color=GREY, linewidth=1.0, linestyle="--")
        for row in found["calibration"]:
            low, high = row["interval"]
            ax.plot([row["mean_confidence"]] * 2, [low, high], color=BLUE, alpha=0.4, linewidth=3)
            ax.plot(row["mean_confidence"], row["share"], "o", color=BLUE)
        ax.set_xlim(0, 1.03)
        ax.set_ylim(0, 1.03)
        ax.set_xlabel("confidence that was stated")
        ax.set_ylabel("share of causes that were right")
        return figure


def shrinkage(found: dict[str, Any]) -> Figure:
    """What is left of the gap of single effects, an arm a dot."""
    effects = list(found["by_effect"])
    with style():
        figure, axes = new_figure(size=(8.6, 0.7 + 0.24 * len(effects)))
        ax = axes[0, 0]
        rng = np.random.default_rng(0)
        for row, effect in enumerate(effects):
            sized = (x for x in found["items"] if x["measured_by"] == "excess" and x["shrink"] is not None)
            own = [x for x in sized if x["truth"] == [effect]]
            left = [max(1.0 - x["shrink"], 1e-6) for x in own]
            colours = [BLUE if x["effect_right"] else VERMILION for x in own]
            ax.scatter(left, row + 0.2 * rng.uniform(-1, 1, len(own)), c=colours, s=14, alpha=0.7, linewidths=0)
        ax.set_xscale("log")
        ax.set_xlim(5e-7, 2.0)
        ax.axvline(0.05, color="black", linewidth=1.0)
        ax.set_yticks(range(len(effects)), [_words(e) for e in effects], fontsize=8)
        ax.invert_yaxis()
        ax.set_xlabel("share of the excess that is left (line: 0.05, the median to reach)")
        return figure


def withheld(found: dict[str, Any]) -> Figure:
    """Verdicts on arms whose effect was not in the catalogue."""
    effects = list(found["withheld"])
    rows = [found["withheld"][e] for e in effects]
    unknown = np.array([r["unknown where due"]["hits"] for r in rows])
    wrong = np.array([r["unknown where due"]["trials"] for r in rows]) - unknown
    others = np.array([r["explained by others"] for r in rows])
    with style():
        figure, axes = new_figure(size=(8.6, 0.9 + 0.24 * len(effects)))
        ax, at = axes[0, 0], np.arange(len(effects))
        ax.barh(at, unknown, color=GREEN, label="unknown, at the right joint")
        ax.barh(at, wrong, left=unknown, color=VERMILION, label="unknown was due, something else was said")
        ax.barh(at, others, left=unknown + wrong, color=SKY, label="others explain 90 % and more")
        ax.set_yticks(at, [_words(e) for e in effects], fontsize=8)
        ax.invert_yaxis()
        ax.set_xlabel("arms")
        ax.legend(loc="upper center", bbox_to_anchor=(0.4, 1.0 + 0.35 / (0.9 + 0.24 * len(effects))), ncols=3)
        return figure


def _others(table: dict[str, dict[str, int]]) -> list[str]:
    named = {name for row in table.values() for name in row}
    return [*sorted(named - set(MADE_UP)), *(n for n in MADE_UP if n in named)]


def _words(effect: str) -> str:
    return effect.replace("_", " ")
