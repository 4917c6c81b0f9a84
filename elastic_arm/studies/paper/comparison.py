"""Torques of mod1, mod2, mod3 on the prototype's motion, and the two metrics of Figs. 3 and 4."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from elastic_arm.dynamics import Model, build_model
from elastic_arm.robot.description import Robot
from elastic_arm.studies.paper.virtual_prototype.prototype import PrototypeRun

MODELS = ("mod1", "mod2", "mod3")
PROTOTYPE = "mod_ad"
SIDES = ("motor", "link")


@dataclass(frozen=True)
class Torques:
    """Torques of a model on a motion: `motor` is tau_m, `link` is tau_l, each (N, n), Nm."""

    motor: np.ndarray
    link: np.ndarray

    def side(self, name: str) -> np.ndarray:
        """Return one side by its name."""
        return self.motor if name == "motor" else self.link


@dataclass(frozen=True)
class ModelComparison:
    """One motion of the prototype at one ratio, and the torques of each model on it.

    `torques` holds mod1, mod2, mod3 and mod_ad, whose tau_l is zero: its link is in equilibrium by construction.
    """

    r_tot: float
    run: PrototypeRun
    torques: Mapping[str, Torques]

    def error(self, model: str, reference: str, side: str) -> np.ndarray:
        """Return a model's torque less the reference's (N, n), Nm."""
        return self.torques[model].side(side) - self.torques[reference].side(side)


@dataclass(frozen=True)
class Metric:
    """e_max and e_rmse of one model's torque, Nm; `joint` counts from 1."""

    reference: str
    side: str
    joint: int
    r_tot: float
    model: str
    e_max: float
    e_rmse: float


def model_torques(model: Model, run: PrototypeRun) -> Torques:
    """Evaluate both rows of (1) on the prototype's motion: tau_m, and the first row's residual tau_l.

    A model with bearings is given their tilts too; its tau_l is the residual of the rows of q.
    """
    n = run.q.shape[1]
    forces = model.inverse_dynamics(*run.coordinates(bearings=model.dof == 4 * n))
    return Torques(motor=forces[:, n : 2 * n], link=forces[:, :n])


def compare(robot: Robot, r_tot: float, run: PrototypeRun) -> ModelComparison:
    """Evaluate mod1, mod2 and mod3 of `robot` (with its ratio already set to `r_tot`) on a run of the prototype."""
    torques = {name: model_torques(build_model(robot, name), run) for name in MODELS}
    torques[PROTOTYPE] = Torques(motor=run.tau_m, link=np.zeros_like(run.tau_m))
    return ModelComparison(r_tot, run, torques)


def metrics(comparisons: list[ModelComparison], reference: str) -> list[Metric]:
    """Return e_max and e_rmse per ratio, side, joint and model against mod3 (Fig. 4b) or mod_ad (Fig. 4c)."""
    models = [name for name in MODELS if name != reference]
    rows = []
    for comparison in comparisons:
        for side in SIDES:
            for model in models:
                error = comparison.error(model, reference, side)
                e_max, e_rmse = np.abs(error).max(0), np.sqrt((error**2).mean(0))
                rows += [
                    Metric(reference, side, i + 1, comparison.r_tot, model, float(e_max[i]), float(e_rmse[i]))
                    for i in range(error.shape[1])
                ]
    return rows


@dataclass(frozen=True)
class LinearTrend:
    """A least-squares line of an error over r_tot: at r_tot = 0, per unit of r_tot, and the share it explains.

    `highest` is the error at the highest ratio, Nm.
    """

    constant: float
    slope: float
    r_squared: float
    highest: float


def line_over_ratio(rows: list[Metric], model: str, side: str, joint: int) -> LinearTrend:
    """Fit e_max = constant + slope r_tot for one model, side and joint."""
    picked = [row for row in rows if (row.model, row.side, row.joint) == (model, side, joint)]
    r_tot, e_max = np.array([row.r_tot for row in picked]), np.array([row.e_max for row in picked])
    slope, constant = np.polyfit(r_tot, e_max, 1)
    spread = float(((e_max - e_max.mean()) ** 2).sum())
    missed = float(((e_max - constant - slope * r_tot) ** 2).sum())
    share = 1.0 - missed / spread if spread > 0.0 else 1.0
    return LinearTrend(float(constant), float(slope), share, float(e_max[np.argmax(r_tot)]))
