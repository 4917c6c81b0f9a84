"""All numbers of the study as CSV tables and one JSON file, with the report."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from elastic_arm.output_files import csv_text, plain, write_result
from elastic_arm.studies.paper.claims import Claim
from elastic_arm.studies.paper.coupling import SymbolicCoupling
from elastic_arm.studies.paper.study import StudyResult

SCHEMA = "elastic_arm/paper/2"
# Arrays (coefficients,) of an estimate.
PER_COEFFICIENT = ("true", "estimate", "error", "model_error", "bushing_error", "noise_spread",
                   "fast_noise_spread", "torque")  # fmt: skip


def export(result: StudyResult, claims: list[Claim], folder: Path) -> list[Path]:
    """Write the study's numbers; return the files.

    These are paper.json with everything, and of it metrics.csv (Figs. 4b and 4c), torques.csv
    (Figs. 3 and 4a), coefficients.csv (Fig. 5), tracking.csv and claims.csv.
    """
    coefficients = []
    for estimate in result.estimates:
        place = {"model": estimate.model, "r_tot": estimate.r_tot}
        for k, name in enumerate(estimate.names):
            numbers = {column: float(getattr(estimate, column)[k]) for column in PER_COEFFICIENT}
            coefficients.append({**place, "coefficient": name, **numbers})
    tracking = [asdict(one) for one in result.tracking]
    for row in tracking:
        del row["each"]
    tables: dict[str, list[dict[str, Any]]] = {
        "claims": [asdict(claim) for claim in claims],
        "metrics": [*result.against_mod3.rows(), *result.against_prototype.rows()],
        "torques": _torques(result),
        "coefficients": coefficients,
        "tracking": tracking,
    }
    content = _as_dict(result) | {k: v for k, v in tables.items() if k != "torques"}
    whole = write_result(
        folder / "paper.json", json.dumps(plain(content), indent=1, allow_nan=False)
    )
    rows = {name: csv_text(list(table[0]), table) for name, table in tables.items()}
    return [whole, *(write_result(folder / f"{name}.csv", text) for name, text in rows.items())]


def _as_dict(result: StudyResult) -> dict[str, Any]:
    kept = ("translations", "estimates", "settings")
    found: dict[str, Any] = {"schema": SCHEMA, "robot": result.robot.name, "engine": result.engine}
    found |= {"ratios": result.ratios, "motor_torque_parts": result.inertial}
    found |= {name: getattr(result, name) for name in kept}
    found["excited"] = {model: search.to_dict() for model, search in result.excited.items()}
    found["S"] = {
        "locked": _in_words(result.coupling),
        "tilted": _in_words(result.tilted_coupling),
    }
    return found


def _in_words(coupling: SymbolicCoupling) -> list[list[str]]:
    return [list(map(str, row)) for row in coupling.matrix.tolist()]


def _torques(result: StudyResult) -> list[dict[str, Any]]:
    """Return the curves of Figs. 3 and 4a, a row a sample."""
    top = result.at_highest()
    columns = {"t": top.run.t}
    for model, torques in top.torques.items():
        for side in ("motor", "link"):
            for joint, values in enumerate(torques.side(side).T):
                columns[f"{model}.{side}.{joint + 1}"] = values
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
