"""Sections of a replay's report: errors of all models side by side, and recorded and replayed
courses overlaid."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure as MplFigure

from elastic_arm.mujoco.replaying import Replay, labels
from elastic_arm.report.html import Figure, Section, Table, Text
from elastic_arm.report.style import CYCLE, GREY, draw_signal, drawing, label_times

SHOWN_SECONDS = 6.0  # of a recording in a figure: windows stay visible


def sections(found: Sequence[Replay]) -> list[Section]:
    """Return the sections, most important first."""
    first = found[0]
    how = Text(
        f"In MuJoCo, the {first.torque} motor torque drives the arm for {first.window:g} s from"
        f" each of {first.windows} starting points. Torque: the {first.torque} torque compared with"
        " MuJoCo's inverse dynamics of the recorded motion."
    )
    units = first.units
    tables = [
        _table(found, "position", 1e3, units.over("mrad")),
        _table(found, "velocity", 1e3, units.over("mrad/s")),
        _table(found, "torque", 1.0, units.over("Nm")),
        _table(found, "correlation", 1.0, f"of required and {first.torque} torque"),
        _table(found, "lag", 1e3, f"ms by which the {first.torque} torque lags"),
    ]
    shown = [
        Section("Errors of each model", [how, *tables]),
        Section(
            "Positions, recorded and replayed",
            [Figure(positions(found), "Each window starts from the recorded state.")],
        ),
        Section(
            f"Torques, {first.torque} and required",
            [Figure(torques(found), "Required: by MuJoCo's inverse dynamics.")],
        ),
    ]
    if any(one.closed_loop is not None for one in found):
        pairs = zip(labels(found), found, strict=True)
        rows = [
            [name, *map(float, 1e3 * one.closed_loop)]
            for name, one in pairs
            if one.closed_loop is not None
        ]
        table = Table(
            ["model", *first.joints],
            rows,
            f"Root mean square of the position error, {units.over('mrad')}",
        )
        shown.insert(
            1, Section("Under the recorded reference, with the model's own servos", [table])
        )
    return shown


def _table(found: Sequence[Replay], name: str, factor: float, unit: str) -> Table:
    pairs = zip(labels(found), found, strict=True)
    rows = [
        [label, *(factor * float(v) for v in getattr(one.open_loop, name))] for label, one in pairs
    ]
    return Table(["model", *found[0].joints], rows, f"{name.capitalize()}, {unit}")


def positions(found: Sequence[Replay]) -> MplFigure:
    """Draw recorded angles and those of each model."""
    return _overlay(found, "recorded", "recorded", "replayed", "rad")


def torques(found: Sequence[Replay]) -> MplFigure:
    """Draw recorded torques and those that each model needs."""
    return _overlay(found, found[0].torque, "torque_recorded", "torque_needed", "Nm")


def _overlay(
    found: Sequence[Replay], label: str, recorded: str, model: str, unit: str
) -> MplFigure:
    joints = found[0].joints
    with drawing(len(joints), 1, size=(8.4, 1.5 * len(joints)), sharex=True) as (figure, axes):
        for i, joint in enumerate(joints):
            ax = axes[i, 0]
            course = found[0].course
            kept = course.t <= course.t[0] + SHOWN_SECONDS
            values = getattr(course, recorded)[kept, i]
            draw_signal(ax, course.t[kept], values, color=GREY, lw=2.6, alpha=0.6, label=label)
            for k, (name, one) in enumerate(zip(labels(found), found, strict=True)):
                values = getattr(one.course, model)[:, i]
                own = one.course.t <= one.course.t[0] + SHOWN_SECONDS
                values = np.where(np.isfinite(values), values, np.nan)
                draw_signal(
                    ax,
                    one.course.t[own],
                    values[own],
                    color=CYCLE[k % len(CYCLE)],
                    lw=0.9,
                    label=name,
                )
            ax.set_title(f"{joint} [{found[0].units.at(joint, unit)}]", loc="left")
        label_times(figure, axes, 1 + len(found))
    return figure
