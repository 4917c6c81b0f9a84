"""The whole study, stage by stage: runs of the prototype over the cores, then what the models make of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from elastic_arm.dynamics import build_model
from elastic_arm.robot.description import Robot
from elastic_arm.studies.paper import comparison, convergence, cost, feedforward
from elastic_arm.studies.paper.comparison import MODELS, ModelComparison
from elastic_arm.studies.paper.coupling import SymbolicCoupling, symbolic_coupling
from elastic_arm.studies.paper.excitations import ExcitationSearch, excite
from elastic_arm.studies.paper.identification_study import CoefficientEstimate
from elastic_arm.studies.paper.identification_study import study as identify
from elastic_arm.studies.paper.torque_study import (
    LOCKED_STEP,
    LinkErrors,
    TorqueResult,
    follow,
    link_errors,
    ramp_tasks,
    studied_ratios,
    torque_result,
)
from elastic_arm.studies.paper.virtual_prototype.mechanism import Bushing, engine
from elastic_arm.studies.paper.virtual_prototype.motions import PeriodicMotion, StepRamp
from elastic_arm.studies.paper.virtual_prototype.prototype import PrototypeRun
from elastic_arm.studies.parallel import Advance, ProcessPool, Results

StageStart = Callable[[str, int], Advance]
"""Called with a stage's name and its number of tasks; returns what to call after each task."""


@dataclass(frozen=True)
class StudySettings:
    """How much work the study does."""

    # step, excitation_step: Steps of the prototype for the ramps and for the excitations, s
    step: float
    excitation_step: float
    poses: int  # starting poses of the ramp at the highest ratio, the zero pose included
    identified: tuple[int, ...]  # positions, in the rising list of ratios, of those at which the models are identified
    seeds: tuple[int, int]  # noise realisations at 10 Hz and at 1 kHz
    guesses: int  # wrong descriptions from which individual parameters are recovered
    evaluations: int  # budget of each pattern search
    random_trajectories: int  # how many of the searches' start the searched trajectory is compared with
    # bushing_scales, coupler_frequencies, step_sizes: Of the convergence tables; the last step is the one that the
    # others are compared with
    bushing_scales: tuple[float, ...]
    coupler_frequencies: tuple[float, ...]
    step_sizes: tuple[float, ...]
    # Translation stiffnesses of the bushing at which tau_l is compared beside the one assumed, N/m
    translations: tuple[float, ...]
    tracking: float  # recorded seconds under feed-forward, after :data:`SETTLE` seconds to settle
    motions: int  # number of motions under feed-forward


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
    translations=(2e7, 5e7, 1e8, 4e8, 1e9),
    tracking=4.0,
    motions=3,
)
QUICK = StudySettings(
    step=2.5e-4,
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
    translations=(5e7, 1e9),
    tracking=1.0,
    motions=2,
)
COUPLER_STEP = 1e-4
SETTLE = 2.0
FEEDBACK_FREQUENCY = 10.0
TRACKING_PERIOD = 4.0


@dataclass(kw_only=True)
class StudyResult(TorqueResult):
    """All numbers of the study; the report draws from here and nothing else.

    `poses` are the ramps from other poses at the highest ratio, beside those of
    :class:`~elastic_arm.studies.paper.torque_study.TorqueResult`.
    """

    settings: StudySettings
    poses: list[tuple[np.ndarray, ModelComparison]]
    convergence: Mapping[str, list[convergence.ConvergenceCheck]]
    excited: Mapping[str, ExcitationSearch]
    estimates: list[CoefficientEstimate]
    tracking: list[feedforward.Tracking]
    costs: list[cost.Cost]
    engine: str
    seconds: dict[str, float] = field(default_factory=dict)

    def estimate(self, model: str, r_tot: float | None = None) -> CoefficientEstimate:
        """Return one model's identification, at the highest ratio by default."""
        wanted = self.highest if r_tot is None else r_tot
        return next(e for e in self.estimates if (e.model, e.r_tot) == (model, wanted))


