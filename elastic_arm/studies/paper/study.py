"""The whole study, stage by stage: runs of the prototype in parallel, then their evaluation by the
models.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics import build_model
from elastic_arm.excitation import ExcitationResult
from elastic_arm.processes import Advance, ProcessPool, Results, Task
from elastic_arm.robot.description import Robot
from elastic_arm.studies.paper import feedforward, torques
from elastic_arm.studies.paper.coupling import SymbolicCoupling, symbolic_coupling
from elastic_arm.studies.paper.identification_study import CoefficientEstimate, excite
from elastic_arm.studies.paper.identification_study import study as identify
from elastic_arm.studies.paper.torques import (
    MODELS,
    PROTOTYPE,
    LinkErrors,
    ModelComparison,
    TorqueErrors,
    compare,
    follow,
    torque_errors,
)
from elastic_arm.studies.paper.virtual_prototype.mechanism import Bushing, engine
from elastic_arm.studies.paper.virtual_prototype.motions import PeriodicMotion

StageStart = Callable[[str, int], Advance]
"""Called with a stage's name and its number of tasks; returns what to call after each task."""


@dataclass(frozen=True)
class StudySettings:
    """How much work the study does."""

    step: float  # of the prototype for the ramps, s; for the excitations:
    excitation_step: float
    identified: tuple[int, ...]  # positions of the ratios at which the models are identified
    seeds: tuple[int, int]  # noise realisations at 10 Hz and at 1 kHz
    evaluations: int  # budget of each pattern search
    random_trajectories: int
    translations: tuple[float, ...]  # stiffnesses of the bushing at which tau_l is compared, N/m
    tracking: float  # recorded seconds under feed-forward, after :data:`SETTLE` seconds to settle
    motions: int  # under feed-forward


FULL = StudySettings(
    step=1e-4,
    excitation_step=2e-4,
    identified=(0, 1, 2, 3, 4),
    seeds=(100, 20),
    evaluations=1500,
    random_trajectories=50,
    translations=(2e7, 5e7, 1e8, 4e8, 1e9),
    tracking=4.0,
    motions=3,
)
QUICK = StudySettings(
    step=2.5e-4,
    excitation_step=2.5e-4,
    identified=(-1,),
    seeds=(20, 3),
    evaluations=150,
    random_trajectories=10,
    translations=(5e7, 1e9),
    tracking=1.0,
    motions=2,
)
SETTLE = 2.0
FEEDBACK_FREQUENCY = 10.0
TRACKING_PERIOD = 4.0


@dataclass(kw_only=True)
class StudyResult:
    """All numbers of the study; claims and report are made of them and nothing else.

    `comparisons` are the ramps over the ratios, and `smooth` a ramp at the highest one without
    jumps of acceleration. `inertial` is what tau_m is made of there, rms per joint (n,), and
    `locked_link` the largest tau_l that mod3 leaves with the bushing locked, Nm. `translations` are
    the errors at the highest ratio as the bushing's translation stiffness varies; the paper does
    not state it.
    """

    robot: Robot
    settings: StudySettings
    engine: str
    ratios: tuple[float, ...]
    comparisons: list[ModelComparison]
    smooth: ModelComparison
    against_mod3: TorqueErrors
    against_prototype: TorqueErrors
    inertial: Mapping[str, Array]
    locked_link: float
    translations: list[LinkErrors]
    coupling: SymbolicCoupling
    tilted_coupling: SymbolicCoupling
    excited: Mapping[str, ExcitationResult]
    estimates: list[CoefficientEstimate]
    tracking: list[feedforward.Tracking]

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


