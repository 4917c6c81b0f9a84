"""One answer against the truth of an arm of a level: what the laboratory's score does not ask."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from elastic_arm.effects import EFFECTS, Effect
from elastic_arm.studies.blind_challenge.answer_scoring import score_answer

Line = dict[str, Any]

SURE = 0.9  # confidence from which on a cause that no arm had is a false accusation
LIMIT = 1.96  # standard deviations, of a 95 % interval
KINDS = ("causes", "frictions", "sensors", "numbers")
# What a diagnosis calls the numbers of a sensor among its imperfections.
SENSORS = ("motor_torque_gain", "joint_torque_gain", "motor_torque_offset", "joint_torque_offset")


def joint_names(entry: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the joints of an arm of a level."""
    return tuple(f"joint_{k + 1}" for k in range(len(entry["sensors"]["torque_noise"])))


def score_realistic_answer(
    entry: dict[str, Any], answer: dict[str, Any], effects: Mapping[str, Effect] = EFFECTS
) -> Line:
    """Return what an answer to an arm of a level is worth."""
    joints = joint_names(entry)
    line = score_answer(entry, answer, joints, effects)
    # What the whole level has beyond the ordinary is true of the arm, too.
    conditions = {(c["effect"], joints[c["joint"]]) for c in entry["conditions"]}
    named = [(c["effect"], c["joint"]) for c in answer["causes"]]
    right = [r or key in conditions for r, key in zip(line["cause_right"], named, strict=True)]
    beyond = [r for r, key in zip(right, named, strict=True) if key not in conditions]
    sure = [c["confidence"] >= SURE and not r for c, r in zip(answer["causes"], right, strict=True)]
    return line | {
        "level": entry["level"],
        "joints_of_arm": len(joints),
        "sides": entry["sensors"]["sides"],
        "foreign": [f["effect"] for f in entry["foreign"]],
        "visible": entry["visible"],
        "cause_right": right,
        "no_cause": not beyond,
        "accused": any(sure),
        "coverage": {"causes": [line["covered"], line["intervals"]], **_coverage(entry, answer, joints)},
    }


def expected_unknown(line: Line) -> bool:
    """Whether an arm with an effect of no catalogue was answered as it should: `none` alone where none can see it."""
    return line["verdict"] == "unknown" or (line["verdict"] == "none" and not line["visible"])


def _coverage(entry: Mapping[str, Any], answer: Mapping[str, Any], joints: Sequence[str]) -> dict[str, list[int]]:
    """Count 95 % intervals that hold the true value, and all, of frictions, sensors and numbers of the arm."""
    changed = {(f["effect"], f["joint"]) for f in (*entry["faults"], *entry["conditions"])}
    true = {(f["effect"], joints[f["joint"]]): f["parameters"] for f in entry["ordinary"]}
    true |= {(f["effect"], joints[f["joint"]]): f["parameters"] for f in entry["faults"] if f["joint"] is not None}
    true |= {(f["effect"], joints[f["joint"]]): f["parameters"] for f in entry["conditions"]}
    frictions, sensors, numbers = [], [], []
    warming = any(f["effect"] == "thermal_friction" for f in entry["conditions"])
    for known in answer.get("known", ()):
        parameters = true.get((known["effect"], known["joint"]))
        # Friction that changes during the run has no one value.
        if parameters is not None and not warming and not any("thermal" in effect for effect, _ in changed):
            frictions += [_holds(e, parameters[name]) for name, e in known["parameters"].items() if name in parameters]
    of_arm = {(what, joints[joint]): value for what, joint, value in entry["numbers"]}
    for one in answer.get("imperfections", ()):
        key = (one["what"], one["joint"])
        if one["what"] in SENSORS and key in true:
            sensors.append(_holds(one, next(iter(true[key].values()))))
        elif key in of_arm:
            numbers.append(_holds(one, of_arm[key]))
    counted = {"frictions": frictions, "sensors": sensors, "numbers": numbers}
    return {kind: [sum(filter(None, held)), sum(h is not None for h in held)] for kind, held in counted.items()}


def _holds(estimate: Mapping[str, Any], true: float) -> bool | None:
    """Whether a 95 % interval holds a value; None where no deviation is stated."""
    if estimate["std"] is None or np.ndim(estimate["std"]) or not estimate["std"]:
        return None
    return bool(abs(estimate["value"] - true) <= LIMIT * estimate["std"])
