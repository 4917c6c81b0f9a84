"""How well a challenge was answered: every share with its binomial interval."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from elastic_arm.effects import EFFECTS
from elastic_arm.gap.challenge.campaign import answer_path, load_manifest
from elastic_arm.gap.challenge.draw import LOWEST, contract_parameters
from elastic_arm.gap.challenge.laws import Fault
from elastic_arm.gap.challenge.seal import open_sealed
from elastic_arm.robot import load_robot

DECLARED = 0.05  # an alternative with this confidence counts as declared
ENOUGH_EXPLAINED = 0.9  # a withheld effect whose excess the rest explains to this share is tabled apart


@dataclass(frozen=True)
class Share:
    """Successes of trials."""

    hits: int
    trials: int

    @property
    def value(self) -> float | None:
        """Share, None without trials."""
        return self.hits / self.trials if self.trials else None

    @property
    def interval(self) -> tuple[float, float] | None:
        """95 % (Clopper-Pearson)."""
        if not self.trials:
            return None
        found = binomtest(self.hits, self.trials).proportion_ci(0.95, "exact")
        return float(found.low), float(found.high)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {"hits": self.hits, "trials": self.trials, "share": self.value, "interval": self.interval}


def score(folder: Path) -> dict[str, Any]:
    """Open the sealed truth and compare every answer with it.

    Returns
    -------
    dict
        Shares by question and by effect, the confusion matrix, and one line an item.
    """
    manifest = load_manifest(folder)
    truth = open_sealed(folder, manifest["truth_sha256"])
    robot = load_robot(None)
    lines = [
        _line(entry, json.loads(answer_path(folder, entry["name"]).read_text()), robot.joint_names)
        for entry in truth
        if answer_path(folder, entry["name"]).is_file()
    ]
    single = [x for x in lines if len(x["truth"]) == 1 and not x["withheld"] and x["multiple"] >= LOWEST]
    clean = [x for x in lines if not x["truth"]]
    pairs = [x for x in lines if len(x["truth"]) > 1 and not x["withheld"]]
    without = [x for x in lines if x["withheld"]]
    due = [x for x in without if (x["shrink"] or 0.0) < ENOUGH_EXPLAINED]
    shares = {
        "effect right": _share(single, "effect_right"),
        "effect first": _share(single, "effect_first"),
        "joint right": _share(single, "joint_right"),
        "side right": _share(single, "side_right"),
        "explained": _share(single, "explained"),
        "no false cause beside": _share(single, "alone"),
        "clean called none": _share(clean, "none"),
        "both right": _share(pairs, "effect_right"),
        "unknown where due": _share(due, "unknown"),
        "intervals cover": Share(sum(x["covered"] for x in single), sum(x["intervals"] for x in single)),
    }
    shrinks = [x["shrink"] for x in single if x["shrink"] is not None]
    return {
        "answered": len(lines),
        "open": len(truth) - len(lines),
        "shares": {name: share.to_dict() for name, share in shares.items()},
        "median_shrink": float(np.median(shrinks)) if shrinks else None,
        "by_effect": _by_effect(single),
        "confusion": _confusion(single),
        "items": lines,
    }


def _share(lines: Sequence[dict[str, Any]], key: str) -> Share:
    return Share(sum(bool(x[key]) for x in lines), len(lines))


def _by_effect(lines: Sequence[dict[str, Any]]) -> dict[str, Any]:
    found = {}
    for effect in EFFECTS:
        own = [x for x in lines if x["truth"] == [effect]]
        if own:
            found[effect] = {
                "effect right": _share(own, "effect_right").to_dict(),
                "joint right": _share(own, "joint_right").to_dict(),
                "median shrink": float(np.median([x["shrink"] or 0.0 for x in own])),
                "smallest multiple found": min((x["multiple"] for x in own if x["effect_right"]), default=None),
                "largest multiple missed": max((x["multiple"] for x in own if not x["effect_right"]), default=None),
            }
    return found


def _confusion(lines: Sequence[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """True effect -> what was named first -> how often."""
    counts: dict[str, Counter[str]] = {}
    for x in lines:
        counts.setdefault(x["truth"][0], Counter())[x["named"][0] if x["named"] else x["verdict"]] += 1
    return {effect: dict(row) for effect, row in counts.items()}


def _line(entry: dict[str, Any], answer: dict[str, Any], joints: Sequence[str]) -> dict[str, Any]:
    faults = [Fault(**{**f, "channels": tuple(f["channels"])}) for f in entry["faults"]]
    causes = answer["causes"]
    hits = [_hit(fault, causes, joints) for fault in faults]
    found = [h for h in hits if h is not None]
    covered, intervals = 0, 0
    for fault, hit in zip(faults, hits, strict=True):
        if hit is not None and hit["effect"] == fault.effect:
            inside, asked = _coverage(fault, hit)
            covered, intervals = covered + inside, intervals + asked
    multiples = [m for m in entry["multiple"] if m is not None]
    return {
        "name": entry["name"],
        "truth": [f.effect for f in faults],
        "joints": [None if f.joint is None else joints[f.joint] for f in faults],
        "parameters": [contract_parameters(f) for f in faults],
        "multiple": min(multiples, default=float(LOWEST)),
        "encoder_noise": entry["instruments"]["encoder_noise"],
        "withheld": list(entry["withheld"]),
        "verdict": answer["verdict"],
        "named": [c["effect"] for c in causes],
        "named_joints": [c["joint"] for c in causes],
        "confidence": [c["confidence"] for c in causes],
        "shrink": answer["shrink"],
        "effect_right": bool(faults) and len(found) == len(faults),
        "effect_first": bool(causes) and bool(faults) and causes[0]["effect"] in [f.effect for f in faults],
        "joint_right": bool(faults) and all(_joint_right(f, causes, joints) for f in faults),
        "side_right": bool(found) and all(_side_right(f, h) for f, h in zip(faults, hits, strict=True)),
        "explained": answer["verdict"] == "explained",
        # mod1 lacks S as well as the splines.
        "alone": len(causes) <= len(faults) + (entry["model"] == "mod1"),
        "none": answer["verdict"] == "none" and not causes,
        "unknown": answer["verdict"] == "unknown" and _place_right(faults, answer, joints),
        "covered": covered,
        "intervals": intervals,
    }


def _hit(fault: Fault, causes: Sequence[dict[str, Any]], joints: Sequence[str]) -> dict[str, Any] | None:
    """Return the cause that names a fault, itself or among its declared alternatives."""
    for cause in causes:
        named = [(cause["effect"], cause["joint"], 1.0)]
        named += [(a["effect"], a["joint"], a["confidence"]) for a in cause["alternatives"]]
        if any(e == fault.effect and _same_joint(fault, j, joints) and c >= DECLARED for e, j, c in named):
            return cause
    return None


def _same_joint(fault: Fault, joint: str | None, joints: Sequence[str]) -> bool:
    if fault.effect == "payload":
        return joint == joints[-1]
    return joint == (None if fault.joint is None else joints[fault.joint])


def _joint_right(fault: Fault, causes: Sequence[dict[str, Any]], joints: Sequence[str]) -> bool:
    places = [c["joint"] for c in causes] + [a["joint"] for c in causes for a in c["alternatives"]]
    return any(_same_joint(fault, joint, joints) for joint in places)


def _side_right(fault: Fault, cause: dict[str, Any] | None) -> bool:
    if cause is None or cause["effect"] != fault.effect:
        return cause is not None
    return not any(c.name == "side" for c in EFFECTS[fault.effect].choices) or cause["sides"] == [fault.side]


def _place_right(faults: Sequence[Fault], answer: dict[str, Any], joints: Sequence[str]) -> bool:
    places = [p["joint"] for p in answer["unexplained"]] + [c["joint"] for c in answer["causes"]]
    return all(f.joint is None or joints[f.joint] in places for f in faults)


def _coverage(fault: Fault, cause: dict[str, Any]) -> tuple[int, int]:
    """Count 95 % intervals that hold the true value, of those parameters that have one."""
    inside, asked = 0, 0
    for name, true in contract_parameters(fault).items():
        estimate = cause["parameters"].get(name)
        if estimate is None or name == "order":
            continue
        values, stds = np.atleast_1d(estimate["value"]), np.atleast_1d(estimate["std"])
        for value, std, exact in zip(values, stds, np.atleast_1d(true), strict=True):
            if std is None:
                continue
            off = float(value) - float(exact)
            if name == "phase":
                off = (off + np.pi) % (2 * np.pi) - np.pi
            asked += 1
            inside += abs(off) <= 1.96 * float(std)
    return inside, asked