def run_study(
    robot: Robot, settings: StudySettings, *, workers: int, seed: int, stage: StageStart
) -> StudyResult:
    """Reproduce the paper."""
    ratios = torques.studied_ratios(robot)
    engine_name = f"MuJoCo {engine().__version__}"
    rng = np.random.default_rng(seed)
    arms = {r_tot: robot.with_ratio(r_tot) for r_tot in ratios}
    top = arms[ratios[-1]]
    with ProcessPool(workers) as pool:

        def begin(name: str, tasks: Sequence[Task]) -> Results[Any]:
            return pool.start(list(tasks), stage(name, len(tasks)))

        # What later stages wait for is begun first; the others fill the processes' time.
        searches = begin("search of the excitations", _searches(top, settings, rng))
        excited = dict(zip(MODELS, searches(), strict=True))
        identifying = begin(
            "excitation runs and identification", _identifying(arms, excited, settings, rng)
        )
        step = settings.step
        stepping = torques.ramp_tasks(list(arms.values()), Bushing(), step)
        ramps = begin("step ramps of the prototype", stepping)
        stiffened = [
            partial(torques.link_errors, top, ratios[-1], K, step) for K in settings.translations
        ]
        translating = begin("translation stiffness of the bushing", stiffened)
        locking = begin("the prototype with locked bushings", [partial(torques.locked_link, top)])
        derivations = [partial(symbolic_coupling, top, bearings=b) for b in (False, True)]
        deriving = begin("the coupling S in symbols", derivations)
        estimates = identifying()
        tracking = begin("feed-forward of the prototype", _tracking(arms, estimates, settings, rng))
        *stepped, smooth = ramps()
        compared = [compare(arms[r], r, run) for r, run in zip(ratios, stepped, strict=True)]
        own = torques.link_errors_of(compared[-1], Bushing().translation_stiffness)
        coupling, tilted_coupling = deriving()
        tracked = tracking()
        return StudyResult(
            robot=robot,
            settings=settings,
            engine=engine_name,
            ratios=ratios,
            comparisons=compared,
            smooth=compare(top, ratios[-1], smooth),
            against_mod3=torque_errors(compared, "mod3"),
            against_prototype=torque_errors(compared, PROTOTYPE),
            inertial=torques.motor_terms(top, stepped[-1]),
            locked_link=locking()[0],
            translations=sorted([*translating(), own], key=lambda errors: errors.stiffness),
            coupling=coupling,
            tilted_coupling=tilted_coupling,
            excited=excited,
            estimates=estimates,
            tracking=_by_law(tracked, settings.motions),
        )


def _by_law(tracked: Sequence[feedforward.Tracking], motions: int) -> list[feedforward.Tracking]:
    """Put the runs of each law together."""
    starts = range(0, len(tracked), motions)
    return [feedforward.together(tracked[start : start + motions]) for start in starts]


def _searches(top: Robot, settings: StudySettings, rng: np.random.Generator) -> list[Task]:
    """Search the excitation of each model, each from a seed of its own."""
    seeds = rng.integers(2**31, size=len(MODELS)).tolist()
    effort = (settings.evaluations, settings.random_trajectories)
    return [partial(excite, top, m, *effort, seed) for m, seed in zip(MODELS, seeds, strict=True)]


def _identifying(
    arms: Mapping[float, Robot],
    excited: Mapping[str, ExcitationResult],
    settings: StudySettings,
    rng: np.random.Generator,
) -> list[Task]:
    """Identify each model at each of the chosen ratios."""
    tasks: list[Task] = []
    for k in settings.identified:
        r_tot = list(arms)[k]
        for model in MODELS:
            seed = int(rng.integers(2**31))
            tasks.append(
                partial(_identify, arms[r_tot], model, r_tot, excited[model], settings, seed)
            )
    return tasks


def _identify(
    robot: Robot,
    model: str,
    r_tot: float,
    excited: ExcitationResult,
    settings: StudySettings,
    seed: int,
) -> CoefficientEstimate:
    motion = PeriodicMotion(excited.trajectory)
    rng = np.random.default_rng(seed)
    run = follow(robot, Bushing(), motion, settings.excitation_step)
    locked = follow(robot, Bushing(locked=True), motion, torques.LOCKED_STEP)
    return identify(
        robot,
        model,
        r_tot,
        run,
        locked,
        noise=robot.torque_noise_std,
        seeds=settings.seeds,
        rng=rng,
    )


def _tracking(
    arms: Mapping[float, Robot],
    estimates: list[CoefficientEstimate],
    settings: StudySettings,
    rng: np.random.Generator,
) -> list[Task]:
    """Drive the prototype under feed-forward of each identified model at the lowest and highest
    ratio identified.

    The tasks are those of each law along each motion, laws first.
    """
    known = sorted({e.r_tot for e in estimates})
    n = len(arms[known[0]].joints)
    duration = SETTLE + settings.tracking
    motions = [
        feedforward.reference(n, TRACKING_PERIOD, duration, rng) for _ in range(settings.motions)
    ]
    how = {"frequency": FEEDBACK_FREQUENCY, "settle": SETTLE, "step": settings.excitation_step}
    tasks: list[Task] = []
    for r_tot in dict.fromkeys((known[0], known[-1])):
        truth = build_model(arms[r_tot], "mod3").Psi
        named = [(f"identified {e.model}", e.model, e.Psi) for e in estimates if e.r_tot == r_tot]
        for name, model, Psi in [("none", "mod3", None), *named, ("true mod3", "mod3", truth)]:
            law = feedforward.FeedforwardLaw(name, r_tot, model, Psi)
            tasks += [
                partial(feedforward.assess, arms[r_tot], law, motion, **how) for motion in motions
            ]
    return tasks
