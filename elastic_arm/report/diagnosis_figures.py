"""The figures of a gap diagnosis: map, cumulative shrink, residuals, prediction errors, proposed
motion."""

from collections.abc import Sequence
from functools import partial
from itertools import product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as MplFigure
from scipy.signal import welch

from elastic_arm.arrays import Array
from elastic_arm.diagnosis.context import DiagnosisContext
from elastic_arm.diagnosis.prediction import Prediction
from elastic_arm.diagnosis.result import Cause, Diagnosis
from elastic_arm.estimation.equation_sets import SIDES
from elastic_arm.excitation import FourierTrajectory
from elastic_arm.report.html import Figure, Plot
from elastic_arm.report.style import BLUE, CYCLE, GREY, VERMILION, drawing

# The same colours mean the same throughout.
BEFORE = GREY
CAUSE = VERMILION
AFTER = BLUE
POINTS = 1500  # of a cloud
PANELS = 3  # side by side
SEEN = 0.98  # of the samples of friction that a panel shows, the others are beyond its edges
BRIGHTEST = 100.0  # residual over noise at which the map's colour ends


def title(cause: Cause) -> str:
    """Return a cause's name in words."""
    return f"{cause.effect.replace('_', ' ')}, {cause.joint or 'whole arm'}"


def times(ratio: float) -> str:
    """Return a residual over its noise as text."""
    return f"{ratio:.1f}× noise" if ratio < BRIGHTEST else f"{ratio:.0f}× noise"


def shown_sides(found: Diagnosis) -> tuple[str, ...]:
    """Return the sides of which some joint has a residual."""
    compared = {side for _, side in found.before.rmse}
    return tuple(side for side in SIDES if side in compared)


def gap_map(found: Diagnosis) -> MplFigure:
    """Draw joints by sides, before and after: residual over its noise."""
    sides = shown_sides(found)
    shown = {"uncorrected model": found.before}
    if found.causes:
        shown["with all causes"] = found.after
    size_of_map = (0.6 + (1.5 + len(sides)) * len(shown), 1.3 + 0.5 * len(found.joints))
    with drawing(1, len(shown), size=size_of_map) as (figure, axes):
        for ax, (name, size) in zip(axes[0], shown.items(), strict=True):
            ratio = np.array(
                [
                    [_ratio(size.rmse.get((j, s)), found.noise.get((j, s))) for s in sides]
                    for j in found.joints
                ]
            )
            shade = np.log10(np.maximum(ratio, 1.0)) / np.log10(BRIGHTEST)
            ax.imshow(shade, vmin=0.0, vmax=1.0, cmap="YlOrRd", aspect="auto")
            for (row, column), value in np.ndenumerate(ratio):
                place = (found.joints[row], sides[column])
                label = (
                    "not recorded"
                    if np.isnan(value)
                    else f"{times(value)}\n{size.rmse[place]:.3g} {found.units.at(place[0], 'Nm')}"
                )
                colour = "white" if shade[row, column] > 0.7 else "black"
                ax.text(column, row, label, ha="center", va="center", fontsize=8, color=colour)
            ax.set_xticks(range(len(sides)), [f"{s} side" for s in sides])
            ax.set_yticks(
                range(len(found.joints)),
                found.joints if ax is axes[0, 0] else [""] * len(found.joints),
            )
            ax.set_title(name, loc="left")
            ax.grid(False)
            ax.tick_params(length=0)
    return figure


