"""The score of one answer by the truth of its arm."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from elastic_arm.diagnosis.history import together
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.effects import EFFECTS, Effect, Role, Scope
from elastic_arm.effects.effect import MODELS
from elastic_arm.studies.blind_challenge.effect_sampling import true_parameters
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault

Line = dict[str, Any]

DECLARED = 0.05  # an alternative with this confidence counts as declared
SURE = 0.9  # confidence from which a wrong cause is a false accusation
LIMIT = 1.96  # standard deviations, of a 95 % interval
KINDS = ("causes", "frictions", "sensors", "numbers")
# Names of the numbers of a sensor among the imperfections of a diagnosis.
SENSORS = ("motor_torque_gain", "joint_torque_gain", "motor_torque_offset", "joint_torque_offset")


def score_answer(
    entry: Mapping[str, Any], answer: Mapping[str, Any], effects: Mapping[str, Effect] = EFFECTS
) -> Line:
    """Score an answer (`diagnosis.json`) by the truth of its arm.

    entry: the truth.
    """
    joints = entry["joints"]
    faults = [Fault(**{**one, "channels": tuple(one["channels"])}) for one in entry["faults"]]
    placed = [_placed(f, effects[f.effect], len(joints)) for f in faults]
    causes = answer["causes"]
    # The report of a change is right if the change happened in the stated recording.
    since = entry.get("since", 0)
    in_time = [cause for cause in causes if cause.get("recording", since) == since]
    hits = [_hit(fault, in_time, joints) for fault in placed]
    found = list(zip(faults, hits, strict=True))
    allowed = _allowed(entry, causes, effects)
    right = [
        may_be or (cause in in_time and _is_any(placed, cause, joints))
        for cause, may_be in zip(causes, allowed, strict=True)
    ]
    z: list[float] = []
    for fault, hit in found:
        if hit is not None:
            z += _offs(fault, hit, effects[fault.effect])
    confidence = [cause["confidence"] for cause in causes]
    told = list(zip(confidence, right, strict=True))
    for fault in placed:
        if not any(_is_any([fault], cause, joints) for cause in causes):
            told.append((0.0, True))
    covered = sum(abs(v) <= LIMIT for v in z)
    return {
        **_truth(entry, faults, effects),
        "verdict": answer["verdict"],
        "named": [c["effect"] for c in causes],
        "named_joints": [c["joint"] for c in causes],
        "confidence": confidence,
        "cause_right": right,
        "told": told,
        "shrink": answer["shrink"],
        "effect_right": bool(faults) and all(hit is not None for hit in hits),
        "joint_right": bool(faults) and all(_joint_right(f, causes, joints) for f in placed),
        "side_right": bool(faults) and all(_side_right(f, h, effects[f.effect]) for f, h in found),
        "no_cause": all(allowed) and answer["verdict"] != "unknown",
        "accused": any(p >= SURE and not r for p, r in zip(confidence, right, strict=True)),
        "z": z,
        "coverage": {"causes": [covered, len(z)], **_coverage(entry, answer, joints)},
        "cpu_seconds": answer.get("cpu_seconds"),
        "code": answer.get("code"),
    }


def _truth(
    entry: Mapping[str, Any], faults: Sequence[Fault], effects: Mapping[str, Effect]
) -> Line:
    """Return the part of a line that describes the arm."""
    joints = entry["joints"]
    return {
        "name": entry["name"],
        "level": entry["level"],
        "joints_of_arm": len(joints),
        "sides": entry["sensors"]["sides"],
        "truth": [f.effect for f in faults],
        "joints": [None if f.joint is None else joints[f.joint] for f in faults],
        "parameters": [true_parameters(f, effects[f.effect]) for f in faults],
        "foreign": [f["effect"] for f in entry["foreign"]],
        "multiple": min(entry["multiple"], default=None),
        "visible": entry["visible"],
    }


def _allowed(
    entry: Mapping[str, Any], causes: Sequence[Mapping[str, Any]], effects: Mapping[str, Effect]
) -> list[bool]:
    """Return whether each cause is true although its effect was not drawn."""
    joints = entry["joints"]
    # A simpler model lacks more than the requested effect: mod1 lacks both S and the splines.
    lacking = {
        effect.id
        for effect in effects.values()
        if effect.lacked_by != MODELS and entry["model"] in effect.lacked_by
    }
    # All arms of the level have these effects.
    conditions = {(one["effect"], joints[one["joint"]]) for one in entry["conditions"]}
    return [
        cause["effect"] in lacking or (cause["effect"], cause["joint"]) in conditions
        for cause in causes
    ]


def _is_any(faults: Sequence[Fault], cause: Mapping[str, Any], joints: Sequence[str]) -> bool:
    """Return whether a cause is one of these faults."""
    return any(_is(fault, cause["effect"], cause["joint"], joints) for fault in faults)


def changes_told(found: Sequence[Diagnosis]) -> dict[str, Any]:
    """Return changes between separately diagnosed recordings as causes.

    Each has the recording of the change and the size after it.
    """
    causes: list[dict[str, Any]] = [
        {
            "effect": one.sized.effect,
            "joint": one.sized.joint,
            "confidence": one.changed,
            "recording": one.step.until,
            "sides": ("motor", "link"),
            "alternatives": [],
            "parameters": {
                one.sized.parameter: {"value": one.step.after_value, "std": one.step.after_std}
            },
        }
        for one in together(found)[1]
        if one.step is not None
    ]
    return {
        "verdict": "explained" if causes else "none",
        "causes": causes,
        "known": [],
        "imperfections": [],
    }


def expected_unknown(line: Line) -> bool:
    """Whether an effect of no catalogue was answered rightly.

    With `none` alone where no recording can see it.
    """
    return line["verdict"] == "unknown" or (line["verdict"] == "none" and not line["visible"])


def _placed(fault: Fault, effect: Effect, n: int) -> Fault:
    """Return a fault with the index of the joint that a diagnosis names."""
    return (
        replace(fault, joint=n - 1) if effect.scope is Scope.LAST and fault.joint is None else fault
    )


def _hit(
    fault: Fault, causes: Sequence[dict[str, Any]], joints: Sequence[str]
) -> dict[str, Any] | None:
    """Return the cause that names a fault on its joint, itself or among its declared
    alternatives."""
    for declared in (False, True):
        for cause in causes:
            named = [(cause["effect"], cause["joint"], 1.0)]
            if declared:
                named += [(a["effect"], a["joint"], a["confidence"]) for a in cause["alternatives"]]
            if any(_is(fault, e, j, joints) and c >= DECLARED for e, j, c in named):
                return cause
    return None


def _is(fault: Fault, effect: str, joint: str | None, joints: Sequence[str]) -> bool:
    return effect == fault.effect and joint == (
        None if fault.joint is None else joints[fault.joint]
    )


def _joint_right(fault: Fault, causes: Sequence[dict[str, Any]], joints: Sequence[str]) -> bool:
    places = [c["joint"] for c in causes]
    places += [a["joint"] for c in causes for a in c["alternatives"] if a["confidence"] >= DECLARED]
    return (None if fault.joint is None else joints[fault.joint]) in places


def _side_right(fault: Fault, cause: dict[str, Any] | None, effect: Effect) -> bool:
    """Whether the cause sits on the fault's side, and a delay in its channels, where it could be
    another."""
    if cause is None or cause["effect"] != fault.effect:
        return cause is not None
    choices = [c.name for c in effect.choices]
    if "channels" in choices:
        return set(cause["parameters"]["channels"]["value"]) == set(fault.channels)
    return "side" not in choices or fault.side in cause["sides"]


def _offs(fault: Fault, cause: dict[str, Any], effect: Effect) -> Iterator[float]:
    """Yield by how many standard deviations stated sizes are off, where the injected law is the
    catalogue's."""
    if cause["effect"] != fault.effect or fault.parameters.get("coupled"):
        return
    for name, true in true_parameters(fault, effect).items():
        estimate = cause["parameters"].get(name)
        if estimate is None or effect.parameter(name).integer:
            continue
        values = np.atleast_1d(estimate["value"])
        stds = np.atleast_1d(np.array(estimate["std"], dtype=float))
        off = values.astype(float) - np.atleast_1d(true)
        if effect.parameter(name).role is Role.PHASE:
            off = (off + np.pi) % (2 * np.pi) - np.pi
        known = np.isfinite(stds) & (stds > 0.0)
        yield from (off[known] / stds[known]).tolist()


