"""The whole study, stage by stage: runs of the prototype over the cores, then what the models make of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from elastic_arm.dynamics import build_model
from elastic_arm.errors import RobotError
from elastic_arm.robot.description import Robot
from elastic_arm.studies.paper import comparison, convergence, cost, feedforward
from elastic_arm.studies.paper.comparison import MODELS, Metric, ModelComparison
from elastic_arm.studies.paper.coupling import SymbolicCoupling, symbolic_coupling
from elastic_arm.studies.paper.excitations import ExcitationSearch, excite
from elastic_arm.studies.paper.identification_study import CoefficientEstimate
from elastic_arm.studies.paper.identification_study import study as identify
from elastic_arm.studies.paper.parallel import Advance, ProcessPool
from elastic_arm.studies.paper.virtual_prototype.mechanism import Bushing, engine, transmissions
from elastic_arm.studies.paper.virtual_prototype.motions import QUINTIC, ImposedMotion, PeriodicMotion, StepRamp
from elastic_arm.studies.paper.virtual_prototype.prototype import Prototype, PrototypeRun

StageStart = Callable[[str, int], Advance]
"""Called with a stage's name and its number of tasks; returns what to call after each task."""


@dataclass(frozen=True)
class StudySettings:
    """How much work the study does.

    Parameters
    ----------
    step, excitation_step
        Steps of the prototype for the ramps and for the excitations, s.
    poses
        Starting poses of the ramp at the highest ratio, the zero pose included.
    identified
        Positions, in the rising list of ratios, of those at which the models are identified.
    seeds
        Noise realisations at 10 Hz and at 1 kHz.
    guesses
        Wrong descriptions from which individual parameters are recovered.
    evaluations
        Budget of each pattern search.
    random_trajectories
        How many of the searches' start the searched trajectory is compared with.
    bushing_scales, coupler_frequencies, step_sizes
        Of the convergence tables; the last step is the one that the others are compared with.
    tracking
        Recorded seconds under feed-forward, after :data:`SETTLE` seconds to settle.
    motions
        Number of motions under feed-forward.
    """

    step: float
    excitation_step: float
    poses: int
    identified: tuple[int, ...]
    seeds: tuple[int, int]
    guesses: int
    evaluations: int
    random_trajectories: int
    bushing_scales: tuple[float, ...]
    coupler_frequencies: tuple[float, ...]
    step_sizes: tuple[float, ...]
    tracking: float
    motions: int


FULL = StudySettings(
    step=1e-4,
    excitation_step=2e-4,
    poses=5,
    identified=(0, 1, 2, 3, 4),
    seeds=(100, 20),
    guesses=9,
    evaluations=1500,
    random_trajectories=50,
    bushing_scales=(1.0, 4.0, 16.0, 64.0),
    coupler_frequencies=(500.0, 1000.0, 2000.0, 4000.0),
    step_sizes=(3e-4, 2e-4, 1e-4, 5e-5, 2.5e-5),
    tracking=4.0,
    motions=3,
)
QUICK = StudySettings(
    step=2e-4,
    excitation_step=2.5e-4,
    poses=1,
    identified=(-1,),
    seeds=(20, 3),
    guesses=3,
    evaluations=150,
    random_trajectories=10,
    bushing_scales=(1.0,),
    coupler_frequencies=(500.0, 2000.0),
    step_sizes=(2e-4, 1e-4),
    tracking=1.0,
    motions=1,
)
COUPLER_STEP = 1e-4
LOCKED_STEP = 1e-3  # only the drives are left to swing
SETTLE = 2.0
FEEDBACK_FREQUENCY = 10.0
TRACKING_PERIOD = 4.0


@dataclass
class StudyResult:
    """All numbers of the study; the report draws from here and nothing else.

    `comparisons` are the ramps over the ratios, `poses` those from other poses at the highest one, and `smooth` a ramp
    there without jumps of acceleration.
    """

    robot: Robot
    settings: StudySettings
    ratios: tuple[float, ...]
    comparisons: list[ModelComparison]
    poses: list[tuple[np.ndarray, ModelComparison]]
    smooth: ModelComparison
    against_mod3: list[Metric]
    against_prototype: list[Metric]
    inertial: Mapping[str, np.ndarray]
    convergence: Mapping[str, list[convergence.ConvergenceCheck]]
    coupling: SymbolicCoupling
    tilted_coupling: SymbolicCoupling
    excited: Mapping[str, ExcitationSearch]
    estimates: list[CoefficientEstimate]
    tracking: list[feedforward.Tracking]
    costs: list[cost.Cost]
    engine: str
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def highest(self) -> float:
        """The largest total ratio."""
        return self.ratios[-1]

    def at_highest(self) -> ModelComparison:
        """Return the ramp of Figs. 3 and 4a."""
        return self.comparisons[-1]

    def estimate(self, model: str, r_tot: float | None = None) -> CoefficientEstimate:
        """Return one model's identification, at the highest ratio by default."""
        wanted = self.highest if r_tot is None else r_tot
        return next(e for e in self.estimates if (e.model, e.r_tot) == (model, wanted))


