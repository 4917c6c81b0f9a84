"""From recordings to an identified arm."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from elastic_arm.effects.library.base_tilt import TILT
from elastic_arm.effects.library.friction import PLAIN
from elastic_arm.effects.library.masses import LOAD, PAYLOAD
from elastic_arm.effects.text import parse_laws
from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.motion import Motion
from elastic_arm.identification.batch.derivatives import DerivativeStage
from elastic_arm.identification.batch.ignored_commands import without_ignored_commands
from elastic_arm.identification.batch.imperfections import nuisance_effects
from elastic_arm.identification.batch.mounting import other_mounting, states_tilt
from elastic_arm.identification.batch.selection import (
    BatchChoice,
    BatchTrial,
    IdentificationSettings,
    ProgressCallback,
    Trials,
    identifier_of,
    with_trace,
)
from elastic_arm.identification.carried import carried_of, with_carried
from elastic_arm.identification.consistent import (
    correlation_of_errors,
    odd_masses,
    with_consistency,
)
from elastic_arm.identification.law_columns import on_recorded_side, with_stated
from elastic_arm.identification.least_squares import Prior
from elastic_arm.identification.misfit import poor_fits, resonance
from elastic_arm.identification.regularisation import (
    DOUBT,
    chosen_width,
    described_width,
    description_error,
    law_sizes,
    prior_of,
)
from elastic_arm.identification.result import Identification
from elastic_arm.identification.stream import Identifier
from elastic_arm.identification.validation import HeldOut, validated
from elastic_arm.recording import Recording, Samples
from elastic_arm.recording.inspection.dead_torques import without_dead_torques
from elastic_arm.recording.inspection.outliers import without_outliers
from elastic_arm.recording.inspection.two_encoders import by_motor_encoders
from elastic_arm.recording.made_torque import at_common_gain, with_made_torque
from elastic_arm.recording.recording import recordings_of
from elastic_arm.recording.standstill import without_standstill
from elastic_arm.robot import Robot, require_robot

# Relative error of the description: where an arm is taken for rigid it is never believed to be off
# by more. What repeats in all parts of a recording shows no need of a prior, and still predicts
# another motion badly.
LOOSE = 3.0
MOTOR_INERTIA = "the description states no motor inertia: it was also identified (armature)"
BARE = (
    "no torque was recorded, so there is no equation: parameters visible only in"
    " these torques are not determined"
)
UNSEEN = "excluded, as it acts at a joint without a torque"
FELT = (
    "interpreted as friction that the joint torque sensors measure (side=link),"
    " as no motor torque was recorded"
)


def identify(
    recordings: Recording | Sequence[Recording],
    robot: Robot,
    settings: IdentificationSettings | None = None,
    *,
    validate: Sequence[Recording] = (),
    progress: ProgressCallback | None = None,
) -> Identification:
    """Identify an arm from recordings.

    Parameters
    ----------
    recordings
        One or several recordings with the same channels.
    robot
        The nominal arm.
    settings
        Settings; by default all parameters and no additional effects.
    validate
        Held-out recordings; the result contains the residuals on them.
    progress
        Called with the current stage and its completed share.

    Raises
    ------
    IdentificationError
        If the recordings allow no equation, or too few samples.
    RecordingError, RobotError
        If an argument has another type, or a channel contains implausible numbers.
    """
    return identify_with(recordings, robot, settings, validate=validate, progress=progress).result


class WithMotion(NamedTuple):
    """The result of an identification, and what it was made with."""

    result: Identification
    identifier: Identifier  # the estimator
    motion: Motion  # the first run of smoothed motion
    # by recording: stretches in which commands were ignored, s from its first sample
    ignored: dict[str, list[tuple[float, float]]]


def identify_with(
    recordings: Recording | Sequence[Recording],
    robot: Robot,
    settings: IdentificationSettings | None = None,
    *,
    validate: Sequence[Recording] = (),
    progress: ProgressCallback | None = None,
) -> WithMotion:
    """Identify as :func:`identify` does, and hand out more than the result."""
    require_robot(robot)
    settings = settings or IdentificationSettings()
    asked = settings.laws(robot)
    chosen = recordings_of(recordings)
    validate = recordings_of(validate, "validate")
    if not chosen:
        raise IdentificationError("no recording was given", "Give at least one.")
    report = progress or (lambda what, share: None)
    robot = at_common_gain(robot, [*chosen, *validate])
    ignored: dict[str, list[tuple[float, float]]] = {}
    chosen = [_cleared(one, robot, settings.model, ignored) for one in chosen]
    prepared = [recording.samples() for recording in chosen]
    validate = [_cleared(one, robot, settings.model, ignored) for one in validate]
    held_out = _held_out(validate, prepared[0], robot, settings.model)
    motored = any(samples.tau_m is not None for samples in prepared)
    armed = robot.with_armatures() if motored else robot
    notes = [MOTOR_INERTIA] if armed is not robot else []
    robot = armed
    asked, moved = on_recorded_side(asked, robot, motored=motored)
    known = with_stated(asked, robot, motored=motored, catalogue=settings.catalogue)
    known, unseen = with_trace(known, robot, settings.model, prepared[0])
    # What the description states of imperfections is as uncertain as what it does not.
    unasked = nuisance_effects(robot, settings.catalogue)
    effects = tuple(law for law in known if law in asked or law.effect.id not in unasked)
    recorded = list(zip(chosen, prepared, strict=True))
    settings = replace(settings, effects=effects)
    trials = Trials(recorded, robot, settings, report, unasked=bool(known))
    choice = trials.selected()
    if not states_tilt(known):
        trials, choice, mounting_notes = _mounted(trials, choice)
        notes += mounting_notes
    robot = trials.robot
    result, trial, correlated = _estimated(trials, choice)
    without_torque = prepared[0].without_torque(robot.joint_names)
    notes += _channel_notes(result, moved, without_torque, unseen)
    result = result.with_(notes=tuple(dict.fromkeys([*result.notes, *notes])))
    if validate:
        motions = _held_out_motions(held_out, trial, not choice.sticking, report)
        laws = (*trials.effects, *choice.laws)
        result = validated(result, trial.identifier, robot, laws, motions, correlated)
    if result.identified is not None:
        # Of the arm that is written, after validation has had its say.
        odd = odd_masses(with_carried(robot, result.carried), result.identified)
        result = result.with_(notes=(*result.notes, *odd))
    return WithMotion(result, trial.identifier, trial.derived[0].first, ignored)


def _mounted(trials: Trials, choice: BatchChoice) -> tuple[Trials, BatchChoice, list[str]]:
    """Return the trials of an arm that is mounted as its torques show, the choice among them, and a
    note; the same trials where they show the described mounting."""
    settings = trials.settings
    longest = trials(choice).derived[0].longest
    mounting = other_mounting(trials.robot, settings.model, [longest])
    if mounting is None:
        return trials, choice, []
    robot = mounting.of(trials.robot)
    tilt = parse_laws([TILT], robot, settings.catalogue)
    settings = replace(settings, effects=(*settings.effects, *tilt))
    trials = replace(trials, robot=robot, settings=settings, _known={})
    return trials, trials.selected(), [mounting.note]


def _channel_notes(
    result: Identification,
    moved: Sequence[str],
    without_torque: Sequence[str],
    unseen: Sequence[str],
) -> list[str]:
    """Return notes on laws and joints without a torque that shows them."""
    equations: set[str] = set()
    for of_side in result.noise.values():
        equations.update(of_side)
    bare = [name for name in without_torque if name not in equations]
    listed = ((moved, FELT), (bare, BARE), (unseen, UNSEEN))
    return [f"{', '.join(names)}: {words}" for names, words in listed if names]


def _cleared(
    recording: Recording, robot: Robot, model: str, left_out: dict[str, list[tuple[float, float]]]
) -> Recording:
    """Return the joints of the arm in motion, without outliers, by the encoders that its equations
    take, and without stretches in which commands were ignored, which are added to `left_out`."""
    moving = _in_motion(recording, robot)
    followed, ignored = without_ignored_commands(moving, robot, model)
    if not ignored:
        return followed
    where = recording.source or "the recording"
    notes = [f"{where}: {one.words}" for one in ignored]
    first = (moving.start_ns - recording.select(robot.joint_names).start_ns) * 1e-9
    spans = [(first + one.begin, first + one.end) for one in ignored]
    left_out[recording.source] = spans
    return replace(followed, notes=(*followed.notes, *notes))


def _in_motion(recording: Recording, robot: Robot) -> Recording:
    """Return the joints of the arm in motion, without outliers, and with torques that are made."""
    moving = without_outliers(without_standstill(recording.select(robot.joint_names)))
    moving, _ = without_dead_torques(moving, robot)
    return with_made_torque(by_motor_encoders(moving, robot), robot)


def _estimated(trials: Trials, choice: BatchChoice) -> tuple[Identification, BatchTrial, float]:
    """Return the identification by one choice, its estimator, and by what its errors exceed white
    ones in variance."""
    trial = trials.final(choice)
    trials.report("estimate", 1.0)
    identifier = trial.identifier
    derived = trial.derived
    sources = tuple(recording.source for recording, _ in trials.recordings)
    correlated = 1.0
    if trials.settings.consistent or choice.held:
        correlated = correlation_of_errors(
            identifier, repeats=any(stage.repeats for stage in trials.stages)
        )
    width, prior = _regularised(trial, choice, correlated)
    found = trial.fit if prior is None else identifier.fit(prior)
    result = identifier.estimate(sources, tuple(d.method for d in derived), found)
    units = trials.robot.units
    notes = [note for recording, _ in trials.recordings for note in recording.notes]
    notes += [
        note for d, source in zip(derived, sources, strict=True) for note in d.notes(source, units)
    ]
    notes += (
        []
        if width is None
        else [described_width(width, "cross-validation over parts of the recordings")]
    )
    notes += trials.notes(choice)
    notes += poor_fits(
        identifier.equations, derived[0].longest, result.Psi_base, trials.stages[0].torque_noise
    )
    result = result.with_(notes=tuple(dict.fromkeys([*result.notes, *notes])))
    if trials.settings.consistent:
        trials.report("physical consistency", 1.0)
        laws = (*trials.effects, *choice.laws)
        if not any(law.effect.id in (PAYLOAD.id, LOAD.id) for law in laws):
            carried = carried_of(identifier.fit(), identifier.equations, correlated)
            result = result.with_(carried=carried)
        result = with_consistency(result, identifier, trials.robot, laws, correlated=correlated)
    return result, trial, correlated


def _regularised(
    trial: BatchTrial, choice: BatchChoice, correlated: float
) -> tuple[float | None, Prior | None]:
    """Return the width of the prior that predicts left-out parts best, None where it takes none,
    and the prior."""
    equations = trial.identifier.equations
    blocks = trial.linear_blocks
    prior = partial(prior_of, equations, laws=law_sizes(blocks, equations), correlated=correlated)
    plain = trial.identifier.fit(prior(np.inf)) if choice.held else trial.fit
    chosen = chosen_width(blocks, plain, equations, correlated)
    width = min(chosen or LOOSE, LOOSE) if equations.rigid else chosen
    if width is None:
        return None, None
    return width if chosen else None, prior(width, description_error(plain, equations, DOUBT))


def _held_out(
    recordings: Sequence[Recording], fitted: Samples, robot: Robot, model: str
) -> dict[str, DerivativeStage]:
    """Return the derivative stage of each recording that no fit sees, by its source.

    What cannot be used fails before the fit, which would be lost.
    """
    stages = {}
    for recording in recordings:
        samples = recording.samples()
        channels = identifier_of(robot, model)
        for each in (fitted, samples):
            channels.choose_equations(each)
        stages[recording.source] = DerivativeStage(samples, source=recording.source)
        stages[recording.source]()
    return stages


def _held_out_motions(
    stages: Mapping[str, DerivativeStage], trial: BatchTrial, stuck: bool, report: ProgressCallback
) -> HeldOut:
    """Return the motion of recordings that no fit has seen, `stuck` if it states where joints
    stick."""
    equations = trial.identifier.equations
    motions = {}
    for source, stage in stages.items():
        report(f"validation on {source}", 1.0)
        derived = stage(equations, stuck=stuck).aligned(equations, trial.derived[0])
        motions[source] = list(derived.motions)
    return HeldOut(equations, motions)


def resonances(
    robot: Robot, model: str, recordings: Sequence[Sequence[Motion]]
) -> dict[str, float]:
    """Return the frequency, Hz, at which rigid joints answer their torque most, if any."""
    plain = robot.with_(effects=())
    found = dict[str, float]()
    friction = parse_laws(PLAIN, plain)
    for motions in recordings:
        longest = max(motions, key=len)
        identifier = identifier_of(plain, model, friction, averaged=False)
        identifier.add_motion(longest)
        Psi = identifier.fit().Psi
        for side, j in product(identifier.equations.sides, range(robot.n)):
            if (peak := resonance(identifier.equations, longest, Psi, side, j)) is not None:
                found[robot.joint_names[j]] = peak
    return found
