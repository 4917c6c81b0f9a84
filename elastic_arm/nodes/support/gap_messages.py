"""A diagnosis as messages: the content of `diagnosis.json`, with NaN for its null and "" for no joint."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from elastic_arm_msgs.msg import GapAlternative, GapCause, GapChange, GapDiagnosis, GapParameter, GapPlace, GapResidual

from elastic_arm.diagnosis.live import ResidualLevels
from elastic_arm.estimation.equations import SIDES


def diagnosis_message(found: Mapping[str, Any]) -> GapDiagnosis:
    """Return the content of `diagnosis.json` as a message; its stamp is left to the caller."""
    recordings, interval = found["recordings"], found["shrink_interval"] or (None, None)
    return GapDiagnosis(
        schema=found["schema"],
        model=found["model"],
        robot=found["robot"],
        identify=recordings["identify"],
        validate=recordings["validate"],
        independent_motion=recordings["independent_motion"],
        band_hz=[_number(edge) for edge in found["band_hz"]],
        verdict=found["verdict"],
        residuals=[_residual(found, joint, side) for joint in found["noise"] for side in SIDES],
        shrink=_number(found["shrink"]),
        shrink_interval=[_number(edge) for edge in interval],
        causes=[_cause(cause) for cause in found["causes"]],
        unexplained=[GapPlace(**{**place, "rmse": _number(place["rmse"])}) for place in found["unexplained"]],
        changes=[_change(change) for change in found["changes"]],
        trust=list(found["trust"]),
        trust_probability=[_number(p) for p in found["trust"].values()],
    )


def residual_messages(where: ResidualLevels) -> dict[tuple[str, str], GapResidual]:
    """Return sizes measured between diagnoses, one message a joint and side; nothing is known of any causes."""
    return {
        (joint, side): GapResidual(
            joint=joint,
            side=side,
            noise=where.noise[joint, side],
            rmse_before=rmse,
            max_before=where.size.peak[joint, side],
            rmse_after=math.nan,
            max_after=math.nan,
        )
        for (joint, side), rmse in where.size.rmse.items()
    }


def in_words(found: Mapping[str, Any]) -> str:
    """Return verdict and causes as one line."""
    named = [_named(cause) for cause in found["causes"]]
    return f"{found['verdict']}: {', '.join(named)}" if named else found["verdict"]


def _named(cause: Mapping[str, Any]) -> str:
    return f"{cause['effect']} ({cause['joint']})" if cause["joint"] else str(cause["effect"])


def _residual(found: Mapping[str, Any], joint: str, side: str) -> GapResidual:
    sizes = [found["gap"][when][joint][side] or {"rmse": None, "max": None} for when in ("before", "after")]
    before, after = ({name: _number(value) for name, value in size.items()} for size in sizes)
    return GapResidual(
        joint=joint,
        side=side,
        noise=_number(found["noise"][joint][side]),
        rmse_before=before["rmse"],
        max_before=before["max"],
        rmse_after=after["rmse"],
        max_after=after["max"],
    )


def _cause(cause: Mapping[str, Any]) -> GapCause:
    stated = cause["from"] or {}
    return GapCause(
        effect=cause["effect"],
        joint=cause["joint"] or "",
        sides=cause["sides"],
        regime=cause["regime"],
        parameters=[_parameter(name, e, stated.get(name)) for name, e in cause["parameters"].items()],
        shrink=_number(cause["shrink"]),
        confidence=_number(cause["confidence"]),
        alternatives=[
            GapAlternative(
                effect=other["effect"],
                joint=other["joint"] or "",
                confidence=_number(other["confidence"]),
                separated_by=other["separated_by"] or "",
            )
            for other in cause["alternatives"]
        ],
    )


def _change(change: Mapping[str, Any]) -> GapChange:
    values = change["values"]
    return GapChange(
        **{name: change[name] for name in ("effect", "parameter", "unit", "confidence")},
        joint=change["joint"] or "",
        recording=[one["recording"] for one in values],
        value=[_number(one["value"]) for one in values],
        std=[_number(one["std"]) for one in values],
    )


def _parameter(name: str, estimate: Mapping[str, Any], stated: Any = None) -> GapParameter:
    value, std = (_listed(estimate[part]) for part in ("value", "std"))
    words = [part for part in value if isinstance(part, str)]
    if words:
        return GapParameter(name=name, words=words, unit=estimate["unit"])
    std = std if len(std) == len(value) else [None] * len(value)
    numbers = {"value": value, "std": std, "stated": [] if stated is None else _listed(stated)}
    return GapParameter(name=name, unit=estimate["unit"], **{k: [_number(v) for v in vs] for k, vs in numbers.items()})


def _listed(value: Any) -> list[Any]:
    return list(value) if isinstance(value, list | tuple) else [value]


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
