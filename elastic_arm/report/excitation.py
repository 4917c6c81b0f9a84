"""Figures of an excitation and of the search for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as MplFigure

from elastic_arm.excitation import ExcitationResult, FourierTrajectory, LimitUse, MotionLimits, Workspace
from elastic_arm.report.html import Block, Figure, Section, Table, Text
from elastic_arm.report.style import BLUE, GREEN, GREY, VERMILION, drawing
from elastic_arm.robot.description import Robot
from elastic_arm.robot.kinematics import link_points

POINTS = 1200
POSES = 6
LABELS = {
    "condition": "condition number",
    "d_optimal": "D criterion, decades",
    "a_optimal": "A criterion, decades",
}


def sections(result: ExcitationResult, limits: MotionLimits, robot: Robot, left_out: Sequence[str]) -> list[Section]:
    """Return the report: what was reached, the motion, and what it uses of the limits."""
    median = float(np.median(result.random)) if len(result.random) else float("nan")
    verdict = (
        f"Condition number of the base regressor: {result.condition_after:.3g} optimised, {median:.3g} the median of "
        f"{len(result.random)} random motions within the same limits."
    )
    reached: list[Block] = [
        Text(verdict, "good"),
        *(
            Text(
                f"With such motions only nearly exact encoders separate this parameter from the others: {name}", "warn"
            )
            for name in left_out
        ),
        Figure(condition_against_random(result), "Random motions and the optimised one."),
        Figure(search_course(result), "Course of the pattern search."),
    ]
    motion: list[Block] = [
        Figure(
            joint_motion(result.trajectory, limits),
            "Line: the motion; dashed: limits; shaded: the periodic section between start and stop.",
        ),
        Figure(
            tip_path(result.trajectory, robot, limits.workspace),
            "Path of the last link's frame, with the arm in some poses; dot: start; dashed: floor.",
        ),
    ]
    return [Section("Result", reached), Section("Motion", motion), Section("Limits", _limits(result.use, limits))]


def _limits(use: LimitUse, limits: MotionLimits) -> list[Block]:
    rows = [
        [joint, *(use.share(kind, i) for kind in use.kinds), float(use.peak_torque[i])]
        for i, joint in enumerate(use.joints)
    ]
    header = ["joint", *use.kinds, "peak torque [Nm]"]
    gaps = [
        Text(f"Smallest gap to {name}: {1e3 * gap:.0f} mm; the margin is {1e3 * use.margin:g} mm.")
        for name, gap in use.gaps()
    ]
    assumed = [Text(f"{sentence[:1].upper()}{sentence[1:]}.") for sentence in limits.assumed]
    return [Table(header, rows, "Share of the limits used.", digits=3), *gaps, *assumed]


def search_course(result: ExcitationResult) -> MplFigure:
    """Draw the best value over the evaluations of the search."""
    count, value = np.array(result.history).T
    with drawing(size=(5.6, 3.0)) as (figure, axes):
        ax = axes[0, 0]
        ax.step(count, value, where="post", color=BLUE)
        ax.axhline(result.value_before, color=GREY, ls="--", lw=1.0)
        ax.annotate(
            "start: the best random motion",
            (count[-1], result.value_before),
            (0, -4),
            textcoords="offset points",
            ha="right",
            va="top",
            color=GREY,
        )
        ax.set_xlabel("evaluations")
        ax.set_title(f"{LABELS[result.criterion]} of the best motion so far", loc="left")
        if result.criterion == "condition":
            ax.set_yscale("log")
            _plain_numbers(ax, "y")
    return figure


def condition_against_random(result: ExcitationResult) -> MplFigure:
    """Draw the condition numbers of the random motions and of the optimised one."""
    random = np.sort(result.random)
    with drawing(size=(5.6, 2.6)) as (figure, axes):
        ax = axes[0, 0]
        if len(random):
            share = (np.arange(len(random)) + 0.5) / len(random)
            ax.plot(random, 100 * share, "o", ms=3.5, color=GREY, label=f"{len(random)} random motions")
            ax.axvline(float(np.median(random)), color=GREY, ls="--", lw=1.0, label=f"median {np.median(random):.3g}")
        after = result.condition_after
        ax.axvline(after, color=VERMILION, label=f"optimised {after:.3g}")
        ax.set_xscale("log")
        _plain_numbers(ax, "x")
        ax.set_xlabel("condition number of the base regressor")
        ax.set_title("Share of random motions that are as good or better [%]", loc="left")
        ax.legend(loc="lower right")
    return figure


def joint_motion(trajectory: FourierTrajectory, limits: MotionLimits) -> MplFigure:
    """Draw position, velocity and acceleration of every joint with their limits."""
    t = np.linspace(0.0, trajectory.duration, POINTS)
    bounds = (
        (limits.position_min, limits.position_max),
        (-limits.velocity, limits.velocity),
        (-limits.acceleration, limits.acceleration),
    )
    units = ("rad", "rad/s", "rad/s²")
    with drawing(3, trajectory.n, size=(max(6.0, 3.0 * trajectory.n), 5.6), sharex=True) as (figure, axes):
        for row, (values, (low, high), unit) in enumerate(zip(trajectory.evaluate(t), bounds, units, strict=True)):
            for joint in range(trajectory.n):
                ax = axes[row, joint]
                ax.axvspan(*trajectory.periodic, color="#F3F5F7", zorder=0)
                ax.plot(t, values[:, joint], color=BLUE)
                for bound in (low[joint], high[joint]):
                    ax.axhline(bound, color=VERMILION, lw=1.0, ls="--")
                own = limits.units.at(limits.joints[joint], unit)
                if joint == 0 or own != unit:
                    ax.set_ylabel(f"{'d' * row}q [{own}]")
        for joint, name in enumerate(limits.joints):
            axes[0, joint].set_title(name, loc="left")
            axes[-1, joint].set_xlabel("t [s]")
    return figure


def tip_path(trajectory: FourierTrajectory, robot: Robot, workspace: Workspace | None = None) -> MplFigure:
    """Draw the path of the last link's frame from the side and from above, with the arm in some poses and the floor."""
    q, _, _ = trajectory.evaluate(np.linspace(0.0, trajectory.duration, POINTS))
    points = link_points(robot, q)
    poses = points[np.linspace(0, POINTS - 1, POSES, dtype=int)]
    views = (
        (0, 2, "x [m]", "z [m]", "from the side"),
        (1, 2, "y [m]", "z [m]", "from the front"),
        (0, 1, "x [m]", "y [m]", "from above"),
    )
    with drawing(1, 3, size=(10.5, 3.6)) as (figure, axes):
        for ax, (right, up, x, y, title) in zip(axes[0], views, strict=True):
            for pose in poses:
                ax.plot(pose[:, right], pose[:, up], "-", color=GREY, lw=2.5, alpha=0.45, solid_capstyle="round")
            ax.plot(points[:, -1, right], points[:, -1, up], color=BLUE, lw=1.0)
            ax.plot(*points[0, -1, [right, up]], "o", color=GREEN, ms=5)
            if up == 2 and workspace is not None and workspace.floor is not None:
                ax.axhline(workspace.floor, color=VERMILION, lw=1.0, ls="--")
            ax.set_aspect("equal", adjustable="datalim")
            ax.set_xlabel(x)
            ax.set_ylabel(y)
            ax.set_title(title, loc="left")
    return figure


def _plain_numbers(ax: Axes, which: str) -> None:
    """Label a logarithmic axis with plain numbers, also where it spans less than a decade."""
    axis = ax.xaxis if which == "x" else ax.yaxis
    low, high = axis.get_view_interval()
    axis.set_major_formatter("{x:g}")
    if high < 30.0 * low:
        axis.set_minor_formatter("{x:.3g}")
