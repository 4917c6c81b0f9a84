"""Figs. 1 and 2 and Table I of the paper: the arm, its drive trains and its frames."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as MplFigure
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle
from mpl_toolkits.mplot3d.axes3d import Axes3D

from elastic_arm.report.html import Figure, Section, Table
from elastic_arm.report.style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION, style
from elastic_arm.robot.description import DH, Robot
from elastic_arm.robot.kinematics import link_placements
from elastic_arm.studies.paper.study import StudyResult
from elastic_arm.studies.paper.virtual_prototype.mechanism import transmissions

AXES = ((VERMILION, "x"), (GREEN, "y"), (BLUE, "z"))
# Colour and size of the marks: a spline sits in its wave generator's place.
PARTS = {"rotor": (ORANGE, 60), "wave_generator": (PURPLE, 60), "spline": (SKY, 16)}
ZOOM = 0.95  # of a drawing in space: with more its labels are cut off
FRAME = 0.16  # length of a frame's arrows, m
POSE = (0.0, 0.4, -0.5)
"""Angles of Fig. 1, rad: at the zero pose the links hide each other. Joints beyond these stay at zero."""


def section(result: StudyResult) -> Section:
    """Figs. 1, 2 and Table I."""
    robot = result.robot
    rows = [
        (name, row.a, row.d, f"{math.degrees(row.alpha):g}°", _turned(k, row))
        for k, (name, row) in enumerate(table_i(robot))
    ]
    return Section(
        "Figs. 1 and 2, Table I: the arm",
        [
            Figure(
                figure_1(robot),
                "Fig. 1. (a) The arm, turned out of its zero pose: links as lines, joints' axes (the same as in its "
                f"URDF), and the transmissions by joint: {_carriers(robot)}. (b) The drive of one joint: the rotor "
                "turns the wave generator by a belt (r_b), this the spline by the harmonic drive (r_hd), and the link "
                "hangs on the spline by a bushing of six springs and dampers.",
            ),
            Figure(
                figure_2(robot),
                "Fig. 2. Frames of (2) and (3) at the zero pose: O_G on the ground, O_0 at joint 1, O_i at the far end "
                "of link i; motor and link turn about z of O_i-1, the bearing tilts about its x and y. x red, y green, "
                "z blue.",
            ),
            Table(
                ("frame", "a_i [m]", "d_i [m]", "alpha_i", "theta_i"), rows, caption="Table I, as the arm file has it"
            ),
        ],
    )


def _carriers(robot: Robot) -> str:
    """Return what carries each rotor, wave generator and spline."""
    found = []
    for k, drive in enumerate(transmissions(robot), 1):
        parts = [f"{name.replace('_', ' ')} on {part.carrier}" for name, (part, _) in drive.components.items()]
        found.append(f"{k}: {', '.join(parts)}")
    return "; ".join(found)


def table_i(robot: Robot) -> list[tuple[str, DH]]:
    """Return the Denavit-Hartenberg rows that the description was written in: those of O_0 and of each joint."""
    rows = [robot.base_dh, *(joint.dh for joint in robot.joints)]
    return [(f"O_{k}", row) for k, row in enumerate(rows) if row is not None]


def _turned(k: int, row: DH) -> str:
    offset = f"{math.degrees(row.offset):g}°"
    return offset if k == 0 else f"theta_{k}" if row.offset == 0.0 else f"theta_{k} + {offset}"


def figure_1(robot: Robot) -> MplFigure:
    """Draw the arm, and one drive train."""
    with style():
        figure = MplFigure(figsize=(11.0, 5.4), layout="constrained")
        grid = figure.add_gridspec(1, 2, width_ratios=(1.0, 1.3))
        space: Axes3D = figure.add_subplot(grid[0], projection="3d")
        pose = np.zeros(robot.n)
        pose[: len(POSE)] = POSE[: robot.n]
        joints = _arm(space, robot, pose)
        _drives(space, robot, joints)
        space.set_title("(a)", loc="left")
        space.legend(loc="upper left", fontsize=7)
        plane = figure.add_subplot(grid[1])
        _drive_train(plane, robot.n)
        plane.set_title("(b)", loc="left")
    return figure


def figure_2(robot: Robot) -> MplFigure:
    """Draw the frames O_G and O_0 to O_n at the zero pose."""
    with style():
        figure = MplFigure(figsize=(8.0, 6.4), layout="constrained")
        space: Axes3D = figure.add_subplot(projection="3d")
        _arm(space, robot, np.zeros(robot.n))
        _, links = link_placements(robot, np.zeros(robot.n))
        frames = [np.eye(4), robot.base_placement @ robot.joints[0].before, *links[0]]
        for name, frame in zip(("G", *map(str, range(robot.n + 1))), frames, strict=True):
            _frame(space, frame, rf"$O_{{{name}}}$")
    return figure


def _arm(ax: Axes3D, robot: Robot, pose: np.ndarray) -> np.ndarray:
    """Draw links and joints' axes; return the turned joint frames (n, 4, 4)."""
    (joints,), (links,) = link_placements(robot, pose)
    corners = [np.zeros(3)]
    for joint, link in zip(joints, links, strict=True):
        # Each link leaves its joint along the axis first, as its row has d before a.
        along = joint[:3, 3] + joint[:3, 2] * (joint[:3, 2] @ (link[:3, 3] - joint[:3, 3]))
        corners += [joint[:3, 3], along, link[:3, 3]]
    ax.plot(*np.array(corners).T, color=GREY, lw=5.0, alpha=0.5, solid_joinstyle="round")
    for k, joint in enumerate(joints, 1):
        axis = joint[:3, 3][:, None] + joint[:3, 2][:, None] * np.array([-0.12, 0.12])
        ax.plot(*axis, color="black", lw=0.8, ls="-.")
        ax.text(*(axis[:, 0]), f"axis {k}", fontsize=7, ha="right")
    _same_scale(ax, np.array(corners))
    return joints


