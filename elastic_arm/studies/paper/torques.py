"""The torques of sections IV and V: step ramps of the prototype over the ratios, and those of mod1
to mod3.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from elastic_arm.arrays import Array, rms
from elastic_arm.dynamics import Model, build_model
from elastic_arm.errors import RobotError
from elastic_arm.processes import Task
from elastic_arm.robot.description import Robot
from elastic_arm.studies.paper.virtual_prototype.mechanism import Bushing, transmissions
from elastic_arm.studies.paper.virtual_prototype.motions import QUINTIC, ImposedMotion, StepRamp
from elastic_arm.studies.paper.virtual_prototype.prototype import Prototype, PrototypeRun

MODELS = ("mod1", "mod2", "mod3")
PROTOTYPE = "mod_ad"
SIDES = ("motor", "link")


@dataclass(frozen=True)
class Torques:
    """Torques of a model on a motion: `motor` is tau_m, `link` is tau_l, each (N, n), Nm."""

    motor: Array
    link: Array

    def side(self, name: str) -> Array:
        """Return one side by its name."""
        return self.motor if name == "motor" else self.link


@dataclass(frozen=True)
class ModelComparison:
    """One motion of the prototype at one ratio, and the torques of each model on it.

    `torques` holds mod1, mod2, mod3 and mod_ad, whose tau_l is zero: its link is in equilibrium by
    construction.
    """

    r_tot: float
    run: PrototypeRun
    torques: Mapping[str, Torques]

    def error(self, model: str, reference: str, side: str) -> Array:
        """Return a model's torque less the reference's (N, n), Nm."""
        return self.torques[model].side(side) - self.torques[reference].side(side)


@dataclass(frozen=True)
class TorqueErrors:
    """e_max and e_rmse of torques with respect to a reference, Nm.

    Each is by side and model (ratios, n).
    """

    reference: str
    ratios: tuple[float, ...]
    e_max: Mapping[tuple[str, str], Array]
    e_rmse: Mapping[tuple[str, str], Array]

    def rows(self) -> list[dict[str, Any]]:
        """Return a row a ratio, side, model and joint, which counts from 1."""
        rows = []
        for k, r_tot in enumerate(self.ratios):
            for side, model in self.e_max:
                sizes = zip(self.e_max[side, model][k], self.e_rmse[side, model][k], strict=True)
                for joint, (e_max, e_rmse) in enumerate(sizes, 1):
                    place = {"reference": self.reference, "side": side, "joint": joint}
                    of = {"r_tot": r_tot, "model": model}
                    rows.append({**place, **of, "e_max": float(e_max), "e_rmse": float(e_rmse)})
        return rows


def model_torques(model: Model, run: PrototypeRun) -> Torques:
    """Evaluate both rows of (1) on the prototype's motion.

    tau_m, and the first row's residual tau_l.

    A model with bearings is given their tilts too; its tau_l is the residual of the rows of q.
    """
    n = run.q.shape[1]
    forces = model.inverse_dynamics(*run.coordinates(bearings=model.dof == 4 * n))
    return Torques(motor=forces[:, n : 2 * n], link=forces[:, :n])


def compare(robot: Robot, r_tot: float, run: PrototypeRun) -> ModelComparison:
    """Evaluate mod1, mod2 and mod3 of `robot` on a run of the prototype.

    Its ratio is already set to `r_tot`.
    """
    torques = {name: model_torques(build_model(robot, name), run) for name in MODELS}
    torques[PROTOTYPE] = Torques(motor=run.tau_m, link=np.zeros_like(run.tau_m))
    return ModelComparison(r_tot, run, torques)


def torque_errors(comparisons: Sequence[ModelComparison], reference: str) -> TorqueErrors:
    """Return the errors of all models but the reference: mod3 (Fig. 4b) or mod_ad (Fig. 4c)."""
    models = [name for name in MODELS if name != reference]
    errors = {
        (side, model): np.array([one.error(model, reference, side) for one in comparisons])
        for side in SIDES
        for model in models
    }
    return TorqueErrors(
        reference,
        tuple(one.r_tot for one in comparisons),
        {place: np.abs(error).max(axis=1) for place, error in errors.items()},
        {place: rms(error, axis=1) for place, error in errors.items()},
    )


@dataclass(frozen=True)
class LinearTrend:
    """A least-squares line of an error over r_tot.

    At r_tot = 0, per unit of r_tot, and the share it explains.

    `highest` is the error at the highest ratio, Nm.
    """

    constant: float
    slope: float
    r_squared: float
    highest: float


def line_over_ratio(ratios: Sequence[float], e_max: Array) -> LinearTrend:
    """Fit e_max (ratios,) = constant + slope r_tot."""
    r_tot = np.array(ratios)
    slope, constant = np.polyfit(r_tot, e_max, 1)
    spread = float(((e_max - e_max.mean()) ** 2).sum())
    missed = float(((e_max - constant - slope * r_tot) ** 2).sum())
    share = 1.0 - missed / spread if spread > 0.0 else 1.0
    return LinearTrend(float(constant), float(slope), share, float(e_max[np.argmax(r_tot)]))


LOCKED_STEP = 1e-3  # only the drives are left to swing


@dataclass(frozen=True)
class LinkErrors:
    """Errors of tau_l with respect to mod_ad, by the bushing's stiffness, N/m.

    At the highest ratio; stiffness in translation.

    `e_max` and `e_rmse` are (models, n), Nm, of mod1, mod2 and mod3.
    """

    stiffness: float
    e_max: Array
    e_rmse: Array


def studied_ratios(robot: Robot) -> tuple[float, ...]:
    """Return the total ratios that the robot's description splits, rising."""
    transmissions(robot)
    if len(robot.total_ratios_studied) < 2:
        raise RobotError(
            f"robot {robot.name} describes {len(robot.total_ratios_studied)} total ratios,"
            " but the study compares several",
            "Give 'total_ratios_studied: {r_tot: [belt, harmonic drive], …}' in the arm file",
        )
    return tuple(sorted(robot.total_ratios_studied))