def run_study(robot: Robot, settings: StudySettings, *, workers: int, seed: int, stage: StageStart) -> StudyResult:
    """Reproduce the paper."""
    started = time.perf_counter()
    ratios = studied_ratios(robot)
    engine_name = f"MuJoCo {engine().__version__}"
    rng = np.random.default_rng(seed)
    arms = {r_tot: robot.with_ratio(r_tot) for r_tot in ratios}
    top = arms[ratios[-1]]
    seconds: dict[str, float] = {}
    timed = partial(_timed, stage, seconds)
    starts = rng.uniform(-1.0, 1.0, (settings.poses - 1, robot.n))
    with ProcessPool(workers) as pool:
        # What later stages wait for is begun first; the others fill the processes' time.
        searches = _excite(top, settings, pool, rng, timed)
        checking = _convergence(top, settings, pool, timed)
        excited = dict(zip(MODELS, searches(), strict=True))
        identifying = _identify(arms, excited, settings, pool, rng, timed)
        ramping = _ramps(arms, starts, settings, pool, timed)
        translating = _translations(top, ratios[-1], settings, pool, timed)
        deriving = pool.start(
            [partial(symbolic_coupling, top, bearings=bearings) for bearings in (False, True)],
            timed("the coupling S in symbols", 2),
        )
        estimates = identifying()
        tracking = _track(arms, estimates, settings, pool, rng, timed)
        ramps = ramping()
        checks = _by_table(checking())
        torques = _torques(robot, arms, ramps, checks, translating(), deriving())
        poses = zip(starts, ramps[len(ratios) + 1 :], strict=True)
        compared = [(start, comparison.compare(top, ratios[-1], run)) for start, run in poses]
        tracked, along = tracking(), settings.motions
    advance = timed("cost", 1)
    costs = cost.measure(top, rng)
    advance()
    seconds["whole study"] = time.perf_counter() - started
    return StudyResult(
        **vars(torques),
        settings=settings,
        poses=compared,
        convergence=checks,
        excited=excited,
        estimates=estimates,
        tracking=[feedforward.together(tracked[k : k + along]) for k in range(0, len(tracked), along)],
        costs=costs,
        engine=engine_name,
        seconds=seconds,
    )


def _torques(
    robot: Robot,
    arms: Mapping[float, Robot],
    ramps: list[PrototypeRun],
    checks: Mapping[str, list[convergence.ConvergenceCheck]],
    translations: list[LinkErrors],
    coupling: list[SymbolicCoupling],
) -> TorqueResult:
    locked, tilting = coupling
    return torque_result(
        robot,
        arms,
        ramps,
        translations=translations,
        assumed=Bushing().translation_stiffness,
        locked=next(check.tau_l for check in checks["bushing"] if np.isinf(check.setting)) or 0.0,
        coupling=(locked, tilting),
    )


def _timed(stage: StageStart, seconds: dict[str, float], name: str, count: int) -> Advance:
    """Begin a stage, and keep in `seconds` how long after its beginning its last task was done."""
    begun, advance = time.perf_counter(), stage(name, count)

    def advanced() -> None:
        seconds[name] = time.perf_counter() - begun
        advance()

    return advanced


def _ramps(
    arms: Mapping[float, Robot], starts: np.ndarray, settings: StudySettings, pool: ProcessPool, stage: StageStart
) -> Results[PrototypeRun]:
    """Run the step ramp over all ratios, at the highest without jumps too, and there from the other poses."""
    known = list(arms.values())
    tasks = ramp_tasks(known, Bushing(), settings.step)
    tasks += [partial(follow, known[-1], Bushing(), StepRamp(start), settings.step) for start in starts]
    return pool.start(tasks, stage("step ramps of the prototype", len(tasks)))


def _translations(
    robot: Robot, r_tot: float, settings: StudySettings, pool: ProcessPool, stage: StageStart
) -> Results[LinkErrors]:
    tasks = [partial(link_errors, robot, r_tot, value, settings.step) for value in settings.translations]
    return pool.start(tasks, stage("translation stiffness of the bushing", len(tasks)))


def _convergence(
    robot: Robot, settings: StudySettings, pool: ProcessPool, stage: StageStart
) -> Results[list[convergence.ConvergenceCheck]]:
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
    return pool.start(tasks, stage("convergence of the prototype", len(tasks)))


def _by_table(
    parts: list[list[convergence.ConvergenceCheck]],
) -> dict[str, list[convergence.ConvergenceCheck]]:
    """Name the results of the tasks of :func:`_convergence`."""
    steps, couplers, *bushings = parts
    return {"step": steps, "coupler": couplers, "bushing": [check for part in bushings for check in part]}


def _excite(
    robot: Robot, settings: StudySettings, pool: ProcessPool, rng: np.random.Generator, stage: StageStart
) -> Results[ExcitationSearch]:
    seeds = rng.integers(2**31, size=len(MODELS))
    tasks = [
        partial(excite, robot, model, settings.evaluations, settings.random_trajectories, int(seed))
        for model, seed in zip(MODELS, seeds, strict=True)
    ]
    return pool.start(tasks, stage("search of the excitations", len(tasks)))


def _identify(
    arms: Mapping[float, Robot],
    excited: Mapping[str, ExcitationSearch],
    settings: StudySettings,
    pool: ProcessPool,
    rng: np.random.Generator,
    stage: StageStart,
) -> Results[CoefficientEstimate]:
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
    return pool.start(tasks, stage("excitation runs and identification", len(tasks)))


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
) -> Results[feedforward.Tracking]:
    """Drive the prototype under feed-forward of each identified model at the lowest and highest ratio identified.

    The results are those of each law along each motion, laws first.
    """
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
    return pool.start(tasks, stage("feed-forward of the prototype", len(tasks)))