def _drives(ax: Axes3D, robot: Robot, joints: np.ndarray) -> None:
    """Mark rotors, wave generators and splines, each in the frame that its place is given in."""
    for k, drive in enumerate(transmissions(robot)):
        for name, (colour, size) in PARTS.items():
            part = getattr(drive, name)
            at = joints[k] @ np.append(part.position, 1.0)
            label = name.replace("_", " ") if k == 0 else None
            ax.scatter(*at[:3], color=colour, s=size, label=label, depthshade=False)
            if name == "rotor":
                ax.text(*at[:3], f"   {k + 1}", fontsize=7)


def _frame(ax: Axes3D, frame: np.ndarray, name: str) -> None:
    for k, (colour, _) in enumerate(AXES):
        ax.quiver(*frame[:3, 3], *(FRAME * frame[:3, k]), color=colour, lw=1.4, arrow_length_ratio=0.25)
    ax.text(*(frame[:3, 3] - 0.4 * FRAME * frame[:3, :3].sum(axis=1)), name, fontsize=9)


def _same_scale(ax: Axes3D, points: np.ndarray) -> None:
    low, high = points.min(axis=0) - 0.2, points.max(axis=0) + 0.2
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set_box_aspect(high - low, zoom=ZOOM)
    ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    ax.locator_params(nbins=4)
    ax.tick_params(labelsize=7)
    ax.view_init(elev=14.0, azim=-70.0)


def _drive_train(ax: Axes, joint: int) -> None:
    """Draw rotor, belt, wave generator, spline, bushing and link of one joint in a row."""
    ax.set(xlim=(0.0, 11.6), ylim=(-2.4, 2.4), aspect="equal")
    ax.axis("off")
    bodies = (
        (0.9, 0.55, ORANGE, "rotor", rf"$\theta_{{m{joint}}} = r_b r_{{hd}} \theta_{{{joint}}}$"),
        (3.2, 0.95, PURPLE, "wave generator", rf"$\theta_{{wg{joint}}} = r_{{hd}} \theta_{{{joint}}}$"),
        (5.6, 1.15, SKY, "flex spline", rf"$\theta_{{{joint}}}$"),
    )
    for x, radius, colour, name, angle in bodies:
        ax.add_patch(Circle((x, 0.0), radius, facecolor=colour, alpha=0.55, edgecolor="black"))
        ax.text(x, -1.55, name, ha="center", fontsize=8)
        ax.text(x, 1.4, angle, ha="center", fontsize=9)
    for side in (1.0, -1.0):
        ax.plot([0.9, 3.2], [0.55 * side, 0.95 * side], color="black", lw=1.0)
    ax.text(1.95, 0.95, r"belt $r_b$", ha="center", fontsize=8)
    ax.plot([4.15, 4.45], [0.0, 0.0], color="black", lw=1.0)
    ax.text(4.3, 0.25, r"$r_{hd}$", ha="center", fontsize=8)
    coil = np.linspace(0.0, 1.0, 200)
    for height, name in ((0.6, "$K, D$ about $z$"), (0.0, "bearing about $x, y$"), (-0.6, "$x, y, z$ (stiff)")):
        ax.plot(6.75 + 2.3 * coil, height + 0.12 * np.sin(20 * np.pi * coil), color=GREY, lw=1.0)
        ax.text(7.9, height + 0.18, name, ha="center", fontsize=6.5)
    ax.text(7.9, -1.55, "bushing", ha="center", fontsize=8)
    ax.add_patch(FancyBboxPatch((9.15, -0.8), 1.9, 1.6, boxstyle="round,pad=0.05", facecolor=GREY, alpha=0.45))
    ax.text(10.1, -1.55, "link", ha="center", fontsize=8)
    ax.text(10.1, 1.4, rf"$q_{{{joint}}}, q_{{{joint}x}}, q_{{{joint}y}}$", ha="center", fontsize=9)
    ax.add_patch(Rectangle((0.2, -2.15), 6.7, 0.18, facecolor="none", edgecolor=GREY, hatch="////", lw=0.5))
    ax.text(7.05, -2.17, rf"carrier: link {joint - 1}", fontsize=8)