def studied_ratios(robot: Robot) -> tuple[float, ...]:
    """Return the total ratios that the robot's description splits, rising.

    Raises
    ------
    RobotError
        When the robot cannot carry the study: no transmissions, no bearings, no ratios.
    """
    transmissions(robot)
    if len(robot.total_ratios_studied) < 2:
        raise RobotError(
            f"robot {robot.name} describes {len(robot.total_ratios_studied)} total ratios, the study compares several",
            "Give 'total_ratios_studied: {r_tot: [belt, harmonic drive], …}' in the arm file",
        )
    return tuple(sorted(robot.total_ratios_studied))


def run_study(robot: Robot, settings: StudySettings, *, workers: int, seed: int, stage: StageStart) -> StudyResult:
    """Reproduce the paper.

    Parameters
    ----------
    robot
        Every joint with transmission and bearing, and several `total_ratios_studied`.
    workers
        Processes for the prototype's runs.
    seed
        Of the noise, the poses and the searches' starts.
    stage
        Receives the progress.

    Raises
    ------
    RobotError, MissingExtraError
        When the robot or the machine cannot carry the study.
    """
    started = time.perf_counter()
    ratios = studied_ratios(robot)
    engine_name = f"MuJoCo {engine().__version__}"
    rng = np.random.default_rng(seed)
    arms = {r_tot: robot.with_ratio(r_tot) for r_tot in ratios}
    top = arms[ratios[-1]]
    seconds: dict[str, float] = {}

    def timed(name: str, count: int) -> Advance:
        seconds[name] = time.perf_counter() - started
        return stage(name, count)

    starts = [np.zeros(robot.n), *rng.uniform(-1.0, 1.0, (settings.poses - 1, robot.n))]
    with ProcessPool(workers) as pool:
        ramps = _ramps(arms, starts, settings, pool, timed)
        checks = _convergence(top, settings, pool, timed)
        excited = _excite(top, settings, pool, rng, timed)
        estimates = _identify(arms, excited, settings, pool, rng, timed)
        tracking = _track(arms, estimates, settings, pool, rng, timed)
    smooth = comparison.compare(top, ratios[-1], ramps.pop())
    comparisons = [comparison.compare(arms[r], r, run) for r, run in zip(ratios, ramps, strict=False)]
    others = zip(starts[1:], ramps[len(ratios) :], strict=True)
    poses = [(start, comparison.compare(top, ratios[-1], run)) for start, run in others]
    advance = timed("symbols and cost", 3)
    symbols = []
    for bearings in (False, True):
        symbols.append(symbolic_coupling(top, bearings=bearings))
        advance()
    costs = cost.measure(top, rng)
    advance()
    result = StudyResult(
        robot=robot,
        settings=settings,
        ratios=ratios,
        comparisons=comparisons,
        poses=poses,
        smooth=smooth,
        against_mod3=comparison.metrics(comparisons, "mod3"),
        against_prototype=comparison.metrics(comparisons, comparison.PROTOTYPE),
        inertial=motor_terms(top, comparisons[-1].run),
        convergence=checks,
        coupling=symbols[0],
        tilted_coupling=symbols[1],
        excited=excited,
        estimates=estimates,
        tracking=tracking,
        costs=costs,
        engine=engine_name,
    )
    result.seconds = _durations(seconds, time.perf_counter() - started)
    return result


def follow(robot: Robot, bushing: Bushing, motion: ImposedMotion, step: float) -> PrototypeRun:
    """Build a prototype and let it follow a motion, at `step` or what its bushings bear: one task of the study.

    Parameters
    ----------
    robot
        With bearings.
    bushing
        Numbers of the bushing.
    motion
        Imposed at the rotors.
    step
        Largest integration step, s.
    """
    prototype = Prototype(robot, bushing)
    return prototype.follow(motion, step=min(step, prototype.stable_step()))


def motor_terms(robot: Robot, run: PrototypeRun) -> dict[str, np.ndarray]:
    """Return the parts of tau_m (1), mod3, on a run: rms per joint (n,) of B ddtheta, S' ddq, c2 and the drive."""
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


def _ramps(
    arms: Mapping[float, Robot], starts: list[np.ndarray], settings: StudySettings, pool: ProcessPool, stage: StageStart
) -> list[PrototypeRun]:
    """Run the step ramp over all ratios, at the highest from the other poses too, and there without jumps."""
    tasks = [partial(follow, arm, Bushing(), StepRamp(starts[0]), settings.step) for arm in arms.values()]
    top = list(arms.values())[-1]
    tasks += [partial(follow, top, Bushing(), StepRamp(start), settings.step) for start in starts[1:]]
    tasks.append(partial(follow, top, Bushing(), StepRamp(starts[0], shape=QUINTIC), settings.step))
    return pool.run(tasks, stage("step ramps of the prototype", len(tasks)))