def _coverage(
    entry: Mapping[str, Any], answer: Mapping[str, Any], joints: Sequence[str]
) -> dict[str, list[int]]:
    """Count 95 % intervals that hold the true value, and all, of frictions, sensors and numbers of
    the arm."""
    stated = [
        f
        for kind in ("ordinary", "faults", "conditions")
        for f in entry[kind]
        if f["joint"] is not None
    ]
    true = {(f["effect"], joints[f["joint"]]): f["parameters"] for f in stated}
    of_arm = {(what, joints[joint]): value for what, joint, value in entry["numbers"]}
    held: dict[str, list[bool]] = {"frictions": [], "sensors": [], "numbers": []}
    # Friction that changes during the run, or by direction, has no one value.
    scaled = any(f["effect"] in ("thermal_friction", "asymmetric_friction") for f in stated)
    for known in () if scaled else answer.get("known", ()):
        parameters = true.get((known["effect"], known["joint"]), {})
        pairs = [
            (e, parameters[name]) for name, e in known["parameters"].items() if name in parameters
        ]
        held["frictions"] += [_holds(e, value) for e, value in pairs if _is_stated(e)]
    for one in filter(_is_stated, answer.get("imperfections", ())):
        key = (one["what"], one["joint"])
        if one["what"] in SENSORS and key in true:
            held["sensors"].append(_holds(one, next(iter(true[key].values()))))
        elif key in of_arm:
            held["numbers"].append(_holds(one, of_arm[key]))
    return {kind: [sum(outcomes), len(outcomes)] for kind, outcomes in held.items()}


def _is_stated(estimate: Mapping[str, Any]) -> bool:
    return bool(estimate["std"]) and not np.ndim(estimate["std"])


def _holds(estimate: Mapping[str, Any], true: float) -> bool:
    return bool(abs(estimate["value"] - true) <= LIMIT * estimate["std"])
