"""The settings of a batch identification, and the choices that the recordings decide.

**Dry friction** reverses gradually about standstill: at each joint within the most probable of
several speeds, by the difference of their errors block by block (Q. Vuong, Econometrica 57 (1989)
307) and the usual speed. While a joint sticks, its dry friction may have any value; if the law
fails there, the rows that contain it are left out.

**Zeros** of torque channels and the tilt of the base: see :mod:`.imperfections`.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics import build_model
from elastic_arm.effects import Catalogue, EffectInstance
from elastic_arm.effects.library.friction import PLAIN
from elastic_arm.effects.text import parse_laws, read_effects
from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.residuals import FAILS
from elastic_arm.identification.accumulator import closes
from elastic_arm.identification.base_regression import BaseRegression, Column
from elastic_arm.identification.batch.derivatives import DerivativeStage, Derived
from elastic_arm.identification.batch.imperfections import (
    NuisanceLaw,
    described_imperfections,
    judged_imperfections,
    possible_imperfections,
    told_apart,
)
from elastic_arm.identification.law_columns import (
    DEFAULT_SIGN_SPEED,
    SIGN_SPEEDS,
    USUAL_SIGN_SPEED,
    is_dry,
    law_columns,
    place_of,
)
from elastic_arm.identification.least_squares import Blocks, Fit
from elastic_arm.identification.stream import Identifier
from elastic_arm.recording import Recording, Samples
from elastic_arm.recording.inspection.outliers import without_outliers
from elastic_arm.robot import Robot

ProgressCallback = Callable[[str, float], None]

# Squared errors below this share of their terms' squares are nothing but rounding: exact sensors
# close an equation so.
ROUNDING = 1e-12
# Hz up to which first resonances of arms lie: rows of a band that ends there are not averaged.
RESONANCES = 20.0
STICKS = "times at which a joint sticks are excluded: its dry friction takes any value there"
# Standard deviation, as a factor, of the speeds within which friction turns over.
SPREAD = 10.0
# Laws whose squared errors differ by this share may be ranked either way by another motion.
ALIKE = 0.02


@dataclass(frozen=True)
class IdentificationSettings:
    """How an arm is identified.

    Parameters
    ----------
    model
        mod1, mod2 or mod3.
    effects
        Effects identified in addition to the parameters of the model and to the effects in the
        description, as text ("coulomb_friction", on every joint) or as
        :func:`elastic_arm.effects.text.parse_laws` reads them.
    consistent
        Also estimate all parameters such that they are physically consistent, and close to the
        nominal ones where the data do not determine them.
    catalogue
        Catalogue of the effects in the description; the default one if None.
    """

    model: str = "mod3"
    effects: Sequence[EffectInstance | str] = ()
    consistent: bool = True
    catalogue: Catalogue | None = None

    def laws(self, robot: Robot) -> tuple[EffectInstance, ...]:
        """Return the laws on the joints of an arm."""
        return read_effects(self.effects, lambda text: parse_laws([text], robot, self.catalogue))


@dataclass(frozen=True)
class BatchChoice:
    """The choices that have been decided so far."""

    # rad/s, of all joints or (n,), see :func:`.law_columns.law_columns`
    sign_speed: float | tuple[float, ...] = DEFAULT_SIGN_SPEED
    imperfections: tuple[NuisanceLaw, ...] = ()  # What is identified though nobody asked for it
    averaged: bool = True  # Whether the rows of an arm that is taken for rigid are averaged
    sticking: bool = True  # Whether rows that hold the friction of a joint that sticks count

    @property
    def key(self) -> tuple[object, ...]:
        """What distinguishes it from other choices."""
        return (
            self.sign_speed,
            self.averaged,
            self.sticking,
            tuple((e.place, e.ordinary) for e in self.imperfections),
        )

    @property
    def held(self) -> bool:
        """Whether a prior constrains some imperfections to their ordinary size."""
        return any(each.ordinary is not None for each in self.imperfections)

    @property
    def laws(self) -> tuple[EffectInstance, ...]:
        """The imperfections' laws."""
        return tuple(each.instance for each in self.imperfections)


