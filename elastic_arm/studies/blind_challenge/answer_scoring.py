"""One answer against the truth of its arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from elastic_arm.effects import EFFECTS, Effect, Role, Scope
from elastic_arm.effects.model import MODELS
from elastic_arm.studies.blind_challenge.arm_sampling import LOWEST
from elastic_arm.studies.blind_challenge.effect_sampling import true_parameters
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault

DECLARED = 0.05  # an alternative with this confidence counts as declared
CAUSE = 0.01  # of the gap: less is no cause


def is_faint(line: Mapping[str, Any]) -> bool:
    """Whether one of several effects of an arm is less than a cause, or less than ten bounds."""
    return bool(line["share"] < CAUSE or line["multiple"] < LOWEST)


def score_answer(
    entry: dict[str, Any],
    answer: dict[str, Any],
    joints: Sequence[str],
    effects: Mapping[str, Effect] = EFFECTS,
) -> dict[str, Any]:
    """Return what an answer is worth."""
    faults = [Fault(**{**f, "channels": tuple(f["channels"])}) for f in entry["faults"]]
    causes = answer["causes"]
    # A poorer model lacks more than the one effect that was asked for: mod1 lacks S as well as the splines.
    own = [f.effect for f in faults]
    poorer = [e for e in effects.values() if e.lacked_by != MODELS and entry["model"] in e.lacked_by]
    lacking = tuple(e.id for e in poorer if e.id not in own)
    placed = [_placed(f, effects[f.effect], len(joints)) for f in faults]
    hits = [_hit(fault, causes, joints) for fault in placed]
    covered = [_coverage(f, h, effects[f.effect]) for f, h in zip(faults, hits, strict=True) if h is not None]
    itself = [_is(f, c["effect"], c["joint"], joints) for f in placed for c in causes]
    right = [any(_is(f, c["effect"], c["joint"], joints) for f in placed) or c["effect"] in lacking for c in causes]
    return {
        "name": entry["name"],
        "truth": [f.effect for f in faults],
        "joints": [None if f.joint is None else joints[f.joint] for f in faults],
        "parameters": [true_parameters(f, effects[f.effect]) for f in faults],
        "multiple": min(entry["multiple"], default=None),
        "bound": entry["bound"],
        "share": min(entry["share"], default=None),
        "encoder_noise": entry["instruments"]["encoder_noise"],
        "verdict": answer["verdict"],
        "named": [c["effect"] for c in causes],
        "named_joints": [c["joint"] for c in causes],
        "confidence": [c["confidence"] for c in causes],
        "cause_right": right,
        "shrink": answer["shrink"],
        "measured_by": answer.get("measured_by", "excess"),
        "log_likelihood": answer.get("log_likelihood", 0.0),
        "effect_right": bool(faults) and all(h is not None for h in hits),
        "effect_itself": bool(faults) and sum(itself) >= len(faults),
        "effect_first": bool(causes) and bool(faults) and causes[0]["effect"] in [f.effect for f in faults],
        "joint_right": bool(faults) and all(_joint_right(f, causes, joints) for f in placed),
        "side_right": bool(faults)
        and all(_side_right(f, h, effects[f.effect]) for f, h in zip(faults, hits, strict=True)),
        "explained": answer["verdict"] == "explained",
        "alone": len(causes) <= len(faults) + len(lacking),
        "none": answer["verdict"] == "none" and not causes,
        "unknown": answer["verdict"] == "unknown" and _place_right(faults, answer, joints),
        "covered": sum(c for c, _ in covered),
        "intervals": sum(n for _, n in covered),
        "cpu_seconds": answer.get("cpu_seconds"),
        "code": answer.get("code"),
    }


def _placed(fault: Fault, effect: Effect, n: int) -> Fault:
    """Return a fault with the index of the joint that a diagnosis names."""
    return replace(fault, joint=n - 1) if effect.scope is Scope.LAST and fault.joint is None else fault


def _hit(fault: Fault, causes: Sequence[dict[str, Any]], joints: Sequence[str]) -> dict[str, Any] | None:
    """Return the cause that names a fault on its joint, itself or among its declared alternatives."""
    for declared in (False, True):
        for cause in causes:
            named = [(cause["effect"], cause["joint"], 1.0)]
            if declared:
                named += [(a["effect"], a["joint"], a["confidence"]) for a in cause["alternatives"]]
            if any(_is(fault, e, j, joints) and c >= DECLARED for e, j, c in named):
                return cause
    return None


def _is(fault: Fault, effect: str, joint: str | None, joints: Sequence[str]) -> bool:
    return effect == fault.effect and _same_joint(fault, joint, joints)


def _same_joint(fault: Fault, joint: str | None, joints: Sequence[str]) -> bool:
    return joint == (None if fault.joint is None else joints[fault.joint])


def _joint_right(fault: Fault, causes: Sequence[dict[str, Any]], joints: Sequence[str]) -> bool:
    places = [c["joint"] for c in causes]
    places += [a["joint"] for c in causes for a in c["alternatives"] if a["confidence"] >= DECLARED]
    return any(_same_joint(fault, joint, joints) for joint in places)


def _side_right(fault: Fault, cause: dict[str, Any] | None, effect: Effect) -> bool:
    """Whether the cause sits on the fault's side, and a delay in its channels, where it could be another."""
    if cause is None:
        return False
    choices = [c.name for c in effect.choices]
    if cause["effect"] != fault.effect:
        return True
    if "channels" in choices:
        return set(cause["parameters"]["channels"]["value"]) == set(fault.channels)
    return "side" not in choices or bool(cause["sides"] == [fault.side])


def _place_right(faults: Sequence[Fault], answer: dict[str, Any], joints: Sequence[str]) -> bool:
    """Whether the fault's joint is among the places that are left unexplained, or that a cause was named for."""
    places = [p["joint"] for p in answer["unexplained"]] + [c["joint"] for c in answer["causes"]]
    return all(f.joint is None or joints[f.joint] in places for f in faults)


def _coverage(fault: Fault, cause: dict[str, Any], effect: Effect) -> tuple[int, int]:
    """Count 95 % intervals that hold the true value, and all intervals, where the injected law is the catalogue's."""
    if cause["effect"] != fault.effect or fault.parameters.get("coupled"):
        return 0, 0
    inside, asked = 0, 0
    for name, true in true_parameters(fault, effect).items():
        estimate = cause["parameters"].get(name)
        if estimate is None or effect.parameter(name).integer:
            continue
        values, stds = np.atleast_1d(estimate["value"]), np.atleast_1d(np.array(estimate["std"], dtype=float))
        off = values.astype(float) - np.atleast_1d(true)
        if effect.parameter(name).role is Role.PHASE:
            off = (off + np.pi) % (2 * np.pi) - np.pi
        known = np.isfinite(stds)
        asked += int(known.sum())
        inside += int((np.abs(off[known]) <= 1.96 * stds[known]).sum())
    return inside, asked
