"""A diagnosis as messages: the content of `diagnosis.json`, with NaN for null and "" for no
joint."""

import math
from collections.abc import Iterable, Mapping
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

from elastic_arm.diagnosis.words import motion_that_shows, regime_text
from elastic_arm.estimation.equation_sets import SIDES


def diagnosis_message(found: Mapping[str, Any]) -> GapDiagnosis:
    """Return the content of `diagnosis.json` as a message; the caller sets its stamp."""
    content = {**found, **found["recordings"]}
    content["shrink_interval"] = found["shrink_interval"] or (None, None)
    residuals = [_residual(found, joint, side) for joint in found["noise"] for side in SIDES]
    unexplained = [_filled(GapPlace, place) for place in found["unexplained"]]
    return _filled(
        GapDiagnosis,
        content,
        header=Header(),
        residuals=residuals,
        causes=list(map(_cause, found["causes"])),
        unexplained=unexplained,
        changes=list(map(_change, found["changes"])),
        trust_probability=_numbers(found["trust"].values()),
    )


def in_words(found: Mapping[str, Any]) -> str:
    """Return verdict, causes and unexplained places as one line, which is the same as long as the
    answer is."""
    verdict = found["verdict"]
    named = [_named(cause) for cause in found["causes"]]
    if verdict == "none":
        return "none: the arm moves like its model, within noise and usual tolerances"
    parts = [", ".join(named)] if named else []
    if verdict == "unknown" and found["unexplained"]:
        first = found["unexplained"][0]
        joint = first["joint"]
        regime = first["regime"]
        where = f"the largest unexplained residual, at {joint} ({first['side']} side),"
        then = f"to find its law, move {joint} alone: {motion_that_shows(regime)}"
        parts.append(f"{where} {regime_text(regime)}; {then}")
    return f"{verdict}: {'; '.join(parts)}" if parts else str(verdict)


def _named(cause: Mapping[str, Any]) -> str:
    return f"{cause['effect']} ({cause['joint']})" if cause["joint"] else str(cause["effect"])


def _filled(kind: Any, content: Mapping[str, Any], **given: Any) -> Any:
    """Return a message with the given fields, and the others from the entries of the content with
    the same names."""
    fields = kind.get_fields_and_field_types()
    sent = {name: _sent(content[name], fields[name]) for name in fields if name not in given}
    return kind(**given, **sent)


def _sent(value: Any, kind: str) -> Any:
    if "[" in kind or "<" in kind:
        return _numbers(value) if "double" in kind else list(value)
    if kind == "double":
        return _number(value)
    return "" if value is None else value


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
    content = dict(change)
    for name in ("recording", "value", "std"):
        content[name] = [one[name] for one in change["values"]]
    return _filled(GapChange, content)


def _parameter(name: str, estimate: Mapping[str, Any], stated: Any = None) -> GapParameter:
    value = _listed(estimate["value"])
    std = _listed(estimate["std"])
    words = [part for part in value if isinstance(part, str)]
    if words:
        return GapParameter(name=name, words=words, unit=estimate["unit"])
    if len(std) != len(value):
        std = [None] * len(value)
    return GapParameter(
        name=name,
        unit=estimate["unit"],
        value=_numbers(value),
        std=_numbers(std),
        stated=[] if stated is None else _numbers(_listed(stated)),
    )


def _listed(value: Any) -> list[Any]:
    return list(value) if isinstance(value, list | tuple) else [value]


def _numbers(values: Iterable[float | None]) -> list[float]:
    return [_number(value) for value in values]


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