def residual_blocks(
    found: Diagnosis,
    context: DiagnosisContext,
    row: int,
    left: Sequence[Array],
    cause: str | None,
    regime: str = "",
) -> list[Plot | Figure]:
    """Return figures of a residual over time, frequency, velocity, position and angle.

    With what was added.

    `left` is what is left of all residuals (N', R) of each stretch, `cause` what was added, None
    where nothing was, and `regime` where it shows most: what follows the rotor is drawn over the
    angle of the rotor.
    """
    n = len(found.joints)
    side = context.validate.layout.sides[row // n]
    i = row % n
    part = max(range(len(left)), key=lambda k: len(left[k]))
    stretch = context.validate.parts[part].stretch
    before = context.before[part][:, row]
    rest = left[part][:, row]
    added = None if cause is None else before - rest
    t = stretch.t
    motion = stretch.motion
    moving = "link" if side == "link" else "motor"
    joint = found.joints[i]
    unit = partial(found.units.at, joint)
    speed, angle = (motion.dq, motion.q) if side == "link" else (motion.dtheta, motion.theta)
    w = np.interp(t, motion.t, speed[:, i])
    q = np.interp(t, motion.t, angle[:, i])
    turn, turning = angle_within_turn(
        found, context, i, np.interp(t, motion.t, motion.theta[:, i]), regime
    )
    what = "position" if joint in found.prismatic else "angle"
    names = (f"{moving} velocity [{unit('rad/s')}]", f"{moving} {what} [{unit('rad')}]", turning)
    with drawing(1, 4, size=(11.2, 2.7)) as (figure, axes):
        spectrum, *clouds = axes[0]
        _draw_spectra(spectrum, before, rest if cause else None, stretch.band.kept_rate, found.band)
        spectrum.set_ylabel(f"{unit('Nm')}/√Hz")
        for ax, x, name in zip(clouds, (w, q, turn), names, strict=True):
            _draw_cloud(ax, x, before, added)
            ax.set_xlabel(name.replace(" within", "\nwithin"))
            ax.locator_params(axis="x", nbins=5)
        clouds[0].set_ylabel(unit("Nm"))
    signals = {"residual before": (before, BEFORE)}
    if cause is not None and added is not None:
        signals |= {
            cause.replace("_", " "): (added, CAUSE),
            "residual after adding it": (rest, AFTER),
        }
    return [Plot(t, signals, unit("Nm")), Figure(figure)]


def _draw_spectra(ax: Axes, before: Array, rest: Array | None, rate: float, band: float) -> None:
    for values, colour in ((before, BEFORE), (rest, AFTER)):
        if values is not None:
            f, density = welch(values, rate, nperseg=min(len(values), int(4 * rate)))
            seen = (f > 0) & (f <= band)
            ax.semilogy(f[seen], np.sqrt(density[seen]), color=colour)
    ax.set_xlabel("frequency [Hz]")


def _draw_cloud(ax: Axes, x: Array, before: Array, cause: Array | None) -> None:
    step = max(1, len(x) // POINTS)
    ax.plot(
        x[::step], before[::step], ".", color=BEFORE, ms=3.0, alpha=0.45, mew=0, rasterized=True
    )
    if cause is not None:
        ax.plot(
            x[::step], cause[::step], ".", color=CAUSE, ms=2.2, alpha=0.7, mew=0, rasterized=True
        )


def places_with_friction(context: DiagnosisContext) -> list[int]:
    """Return the residuals at which friction acts, by their numbers."""
    largest = np.max([np.abs(one).max(axis=0) for one in context.friction], axis=0)
    return np.flatnonzero(largest).tolist()


def friction_curves(
    found: Diagnosis, context: DiagnosisContext, places: Sequence[int]
) -> MplFigure:
    """Draw friction over velocity, a place a panel: by the recordings and by the model."""
    n = len(found.joints)
    columns = min(len(places), PANELS)
    rows = -(-len(places) // PANELS)
    with drawing(rows, columns, size=(2.8 * columns, 2.4 * rows)) as (figure, axes):
        for ax in axes.flat[len(places) :]:
            ax.set_visible(False)
        for ax, row in zip(axes.flat, places, strict=False):
            side = context.validate.layout.sides[row // n]
            joint = found.joints[row % n]
            w, measured, model = friction_at(context, row, side)
            step = max(1, len(w) // POINTS)
            dots = {"ms": 2.5, "alpha": 0.6, "mew": 0, "rasterized": True}
            ax.plot(w[::step], measured[::step], ".", color=BEFORE, **dots)
            ax.plot(w[::step], model[::step], ".", color=AFTER, **dots)
            # At rest, friction takes whatever torque holds the joint.
            largest = float(np.quantile(np.abs(measured), SEEN))
            ax.set_ylim(-1.2 * largest, 1.2 * largest)
            ax.set_title(f"{joint}, {side} side", loc="left")
            ax.set_xlabel(f"velocity [{found.units.at(joint, 'rad/s')}]")
            ax.set_ylabel(found.units.at(joint, "Nm"))
    return figure


def friction_at(context: DiagnosisContext, row: int, side: str) -> tuple[Array, Array, Array]:
    """Return velocities (N,), and the friction (N,) Nm there by the recordings and by the
    model."""
    i = row % context.model.robot.n
    speeds = []
    for part in context.validate.parts:
        motion = part.stretch.motion
        speed = motion.dq if side == "link" else motion.dtheta
        speeds.append(np.interp(part.stretch.t, motion.t, speed[:, i]))
    model = np.concatenate([one[:, row] for one in context.friction])
    left = np.concatenate([one[:, row] for one in context.after])
    return np.concatenate(speeds), model + left, model


def angle_within_turn(
    found: Diagnosis, context: DiagnosisContext, i: int, theta: Array, regime: str
) -> tuple[Array, str]:
    """Return the angle within a turn of what turns fast, and its name.

    Wave generator, rotor, or the joint itself.
    """
    gear = context.model.robot.joints[i].transmission
    if gear is None:
        # Around the middle of the motion: one about zero would be cut in two.
        middle = 0.5 * (theta.min() + theta.max())
        return middle + np.mod(
            theta - middle + np.pi, 2 * np.pi
        ) - np.pi, "joint angle within a turn [rad]"
    rotor = regime == "rotor_angle"
    ratio = gear.r_tot if rotor else gear.harmonic_drive_ratio
    name = "rotor" if rotor else "wave generator"
    return np.mod(ratio * theta, 2 * np.pi), f"{name} angle within a turn [rad]"


def before_and_after(found: Diagnosis, context: DiagnosisContext) -> list[Plot]:
    """Return every residual over time, before and after, on the longest stretch."""
    part = max(range(len(context.before)), key=lambda k: len(context.before[k]))
    t = context.validate.parts[part].stretch.t
    shown = []
    for row, (side, joint) in enumerate(product(context.validate.layout.sides, found.joints)):
        if (joint, side) in found.noise:
            unit = found.units.at(joint, "Nm")
            signals = {"before": (context.before[part][:, row], BEFORE)}
            signals |= {"after": (context.after[part][:, row], AFTER)} if found.causes else {}
            noise = f"noise {found.noise[joint, side]:.3g} {unit}"
            shown.append(Plot(t, signals, unit, f"{joint}, {side} side; {noise}."))
    return shown


def horizons(prediction: Prediction, joints: Sequence[str], unit: str) -> MplFigure:
    """Draw prediction errors over the horizon, a joint a panel."""
    before = prediction.before or {}
    after = prediction.after or {}
    ms = 1e3 * np.array(prediction.horizons)
    drawn = [(before, BEFORE, 2.6, "before"), (after, AFTER, 1.0, "after")][
        : 1 if after == before else 2
    ]
    width = max(4.5, min(3.2 * len(joints), 12.0))
    with drawing(1, len(joints), size=(width, 2.9), sharey=True) as (figure, axes):
        for ax, joint in zip(axes[0], joints, strict=True):
            ax.set_title(joint, loc="left")
            for side, dash in (("motor", "-"), ("link", "--")):
                for size, colour, width, word in drawn:
                    if (joint, side) in size:
                        values = 1e6 * np.array(size[joint, side])
                        style_of = {
                            "marker": "o",
                            "ms": 2.5 * width**0.5,
                            "color": colour,
                            "lw": width,
                        }
                        ax.loglog(ms, values, dash, **style_of, label=f"{side} angle, {word}")
            ax.set_xticks(ms, [f"{v:g}" for v in ms])
            ax.minorticks_off()
            ax.set_xlabel("horizon [ms]")
        axes[0, 0].set_ylabel(f"prediction error [{unit}]")
        axes[0, -1].legend(fontsize=7)
    return figure


def motion(trajectory: FourierTrajectory, found: Diagnosis) -> MplFigure:
    """Draw a proposed motion."""
    t = np.linspace(0.0, trajectory.duration, 1000)
    q, dq, _ = trajectory.evaluate(t)
    with drawing(1, 2, size=(9.6, 2.7)) as (figure, axes):
        for ax, values, what, unit in (
            (axes[0, 0], q, "angle", "rad"),
            (axes[0, 1], dq, "velocity", "rad/s"),
        ):
            for k, joint in enumerate(found.joints):
                ax.plot(t, values[:, k], color=CYCLE[k % len(CYCLE)], label=joint)
            ax.set_xlabel("time [s]")
            ax.set_ylabel(f"{what} [{found.units.over(unit)}]")
        axes[0, 0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4)
    return figure


def _ratio(rmse: float | None, noise: float | None) -> float:
    return np.nan if rmse is None or not noise else rmse / noise
