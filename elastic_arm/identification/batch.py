"""From recordings to an identified arm."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics import build_model
from elastic_arm.effects import Catalogue, EffectInstance
from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.motion import Motion
from elastic_arm.estimation.resampling import Clock
from elastic_arm.estimation.series import FourierFit, fourier_motion, period_of, repeats
from elastic_arm.estimation.smoother import Smoother, design_smoother, left_out, runs, with_ends
from elastic_arm.identification.accumulator import closes
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.consistency import correlation_of_errors, with_consistency
from elastic_arm.identification.deflection import shifted, shifts, zeros
from elastic_arm.identification.deviations import series_covariance
from elastic_arm.identification.law_columns import DEFAULT_SIGN_SPEED, SIGN_SPEEDS, is_dry, law_columns, with_stated
from elastic_arm.identification.least_squares import Prior
from elastic_arm.identification.regularisation import (
    DOUBT,
    HeldOut,
    chosen_width,
    described_width,
    description_error,
    law_sizes,
    prior_of,
    validated,
)
from elastic_arm.identification.result import Identification
from elastic_arm.identification.stream import Identifier, smoothed
from elastic_arm.recording import Recording, Samples
from elastic_arm.recording.inspection.outliers import without_outliers
from elastic_arm.robot import Robot

Array = NDArray[np.float64]
Method = Literal["auto", "smoother", "fourier"]
ProgressCallback = Callable[[str, float], None]
MOTOR_INERTIA = (
    "the description states no motor inertia: it was identified beside the links (armature; a URDF cannot hold it)"
)


@dataclass(frozen=True)
class Derived:
    """A recording after its derivative stage: runs of motion, and how they came about.

    Parameters
    ----------
    pieces
        Each makes one run when it is called: a long recording is never in memory as a whole.
    method
        In words.
    series
        Of link and motor side for each of `pieces`, where the derivatives come from them.
    said
        What is to be known of clock and pieces.
    repeats
        Whether the motion is periodic.
    zeros, shift
        Where deflections are measured: at no load, with standard deviations, and what is added to the link angles so
        that they count from where those of the first recording do, (n,) rad each.
    """

    pieces: tuple[Callable[[], Motion], ...]
    method: str
    series: tuple[tuple[FourierFit | None, FourierFit | None], ...] = ()
    said: tuple[str, ...] = ()
    repeats: bool = False
    zeros: tuple[Array, Array] | None = None
    shift: Array | None = None

    @property
    def motions(self) -> Iterator[Motion]:
        """Make the runs one after another; runs of one piece of the recording follow each other without a hole."""
        return (piece() if self.shift is None else shifted(piece(), self.shift) for piece in self.pieces)

    def notes(self, source: str, joints: Sequence[str]) -> list[str]:
        """Return what was done to the recording `source` beside smoothing it."""
        said = [f"{source}: {note}" for note in self.said]
        if self.shift is None or not self.shift.any():
            return said
        moved = ", ".join(f"{name} {1e3 * by:+.3g}" for name, by in zip(joints, self.shift, strict=True) if by)
        return [*said, f"{source}: zeros of the link encoders moved to those of the first recording, mrad: {moved}"]

    def aligned(self, equations: BaseRegression, first: Derived | None) -> Derived:
        """Return it with the zeros of the link encoders as in the first recording, where deflections are measured."""
        if not equations.summed:
            return self
        found = zeros(list(self.motions), equations.model)
        return replace(
            self, zeros=found, shift=None if first is None or first.zeros is None else shifts(found, first.zeros)
        )


class DerivativeStage:
    """The derivative stage of one recording: what depends on no law (clock, noise, series) is found once.

    Parameters
    ----------
    samples
        Of one recording.
    method
        "fourier": analytic derivatives of a fitted series; "smoother"; "auto": the series where the motion repeats and
        nothing stands out of the encoders' noise, else the smoother.
    period
        Of the motion, s; found from it when None.

    Raises
    ------
    IdentificationError
        If the recording is too short, or a series was requested and the motion is none.
    """

    def __init__(self, samples: Samples, method: Method = "auto", *, period: float | None = None) -> None:
        if period is not None and not period > 0:
            raise IdentificationError(f"the period is {period:g} s", "Give a time above zero, or none.")
        clock = Clock.of(samples)
        self._grids = clock.place(samples)
        if not self._grids:
            raise IdentificationError("the recording has no run of samples without gaps", "Record seconds of motion.")
        if not any(grid.moves() for grid in self._grids):
            raise IdentificationError("the recording holds no motion", "Record one that `elastic-arm excite` makes.")
        self._said: tuple[str, ...] = (clock.note,) if clock.note else ()
        self._width = next(iter(self._grids[0].channels().values())).shape[1]
        self._longest, self._period = max(self._grids, key=len), period
        if period is None:
            with contextlib.suppress(IdentificationError):
                self._period = period_of(self._longest)
        self._series: Derived | None = None
        if method != "smoother":
            try:
                self._series = self._by_series()
            except IdentificationError:
                if method == "fourier":
                    raise

    @property
    def _repeats(self) -> bool:
        return self._period is not None and repeats(self._longest, self._period)

    @functools.cached_property
    def _smoother(self) -> Smoother:
        return design_smoother(self._grids, self._width)

    def _by_series(self) -> Derived:
        """Fit series to every piece in which the motion repeats, each its own: it may begin anew after a gap."""
        grids, period = self._grids, self._period or period_of(self._longest)
        noises = (self._smoother.link_noise, self._smoother.motor_noise)
        link_std, motor_std = (None if noise is None else noise.position_std for noise in noises)
        used = [grid for grid in grids if grid is self._longest or repeats(grid, period)]
        fitted = [fourier_motion(grid, link_std, motor_std, period) for grid in used]
        what = "Fourier series" if len(used) == len(grids) else f"Fourier series of {len(used)} of {len(grids)} pieces"
        pieces = tuple((lambda motion=motion: motion) for motion, _, _ in fitted)
        return Derived(pieces, what, tuple((link, motor) for _, link, motor in fitted), self._said, self._repeats)

    def __call__(self, equations: BaseRegression | None = None, *, ends: bool = False) -> Derived:
        """Return the motion, the laws of `equations` through the same filter; with `ends`, those of the pieces too."""
        if self._series is not None:
            return self._series
        smoother, grids = self._smoother, self._grids
        lost = 2 * smoother.lag * (2 if equations is not None and equations.columns else 1)
        grids = [with_ends(grid, lost) for grid in grids] if ends else grids
        long_enough = [grid for grid in grids if len(grid) > lost] or [max(grids, key=len)]
        stage = smoother if equations is None else partial(smoothed, smoother, equations=equations)
        pieces = [partial(stage, run) for grid in long_enough for run in runs(grid, lost)]
        method = f"smoother to {smoother.cutoff / (2 * np.pi):.1f} Hz"
        said = (*self._said, *left_out(grids, long_enough))
        return Derived(tuple(pieces), method, said=said, repeats=self._repeats)


def identify(
    recordings: Recording | Sequence[Recording],
    robot: Robot,
    model: str = "mod3",
    *,
    effects: Sequence[EffectInstance] = (),
    derivatives: Method = "auto",
    period: float | None = None,
    weighted: bool = True,
    consistent: bool = True,
    validate: Sequence[Recording] = (),
    progress: ProgressCallback | None = None,
    catalogue: Catalogue | None = None,
) -> Identification:
    """Identify an arm from recordings.

    Parameters
    ----------
    recordings
        One or several, with equal channels.
    robot
        The nominal arm.
    model
        mod1, mod2 or mod3.
    effects
        Laws identified beside the model's own parameters (:func:`elastic_arm.effects.text.parse_laws`), and beside
        those that the description states.
    derivatives, period
        See :class:`DerivativeStage`.
    weighted
        Weigh each equation by its noise; else ordinary least squares.
    consistent
        Also find all parameters, physically consistent and close to the nominal where the data determine nothing.
    validate
        Recordings that no fit may see; the residuals on them are part of the result.
    progress
        Called with what is being done and the share that is done.
    catalogue
        Where the ids of the description's effects are looked up; the default one when None.

    Raises
    ------
    IdentificationError
        If the recordings allow no equation, or too few samples.
    """
    return identify_with(
        recordings,
        robot,
        model,
        effects=effects,
        derivatives=derivatives,
        period=period,
        weighted=weighted,
        consistent=consistent,
        validate=validate,
        progress=progress,
        catalogue=catalogue,
    )[0]


def identify_with(
    recordings: Recording | Sequence[Recording],
    robot: Robot,
    model: str = "mod3",
    *,
    effects: Sequence[EffectInstance] = (),
    derivatives: Method = "auto",
    period: float | None = None,
    weighted: bool = True,
    consistent: bool = True,
    validate: Sequence[Recording] = (),
    progress: ProgressCallback | None = None,
    catalogue: Catalogue | None = None,
) -> tuple[Identification, Identifier, Motion]:
    """Identify as :func:`identify` does, and hand out the estimator and a run of motion too.

    Parameters
    ----------
    recordings, robot, model, effects, derivatives, period, weighted, consistent, validate, progress, catalogue
        See :func:`identify`.

    Returns
    -------
    result, identifier, motion
        The result, the estimator that it came from, and the first run of smoothed motion.
    """
    chosen = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if not chosen:
        raise IdentificationError("no recording was given", "Give at least one.")
    report = progress or (lambda what, share: None)
    chosen = [without_outliers(recording.select(robot.joint_names)) for recording in chosen]
    prepared = [recording.samples() for recording in chosen]
    motored = any(samples.tau_m is not None for samples in prepared)
    described, robot = robot, robot.with_armatures() if motored else robot
    effects = with_stated(effects, robot, motored=motored, catalogue=catalogue)
    speeds = SIGN_SPEEDS if any(is_dry(instance) for instance in effects) else (DEFAULT_SIGN_SPEED,)
    add = partial(_added, list(zip(chosen, prepared, strict=True)), [], (derivatives, period), report)

    def begun(speed: float) -> Identifier:
        columns, arm = law_columns(effects, robot, model, speed), build_model(robot, model)
        return Identifier(arm, columns, joints=robot.joint_names, weighted=weighted, encoder_columns=True)

    tries = []
    for k, speed in enumerate(speeds):
        derived = add(identifier := begun(speed), k / len(speeds))
        misfit = float(np.sum(np.log(identifier.fit().noise))) if len(speeds) > 1 else 0.0
        tries.append((misfit, speed, identifier, derived))
    _, speed, identifier, derived = min(tries, key=lambda each: each[0])
    if not closes(identifier.fit(), identifier.linear_blocks()):
        derived = add(identifier := begun(speed), 1.0, ends=True)
    report("estimate", 1.0)
    names, methods = tuple(r.source for r in chosen), tuple(d.method for d in derived)
    covariance = _covariance(identifier, derived)
    width, prior = (None, None) if covariance is not None else _regularised(identifier)
    result = identifier.estimate(names, methods, covariance, prior)
    notes = [MOTOR_INERTIA] if robot is not described else []
    notes += [note for r in chosen for note in r.notes]
    notes += [note for d, r in zip(derived, chosen, strict=True) for note in d.notes(r.source, robot.joint_names)]
    notes += [] if width is None else [described_width(width, "parts of the recordings left out in turn")]
    notes += [f"dry friction turns over within {speed:g} rad/s of standstill"] if len(speeds) > 1 else []
    result = result.with_(notes=tuple(dict.fromkeys([*result.notes, *notes])))
    if consistent:
        report("physical consistency", 1.0)
        weight = correlation_of_errors(identifier, repeats=any(d.repeats for d in derived))
        result = with_consistency(result, identifier, robot, effects, correlated=weight)
    if validate:
        held_out = _held_out(validate, identifier, derived[0], report)
        result = validated(result, identifier, robot, effects, held_out)
    return result, identifier, next(derived[0].motions)


def _added(
    recordings: Sequence[tuple[Recording, Samples]],
    stages: list[DerivativeStage],
    method: tuple[Method, float | None],
    report: ProgressCallback,
    identifier: Identifier,
    share: float,
    *,
    ends: bool = False,
) -> list[Derived]:
    """Add all recordings to an estimator; derivative stages are kept in `stages`. See :func:`identify_with`."""
    derived: list[Derived] = []
    for j, (recording, samples) in enumerate(recordings):
        report(f"equations of {recording.source}", share)
        equations = _chosen_equations(identifier, samples)
        if j == len(stages):
            stages.append(DerivativeStage(samples, method[0], period=method[1]))
        derived.append(stages[j](equations, ends=ends).aligned(equations, derived[0] if derived else None))
        for motion in derived[-1].motions:
            identifier.add_motion(motion)
    return derived


def _regularised(identifier: Identifier) -> tuple[float | None, Prior | None]:
    """Return the width of the prior that predicts left-out parts best, and the prior; None where it takes none."""
    equations, plain, blocks = identifier.equations, identifier.fit(), identifier.linear_blocks()
    if (width := chosen_width(blocks, plain, equations)) is None:
        return None, None
    return width, prior_of(equations, width, description_error(plain, equations, DOUBT), law_sizes(blocks, equations))


def _chosen_equations(identifier: Identifier, samples: Samples) -> BaseRegression:
    """Return the equations that the channels allow, in which every law that is fitted has left a trace."""
    equations = identifier.choose_equations(samples)
    own = len(equations.names) - len(equations.columns)
    unseen = [c.name for k, c in enumerate(equations.columns, own) if not equations.base.T[:, k].any()]
    if unseen:
        raise IdentificationError(
            f"{', '.join(unseen)}: no trace in the torques that were recorded",
            "Leave the law out, or let it act on the recorded side, as in coulomb_friction:side=link.",
        )
    return equations


def _covariance(identifier: Identifier, derived: Sequence[Derived]) -> Array | None:
    """Return the covariance where derivatives come from series; None where the blocks hold all of it."""
    series = [(motion, *pair) for d in derived if d.series for motion, pair in zip(d.motions, d.series, strict=True)]
    if not series:
        return None
    fit, equations = identifier.fit(), identifier.equations
    known = fit.white_covariance if all(d.series for d in derived) else fit.covariance
    return known + sum(series_covariance(equations, fit, *each) for each in series)


def _held_out(
    recordings: Sequence[Recording], identifier: Identifier, first: Derived, report: ProgressCallback
) -> HeldOut:
    """Return the smoothed motion of recordings that no fit has seen."""
    equations = identifier.equations
    motions = {}
    for recording in recordings:
        report(f"validation on {recording.source}", 1.0)
        samples = without_outliers(recording.select(identifier.model.robot.joint_names)).samples()
        identifier.choose_equations(samples)
        derived = DerivativeStage(samples, "smoother")(equations).aligned(equations, first)
        motions[recording.source] = list(derived.motions)
    return HeldOut(equations, motions)


def identifier_of(
    robot: Robot, model: str = "mod3", effects: Sequence[EffectInstance] = (), **options: object
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
    arm, columns = build_model(robot, model), law_columns(effects, robot, model)
    return Identifier(arm, columns, joints=robot.joint_names, **options)  # type: ignore[arg-type]
