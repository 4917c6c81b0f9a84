"""The figures of the paper's study: Figs. 3 to 5, drawn as the paper draws them, and those that it leaves for later."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from elastic_arm.report.style import BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION, new_figure, style
from elastic_arm.studies.paper.comparison import MODELS, PROTOTYPE, SIDES, Metric, ModelComparison
from elastic_arm.studies.paper.identification_study import CoefficientEstimate, ErrorShares, mean_shares
from elastic_arm.studies.paper.study import StudyResult

COLOURS = {"mod1": VERMILION, "mod2": ORANGE, "mod3": BLUE, PROTOTYPE: GREY}
LABELS = {"mod1": "mod$_1$", "mod2": "mod$_2$", "mod3": "mod$_3$", PROTOTYPE: "mod$_{ad}$"}
SYMBOLS = {"motor": "m", "link": "l"}
DASHES = {"mod1": (0, (1, 1)), "mod2": (0, (4, 2)), "mod3": "-", PROTOTYPE: "-"}


def torque_name(side: str, joint: int) -> str:
    """Return the symbol of a torque; `joint` counts from 1."""
    return rf"$\tau_{{{joint}}}^{{{SYMBOLS[side]}}}$"


def torques(comparison: ModelComparison, models: tuple[str, ...], *, differences: bool = False) -> Figure:
    """Draw tau^m and tau^l of models over time (Figs. 3 and 4a)."""
    n = comparison.run.q.shape[1]
    with style():
        figure, axes = new_figure(3 if differences else 2, n, size=(11.0, 6.6 if differences else 4.6), sharex=True)
        for joint in range(n):
            for row, side in enumerate(SIDES):
                _curves(axes[row, joint], comparison, models, side, joint)
            if differences:
                _difference_curves(axes[2, joint], comparison, joint)
            axes[-1, joint].set_xlabel("t [s]")
        axes[0, 0].legend(loc="best")
    return figure


def _curves(ax: Axes, comparison: ModelComparison, models: tuple[str, ...], side: str, joint: int) -> None:
    for model in models:
        width = 2.6 if model == PROTOTYPE else 1.2
        values = comparison.torques[model].side(side)[:, joint]
        ax.plot(comparison.run.t, values, color=COLOURS[model], ls=DASHES[model], lw=width, label=LABELS[model])
    ax.set_title(torque_name(side, joint + 1) + " [Nm]", loc="left")


def _difference_curves(ax: Axes, comparison: ModelComparison, joint: int) -> None:
    for model in ("mod1", "mod2"):
        values = comparison.error(model, "mod3", "motor")[:, joint]
        ax.plot(comparison.run.t, values, color=COLOURS[model], ls=DASHES[model], label=LABELS[model])
    ax.set_title(torque_name("motor", joint + 1) + " less that of mod$_3$ [Nm]", loc="left")


def stacked_metrics(metrics: list[Metric], models: tuple[str, ...], ratios: tuple[float, ...], n: int) -> Figure:
    """Draw e_max (bottom) and e_rmse (top) as stacked bars over r_tot, per side and joint (Figs. 4b and 4c)."""
    table = {(m.side, m.joint, m.r_tot, m.model): m for m in metrics}
    width = 0.8 / len(models)
    with style():
        figure, axes = new_figure(2, n, size=(11.0, 5.0), sharex=True)
        for row, side in enumerate(SIDES):
            for joint in range(1, n + 1):
                ax = axes[row, joint - 1]
                for k, model in enumerate(models):
                    picked = [table[side, joint, r_tot, model] for r_tot in ratios]
                    place = np.arange(len(ratios)) + (k - 0.5 * (len(models) - 1)) * width
                    low, top = np.array([m.e_max for m in picked]), np.array([m.e_rmse for m in picked])
                    ax.bar(place, low, 0.92 * width, color=COLOURS[model])
                    ax.bar(place, top, 0.92 * width, bottom=low, color=COLOURS[model], alpha=0.45)
                ax.set_title(torque_name(side, joint) + " [Nm]", loc="left")
                _keep_zero_flat(ax)
                ax.set_xticks(range(len(ratios)), [f"{r_tot:g}" for r_tot in ratios])
        for ax in axes[-1]:
            ax.set_xlabel("r$_{tot}$")
        handles = [Patch(color=COLOURS[model], label=LABELS[model]) for model in models]
        handles += [
            Patch(color=GREY, label="e$_{max}$ (bottom)"),
            Patch(color=GREY, alpha=0.45, label="e$_{rmse}$ (top)"),
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


def _keep_zero_flat(ax: Axes) -> None:
    """Do not blow rounding errors up to full height."""
    if ax.get_ylim()[1] < 1e-6:
        ax.set_ylim(0.0, 1e-3)


def convergence(result: StudyResult) -> Figure:
    """Draw what step size, coupler stiffness and bushing stiffness leave."""
    labels = {
        "step": ("integration step [s]", "change of $\\tau^m$ from the finest step [Nm]"),
        "coupler": ("natural frequency of the couplers [rad/s]", "$\\tau^m$ less that of exact couplers [Nm]"),
        "bushing": ("bushing stiffness, times the arm's", "mod$_3$ against mod$_{ad}$ [Nm]"),
    }
    with style():
        figure, axes = new_figure(1, 3, size=(11.0, 3.0))
        for ax, (name, (horizontal, title)) in zip(axes[0], labels.items(), strict=True):
            checks = [check for check in result.convergence[name] if np.isfinite(check.setting)]
            settings = [check.setting for check in checks]
            ax.loglog(settings, [check.tau_m for check in checks], "o-", color=BLUE, label=r"$\tau^m$")
            if name == "bushing":
                ax.loglog(settings, [check.tau_l for check in checks], "s-", color=VERMILION, label=r"$\tau^l$")
                ax.legend()
            ax.set_xticks(settings, [f"{setting:g}" for setting in settings])
            ax.set_xticks([], minor=True)
            ax.set_xlabel(horizontal)
            ax.set_title(title, loc="left")
    return figure


def excitation_search(result: StudyResult) -> Figure:
    """Draw each search's course beside the condition numbers of random trajectories."""
    with style():
        figure, axes = new_figure(1, len(MODELS), size=(11.0, 3.2), sharey=True)
        for ax, model in zip(axes[0], MODELS, strict=True):
            excited = result.excited[model]
            evaluations, best = np.array(excited.course).T
            ax.step(evaluations, best, where="post", color=COLOURS[model], label="search")
            ax.axhline(excited.unoptimised, color=GREY, ls="--", label="where it began")
            ax.plot(
                np.full(len(excited.random), 1.02 * evaluations[-1]), excited.random, "_", color=GREY, label="random"
            )
            ax.set_yscale("log")
            ax.set_title(f"{LABELS[model]}: condition number of F", loc="left")
            ax.set_xlabel("evaluations")
        axes[0, 0].legend()
    return figure