@dataclass(frozen=True)
class BatchTrial:
    """An estimator with the data of all recordings, and the derivative stages."""

    identifier: Identifier
    derived: list[Derived]

    @functools.cached_property
    def fit(self) -> Fit:
        """The estimate without a prior."""
        return self.identifier.fit()

    @functools.cached_property
    def linear_blocks(self) -> Blocks:
        """The sums of rows that are linear in the base parameters."""
        return self.identifier.linear_blocks(self.fit)


@dataclass
class Trials:
    """Estimators for one question with different choices.

    Results that depend on no choice are computed once.
    """

    recordings: Sequence[tuple[Recording, Samples]]  # With their samples
    robot: Robot  # The nominal arm
    # How it is identified; laws that the description states are among the effects
    settings: IdentificationSettings
    report: ProgressCallback  # Called with what is being done, and the share that is done
    unasked: bool = False  # Whether imperfections are identified that nobody asked for
    _known: dict[tuple[object, ...], BatchTrial] = field(default_factory=dict)
    _made: int = 0

    @functools.cached_property
    def effects(self) -> tuple[EffectInstance, ...]:
        """The laws that are identified."""
        return self.settings.laws(self.robot)

    @functools.cached_property
    def stages(self) -> list[DerivativeStage]:
        """The derivative stage of each recording."""
        found = []
        for recording, samples in self.recordings:
            self.report(f"motion of {recording.source}", 0.0)
            found.append(DerivativeStage(samples, source=recording.source))
        return found

    def __call__(self, choice: BatchChoice, *, ends: bool = False) -> BatchTrial:
        """Return the estimator of one choice; with `ends`, those of the recordings' pieces are used
        too."""
        if not ends and choice.key in self._known:
            return self._known[choice.key]
        identifier = self._estimator(choice, encoder_columns=True, averaged=choice.averaged)
        unasked = {place_of(each.instance, self.robot) for each in choice.imperfections}
        derived: list[Derived] = []
        for stage, (recording, samples) in zip(self.stages, self.recordings, strict=True):
            self.report(f"equations of {recording.source}", self._made / (self._made + 1))
            equations = identifier.choose_equations(samples)
            if lost := [
                c.name
                for c in equations.columns
                if c not in _traced(equations) and c.place not in unasked
            ]:
                raise IdentificationError(
                    f"{', '.join(lost)}: not visible in the recorded torques",
                    "Omit the effect, or let it act on the recorded side, as in"
                    " coulomb_friction:side=link.",
                )
            made = stage(equations, ends=ends, stuck=not choice.sticking)
            derived.append(made.aligned(equations, derived[0] if derived else None))
        if identifier.accumulator is not None:
            identifier.accumulator.expect(sum(made.samples for made in derived))
        for motion in (motion for made in derived for motion in made.motions):
            identifier.add_motion(motion)
        trial = BatchTrial(identifier, derived)
        self._made += 1
        if not ends:
            self._known[choice.key] = trial
        return trial

    def _estimator(self, choice: BatchChoice, **options: Any) -> Identifier:
        """Return an estimator with the columns of the laws asked for and of imperfections, these
        with their priors."""
        laws = [*self.effects, *choice.laws]
        columns = law_columns(laws, self.robot, self.settings.model, choice.sign_speed)
        ordinary = {
            place_of(each.instance, self.robot): each.ordinary for each in choice.imperfections
        }
        columns = [replace(column, ordinary=ordinary.get(column.place)) for column in columns]
        arm = build_model(self.robot, self.settings.model)
        return Identifier(arm, columns, joints=self.robot.joint_names, **options)

    def selected(self) -> BatchChoice:
        """Return the choices that the recordings decide."""
        choice = self._sticking(self.turning())
        possible = choice.imperfections
        if not possible:
            return choice
        trial = self(choice)
        equations = trial.identifier.equations
        kept = judged_imperfections(possible, trial.fit, equations, held=equations.rigid)
        return replace(choice, imperfections=kept)

    def turning(self) -> BatchChoice:
        """Return the choice of the speed within which dry friction reverses."""
        return self._speed(self._averaged(BatchChoice(imperfections=self._possible())))

    def _possible(self) -> tuple[NuisanceLaw, ...]:
        """Return the imperfections that the channels can separate from everything else."""
        if not self.unasked:
            return ()
        samples = [each for _, each in self.recordings]
        possible = possible_imperfections(
            samples, self.robot, self.effects, self.settings.catalogue
        )
        equations = self._estimator(BatchChoice(imperfections=possible)).choose_equations(
            samples[0]
        )
        return told_apart(possible, equations)

    def final(self, choice: BatchChoice) -> BatchTrial:
        """Return the estimator of a choice.

        It uses the ends of short recordings if the equations do not hold exactly.
        """
        trial = self(choice)
        return trial if closes(trial.fit, trial.linear_blocks) else self(choice, ends=True)

    def notes(self, choice: BatchChoice) -> list[str]:
        """Return the choices in words."""
        found = []
        if any(is_dry(instance) for instance in self.effects):
            found.append(
                f"dry friction reverses within {standstill(choice.sign_speed, self.robot)} of"
                " standstill"
            )
        if not choice.sticking:
            found.append(STICKS)
        return found + described_imperfections(choice.imperfections)

    def _averaged(self, choice: BatchChoice) -> BatchChoice:
        """Return the choice without averages if they remove nothing.

        This is the case if the band ends at the resonances of arms, or the equations hold as they
        are, because the arm is rigid in the band.
        """
        whole = replace(choice, averaged=False)
        if all(stage.band <= RESONANCES or stage.read is not None for stage in self.stages):
            return whole
        trial = self(whole)
        rigid = trial.identifier.equations.rigid
        return choice if rigid and not closes(trial.fit, trial.linear_blocks) else whole

    def _sticking(self, choice: BatchChoice) -> BatchChoice:
        """Return the choice without the rows of joints that stick, if the law of friction fails
        there.

        With averages these rows are kept: the model error is not noise there, and omitted rows
        would be predicted worse.
        """
        if choice.averaged or not any(is_dry(instance) for instance in self.effects):
            return choice
        rest = self(replace(choice, sticking=False))
        share = 1.0 - rest.linear_blocks.share
        held = share > 0.0
        if not held.any():
            return choice
        whole = _errors_by_block(self(choice), rest.fit).sum(axis=0)
        left = _errors_by_block(rest, rest.fit).sum(axis=0)
        precision = held / rest.fit.noise**2
        stuck = precision @ (whole - left) / share.sum()
        moving = precision @ left / np.sum(1.0 - share[held])
        return replace(choice, sticking=bool(stuck <= FAILS * moving))

    def _speed(self, choice: BatchChoice) -> BatchChoice:
        """Return the choice with the speed within which the dry friction of each joint reverses."""
        if not any(is_dry(instance) for instance in self.effects):
            return choice
        each: dict[float, Array] = {}
        for speed in SIGN_SPEEDS:
            trial = self(replace(choice, sign_speed=speed))
            each[speed] = _errors_by_block(trial, trial.fit)
            del trial
            # Sums by block take much memory, and those of the best alone are asked for again.
            usual = np.maximum(each[SIGN_SPEEDS[0]].sum(axis=0), 1e-300)
            totals = {one: float(np.sum(e.sum(axis=0) / usual)) for one, e in each.items()}
            for one in each.keys() - {min(totals, key=totals.__getitem__)}:
                self._known.pop(replace(choice, sign_speed=one).key, None)
        errors = np.array(list(each.values()))
        scale = np.maximum(errors.min(axis=0).sum(axis=0), 1e-300)
        by_joint = (errors / scale).reshape(*errors.shape[:2], -1, self.robot.n).sum(axis=2)
        best = [turning_speed(by_joint[:, :, j]) for j in range(self.robot.n)]
        return replace(choice, sign_speed=best[0] if len(set(best)) == 1 else tuple(best))


