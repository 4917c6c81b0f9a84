"""The estimator: samples in, estimates out, constant memory. The batch is this class fed at
once."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics import Model
from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.motion import Motion
from elastic_arm.estimation.resampling import Clock, Grid, Placing, joined, part, read_at
from elastic_arm.estimation.residuals import AROUND, standing_speed, sticking
from elastic_arm.estimation.smoother import Smoother, design_smoother
from elastic_arm.identification.accumulator import BLOCK, Accumulator
from elastic_arm.identification.base_regression import BaseRegression, Column
from elastic_arm.identification.deflection import Deflections, fit_deflections
from elastic_arm.identification.least_squares import MISFIT_POWER, Blocks, Fit, Prior, fit
from elastic_arm.identification.result import Identification, result_of
from elastic_arm.identification.verdict import Excitation, MotionStatistics, excitation
from elastic_arm.recording import Samples
from elastic_arm.recording.inspection.stuck_channels import STILL
from elastic_arm.recording.standstill import KEPT

# What each joint has recorded.
Recorded = tuple[frozenset[str], ...]
SENSED = ("q", "theta", "tau_J", "tau_m")
# Length of the first samples in motion, s, from which clock and smoother are chosen.
CALIBRATION_SECONDS = 4.0
# A joint that has left its first position by so much is in motion, rad: a standing arm shows no
# bandwidth.
MOVED = 0.01
# Of an arm that stands longer before its first motion, the last seconds are kept, and no more
# samples than these.
STANDING_SECONDS = 60.0
CAPACITY = 200_000
# Samples this far behind are no stragglers, s: the clock was set back, or those before were stamped
# in the future.
SET_BACK = 1.0


def smoothed(
    smoother: Smoother,
    grid: Grid,
    equations: BaseRegression,
    standing: Array | None = None,
    read: Array | None = None,
) -> Motion:
    """Smooth a regular piece, with the laws beyond the model passed through the same filter.

    It states where joints stick, slower than `standing` (n,) rad/s, if that is given and there are
    such laws. Torques that were read at some instants alone (s) passed no filter, and laws pass
    none there.
    """
    every = smoother.thinning
    if read is not None:
        kept = slice(smoother.lag, -smoother.lag)
        whole = smoother(grid)
        raw = grid[kept]
        if equations.columns:  # runs overlap by what two filters lose
            whole = whole[kept]
            raw = raw[kept]
        rows = read_at(whole.t, read)
        some = replace(whole, tau_J=raw.tau_J, tau_m=raw.tau_m)[rows]
        return replace(
            some, laws=equations.laws(some), every=max(1, round(len(whole) / max(len(rows), 1)))
        )
    if not equations.columns:
        return smoother(grid, every)
    motion = smoother(grid)
    if standing is not None:
        velocity = motion.dtheta if motion.dtheta is not None else motion.dq
        assert velocity is not None
        motion = replace(
            motion,
            stuck=sticking(motion.t, velocity, standing, AROUND + 2 * np.pi / smoother.cutoff),
        )
    laws = equations.laws(motion)
    filtered = smoother.filter(laws.reshape(len(laws), -1))
    inner = replace(
        motion[smoother.lag : -smoother.lag], laws=filtered.reshape(len(filtered), *laws.shape[1:])
    )
    return replace(inner[::every], every=every)


def velocity_noise(smoother: Smoother) -> Array | float:
    """Return the standard deviation (n,) rad/s of smoothed velocities, if possible of motors."""
    noise = smoother.noise
    if noise is None:
        return 0.0
    covariance = noise.link if noise.motor is None else noise.motor
    return 0.0 if covariance is None else np.sqrt(covariance[:, 1, 1])


@dataclass
class IncomingRun:
    """Samples without a jump back in time."""

    buffer: Samples | None = None  # Samples that are not on the grid yet
    placing: Placing | None = None  # Puts them there
    # points of the grid that wait for the smoother, or are part of its next window
    run: list[Grid] = field(default_factory=list)
    # since, last: time of the first sample that is held, and of the last one that came
    since: float = np.inf
    last: float = -np.inf

    @property
    def waiting(self) -> int:
        """Samples that are in no equation yet."""
        return sum(map(len, self.run)) + (0 if self.buffer is None else len(self.buffer))

    def is_before(self, samples: Samples) -> bool:
        """Return whether samples belong to another run, as time has jumped back."""
        return bool(samples.t[-1] < max(self.since, self.last - SET_BACK))

    def take(self, samples: Samples) -> Samples:
        """Keep the samples that are later than those before; return them."""
        newest = np.maximum.accumulate(np.concatenate([[self.last], samples.t]))[:-1]
        good = samples.t > newest
        kept = samples if good.all() else part(samples, np.flatnonzero(good))
        if len(kept):
            self.since = min(self.since, float(kept.t[0]))
            self.last = float(kept.t[-1])
            self.buffer = kept if self.buffer is None else joined(self.buffer, kept)
        return kept

    def first_in_motion(self, wait: bool) -> Samples | None:
        """Return the samples that choose clock and smoother, or None."""
        if self.buffer is None:
            return None
        onset = _onset(self.buffer)
        self.buffer = kept = part(self.buffer, self.buffer.t >= onset - STANDING_SECONDS)
        if wait and kept.t[-1] < onset + CALIBRATION_SECONDS:
            self.buffer = part(kept, slice(-CAPACITY, None))
            return None
        since = min(onset, max(kept.t[-1] - CALIBRATION_SECONDS, kept.t[0]))
        return part(kept, (kept.t >= since) & (kept.t <= since + CALIBRATION_SECONDS))


def _onset(samples: Samples) -> float:
    """Return the time at which the first joint leaves its first position; that of the last sample
    where all stand."""
    position = samples.q if samples.q is not None else samples.theta
    if position is None:
        return float(samples.t[-1])
    moves = (np.abs(position - position[0]) > MOVED).any(axis=1)
    return float(samples.t[np.argmax(moves) if moves.any() else -1])


@dataclass
class Progress:
    """Counts of the samples of a stream."""

    samples: int = 0  # Samples in the equations so far
    received: int = 0  # Samples handed in
    resting: int = 0  # Samples left out because the arm stood still
    refused: int = 0  # Samples left out because their stamps did not advance
    pieces: int = 0  # Runs without a gap


class Identifier:
    """Identify an arm from a stream of samples.

    Parameters
    ----------
    model
        Bearings locked.
    columns
        Laws beyond the model.
    smoother, clock
        Derivative stage, and rate and meaning of the stamps; chosen from the first seconds when
        None.
    joints
        Names.
    encoder_columns
        Whether lags and offsets of link encoders are estimated where deflections are measured
        without a joint torque sensor (:mod:`elastic_arm.identification.base_regression`).
    averaged
        Whether the rows of an arm that is taken for rigid are averaged (:mod:`.accumulator`).

    Notes
    -----
    The equations are chosen by the channels of the first samples. Standstill adds nothing: what is
    longer than :data:`.standstill.KEPT` after a motion is left out. Beside laws of dry friction a
    joint that sticks has no equation for its friction, which is any torque up to the dry one.
    Memory is bounded: one block of motion, the smoother's window, and at most 64 blocks.
    """

    def __init__(
        self,
        model: Model,
        columns: Sequence[Column] = (),
        *,
        smoother: Smoother | None = None,
        clock: Clock | None = None,
        joints: Sequence[str] = (),
        encoder_columns: bool = False,
        averaged: bool = True,
    ) -> None:
        self.model = model
        self.columns = tuple(columns)
        self.joints = tuple(joints)
        self.encoder_columns = encoder_columns
        self.averaged = averaged
        self._given = (smoother, clock)
        self.paused = False
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        self.smoother, self.clock = self._given
        self.accumulator: Accumulator | None = None
        self.progress = Progress()
        self._piece = IncomingRun()
        self._recorded: Recorded = ()
        self._rest: tuple[Array, float] | None = (
            None  # where the arm was when it last moved, and when
        )

    def pause(self) -> None:
        """Ignore samples until :meth:`resume`.

        Samples from which no smoother could be chosen yet are given up.
        """
        self.paused = True
        self._end_piece(wait=True)

    def resume(self) -> None:
        """Take samples again."""
        self.paused = False

    @property
    def equations(self) -> BaseRegression:
        """The equations in use.

        Raises an IdentificationError before the first samples.
        """
        return self._ready().equations

    @property
    def statistics(self) -> MotionStatistics:
        """Statistics of the motion so far."""
        return self._ready().statistics

    def choose_equations(self, channels: Samples | Motion) -> BaseRegression:
        """Choose the equations by the channels that are there, and return them.

        Raises an IdentificationError if the channels allow no equation, or others than before.
        """
        there = {name for name in SENSED if getattr(channels, name) is not None}
        by_joint = [set(there) for _ in range(self.model.n)]
        for channel, joint in channels.lacking:
            by_joint[joint].discard(channel)
        recorded = tuple(map(frozenset, by_joint))
        if self.accumulator is None:
            self.accumulator = self._empty(recorded)
            self._recorded = recorded
        if recorded != self._recorded:
            one = ", ".join(sorted(frozenset().union(*self._recorded)))
            other = ", ".join(sorted(frozenset().union(*recorded)))
            what = f"one recording contains {one}, another {other}"
            if one == other:
                what = f"{what}, not at the same joints"
            raise IdentificationError(what, "Identify recordings with the same channels.")
        return self.accumulator.equations

    def _empty(self, recorded: Recorded) -> Accumulator:
        own = self.model, recorded, self.columns, self.joints
        equations = BaseRegression(*own, summed=True, encoder_columns=self.encoder_columns)
        return Accumulator(equations, averaged=self.averaged)

    def add(self, samples: Samples) -> None:
        """Take samples, later than those before; a jump back in time starts a new piece.

        Raises an IdentificationError if the channels allow no equation, or differ from those
        before, or if neither rate nor smoother can be chosen by the samples that wait, which are
        given up.
        """
        if self.paused or not len(samples):
            return
        self.progress.received += len(samples)
        if self._piece.is_before(samples):
            self._end_piece(wait=True)
        taken = self._piece.take(samples)
        self.progress.refused += len(samples) - len(taken)
        if not len(taken):
            return
        self.choose_equations(taken)
        if self._calibrated(wait=True):
            self._process()

    def add_motion(self, motion: Motion) -> None:
        """Take motion whose derivatives are known already."""
        self.choose_equations(motion)
        self._ready().add(motion)
        self.progress.samples += motion.every * len(motion)

    def finish(self) -> None:
        """Work off what still waits, short of the smoother's lag; later samples start a new piece.

        Raises an IdentificationError if there are too few samples to choose a smoother by.
        """
        self._end_piece(wait=False)

    def fit(self, prior: Prior | None = None) -> Fit:
        """Return the estimate from all samples so far, and from what is known beforehand.

        Raises an IdentificationError if there are too few.
        """
        blocks = self._ready().snapshot()
        if not blocks.factors:
            raise IdentificationError(
                f"{self._piece.waiting} samples are not sufficient for an estimate",
                "Wait some seconds, or record longer.",
            )
        if self.equations.summed:
            return fit_deflections(blocks, Deflections(self.equations), prior)
        return fit(blocks, MISFIT_POWER if self.equations.rigid else 1.0, prior=prior)

    def linear_blocks(self, found: Fit | None = None) -> Blocks:
        """Return sums of rows that are linear in the base parameters.

        Rows that are not are linearised at the estimate.
        """
        blocks = self._ready().snapshot()
        if not self.equations.summed:
            return blocks
        found = found or self.fit()
        fixed = {k: float(found.Psi[k]) for k in found.fixed}
        return blocks.transformed(
            Deflections(self.equations).transform(found.Psi, fixed, blocks.groups)
        )

    def estimate(
        self,
        recordings: tuple[str, ...] = (),
        methods: tuple[str, ...] = (),
        found: Fit | None = None,
    ) -> Identification:
        """Return the estimate with standard deviations and verdicts.

        See :meth:`fit` for errors.
        """
        found = found or self.fit()
        return result_of(
            found, self.equations, self.excitation(), self.progress.samples, recordings, methods
        )

    def excitation(self) -> Excitation:
        """Return what the motion so far can determine; the torques are not looked at."""
        ready = self._ready()
        return excitation(ready.snapshot(), ready.equations, ready.statistics)

    def _ready(self) -> Accumulator:
        if self.accumulator is None:
            raise IdentificationError("no samples yet", "Add samples first.")
        return self.accumulator

    def _calibrated(self, wait: bool) -> bool:
        """Choose clock and smoother once there are enough samples, or as well as these allow."""
        if self.smoother is not None and self.clock is not None:
            return True
        first = self._piece.first_in_motion(wait)
        if first is None:
            return False
        try:
            clock = self.clock or Clock.of(first)
            self.smoother = self.smoother or design_smoother(clock.place(first), self.equations.n)
        except IdentificationError:
            self._piece = IncomingRun()  # or all that follow would wait behind these for ever
            raise
        self.clock = clock
        return True

    def _process(self, last: bool = False) -> None:
        """Place what has come, smooth what has a whole window around it, and keep the window of the
        next."""
        piece = self._piece
        if self.clock is None:
            return
        piece.placing = piece.placing or Placing(self.clock)
        for grid, ends in piece.placing.add(piece.buffer, last):
            if grid is not None:
                piece.run.append(grid)
            if piece.run and (ends or sum(map(len, piece.run)) >= self._window + BLOCK):
                run = Grid.joined(piece.run)
                piece.run = [self._smooth(run, ends)]
                piece.since = float(piece.run[0].t[0])
            if ends:
                self.progress.pieces += 1
                piece.run = []
        piece.buffer = None

    def _smooth(self, run: Grid, ends: bool) -> Grid:
        """Smooth what has a whole window around it; return what the next samples need."""
        ready = len(run) - self._window
        if self.smoother is None or ready <= 0:
            return run
        if not ends:
            ready -= ready % self.smoother.thinning
        standing = (
            standing_speed(0.0, velocity_noise(self.smoother))
            if any(c.dry for c in self.columns)
            else None
        )
        motion = smoothed(self.smoother, run[: ready + self._window], self.equations, standing)
        for moving in self._moving(motion):
            self.add_motion(moving)
        return run[ready:]

    def _moving(self, motion: Motion) -> Iterator[Motion]:
        """Yield motion without what follows on a long standstill."""
        position = motion.theta if motion.theta is not None else motion.q
        assert position is not None
        length = max(1, BLOCK // motion.every)
        kept = np.zeros(len(motion), dtype=bool)
        for start in range(0, len(motion), length):
            some = position[start : start + length]
            if self._rest is None or np.any(np.abs(some - self._rest[0]) >= STILL):
                self._rest = some[-1], float(motion.t[start + len(some) - 1])
            kept[start : start + length] = motion.t[start] <= self._rest[1] + KEPT
        self.progress.resting += motion.every * int(np.count_nonzero(~kept))
        edges = np.flatnonzero(np.diff(kept, prepend=False, append=False))
        for first, stop in edges.reshape(-1, 2).tolist():
            yield motion[first:stop]

    @property
    def _window(self) -> int:
        """Samples lost at the ends of a piece, both together."""
        lag = 0 if self.smoother is None else self.smoother.lag
        return 2 * lag * (2 if self.columns else 1)

    def _end_piece(self, wait: bool) -> None:
        """End the run; one that is too short to choose a smoother by counts only where no other is
        waited for."""
        if self._calibrated(wait):
            self._process(last=True)
        self._piece = IncomingRun()
