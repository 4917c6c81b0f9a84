"""The report of the demonstration."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure as MplFigure
from scipy.stats import chi2

from elastic_arm.excitation import ExcitationResult
from elastic_arm.formatting import rounded
from elastic_arm.identification import Identification, chi_square
from elastic_arm.recording import Samples
from elastic_arm.report import excitation
from elastic_arm.report.html import Figure, Section, Table, Text, Written, write_report
from elastic_arm.report.style import BLUE, GREY, VERMILION, draw_signal, label_joints, new_figure, style


def write(
    path: Path,
    search: ExcitationResult,
    course: Sequence[dict[str, Any]],
    offline: Identification,
    truth: np.ndarray,
    samples: Samples,
) -> Path:
    """Write the demonstration's report; `truth` (B,) are the true base parameters, `course` the online estimates."""
    off = np.abs(offline.Psi_base - truth) / offline.std
    together, limit = chi_square(offline, truth), float(chi2.ppf(0.95, len(truth)))
    verdict = (
        f"{offline.samples} samples from the bag determine {len(truth)} base parameters; the true value lies within "
        f"two standard deviations for {int((off < 2).sum())} of them. Errors go together, as one torque scale is "
        f"common to all: taken together, chi² is {together:.0f}, and 95 % of fits stay below {limit:.0f}."
    )
    rows = [
        [
            e.name,
            e.unit.replace("^2", "²"),
            e.nominal,
            float(true),
            *map(Written, rounded(e.value, e.std)),
            float((e.value - true) / e.std),
            e.verdict,
        ]
        for e, true in zip(offline.estimates, truth, strict=True)
    ]
    header = ["base parameter", "unit", "nominal", "true", "identified", "std", "error / std", "determined"]
    sections = [
        Section(
            "Result",
            [
                Text(verdict, "good" if together < limit else "warn"),
                Figure(
                    errors_in_std(offline, course[-1], truth),
                    "Error of every estimate, in its own standard deviations.",
                ),
                Table(header, rows, "The simulated arm differs from its nominal description by up to 15 % everywhere."),
            ],
        ),
        Section(
            "While the arm moved", [Figure(convergence(course, truth, offline), "Online estimates as samples arrive.")]
        ),
        Section("What was recorded", [Figure(recorded(samples, offline.joints), "Both sides of every joint.")]),
        Section(
            "Excitation",
            [
                Figure(excitation.search_course(search), "Course of the pattern search."),
                Figure(excitation.condition_against_random(search), "Random motions and the optimised one."),
            ],
        ),
    ]
    return write_report(path, "The live arm", sections, subtitle=f"{offline.robot}, {offline.model}")


def errors_in_std(offline: Identification, online: dict[str, Any], truth: np.ndarray) -> MplFigure:
    """Draw (estimate - true) / std of every base parameter, online and offline."""
    place = {name: k for k, name in enumerate(online["name"])}
    order = [place[e.name] for e in offline.estimates]
    values, stds = (np.array(online[key], dtype=float)[order] for key in ("value", "std"))
    with style():
        figure, axes = new_figure(size=(9.0, 3.0))
        ax, k = axes[0, 0], np.arange(len(truth))
        ax.axhspan(-2, 2, color=GREY, alpha=0.15, lw=0)
        ax.plot(k - 0.12, (values - truth) / stds, "o", color=VERMILION, ms=4, label="online")
        ax.plot(k + 0.12, (offline.Psi_base - truth) / offline.std, "o", color=BLUE, ms=4, label="offline")
        ax.set(xlabel="base parameter, in the order of the table", ylabel="error / std", xlim=(-1, len(truth)))
        ax.legend(ncols=2)
    return figure


def convergence(course: Sequence[dict[str, Any]], truth: np.ndarray, offline: Identification) -> MplFigure:
    """Draw residual RMS, condition number and the errors' size against the samples used."""
    names = [e.name for e in offline.estimates]
    samples = np.array([line["samples"] for line in course])
    errors = np.array(
        [[dict(zip(line["name"], line["value"], strict=True))[name] for name in names] for line in course], dtype=float
    )
    relative = np.abs(errors - truth) / np.maximum(np.abs(truth), 1e-9)
    with style():
        figure, axes = new_figure(1, 3, size=(11.0, 2.8))
        axes[0, 0].plot(samples, [line["residual_rms"] for line in course], ".-")
        axes[0, 0].set_ylabel("residual RMS, Nm")
        axes[0, 1].semilogy(samples, [line["condition_number"] or np.nan for line in course], ".-")
        axes[0, 1].set_ylabel("condition number")
        axes[0, 2].semilogy(samples, np.median(relative, axis=1), ".-", label="median")
        axes[0, 2].semilogy(samples, relative.max(axis=1), ".-", color=VERMILION, label="worst")
        axes[0, 2].set_ylabel("relative error")
        axes[0, 2].legend()
        for ax in axes[0]:
            ax.set_xlabel("samples used")
    return figure


def recorded(samples: Samples, joints: Sequence[str]) -> MplFigure:
    """Draw angles, deflections and torques of every joint."""
    with style():
        figure, axes = new_figure(3, len(joints), size=(3.6 * len(joints), 6.0), sharex=True)
        label_joints(axes[0], joints)
        for i in range(len(joints)):
            if samples.q is not None:
                draw_signal(axes[0, i], samples.t, samples.q[:, i], color=BLUE, label="q")
            if samples.q is not None and samples.theta is not None:
                draw_signal(axes[1, i], samples.t, 1e3 * (samples.theta - samples.q)[:, i], color=BLUE)
            for values, colour, name in ((samples.tau_m, VERMILION, "tau_m"), (samples.tau_J, BLUE, "tau_J")):
                if values is not None:
                    draw_signal(axes[2, i], samples.t, values[:, i], color=colour, label=name, lw=0.8)
            axes[2, i].set_xlabel("t, s")
        for row, text in enumerate(("q, rad", "theta − q, mrad", "torque, Nm")):
            axes[row, 0].set_ylabel(text)
        axes[2, -1].legend(ncols=2)
    return figure