def excitation_motion(result: StudyResult, model: str) -> Figure:
    """Draw one period of a searched trajectory."""
    trajectory = result.excited[model].trajectory
    t = np.linspace(0.0, trajectory.period, 500)
    motion = trajectory.evaluate(t + trajectory.ramp)
    with style():
        figure, axes = new_figure(1, 3, size=(11.0, 2.6))
        for ax, values, title in zip(axes[0], motion, ("q [rad]", "dq [rad/s]", "ddq [rad/s²]"), strict=True):
            for joint, name in enumerate(result.robot.joint_names):
                ax.plot(t, values[:, joint], label=name)
            ax.set_title(title, loc="left")
            ax.set_xlabel("t [s]")
        axes[0, 0].legend()
    return figure


_CATEGORIES = (("low", "0–20 %", GREEN), ("mid", "21–50 %", ORANGE), ("high", "51 % and more", VERMILION))


def shares_of(estimates: list[CoefficientEstimate]) -> Figure:
    """Draw Fig. 5: shares of the coefficients per error category, a group a category, a bar a model."""
    with style():
        figure, axes = new_figure(1, 1, size=(6.4, 3.2))
        ax = axes[0, 0]
        for k, estimate in enumerate(estimates):
            values = [getattr(estimate.shares, name) for name, _, _ in _CATEGORIES]
            place = np.arange(3) + 0.27 * (k - 1)
            bars = ax.bar(place, values, 0.25, color=COLOURS[estimate.model], label=LABELS[estimate.model])
            ax.bar_label(bars, fmt="%.1f", fontsize=7)
        ax.set_xticks(range(3), [label for _, label, _ in _CATEGORIES])
        ax.set_ylabel("coefficients [%]")
        ax.set_ylim(0, 110)
        ax.legend()
    return figure


def shares_over(result: StudyResult) -> Figure:
    """Draw the shares over the ratios: without noise, with noise at 10 Hz, with noise at 1 kHz."""
    ratios = sorted({estimate.r_tot for estimate in result.estimates})
    with style():
        figure, axes = new_figure(3, len(MODELS), size=(11.0, 6.2), sharex=True, sharey=True)
        for column, model in enumerate(MODELS):
            picked = [result.estimate(model, r_tot) for r_tot in ratios]
            _share_bars(axes[0, column], [e.shares for e in picked])
            _share_bars(axes[1, column], *_spread([e.noisy_shares for e in picked]))
            _share_bars(axes[2, column], *_spread([e.fast_noisy_shares for e in picked]))
            for ax, what in zip(axes[:, column], ("no noise, 10 Hz", "noise, 10 Hz", "noise, 1 kHz"), strict=True):
                ax.set_title(f"{LABELS[model]}, {what} [%]", loc="left")
            axes[-1, column].set_xticks(range(len(ratios)), [f"{r_tot:g}" for r_tot in ratios])
            axes[-1, column].set_xlabel("r$_{tot}$")
        handles = [Patch(color=colour, label=label) for _, label, colour in _CATEGORIES]
        figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure


