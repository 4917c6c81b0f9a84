"""A diagnosis as messages: the content of `diagnosis.json`, with NaN for its null and "" for no
joint."""

import math
from collections.abc import Mapping
from typing import Any

from elastic_arm_msgs.msg import (
    GapAlternative,
    GapCause,
    GapChange,
    GapDiagnosis,
    GapParameter,
    GapPlace,
    GapResidual,
)
from std_msgs.msg import Header

from elastic_arm.estimation.equations import SIDES


def diagnosis_message(found: Mapping[str, Any]) -> GapDiagnosis:
    """Return the content of `diagnosis.json` as a message; its stamp is left to the caller."""
    return _filled(
        GapDiagnosis,
        {
            **found,
            **found["recordings"],
            "shrink_interval": found["shrink_interval"] or (None, None),
        },
        header=Header(),
        residuals=[_residual(found, joint, side) for joint in found["noise"] for side in SIDES],
        causes=[_cause(cause) for cause in found["causes"]],
        unexplained=[_filled(GapPlace, place) for place in found["unexplained"]],
        changes=[_change(change) for change in found["changes"]],
        trust_probability=[_number(p) for p in found["trust"].values()],
    )


def in_words(found: Mapping[str, Any]) -> str:
    """Return verdict, causes and what no cause explains as one line, which is the same while the
    answer is."""
    verdict, named = found["verdict"], [_named(cause) for cause in found["causes"]]
    if verdict == "none":
        return "none: the arm moves as its model"
    parts = [", ".join(named)] if named else []
    if verdict == "unknown" and found["unexplained"]:
        first = found["unexplained"][0]
        parts.append(f"most is left at {first['joint']} ({first['side']} side), without a cause")
    return f"{verdict}: {'; '.join(parts)}" if parts else str(verdict)


def _named(cause: Mapping[str, Any]) -> str:
    return f"{cause['effect']} ({cause['joint']})" if cause["joint"] else str(cause["effect"])


def _filled(kind: Any, content: Mapping[str, Any], **given: Any) -> Any:
    """Return a message of what is given, and of what the content has by the names of its other
    fields."""
    fields = kind.get_fields_and_field_types()
    return kind(
        **given,
        **{name: _sent(content[name], fields[name]) for name in fields if name not in given},
    )


def _sent(value: Any, kind: str) -> Any:
    if "[" in kind or "<" in kind:
        return [_number(one) for one in value] if "double" in kind else list(value)
    return _number(value) if kind == "double" else "" if value is None else value


def _residual(found: Mapping[str, Any], joint: str, side: str) -> GapResidual:
    sizes = {"joint": joint, "side": side, "noise": found["noise"][joint][side]}
    for when in ("before", "after"):
        size = found["gap"][when][joint][side] or {}
        sizes |= {f"{name}_{when}": size.get(name) for name in ("rmse", "max")}
    return _filled(GapResidual, sizes)


def _cause(cause: Mapping[str, Any]) -> GapCause:
    stated = cause["from"] or {}
    parameters = [_parameter(name, e, stated.get(name)) for name, e in cause["parameters"].items()]
    others = [_filled(GapAlternative, other) for other in cause["alternatives"]]
    return _filled(GapCause, cause, parameters=parameters, alternatives=others)


def _change(change: Mapping[str, Any]) -> GapChange:
    by_recording = {
        name: [one[name] for one in change["values"]] for name in ("recording", "value", "std")
    }
    return _filled(GapChange, {**change, **by_recording})


def _parameter(name: str, estimate: Mapping[str, Any], stated: Any = None) -> GapParameter:
    value, std = (_listed(estimate[part]) for part in ("value", "std"))
    words = [part for part in value if isinstance(part, str)]
    if words:
        return GapParameter(name=name, words=words, unit=estimate["unit"])
    std = std if len(std) == len(value) else [None] * len(value)
    numbers = {"value": value, "std": std, "stated": [] if stated is None else _listed(stated)}
    return GapParameter(
        name=name,
        unit=estimate["unit"],
        **{k: [_number(v) for v in vs] for k, vs in numbers.items()},
    )


def _listed(value: Any) -> list[Any]:
    return list(value) if isinstance(value, list | tuple) else [value]


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
