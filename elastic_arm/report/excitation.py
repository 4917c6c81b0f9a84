"""Figures of an excitation and of the search for it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from elastic_arm.excitation import ExcitationResult, FourierTrajectory, MotionLimits
from elastic_arm.report.style import BLUE, GREEN, GREY, VERMILION, new_figure, style
from elastic_arm.robot.description import Robot
from elastic_arm.robot.kinematics import link_points

Array = NDArray[np.float64]

POINTS = 1200
POSES = 6
LABELS = {
    "condition": "condition number",
    "d_optimal": "D criterion, decades",
    "a_optimal": "A criterion, decades",
}


def search_course(result: ExcitationResult) -> Figure:
    """Draw the best value over the evaluations of the search."""
    count, value = np.array(result.history).T
    with style():
        figure, axes = new_figure(size=(5.6, 3.0))
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


def condition_against_random(result: ExcitationResult) -> Figure:
    """Draw the condition numbers of the random motions and of the optimised one."""
    random = np.sort(result.random)
    with style():
        figure, axes = new_figure(size=(5.6, 2.6))
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


def joint_motion(trajectory: FourierTrajectory, limits: MotionLimits) -> Figure:
    """Draw position, velocity and acceleration of every joint with their limits."""
    t = np.linspace(0.0, trajectory.duration, POINTS)
    bounds = (
        (limits.position_min, limits.position_max),
        (-limits.velocity, limits.velocity),
        (-limits.acceleration, limits.acceleration),
    )
    names = ("q [rad]", "dq [rad/s]", "ddq [rad/s²]")
    with style():
        figure, axes = new_figure(3, trajectory.n, size=(max(6.0, 3.0 * trajectory.n), 5.6), sharex=True)
        for row, (values, (low, high), name) in enumerate(zip(trajectory.evaluate(t), bounds, names, strict=True)):
            for joint in range(trajectory.n):
                ax = axes[row, joint]
                ax.axvspan(*trajectory.periodic, color="#F3F5F7", zorder=0)
                ax.plot(t, values[:, joint], color=BLUE)
                for bound in (low[joint], high[joint]):
                    ax.axhline(bound, color=VERMILION, lw=1.0, ls="--")
                if joint == 0:
                    ax.set_ylabel(name)
        for joint, name in enumerate(limits.joints):
            axes[0, joint].set_title(name, loc="left")
            axes[-1, joint].set_xlabel("t [s]")
    return figure


def tip_path(trajectory: FourierTrajectory, robot: Robot) -> Figure:
    """Draw the path of the last link's frame from the side and from above, with the arm in some poses."""
    q, _, _ = trajectory.evaluate(np.linspace(0.0, trajectory.duration, POINTS))
    points = link_points(robot, q)
    poses = points[np.linspace(0, POINTS - 1, POSES, dtype=int)]
    views = (
        (0, 2, "x [m]", "z [m]", "from the side"),
        (1, 2, "y [m]", "z [m]", "from the front"),
        (0, 1, "x [m]", "y [m]", "from above"),
    )
    with style():
        figure, axes = new_figure(1, 3, size=(10.5, 3.6))
        for ax, (right, up, x, y, title) in zip(axes[0], views, strict=True):
            for pose in poses:
                ax.plot(pose[:, right], pose[:, up], "-", color=GREY, lw=2.5, alpha=0.45, solid_capstyle="round")
            ax.plot(points[:, -1, right], points[:, -1, up], color=BLUE, lw=1.0)
            ax.plot(*points[0, -1, [right, up]], "o", color=GREEN, ms=5)
            if up == 2:
                ax.axhline(0.0, color=VERMILION, lw=1.0, ls="--")
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