def _spread(many: list[tuple[ErrorShares, ...]]) -> tuple[list[ErrorShares], list[ErrorShares]]:
    pairs = [mean_shares(seeds) for seeds in many]
    return [pair[0] for pair in pairs], [pair[1] for pair in pairs]


def _share_bars(ax: Axes, means: list[ErrorShares], spreads: list[ErrorShares] | None = None) -> None:
    bottom = np.zeros(len(means))
    for name, _, colour in _CATEGORIES:
        values = np.array([getattr(share, name) for share in means])
        spread = None if spreads is None else [getattr(share, name) for share in spreads]
        ax.bar(
            np.arange(len(means)), values, 0.7, bottom=bottom, color=colour, yerr=spread, ecolor="#333333", capsize=2
        )
        bottom += values
    ax.set_ylim(0, 115)


def error_sources(estimates: list[CoefficientEstimate]) -> Figure:
    """Draw, per coefficient, the model's own error, what the bushing adds, and the spread under noise."""
    with style():
        figure, axes = new_figure(1, len(estimates), size=(11.0, 4.2), sharey=True)
        for ax, estimate in zip(axes[0], estimates, strict=True):
            order = np.argsort(estimate.torque)[::-1]
            place = np.arange(len(order))
            for values, marker, colour, label in (
                (estimate.model_error, "s", VERMILION, "model (bushing locked)"),
                (estimate.bushing_error, "o", BLUE, "bushing"),
                (estimate.noise_spread, "^", GREY, "noise, 10 Hz (std)"),
                (estimate.fast_noise_spread, "v", PURPLE, "noise, 1 kHz (std)"),
            ):
                ax.semilogy(place, np.maximum(np.abs(values[order]), 1e-4), marker, ms=3.5, color=colour, label=label)
            ax.axhspan(20.5, 50.5, color=ORANGE, alpha=0.15, lw=0)
            ax.axhspan(50.5, 1e5, color=VERMILION, alpha=0.1, lw=0)
            ax.set_ylim(5e-5, 1e5)
            ax.set_title(f"{LABELS[estimate.model]}: error of each coefficient [%]", loc="left")
            ax.set_xlabel("coefficient, by falling torque")
        axes[0, 0].legend(loc="upper left", fontsize=7)
    return figure


def smallness(estimates: list[CoefficientEstimate]) -> Figure:
    """Draw each coefficient's error against the torque it contributes."""
    with style():
        figure, axes = new_figure(1, 2, size=(9.0, 3.2), sharey=True)
        for estimate in estimates:
            for ax, horizontal in zip(axes[0], (estimate.torque, np.abs(estimate.true)), strict=True):
                error = np.maximum(np.abs(estimate.error), 1e-4)
                ax.loglog(horizontal, error, "o", ms=4, color=COLOURS[estimate.model], label=LABELS[estimate.model])
        axes[0, 0].set_xlabel("torque contributed, rms [Nm]")
        axes[0, 1].set_xlabel("true value [SI]")
        axes[0, 0].set_title("error of each coefficient [%]", loc="left")
        axes[0, 0].legend()
    return figure


def tracking(result: StudyResult) -> Figure:
    """Draw the tool's error under feed-forward, per ratio; no model at all is left to the table."""
    ratios = sorted({t.r_tot for t in result.tracking})
    with style():
        figure, axes = new_figure(1, len(ratios), size=(5.2 * len(ratios), 3.2))
        for ax, r_tot in zip(axes[0], ratios, strict=True):
            picked = [t for t in result.tracking if t.r_tot == r_tot and t.feedforward != "none"]
            colours = [COLOURS.get(t.feedforward.removeprefix("identified "), GREY) for t in picked]
            place = np.arange(len(picked))
            for shift, values, alpha in (
                (-0.2, [t.tool_rms for t in picked], 1.0),
                (0.2, [t.joints_rms for t in picked], 0.45),
            ):
                ax.bar_label(ax.bar(place + shift, values, 0.38, color=colours, alpha=alpha), fmt="%.4f", fontsize=7)
            ax.set_xticks(place, [t.feedforward.replace(" ", "\n") for t in picked])
            ax.set_title(f"tool error, rms [mm], r$_{{tot}}$ = {r_tot:g}", loc="left")
            ax.margins(y=0.15)
        handles = [
            Patch(color=GREY, label="whole"),
            Patch(color=GREY, alpha=0.45, label="the joints' part, without tilt"),
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=2)
    return figure
