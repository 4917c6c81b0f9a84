"""Sections of the paper's report on identification: excitation, Fig. 5 and beyond, and what a better model buys."""

from __future__ import annotations

import numpy as np

from elastic_arm.report.html import Figure, Section, Table, Text
from elastic_arm.studies.paper.comparison import MODELS
from elastic_arm.studies.paper.identification_study import CoefficientEstimate, mean_shares, shares
from elastic_arm.studies.paper.report import figures as draw
from elastic_arm.studies.paper.study import FEEDBACK_FREQUENCY, StudyResult

PAPER_SHARES = {"mod1": (29.69, None, 62.5), "mod2": (60.53, 13.16, 26.32), "mod3": (68.42, None, 21.0)}
PAPER_COUNTS = {"mod1": 65, "mod2": 75, "mod3": 75}


def excitation(result: StudyResult) -> Section:
    """The searches."""
    rows = []
    for model in MODELS:
        e = result.excited[model]
        rows.append(
            (model, e.evaluations, e.unoptimised, float(np.median(e.random)), float(e.random.min()), e.condition)
        )
    return Section(
        "Excitation",
        [
            Figure(
                draw.excitation_search(result),
                "Course of the pattern search for each model's own regressor; dashes at the right: random "
                "trajectories within the same limits.",
            ),
            Table(
                ("model", "evaluations", "start of the search", "random, median", "random, best", "found"),
                rows,
                caption="Condition number of the base regressor F of (12), columns equilibrated",
            ),
            Figure(draw.excitation_motion(result, "mod3"), "One period of the trajectory found for mod3."),
            Text("Each model's trajectory was searched at the highest ratio and serves at all ratios."),
        ],
    )


def figure_5(result: StudyResult) -> Section:
    """Fig. 5 and every coefficient."""
    found = [result.estimate(m) for m in MODELS]
    rows: list[tuple[str | int | float | None, ...]] = []
    for e in found:
        kinds = [("here", e.error), ("merged", e.merged_error)]
        if e.unfolded_error is not None:
            kinds.append(("unfolded", e.unfolded_error))
        for what, error in kinds:
            split = shares(error)
            rows.append((e.model, what, e.estimable, len(error), split.low, split.mid, split.high, split.beyond))
        rows.append((e.model, "paper", PAPER_COUNTS[e.model], None, *PAPER_SHARES[e.model], None))
    return Section(
        "Fig. 5: errors of the identified coefficients",
        [
            Figure(draw.shares_of(found), f"r_tot = {result.highest:g}, 100 samples at 10 Hz, no noise, (11) to (13)."),
            Table(
                (
                    "model",
                    "",
                    "parameters",
                    "coefficients",
                    "0–20 %",
                    "21–50 %",
                    "51 % and more",
                    "of which beyond 100 %",
                ),
                rows,
                caption="'merged': coefficients that this motion does not tell apart (columns dependent to 1e-4) are "
                "one; 'unfolded': mod1 against a true Psi without the splines that it counts with the links",
                digits=4,
            ),
            Figure(
                draw.smallness(found),
                "Left: error against the torque that a coefficient contributes; right: against its true value.",
            ),
            *(_coefficient_table(e) for e in found),
        ],
    )


def _coefficient_table(e: CoefficientEstimate) -> Table:
    columns = (
        e.true,
        e.estimate,
        e.error,
        e.model_error,
        e.bushing_error,
        e.noise_spread,
        e.fast_noise_spread,
        e.torque,
    )
    rows = [(name, *(float(column[k]) for column in columns)) for k, name in enumerate(e.names)]
    header = (
        "coefficient",
        "true",
        "identified",
        "error [%]",
        "model [%]",
        "bushing [%]",
        "noise 10 Hz [%]",
        "noise 1 kHz [%]",
        "torque [Nm]",
    )
    return Table(header, rows, caption=f"{e.model} at r_tot = {e.r_tot:g}", digits=3)


def noise(result: StudyResult) -> Section:
    """Noise, 1 kHz, and the errors apart."""
    found = [result.estimate(m) for m in MODELS]
    rows: list[tuple[str | int | float | None, ...]] = []
    for e in found:
        kinds = (("10 Hz", e.noisy_shares), ("10 Hz, merged", e.merged_noisy_shares), ("1 kHz", e.fast_noisy_shares))
        for what, many in kinds:
            mean, spread = mean_shares(many)
            categories = ("low", "mid", "high", "beyond")
            written = (f"{getattr(mean, c):.1f} ± {getattr(spread, c):.1f}" for c in categories)
            rows.append((e.model, what, len(many), *written))
    noise = result.robot.torque_noise_std
    return Section(
        "Noise, sample rate, and where errors come from",
        [
            Figure(
                draw.error_sources(found),
                "Per coefficient: the model's own error (prototype with locked bushings), what the bushing adds, and "
                f"the standard deviation under torque noise of {noise} Nm at 10 Hz and at 1 kHz. Bands: the paper's "
                "mid and high.",
            ),
            Table(
                ("model", "samples", "seeds", "0–20 %", "21–50 %", "51 % and more", "of which beyond 100 %"),
                rows,
                caption=f"Shares with torque noise of {noise} Nm, mean ± standard deviation over seeds, r_tot = "
                f"{result.highest:g}",
            ),
        ],
    )


def ratios(result: StudyResult) -> Section:
    """Identification at every ratio."""
    return Section(
        "Identification over the ratios",
        [
            Figure(
                draw.shares_over(result), "Shares per model and r_tot; whiskers: standard deviation over noise seeds."
            )
        ],
    )


def individual(result: StudyResult) -> Section:
    """Individual parameters."""
    rows = []
    for e in result.estimates:
        error, guess = e.individual.error, e.individual.guess
        split = shares(error)
        medians = float(np.median(error)), float(np.median(guess))
        rows.append((e.model, e.r_tot, len(error), *medians, split.low, split.mid, split.high))
    return Section(
        "Individual parameters under physical consistency",
        [
            Text(
                "Single masses, centres of mass, inertias, stiffnesses and dampings, drawn toward a wrong "
                "description (each body scaled at random) only as far as the data leave them open, and kept "
                "physically possible. What the data do not determine stays as wrong as that description."
            ),
            Table(
                (
                    "model",
                    "r_tot",
                    "parameters",
                    "median error [%]",
                    "of the description [%]",
                    "0–20 %",
                    "21–50 %",
                    "51 % and more",
                ),
                rows,
            ),
        ],
    )


def tracking(result: StudyResult) -> Section:
    """Feed-forward."""
    rows = [
        (t.feedforward, t.r_tot, t.tool_rms, t.tool_max, t.joints_rms, t.angle_rms, t.feedback_rms)
        for t in result.tracking
    ]
    return Section(
        "What does a better model buy?",
        [
            Figure(draw.tracking(result), "Tool error of the prototype under feed-forward of each identified model."),
            Table(
                (
                    "feed-forward",
                    "r_tot",
                    "tool, rms [mm]",
                    "tool, largest [mm]",
                    "joints' part, rms [mm]",
                    "q, rms [mrad]",
                    "feedback torque, rms [Nm]",
                ),
                rows,
                caption=f"Motions that no identification saw, feedback of natural frequency {FEEDBACK_FREQUENCY:g} "
                "rad/s on the motor side; 'true mod3' has the description's numbers: what is left is the "
                "bearings' tilt, in no model here",
            ),
        ],
    )
