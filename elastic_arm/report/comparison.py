"""Sections of a comparison: a real and a simulated recording, channel by channel, and which effects
are in which."""

import numpy as np
from matplotlib.figure import Figure as MplFigure

from elastic_arm.diagnosis.comparison import SimulationComparison
from elastic_arm.recording.inspection.differences import RecordingDifference
from elastic_arm.recording.sides import SAMPLED
from elastic_arm.report.html import Figure, Section, Table, Text
from elastic_arm.report.style import draw_signal, drawing, label_times

UNITS = {
    name: {"position": "rad", "velocity": "rad/s"}.get(channel, "Nm")
    for name, (_, channel) in SAMPLED.items()
}


def sections(found: SimulationComparison) -> list[Section]:
    """Return the sections, most important first."""
    header = ["effect", "where", "in", "in the real recording", "in the simulated recording"]
    rows = found.rows()
    effects = [
        Text(
            "Effects that the model lacks for either recording, with size and probability in each."
        ),
        Table(header, rows)
        if rows
        else Text("No effect is missing in the model for either recording."),
    ]
    return [
        Section(
            f"Compared with {found.simulated or 'the simulated recording'}: effects by recording",
            effects,
        ),
        Section("Comparison by channel, without a model", _differences(found.difference)),
    ]


def _differences(found: RecordingDifference) -> list[Text | Table | Figure]:
    how = Text(
        f"Real minus simulated, over {found.t[-1] - found.t[0]:.3g} s, aligned by"
        f" {found.aligned_by} positions ({1e3 * found.offset:.3f} ms). Share: relative to"
        " the standard deviation of the real channel."
    )
    tables: list[Table] = []
    for one in found.channels:
        unit = UNITS[one.channel]
        numbers = np.column_stack([one.rms, one.largest, one.mean, one.share, 1e3 * one.lag])
        rows = [[joint, *row] for joint, row in zip(found.joints, numbers.tolist(), strict=True)]
        header = [
            "joint",
            f"rms, {unit}",
            f"largest, {unit}",
            f"mean, {unit}",
            "share",
            "delay of the real channel, ms",
        ]
        tables.append(Table(header, rows, one.channel, digits=3))
    return [how, *tables, Figure(drawn(found), "Real minus simulated.")]


def drawn(found: RecordingDifference) -> MplFigure:
    """Draw the difference of every channel, a line a joint."""
    with drawing(len(found.channels), 1, size=(8.4, 1.6 * len(found.channels)), sharex=True) as (
        figure,
        axes,
    ):
        for i, one in enumerate(found.channels):
            for k, joint in enumerate(found.joints):
                draw_signal(axes[i, 0], found.t, one.apart[:, k], lw=0.9, label=joint)
            axes[i, 0].set_title(f"{one.channel} [{UNITS[one.channel]}]", loc="left")
        label_times(figure, axes, len(found.joints))
    return figure