def standstill(sign_speed: float | Sequence[float], robot: Robot) -> str:
    """Return in words the speeds, of all joints or (n,), within which dry friction reverses."""
    by_unit: dict[str, list[float]] = {}
    for name, speed in zip(
        robot.joint_names, np.broadcast_to(sign_speed, robot.n).tolist(), strict=True
    ):
        by_unit.setdefault(robot.units.at(name, "rad/s"), []).append(speed)
    spans = []
    for unit, speeds in by_unit.items():
        low = f"{min(speeds):g}"
        high = f"{max(speeds):g}"
        spans.append(f"{low} {unit}" if low == high else f"{low} to {high} {unit}")
    return " and ".join(spans)


def turning_speed(errors: Array) -> float:
    """Return the most probable speed, rad/s, within which dry friction reverses.

    Each speed gives another law with the same number of parameters. If the error of a law exceeds
    that of the best one by d, with a standard deviation s from the scatter between blocks, its
    relative likelihood is exp(-(d/s)²/2). Since no law is exact, a share :data:`ALIKE` of the
    errors is included in s: blocks of one motion resemble each other more than another motion does.
    The prior of the speeds is spread by a factor of :data:`SPREAD` about the usual one. `errors`
    (speeds, blocks) are squared errors of one joint.
    """
    more = errors - errors[np.argmin(errors.sum(axis=1))]
    doubt = (
        np.std(more, axis=1, ddof=1) * np.sqrt(more.shape[1])
        if more.shape[1] > 1
        else np.full(len(more), np.inf)
    )
    doubt = np.maximum(np.hypot(doubt, ALIKE * errors.sum(axis=1).min()), 1e-300)
    unlikely = 0.5 * (more.sum(axis=1) / doubt) ** 2
    unusual = 0.5 * (np.log(np.array(SIGN_SPEEDS) / USUAL_SIGN_SPEED) / np.log(SPREAD)) ** 2
    return SIGN_SPEEDS[int(np.argmin(unlikely + unusual))]


