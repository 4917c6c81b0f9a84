"""All numbers of the study as CSV tables and one JSON file, beside the report."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from elastic_arm.errors import OutputError
from elastic_arm.studies.paper.claims.all_claims import Claim
from elastic_arm.studies.paper.identification_study import shares
from elastic_arm.studies.paper.study import StudyResult

SCHEMA = "elastic_arm/paper/1"


def export(result: StudyResult, claims: list[Claim], folder: Path) -> list[Path]:
    """Write the study's numbers.

    Returns
    -------
    The files: paper.json with everything; metrics.csv (Figs. 4b and 4c), torques.csv (Figs. 3 and 4a), coefficients.csv
    (Fig. 5), shares.csv, tracking.csv, claims.csv.
    """
    content = as_dict(result, claims)
    tables: dict[str, list[dict[str, Any]]] = {
        "claims": content["claims"],
        "metrics": content["metrics"],
        "torques": _torques(result),
        "coefficients": _coefficients(result),
        "shares": [{k: v for k, v in e.items() if not isinstance(v, dict)} for e in content["identification"]],
        "tracking": [{k: v for k, v in row.items() if k != "each"} for row in content["tracking"]],
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        files = [_write_csv(folder / f"{name}.csv", rows) for name, rows in tables.items()]
        whole = folder / "paper.json"
        whole.write_text(json.dumps(content, indent=1, allow_nan=False), encoding="utf-8")
    except OSError as error:
        raise OutputError(
            f"the study's numbers cannot be written to {folder}: {error.strerror}", "Choose another folder with --out."
        ) from error
    return [whole, *files]


def as_dict(result: StudyResult, claims: list[Claim]) -> dict[str, Any]:
    """Return the study as plain data for JSON."""
    return _plain(
        {
            "schema": SCHEMA,
            "robot": result.robot.name,
            "engine": result.engine,
            "ratios": result.ratios,
            "settings": asdict(result.settings),
            "claims": [asdict(claim) for claim in claims],
            "metrics": [asdict(metric) for metric in (*result.against_mod3, *result.against_prototype)],
            "translations": [asdict(errors) for errors in result.translations],
            "convergence": {name: [asdict(c) for c in checks] for name, checks in result.convergence.items()},
            "S": {
                "rows": result.tilted_coupling.rows,
                "locked": [[str(v) for v in row] for row in result.coupling.matrix.tolist()],
                "tilted": [[str(v) for v in row] for row in result.tilted_coupling.matrix.tolist()],
            },
            "motor_torque_parts": result.inertial,
            "excitation": {model: _excited(result, model) for model in result.excited},
            "identification": _shares(result),
            "coefficients": _coefficients(result),
            "individual": [
                {"model": e.model, "r_tot": e.r_tot, "names": e.individual.names, "error": e.individual.error}
                for e in result.estimates
            ],
            "tracking": [asdict(t) for t in result.tracking],
            "cost": [asdict(c) for c in result.costs],
            "seconds": result.seconds,
        }
    )


def _excited(result: StudyResult, model: str) -> dict[str, Any]:
    e = result.excited[model]
    trajectory = {name: getattr(e.trajectory, name) for name in ("omega", "a", "b", "q0", "duration", "ramp")}
    return {
        "condition": e.condition,
        "start": e.unoptimised,
        "random": e.random,
        "course": e.course,
        "indistinct": e.indistinct,
        "limits": e.limits,
        "trajectory": trajectory,
    }


def _shares(result: StudyResult) -> list[dict[str, Any]]:
    rows = []
    for e in result.estimates:
        row = {"model": e.model, "r_tot": e.r_tot, "parameters": e.estimable, "coefficients": len(e.names)}
        row |= asdict(e.shares) | {"residual": e.residual, "condition": e.condition}
        row |= {f"merged_{category}": value for category, value in asdict(shares(e.merged_error)).items()}
        kinds = {"noisy": e.noisy_shares, "merged_noisy": e.merged_noisy_shares, "fast_noisy": e.fast_noisy_shares}
        for name, many in kinds.items():
            for category in ("low", "mid", "high", "beyond"):
                values = np.array([getattr(share, category) for share in many])
                row |= {f"{name}_{category}": values.mean(), f"{name}_{category}_std": values.std()}
        row |= {"individual_median": float(np.median(e.individual.error))}
        rows.append(row)
    return rows


def _coefficients(result: StudyResult) -> list[dict[str, Any]]:
    columns = ("true", "estimate", "error", "model_error", "bushing_error", "noise_spread", "fast_error")
    return [
        {"model": e.model, "r_tot": e.r_tot, "coefficient": name}
        | {column: float(getattr(e, column)[k]) for column in (*columns, "fast_noise_spread", "torque")}
        for e in result.estimates
        for k, name in enumerate(e.names)
    ]


def _torques(result: StudyResult) -> list[dict[str, Any]]:
    """Return the curves of Figs. 3 and 4a, a row a sample."""
    top = result.at_highest()
    columns = {"t": top.run.t}
    for model, torques in top.torques.items():
        for side in ("motor", "link"):
            for joint, values in enumerate(torques.side(side).T):
                columns[f"{model}.{side}.{joint + 1}"] = values
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _write_csv(path: Path, rows: Sequence[dict[str, Any]]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path


def _plain(value: Any) -> Any:
    """Turn arrays, tuples and numbers into JSON types; what is not finite becomes None."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
