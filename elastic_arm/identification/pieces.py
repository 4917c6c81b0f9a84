"""The pieces of a recording that pass the smoother: runs that stay in the cache, and the ends that it loses.

A smoother loses what lies within its lag of the ends of a piece, and laws beyond the model, which pass it twice, lose
that twice. Of a recording of some seconds that is a good part. Where the arm moves there, and the equations close no
better than :data:`CLOSED` anyway, the piece is continued by its mirror image, and samples count from where that has no
more than :data:`FOREIGN` of the weight.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from elastic_arm.estimation.observation import extended
from elastic_arm.estimation.resampling import Grid
from elastic_arm.estimation.smoother import TAIL
from elastic_arm.identification.least_squares import Blocks, Fit

# Long recordings go through the derivative stage in runs of this many samples, which stay in the cache.
RUN = 32768
FOREIGN = 1e-4  # share of the response that may lie in the mirror image
CLOSED = 1e-3  # rms of the residuals over that of the torques: simulated arms with good sensors have less
LOST = 0.05  # share of a piece that its ends have to be; convention
MOVING = 0.3  # rms speed of the ends over that of the piece: a joint at rest carries any torque up to its dry friction


def runs(grid: Grid, lost: int) -> Iterator[Grid]:
    """Cut a regular piece into runs that overlap by what the smoother loses."""
    for start in range(0, max(len(grid) - lost, 1), RUN):
        yield grid[start : start + RUN + lost]


def left_out(grids: Sequence[Grid], used: Sequence[Grid]) -> tuple[str, ...]:
    """Return in words which pieces between gaps are too short for the smoother."""
    kept, whole = (sum(map(len, some)) for some in (used, grids))
    if len(used) == len(grids):
        return ()
    pieces = f"{len(grids) - len(used)} of {len(grids)} pieces between gaps"
    return (f"{pieces} are too short and left out, {whole - kept} of {whole} samples",)


def with_ends(grid: Grid, lost: int) -> Grid:
    """Return a piece continued at both ends, if they are a good part of it and the arm moves there.

    Parameters
    ----------
    grid
        The piece.
    lost
        Samples that the smoother loses at both ends together.
    """
    most = min(lost // 2, len(grid) - 2)
    more = most - int(np.ceil(0.5 * lost * np.log(FOREIGN) / np.log(TAIL)))
    if more <= 0 or lost < LOST * len(grid) or not _moves_at_ends(grid, lost // 2):
        return grid
    return extended(grid, more)


def _moves_at_ends(grid: Grid, count: int) -> bool:
    position = grid.theta if grid.theta is not None else grid.q
    if position is None:
        return False
    speed = np.diff(position, axis=0)
    whole, ends = (np.sqrt(np.mean(v**2)) for v in (speed, np.concatenate([speed[:count], speed[-count:]])))
    return bool(ends > MOVING * whole)


def closes(fit: Fit, blocks: Blocks) -> bool:
    """Whether the equations close so well that samples with a trace of foreign motion would make them worse.

    Parameters
    ----------
    fit
        Of the samples between the ends.
    blocks
        Their sums.
    """
    torque = np.sqrt(np.sum([hi[:, -1, -1] for hi, _ in blocks.grams], axis=0) / max(blocks.samples, 1))
    carries = torque > 0.0
    return not carries.any() or float(np.median(fit.noise[carries] / torque[carries])) < CLOSED
