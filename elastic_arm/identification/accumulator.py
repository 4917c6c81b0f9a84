"""From motion to sums: rows of the equations, block by block."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elastic_arm.estimation.motion import Motion
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.errors_in_variables import noise_sums
from elastic_arm.identification.least_squares import Blocks, Fit
from elastic_arm.identification.verdict import MotionStatistics

# Samples of a unit: the shortest block.
BLOCK = 256
# In long recordings one sample stands for so many units in the sums of noise.
MOST_REPRESENTED = 4
# Rms of the residuals over that of the torques: simulated arms with good sensors have less.
CLOSED = 1e-3


class Accumulator:
    """Rows of the equations, block by block; the last samples wait until their block is full."""

    def __init__(self, equations: BaseRegression) -> None:
        self.equations = equations
        self.blocks = Blocks(len(equations.groups), len(equations.base) + 1)
        self.statistics_of_blocks = MotionStatistics()
        self._waiting: list[Motion] = []

    def expect(self, samples: int) -> None:
        """Begin with blocks half as long as those that so many samples end with, or as long: fewer steps to these.

        Blocks that were begun stay as they are.
        """
        if not self.blocks.grams:
            longer = max(samples // BLOCK // self.blocks.most, 1).bit_length() - 1
            self.blocks.span = 2**longer

    def add(self, motion: Motion) -> None:
        """Add a run of motion; runs need not meet."""
        if self._waiting and self._waiting[-1].noise is not motion.noise:
            self._add_blocks(Motion.joined(self._waiting))
            self._waiting = []
        waiting, unit = sum(map(len, self._waiting)), _unit(motion)
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
        """Return the blocks with the samples that wait in them."""
        blocks = self.blocks.copy()
        if self._waiting:
            self._add_to(blocks, Motion.joined(self._waiting), 1)
        return blocks

    @property
    def statistics(self) -> MotionStatistics:
        """Statistics of the motion, with the samples that wait."""
        found = replace(self.statistics_of_blocks)
        if self._waiting:
            found.add(Motion.joined(self._waiting))
        return found

    def _add_blocks(self, motion: Motion) -> None:
        start, unit = 0, _unit(motion)
        while start < len(motion):
            units = max(1, min((len(motion) - start) // unit, self.blocks.room))
            stop = start + units * unit
            self.statistics_of_blocks.add(motion[start:stop])
            self._add_to(self.blocks, motion[start:stop], units)
            start = stop

    def _add_to(self, blocks: Blocks, motion: Motion, units: int) -> None:
        """Add samples, each as often as it stands for others."""
        hi, lo = self.equations.information(motion)
        noise = noise_sums(self.equations, motion, *_thinning(blocks, _unit(motion)))
        gram = motion.every * hi, motion.every * lo
        blocks.add(gram, motion.every * len(motion), units, None if noise is None else motion.every * noise)


def _thinning(blocks: Blocks, unit: int) -> tuple[int, int]:
    """Return for how many samples one stands in the sums of noise, and the index of the first such sample.

    Both depend on the place in the block alone, not on how samples come.
    """
    group = min(blocks.span, MOST_REPRESENTED)
    return group * unit, (blocks.begun % group and group - blocks.begun % group) * unit + unit // 2


def _unit(motion: Motion) -> int:
    """Return the samples of a unit."""
    return max(1, BLOCK // motion.every)


def closes(fit: Fit, blocks: Blocks) -> bool:
    """Whether the equations close so well that samples with a trace of foreign motion would make them worse.

    Parameters
    ----------
    fit
        Of the samples between the ends.
    blocks
        Their sums.
    """
    square = np.sum([hi[:, -1, -1] for hi, _ in blocks.grams], axis=0) / max(blocks.samples, 1)
    torque = np.sqrt(np.maximum(square, 0.0))  # next to none, rounding may leave less than nothing
    carries = torque > 0.0
    return not carries.any() or float(np.median(fit.noise[carries] / torque[carries])) < CLOSED
