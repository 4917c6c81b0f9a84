"""The torques of sections IV and V: step ramps of the prototype over the ratios, and what mod1 to
mod3 make of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from elastic_arm.dynamics import Model, build_model
from elastic_arm.errors import RobotError
from elastic_arm.processes import Task
from elastic_arm.robot.description import Robot
from elastic_arm.studies.paper.coupling import SymbolicCoupling
from elastic_arm.studies.paper.virtual_prototype.mechanism import Bushing, transmissions
from elastic_arm.studies.paper.virtual_prototype.motions import QUINTIC, ImposedMotion, StepRamp
from elastic_arm.studies.paper.virtual_prototype.prototype import Prototype, PrototypeRun

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

    `torques` holds mod1, mod2, mod3 and mod_ad, whose tau_l is zero: its link is in equilibrium by
    construction.
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


def metrics(comparisons: list[ModelComparison], reference: str) -> list[Metric]:
    """Return e_max and e_rmse per ratio, side, joint and model.

    Against mod3 (Fig. 4b) or mod_ad (Fig. 4c).
    """
    models = [name for name in MODELS if name != reference]
    rows = []
    for comparison in comparisons:
        for side in SIDES:
            for model in models:
                error = comparison.error(model, reference, side)
                e_max = np.abs(error).max(0)
                e_rmse = np.sqrt((error**2).mean(0))
                rows += [
                    Metric(
                        reference,
                        side,
                        i + 1,
                        comparison.r_tot,
                        model,
                        float(e_max[i]),
                        float(e_rmse[i]),
                    )
                    for i in range(error.shape[1])
                ]
    return rows


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


def line_over_ratio(rows: list[Metric], model: str, side: str, joint: int) -> LinearTrend:
    """Fit e_max = constant + slope r_tot for one model, side and joint."""
    picked = [row for row in rows if (row.model, row.side, row.joint) == (model, side, joint)]
    r_tot = np.array([row.r_tot for row in picked])
    e_max = np.array([row.e_max for row in picked])
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
    e_max: np.ndarray
    e_rmse: np.ndarray


@dataclass(kw_only=True)
class TorqueResult:
    """What the claims on torques are judged by.

    `comparisons` are the ramps over the ratios, and `smooth` a ramp at the highest one without
    jumps of acceleration. `inertial` is what tau_m is made of there, rms per joint (n,), and
    `locked_link` the largest tau_l that mod3 leaves with the bushing locked, Nm. `translations` are
    the errors at the highest ratio as the bushing's translation stiffness varies; the paper does
    not state it.
    """

    robot: Robot
    ratios: tuple[float, ...]
    comparisons: list[ModelComparison]
    smooth: ModelComparison
    against_mod3: list[Metric]
    against_prototype: list[Metric]
    inertial: Mapping[str, np.ndarray]
    locked_link: float
    translations: list[LinkErrors]
    coupling: SymbolicCoupling
    tilted_coupling: SymbolicCoupling

    @property
    def highest(self) -> float:
        """The largest total ratio."""
        return self.ratios[-1]

    def at_highest(self) -> ModelComparison:
        """Return the ramp of Figs. 3 and 4a."""
        return self.comparisons[-1]


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


def torque_result(
    robot: Robot,
    arms: Mapping[float, Robot],
    runs: Sequence[PrototypeRun],
    *,
    translations: Sequence[LinkErrors],
    assumed: float,
    locked: float,
    coupling: tuple[SymbolicCoupling, SymbolicCoupling],
) -> TorqueResult:
    """Compare the models on the runs of :func:`ramp_tasks`."""
    ratios = tuple(arms)
    top = arms[ratios[-1]]
    compared = [compare(arms[r_tot], r_tot, run) for r_tot, run in zip(ratios, runs, strict=False)]
    own = link_errors_of(compared[-1], assumed)
    return TorqueResult(
        robot=robot,
        ratios=ratios,
        comparisons=compared,
        smooth=compare(top, ratios[-1], runs[len(ratios)]),
        against_mod3=metrics(compared, "mod3"),
        against_prototype=metrics(compared, PROTOTYPE),
        inertial=motor_terms(top, runs[len(ratios) - 1]),
        locked_link=locked,
        translations=sorted([*translations, own], key=lambda errors: errors.stiffness),
        coupling=coupling[0],
        tilted_coupling=coupling[1],
    )


def link_errors(robot: Robot, r_tot: float, stiffness: float, step: float) -> LinkErrors:
    """Run the step ramp with another stiffness of the bushing; compare tau_l.

    The stiffness is in translation; tau_l is that of the models.
    """
    run = follow(robot, Bushing().with_translation(stiffness), StepRamp(np.zeros(robot.n)), step)
    return link_errors_of(compare(robot, r_tot, run), stiffness)


def link_errors_of(compared: ModelComparison, stiffness: float) -> LinkErrors:
    """Return the errors of tau_l of a ramp that was run with this translation stiffness, N/m."""
    errors = np.array([compared.error(model, PROTOTYPE, "link") for model in MODELS])
    return LinkErrors(stiffness, np.abs(errors).max(axis=1), np.sqrt((errors**2).mean(axis=1)))


def motor_terms(robot: Robot, run: PrototypeRun) -> dict[str, np.ndarray]:
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
    return {name: np.sqrt((part**2).mean(axis=0)) for name, part in parts.items()}


def locked_link(robot: Robot) -> float:
    """Return the largest tau_l, Nm, that mod3 leaves on a ramp with locked bushings."""
    run = follow(
        robot,
        Bushing(locked=True),
        StepRamp(np.zeros(robot.n), hold=0.05, shape=QUINTIC),
        LOCKED_STEP,
    )
    return float(np.abs(model_torques(build_model(robot, "mod3"), run).link).max())
