"""The style of all figures: colours by meaning, light grid, and thinned signals."""

import contextlib
import io
from collections.abc import Iterator
from typing import Any

import matplotlib as mpl
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe & Ito's palette: distinguishable for colour-blind readers too.
BLUE = "#0072B2"
ORANGE = "#E69F00"
GREEN = "#009E73"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"
SKY = "#56B4E9"
GREY = "#6E7781"
POINTS = 1500  # samples of a drawn signal, at most
CYCLE = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, GREY)

_RC: Any = {
    "axes.prop_cycle": cycler(color=CYCLE),
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.labelsize": 9,
    "figure.dpi": 110,
    "font.size": 9,
    "grid.color": "#E3E6EA",
    "grid.linewidth": 0.7,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "lines.linewidth": 1.3,
    "svg.fonttype": "none",
}


@contextlib.contextmanager
def style() -> Iterator[None]:
    """Draw within the project's look, whatever the caller's matplotlib settings are."""
    with mpl.rc_context(_RC):
        yield


class Drawing(Figure):
    """A figure that a notebook shows by itself."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        with style():
            self.savefig(buffer, format="png", dpi=110)
        return buffer.getvalue()


@contextlib.contextmanager
def drawing(
    rows: int = 1, columns: int = 1, *, size: tuple[float, float] | None = None, **options: Any
) -> Iterator[tuple[Figure, np.ndarray]]:
    """Make a figure and its axes in the project's look, without a window or pyplot's state."""
    with style():
        figure = Drawing(figsize=size or (4.2 * columns, 2.4 * rows), layout="constrained")
        yield figure, figure.subplots(rows, columns, squeeze=False, **options)


def draw_signal(ax: Axes, t: np.ndarray, y: np.ndarray, **kwargs: Any) -> None:
    """Draw y(t) so that every extreme survives but the file stays small.

    Keeps the smallest and the largest sample of each of :data:`POINTS` / 2 bins; NaN breaks the
    line.
    """
    keep = envelope_indices(y, POINTS)
    ax.plot(t[keep], y[keep], **kwargs)


def label_times(figure: Figure, axes: np.ndarray, lines: int) -> None:
    """Label the axes of times below, and above the figure the lines of its first axes, so many side
    by side."""
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    keys = axes[0, 0].get_legend_handles_labels()
    figure.legend(*keys, loc="outside upper center", ncols=lines)


def envelope_indices(y: np.ndarray, points: int) -> np.ndarray:
    """Return sorted indices of minimum and maximum of each bin of `y` (N,).

    There are `points` / 2 bins or fewer.
    """
    if len(y) <= points:
        return np.arange(len(y))
    width = -(-len(y) // (points // 2))
    bins = -(-len(y) // width)
    # Repeating the last sample fills the last bin without adding an extreme.
    folded = np.pad(np.nan_to_num(y), (0, bins * width - len(y)), mode="edge").reshape(bins, width)
    start = np.arange(bins) * width
    picks = np.concatenate([start + folded.argmin(1), start + folded.argmax(1), [0, len(y) - 1]])
    return np.unique(np.minimum(picks, len(y) - 1))
