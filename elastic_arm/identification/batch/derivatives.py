"""The derivative stage of a batch: from the samples of a recording to runs of smoothed motion."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.codegen.parallel import ahead
from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.motion import Motion
from elastic_arm.estimation.resampling import Clock, Grid
from elastic_arm.estimation.residuals import standing_speed
from elastic_arm.estimation.smoother import Smoother, design_smoother, left_out, runs, with_ends
from elastic_arm.estimation.torque_noise import torque_noise
from elastic_arm.formatting import JointUnits
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.deflection import shifts, zeros
from elastic_arm.identification.stream import smoothed, velocity_noise
from elastic_arm.recording import Samples
from elastic_arm.recording.inspection.stuck_channels import STILL

LONGEST = 0.7  # of the recording: a motion of a longer period is not seen to repeat


@dataclass(frozen=True)
class Derived:
    """A recording after its derivative stage: runs of motion, and how they came about."""

    # each makes one run when it is called: a long recording is never in memory as a whole
    pieces: tuple[Callable[[], Motion], ...]
    method: str  # In words
    said: tuple[str, ...] = ()  # What is to be known of clock and pieces
    lengths: tuple[int, ...] = ()  # Samples of the recording in each run
    zeros: tuple[Array, Array] | None = (
        None  # deflections at no load and their deviations, (n,) rad, where measured
    )
    # (n,) rad added to the link angles, to count from where those of the first recording do
    shift: Array | None = None

    @property
    def motions(self) -> Iterator[Motion]:
        """Yield the runs one after another; threads make the next ones meanwhile.

        Runs of one piece meet.
        """
        return ahead(self._made, self.pieces)

    @property
    def first(self) -> Motion:
        """Make the first run alone."""
        return self._made(self.pieces[0])

    @property
    def longest(self) -> Motion:
        """Make the longest run alone, the first one of several."""
        return self._made(self.pieces[int(np.argmax(self.lengths))])

    @property
    def samples(self) -> int:
        """Samples of the recording in all runs together."""
        return sum(self.lengths)

    def _made(self, piece: Callable[[], Motion]) -> Motion:
        motion = piece()
        return (
            motion
            if self.shift is None or motion.q is None
            else replace(motion, q=motion.q + self.shift)
        )

    def notes(self, source: str, units: JointUnits) -> list[str]:
        """Return what was done to the recording beside smoothing it.

        `units` are those of the arm's joints.
        """
        said = [f"{source}: {note}" for note in self.said]
        if self.shift is None or not self.shift.any():
            return said
        moved = ", ".join(
            f"{name} {1e3 * by:+.3g}"
            for name, by in zip(units.joints, self.shift, strict=True)
            if by
        )
        moved = f"{units.over('mrad')}: {moved}"
        return [
            *said,
            (
                f"{source}: zeros of the link encoders shifted to those of the first"
                f" recording, {moved}"
            ),
        ]

    def aligned(self, equations: BaseRegression, first: Derived | None) -> Derived:
        """Return it with the link encoders' zeros of the first recording.

        Only where deflections are measured.
        """
        if not equations.summed:
            return self
        found = zeros(list(self.motions), equations.model)
        return replace(
            self,
            zeros=found,
            shift=None if first is None or first.zeros is None else shifts(found, first.zeros),
        )


class DerivativeStage:
    """The derivative stage of one recording: what depends on no law (clock, noise) is found once.

    Parameters
    ----------
    samples
        Of one recording.
    source
        Where the recording came from, for errors.

    Raises
    ------
    IdentificationError
        If the recording is too short.
    """

    def __init__(self, samples: Samples, *, source: str = "") -> None:
        self._source = source or "the recording"
        self._read = samples.read
        clock = Clock.of(samples, self._source)
        self._grids = clock.place(samples)
        if not self._grids:
            raise IdentificationError(
                f"{self._source} has no interval without gaps", "Record several seconds of motion."
            )
        if not any(grid.moves() for grid in self._grids):
            raise IdentificationError(
                f"{self._source} contains no motion", "Record a motion from `elastic-arm excite`."
            )
        self._said: tuple[str, ...] = (clock.note,) if clock.note else ()
        self._width = next(iter(self._grids[0].channels().values())).shape[1]
        self._longest = max(self._grids, key=len)

    @functools.cached_property
    def repeats(self) -> bool:
        """Whether the motion is periodic."""
        position = self._longest.q if self._longest.q is not None else self._longest.theta
        return position is not None and repeats(position)

    @functools.cached_property
    def torque_noise(self) -> dict[str, Array]:
        """Standard deviation (n,) of the noise of each torque channel, Nm."""
        levels = {channel: torque_noise([self._longest], channel) for channel in ("tau_J", "tau_m")}
        return {channel: level for channel, level in levels.items() if level is not None}

    @property
    def band(self) -> float:
        """Frequency in Hz up to which the smoother passes motion."""
        return float(self._smoother.cutoff / (2 * np.pi))

    @functools.cached_property
    def read(self) -> Array | None:
        """When torques were read, s; None where that is often enough."""
        return (
            None
            if self._read is None or 0.5 / np.median(np.diff(self._read)) > self.band
            else self._read
        )

    @functools.cached_property
    def _smoother(self) -> Smoother:
        return design_smoother(self._grids, self._width)

    @functools.cached_property
    def _standing(self) -> Array:
        """Speed (n,) rad/s below which joints stand; zero for those that never move: nothing else
        is known of them."""
        angle = "theta" if self._longest.theta is not None else "q"
        lost = 2 * self._smoother.lag
        grids = [grid for grid in self._grids if len(grid) > lost]
        fastest = []
        low = []
        high = []
        for grid in grids:
            position = getattr(grid, angle)
            low.append(position.min(axis=0))
            high.append(position.max(axis=0))
            channels = {angle: position, f"d{angle}": getattr(grid, f"d{angle}")}
            for run in runs(Grid(grid.t, grid.rate, **channels), lost):
                velocity = getattr(self._smoother(run), f"d{angle}")
                fastest.append(np.abs(velocity).max(axis=0))
        travel = np.max(high, axis=0) - np.min(low, axis=0)
        standing = standing_speed(np.max(fastest, axis=0), velocity_noise(self._smoother))
        return np.where(travel >= STILL, standing, 0.0)

    def __call__(
        self, equations: BaseRegression | None = None, *, ends: bool = False, stuck: bool = False
    ) -> Derived:
        """Return the motion, the laws of `equations` through the same filter."""
        smoother = self._smoother
        grids = self._grids
        twice = equations is not None and bool(equations.columns)
        lost = 2 * smoother.lag * (2 if twice else 1)
        grids = [with_ends(grid, lost) for grid in grids] if ends else grids
        long_enough = [grid for grid in grids if len(grid) > lost]
        if not long_enough:
            raise self._too_short(lost, twice)
        standing = self._standing if stuck else None
        stage: Callable[[Grid], Motion] = smoother
        if equations is not None:
            stage = partial(
                smoothed, smoother, equations=equations, standing=standing, read=self.read
            )
        pieces: list[Callable[[], Motion]] = []
        lengths: list[int] = []
        for grid in long_enough:
            cut = list(runs(grid, lost))
            pieces += [partial(stage, run) for run in cut]
            lengths += [len(run) - lost for run in cut]
        method = f"smoother to {smoother.cutoff / (2 * np.pi):.1f} Hz"
        said = (*self._said, *left_out(grids, long_enough))
        return Derived(tuple(pieces), method, said=said, lengths=tuple(lengths))

    def _too_short(self, lost: int, twice: bool) -> IdentificationError:
        """Return the error of a recording of which the smoother loses all, laws that pass it
        `twice` included."""
        whole = len(self._longest)
        rate = self._longest.rate
        piece = (
            "is"
            if len(self._grids) == 1
            else f"has {len(self._grids)} intervals between gaps, the longest"
        )
        why = ", as effects in addition to the model pass it twice" if twice else ""
        problem = (
            f"{self._source} {piece} {whole / rate:.2f} s long: the smoother to {self.band:.1f} Hz"
            f" needs more than {lost / rate:.2f} s{why}"
        )
        enough = twice and 2 * whole > lost
        without = (
            f", or identify without effects (--with), for which {lost / rate / 2:.2f} s"
            " are sufficient"
            if enough
            else ""
        )
        gaps = "" if len(self._grids) == 1 else " without gaps"
        return IdentificationError(problem, f"Record longer{gaps}{without}.")


def repeats(position: Array) -> bool:
    """Return whether angles (N, n) repeat: whether their autocorrelation has a peak."""
    n_samples = len(position)
    # NumPy is slow along the first axis of a narrow array
    columns = np.ascontiguousarray(position.T)
    x = (columns - columns.mean(axis=1)[:, None]) / np.maximum(columns.std(axis=1), 1e-12)[:, None]
    spectrum = np.abs(np.fft.rfft(x, 2 * n_samples, axis=1)) ** 2
    # Over the powers of what overlaps: where the motion repeats, this is one, whatever part of a
    # period the ends cut.
    power = np.concatenate([[0.0], np.cumsum(np.sum(x**2, axis=0))])
    overlap = power[-1] - power[:n_samples] + power[n_samples:0:-1]
    together = 2.0 * np.fft.irfft(spectrum.sum(axis=0))[:n_samples] / np.maximum(overlap, 1e-300)
    late = together[: int(LONGEST * n_samples)]
    if not np.any(late < 0.5):
        return False
    after = late[int(np.argmax(late < 0.5)) :]
    peaks = (after[:-1] > 0.98 * after.max()) & (after[:-1] >= after[1:])
    return bool(after.max() > 0.8 and peaks.any())