def follow(robot: Robot, bushing: Bushing, motion: ImposedMotion, step: float) -> PrototypeRun:
    """Build a prototype and let it follow a motion: one task of the study.

    At `step` or what its bushings bear.
    """
    prototype = Prototype(robot, bushing)
    return prototype.follow(motion, step=min(step, prototype.stable_step()))


def ramp_tasks(arms: Sequence[Robot], bushing: Bushing, step: float) -> list[Task]:
    """Return the runs that every study of torques makes.

    The step ramp over the arms, at the last without jumps too.
    """
    start = np.zeros(arms[0].n)
    tasks: list[Task] = [partial(follow, arm, bushing, StepRamp(start), step) for arm in arms]
    return [*tasks, partial(follow, arms[-1], bushing, StepRamp(start, shape=QUINTIC), step)]


def link_errors(robot: Robot, r_tot: float, stiffness: float, step: float) -> LinkErrors:
    """Run the step ramp with another stiffness of the bushing; compare tau_l.

    The stiffness is in translation; tau_l is that of the models.
    """
    run = follow(robot, Bushing().with_translation(stiffness), StepRamp(np.zeros(robot.n)), step)
    return link_errors_of(compare(robot, r_tot, run), stiffness)


def link_errors_of(compared: ModelComparison, stiffness: float) -> LinkErrors:
    """Return the errors of tau_l of a ramp that was run with this translation stiffness, N/m."""
    errors = np.array([compared.error(model, PROTOTYPE, "link") for model in MODELS])
    return LinkErrors(stiffness, np.abs(errors).max(axis=1), rms(errors, axis=1))


def motor_terms(robot: Robot, run: PrototypeRun) -> dict[str, Array]:
    """Return the parts of tau_m (1), mod3, on a run, rms per joint (n,).

    Of B ddtheta, S' ddq, c2 and the drive.
    """
    model = build_model(robot, "mod3")
    x, dx, _ = run.coordinates()
    terms = model.terms(x, dx)
    parts = {
        "B ddtheta": np.einsum("nij,nj->ni", terms["B"], run.ddtheta),
        "S' ddq": np.einsum("nji,nj->ni", terms["S"], run.ddq),
        "c2": terms["c2"],
        "K (theta - q) + D (dtheta - dq)": run.tau_J,
    }
    return {name: rms(part) for name, part in parts.items()}


def locked_link(robot: Robot) -> float:
    """Return the largest tau_l, Nm, that mod3 leaves on a ramp with locked bushings."""
    run = follow(
        robot,
        Bushing(locked=True),
        StepRamp(np.zeros(robot.n), hold=0.05, shape=QUINTIC),
        LOCKED_STEP,
    )
    return float(np.abs(model_torques(build_model(robot, "mod3"), run).link).max())