def with_trace(
    laws: Sequence[EffectInstance], robot: Robot, model: str, samples: Samples
) -> tuple[tuple[EffectInstance, ...], list[str]]:
    """Return the laws that affect some recorded torque, and the names of the others.

    This applies if the torques of some joints are missing.
    """
    bare = samples.without_torque(robot.joint_names)
    if not any(law.joint in bare for law in laws):
        return tuple(laws), []
    equations = identifier_of(robot, model, laws).choose_equations(samples)
    shown = {column.place for column in _traced(equations)}
    unseen = [law for law in laws if law.joint in bare and place_of(law, robot) not in shown]
    return tuple(law for law in laws if law not in unseen), [place_of(law, robot) for law in unseen]


def identifier_of(
    robot: Robot, model: str = "mod3", effects: Sequence[EffectInstance] = (), **options: Any
) -> Identifier:
    """Return the stream estimator for an arm.

    Parameters
    ----------
    robot
        The nominal arm.
    model
        mod1, mod2 or mod3.
    effects
        Laws identified beside the model.
    options
        Of :class:`.stream.Identifier`.
    """
    arm = build_model(robot, model)
    columns = law_columns(effects, robot, model)
    return Identifier(arm, columns, joints=robot.joint_names, **options)


def _traced(equations: BaseRegression) -> list[Column]:
    """Return the columns of laws beyond the model that act in at least one equation."""
    first = len(equations.names) - len(equations.columns)
    return [c for k, c in enumerate(equations.columns, first) if equations.base.T[:, k].any()]


def _errors_by_block(trial: BatchTrial, fit: Fit) -> Array:
    """Return the squared errors (blocks, groups) of a fit on the rows of a trial, at least as large
    as rounding errors."""
    blocks = trial.linear_blocks
    solution = np.append(-fit.Psi, 1.0)
    factors = np.array(blocks.factors)
    errors = np.sum((factors @ solution) ** 2, axis=-1)
    terms = np.sum((factors * solution) ** 2, axis=(-2, -1))
    return np.maximum(errors, ROUNDING * terms)


def turning_speeds(recordings: Sequence[Recording], robot: Robot) -> Array | None:
    """Return the speed (n,) rad/s within which the dry friction of each joint reverses.

    None if nothing shows it. Base parameters, friction and zeros of the torques are fitted together
    with it.
    """
    chosen = [without_outliers(recording.select(robot.joint_names)) for recording in recordings]
    recorded = [(recording, recording.samples()) for recording in chosen]
    side = "" if all(samples.tau_m is not None for _, samples in recorded) else ":side=link"
    laws = parse_laws([f"{law}{side}" for law in PLAIN], robot)
    settings = IdentificationSettings(model="mod1", effects=laws)
    trials = Trials(recorded, robot, settings, report=lambda what, share: None, unasked=True)
    try:
        speeds = trials.turning().sign_speed
    except IdentificationError:
        return None
    return np.broadcast_to(np.asarray(speeds, dtype=float), (robot.n,)).copy()
