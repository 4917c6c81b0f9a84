"""Convert motion to triangular factors: rows of the equations, block by block.

A rigid arm is rigid only below its first resonance. Above it, rotors move against links, and
torques increase as accelerations decrease. The rows of a rigid arm can therefore be averaged over
:data:`AVERAGED`. This removes faster components and, unlike a narrower smoother, loses no samples
at the ends of a recording.
"""

from dataclasses import replace

import numpy as np

from elastic_arm.arrays import Array, median_step
from elastic_arm.estimation.equation_sets import MOTOR
from elastic_arm.estimation.motion import Motion
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.errors_in_variables import noise_sums
from elastic_arm.identification.least_squares import Blocks, Fit
from elastic_arm.identification.triangular import triangular
from elastic_arm.identification.verdict import MotionStatistics

# Seconds over which rows are averaged: the first resonances of arms are at 5 to 20 Hz.
AVERAGED = 1 / 16
# Samples of a unit: the shortest block.
BLOCK = 256
# In long recordings one sample stands for so many units in the sums of noise.
MOST_REPRESENTED = 4
# Rms of the residuals over that of the torques: simulated arms with good sensors have less.
CLOSED = 1e-3


class Accumulator:
    """Accumulates rows of the equations block by block; the last samples wait until their block is
    full.

    averaged: whether the rows of a rigid arm are averaged.
    """

    def __init__(self, equations: BaseRegression, *, averaged: bool = False) -> None:
        self.equations = equations
        self.averaged = averaged and equations.rigid
        self.blocks = Blocks(len(equations.groups), len(equations.base) + 1)
        self.statistics_of_blocks = MotionStatistics()
        self._waiting: list[Motion] = []

    def expect(self, samples: int) -> None:
        """Start with blocks for at least this number of samples, which takes fewer steps.

        Short blocks begin at half the length, so that noise is estimated from as many samples as in
        a stream. Blocks that have begun are not changed.
        """
        if not self.blocks.factors:
            longest = 2 ** (samples // BLOCK // self.blocks.most).bit_length()
            self.blocks.span = longest if longest > MOST_REPRESENTED else max(longest // 2, 1)

    def add(self, motion: Motion) -> None:
        """Add a run of motion; runs need not be contiguous."""
        if self._waiting and self._waiting[-1].noise is not motion.noise:
            self._add_blocks(Motion.joined(self._waiting))
            self._waiting = []
        waiting = sum(map(len, self._waiting))
        unit = _unit(motion)
        if waiting + len(motion) < unit:
            self._waiting.append(motion)
            return
        if waiting:
            # Only the unit that was begun is put together; the rest is used where it lies.
            begun = unit - waiting
            self._add_blocks(Motion.joined([*self._waiting, motion[:begun]]))
            motion = motion[begun:]
        whole = len(motion) // unit * unit
        self._add_blocks(motion[:whole])
        self._waiting = [motion[whole:]] if whole < len(motion) else []

    def snapshot(self) -> Blocks:
        """Return the blocks, including the samples that still wait."""
        blocks = self.blocks.copy()
        if self._waiting:
            self._add_to(blocks, Motion.joined(self._waiting), 1)
        # Rows that hold the friction of a joint that sticks are zero.
        statistics = self.statistics
        entries = self.equations.equations.entries
        stuck = np.broadcast_to(statistics.stuck / max(statistics.samples, 1), (self.equations.n,))
        blocks.share = 1.0 - np.array(
            [stuck[j] * (equation.combination[MOTOR] != 0) for equation, j in entries]
        )
        return blocks

    @property
    def statistics(self) -> MotionStatistics:
        """Statistics of the motion, including the samples that still wait."""
        found = replace(self.statistics_of_blocks)
        if self._waiting:
            found.add(Motion.joined(self._waiting))
        return found

    def _add_blocks(self, motion: Motion) -> None:
        start = 0
        unit = _unit(motion)
        while start < len(motion):
            units = max(1, min((len(motion) - start) // unit, self.blocks.room))
            stop = start + units * unit
            self.statistics_of_blocks.add(motion[start:stop])
            self._add_to(self.blocks, motion[start:stop], units)
            start = stop

    def _add_to(self, blocks: Blocks, motion: Motion, units: int) -> None:
        """Add samples, each weighted by the number of samples that it represents."""
        if self.averaged:
            factors, count = averaged(self.equations, motion, _unit(motion))
            blocks.add(factors, count, units)
            return
        factors = np.sqrt(motion.every) * self.equations.information(motion)
        noise = noise_sums(self.equations, motion, *_thinning(blocks, _unit(motion)))
        known_noise = None if noise is None else motion.every * noise
        blocks.add(factors, motion.every * len(motion), units, known_noise)


def averaged(
    equations: BaseRegression, motion: Motion, unit: int | None = None
) -> tuple[Array, int]:
    """Return factors of rows averaged over :data:`AVERAGED`, and the number of averages."""
    unit = unit or len(motion)
    step = median_step(motion.t) if len(motion) > 1 else AVERAGED
    parts = min(max(round(unit * step / AVERAGED), 1), unit)
    inner = np.linspace(0, unit, parts, endpoint=False).astype(int)
    starts = (np.arange(0, len(motion), unit)[:, None] + inner).ravel()
    starts = starts[starts < len(motion)]
    counts = np.diff(starts, append=len(motion))
    # What is shorter, at the end, counts less.
    weight = np.sqrt(counts * unit / parts)[:, None]
    rows = np.add.reduceat(equations.rows(motion), starts, axis=1) / weight
    return triangular(rows), max(round(len(motion) * parts / unit), 1)


def _thinning(blocks: Blocks, unit: int) -> tuple[int, int]:
    """Return for how many samples one sample counts in the sums of noise, and the index of the
    first such sample.

    Both depend only on the position in the block, not on how the samples arrive.
    """
    group = min(blocks.span, MOST_REPRESENTED)
    return group * unit, (blocks.begun % group and group - blocks.begun % group) * unit + unit // 2


def _unit(motion: Motion) -> int:
    """Return the samples of a unit."""
    return max(1, BLOCK // motion.every)


def closes(fit: Fit, blocks: Blocks) -> bool:
    """Return whether the motion of other joints in a sample would be larger than the remainder of
    the equations."""
    torque = np.linalg.norm(blocks.total()[..., -1], axis=-1) / np.sqrt(max(blocks.samples, 1))
    carries = torque > 0.0
    return not carries.any() or float(np.median(fit.noise[carries] / torque[carries])) < CLOSED