def _convergence(
    robot: Robot, settings: StudySettings, pool: ProcessPool, stage: StageStart
) -> dict[str, list[convergence.ConvergenceCheck]]:
    ramp = StepRamp(np.zeros(robot.n), hold=0.05)
    tasks = [
        partial(convergence.over_steps, robot, settings.step_sizes, ramp),
        partial(convergence.over_couplers, robot, settings.coupler_frequencies, ramp, COUPLER_STEP),
        *(
            partial(convergence.over_bushings, robot, (scale,), ramp, settings.step)
            for scale in settings.bushing_scales
        ),
        partial(convergence.over_bushings, robot, (np.inf,), ramp, settings.step),
    ]
    steps, couplers, *bushings = pool.run(tasks, stage("convergence of the prototype", len(tasks)))
    return {"step": steps, "coupler": couplers, "bushing": [check for part in bushings for check in part]}


def _excite(
    robot: Robot, settings: StudySettings, pool: ProcessPool, rng: np.random.Generator, stage: StageStart
) -> dict[str, ExcitationSearch]:
    seeds = rng.integers(2**31, size=len(MODELS))
    tasks = [
        partial(excite, robot, model, settings.evaluations, settings.random_trajectories, int(seed))
        for model, seed in zip(MODELS, seeds, strict=True)
    ]
    return dict(zip(MODELS, pool.run(tasks, stage("search of the excitations", len(tasks))), strict=True))


def _identify(
    arms: Mapping[float, Robot],
    excited: Mapping[str, ExcitationSearch],
    settings: StudySettings,
    pool: ProcessPool,
    rng: np.random.Generator,
    stage: StageStart,
) -> list[CoefficientEstimate]:
    """Identify each model from the run of its own trajectory, at each ratio chosen."""
    ratios = [list(arms)[k] for k in settings.identified]
    pairs = [(r_tot, model) for r_tot in ratios for model in MODELS]
    tasks = [
        partial(
            _identify_one,
            arms[r_tot],
            model,
            r_tot,
            excited[model],
            settings,
            int(rng.integers(2**31)),
        )
        for r_tot, model in pairs
    ]
    return pool.run(tasks, stage("excitation runs and identification", len(tasks)))


def _identify_one(
    robot: Robot, model: str, r_tot: float, excited: ExcitationSearch, settings: StudySettings, seed: int
) -> CoefficientEstimate:
    motion = PeriodicMotion(excited.trajectory)
    run = follow(robot, Bushing(), motion, settings.excitation_step)
    locked = follow(robot, Bushing(locked=True), motion, LOCKED_STEP)
    return identify(
        robot,
        model,
        r_tot,
        run,
        locked,
        noise=robot.torque_noise_std,
        seeds=settings.seeds,
        guesses=settings.guesses,
        rng=np.random.default_rng(seed),
    )


def _track(
    arms: Mapping[float, Robot],
    estimates: list[CoefficientEstimate],
    settings: StudySettings,
    pool: ProcessPool,
    rng: np.random.Generator,
    stage: StageStart,
) -> list[feedforward.Tracking]:
    """Drive the prototype under feed-forward of each identified model at the lowest and highest ratio identified."""
    known = sorted({e.r_tot for e in estimates})
    n, duration = len(arms[known[0]].joints), SETTLE + settings.tracking
    motions = [feedforward.reference(n, TRACKING_PERIOD, duration, rng) for _ in range(settings.motions)]
    tasks = []
    for r_tot in dict.fromkeys((known[0], known[-1])):
        truth = build_model(arms[r_tot], "mod3").Psi
        laws = [(f"identified {e.model}", e.model, e.Psi) for e in estimates if e.r_tot == r_tot]
        for name, model, Psi in [("none", "mod3", None), *laws, ("true mod3", "mod3", truth)]:
            law = feedforward.FeedforwardLaw(name, r_tot, model, Psi)
            for motion in motions:
                tasks.append(
                    partial(
                        feedforward.assess,
                        arms[r_tot],
                        law,
                        motion,
                        frequency=FEEDBACK_FREQUENCY,
                        settle=SETTLE,
                        step=settings.excitation_step,
                    )
                )
    runs = pool.run(tasks, stage("feed-forward of the prototype", len(tasks)))
    return [feedforward.together(runs[k : k + len(motions)]) for k in range(0, len(runs), len(motions))]


def _durations(starts: Mapping[str, float], end: float) -> dict[str, float]:
    """Turn the stages' starting times into durations, s, and add the whole."""
    edges = [*starts.values(), end]
    return {name: edges[k + 1] - edges[k] for k, name in enumerate(starts)} | {"whole study": end}
