"""The report of the study: claims first, then one function per figure, with method and numbers."""

import math
from collections import Counter
from dataclasses import astuple
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import sympy
from matplotlib.figure import Figure as MplFigure
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.axes3d import Axes3D

from elastic_arm.arrays import Array, rms
from elastic_arm.dynamics import build_model
from elastic_arm.report.html import Block, Figure, Section, Table, Text, write_report
from elastic_arm.report.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    drawing,
    style,
)
from elastic_arm.robot.description import DH, Robot
from elastic_arm.robot.kinematics import link_placements
from elastic_arm.studies.paper.claims import FAILS, HOLDS, IN_PART, UNDECIDED, Claim
from elastic_arm.studies.paper.coupling import linearized
from elastic_arm.studies.paper.identification_study import SHAPE, mean_shares, shares
from elastic_arm.studies.paper.study import FEEDBACK_FREQUENCY, StudyResult
from elastic_arm.studies.paper.torques import (
    MODELS,
    PROTOTYPE,
    SIDES,
    ModelComparison,
    TorqueErrors,
)
from elastic_arm.studies.paper.virtual_prototype.mechanism import Bushing, transmissions

MARKS = {HOLDS: "✓", IN_PART: "◐", FAILS: "✗", UNDECIDED: "?"}
COLOURS = {"mod1": VERMILION, "mod2": ORANGE, "mod3": BLUE, PROTOTYPE: GREY}
LABELS = {"mod1": "mod$_1$", "mod2": "mod$_2$", "mod3": "mod$_3$", PROTOTYPE: "mod$_{ad}$"}
SYMBOLS = {"motor": "m", "link": "l"}
DASHES: dict[str, Any] = {"mod1": (0, (1, 1)), "mod2": (0, (4, 2)), "mod3": "-", PROTOTYPE: "-"}
CATEGORIES = (
    ("low", "0–20 %", GREEN),
    ("mid", "21–50 %", ORANGE),
    ("high", "51 % and more", VERMILION),
)
NAMES = (*(label for _, label, _ in CATEGORIES), "of which beyond 100 %")
PAPER_SHARES = {
    "mod1": (29.69, None, 62.5),
    "mod2": (60.53, 13.16, 26.32),
    "mod3": (68.42, None, 21.0),
}
PAPER_COUNTS = {"mod1": 65, "mod2": 75, "mod3": 75}
# Colour and size of the marks: a spline sits in its wave generator's place.
PARTS = {"rotor": (ORANGE, 60), "wave_generator": (PURPLE, 60), "spline": (SKY, 16)}
# rad, of Fig. 1: at the zero pose the links hide each other; joints beyond these stay at zero
POSE = (0.0, 0.4, -0.5)
FRAME = 0.16  # m, length of a frame's arrows
Row = tuple[str | int | float | None, ...]


def write_paper_report(result: StudyResult, claims: list[Claim], path: Path) -> Path:
    """Write the study as one self-contained HTML file."""
    found = [_summary(result, claims), *(section(result) for section in SECTIONS), READINGS]
    subtitle = (
        f"Three models of {result.robot.name} against a virtual prototype in {result.engine}, over"
        f" r_tot = {', '.join(f'{r:g}' for r in result.ratios)}"
    )
    return write_report(path, "The paper, reproduced", found, subtitle=subtitle)


def _summary(result: StudyResult, claims: list[Claim]) -> Section:
    counts = Counter(claim.verdict for claim in claims)
    chosen = [claim for claim in claims if claim.by_choice]
    blocks: list[Block] = [
        Text(
            f"Of {len(claims)} claims of the paper, with our numbers, {counts[HOLDS]}"
            f" hold, {counts[IN_PART]} hold in part, {counts[FAILS]} do not hold, and"
            f" {counts[UNDECIDED]} are undecided because of the noise of the study (seeds"
            " of noise, searches and guesses).",
            "good" if not counts[FAILS] + counts[UNDECIDED] else "warn",
        ),
        Text(
            "The paper gives no inertial or stiffness values. The values of the nominal"
            " arm file are our own, typical of catalogue parts. Three of them were chosen"
            " to match the paper: the total mass of 139 kg, a circular spline of joint 1"
            " with ten times the inertia of joint 2's flex spline, and a motor-torque"
            f" error of joint 1 below 0.5 Nm (S_11 = {_entry(result, 0, 0):.3g} kg m^2,"
            f" S_23 = {_entry(result, 1, 2):.3g} kg m^2 at r_tot = {result.highest:g})."
            f" {len(chosen)} claims depend on these choices and are marked *: that they"
            " hold for this arm is no evidence for the paper."
        ),
        Table(
            ("section", "claim of the paper", "evidence in this study", "verdict"),
            [_claim_row(claim) for claim in claims],
            caption="* depends on a number that was chosen to match the paper",
        ),
    ]
    return Section("Claims", blocks)


def _claim_row(claim: Claim) -> tuple[str, str, str, str]:
    """Return the row of a claim in the summary."""
    verdict = f"{MARKS[claim.verdict]} {claim.verdict}"
    if not claim.by_choice:
        return claim.section, claim.claim, claim.finding, verdict
    finding = f"{claim.finding}. * {claim.by_choice.capitalize()}."
    return claim.section, claim.claim, finding, f"{verdict} *"


def _entry(result: StudyResult, row: int, column: int) -> float:
    """Return an entry of S at the highest ratio, zero where the arm has fewer joints."""
    robot = result.robot.with_ratio(result.highest)
    if max(row, column) >= robot.n:
        return 0.0
    pose = np.zeros((1, 2 * robot.n))
    return float(build_model(robot, "mod3").terms(pose, pose)["S"][0, row, column])


def figures_1_and_2(result: StudyResult) -> Section:
    """Figs. 1, 2 and Table I: the arm with its transmissions, and its frames."""
    robot = result.robot
    pose = np.zeros(robot.n)
    pose[: len(POSE)] = POSE[: robot.n]
    with style():
        figure = MplFigure(figsize=(11.0, 5.4), layout="constrained")
        turned: Axes3D = figure.add_subplot(1, 2, 1, projection="3d")
        joints = _arm(turned, robot, pose)
        for k, drive in enumerate(transmissions(robot)):
            for name, (colour, size) in PARTS.items():
                at = joints[k] @ np.append(getattr(drive, name).position, 1.0)
                label = name.replace("_", " ") if k == 0 else None
                turned.scatter(*at[:3], color=colour, s=size, label=label, depthshade=False)
        turned.legend(loc="upper left", fontsize=7)
        flat: Axes3D = figure.add_subplot(1, 2, 2, projection="3d")
        _arm(flat, robot, np.zeros(robot.n))
        _, links = link_placements(robot, np.zeros(robot.n))
        frames = [np.eye(4), robot.base_placement @ robot.joints[0].before, *links[0]]
        for name, frame in zip(("G", *map(str, range(robot.n + 1))), frames, strict=True):
            for k, colour in enumerate((VERMILION, GREEN, BLUE)):
                flat.quiver(
                    *frame[:3, 3],
                    *(FRAME * frame[:3, k]),
                    color=colour,
                    lw=1.4,
                    arrow_length_ratio=0.25,
                )
            flat.text(
                *(frame[:3, 3] - 0.4 * FRAME * frame[:3, :3].sum(axis=1)),
                rf"$O_{{{name}}}$",
                fontsize=9,
            )
    of_drives = []
    for k, drive in enumerate(transmissions(robot), 1):
        parts = drive.components.items()
        on = [f"{name.replace('_', ' ')} on {part.carrier}" for name, (part, _) in parts]
        of_drives.append(f"{k}: {', '.join(on)}")
    carriers = "; ".join(of_drives)
    rows = [
        (name, row.a, row.d, f"{math.degrees(row.alpha):g}°", _turned(k, row))
        for k, (name, row) in enumerate(table_i(robot))
    ]
    caption = (
        "Left, Fig. 1: the arm in a pose other than zero, and its transmissions by"
        " joint; the rotor drives them through a belt (r_b) and a harmonic drive"
        f" (r_hd): {carriers}. Right, Fig. 2: the frames of (2) and (3) at the zero"
        " pose: O_G on the ground, O_0 at joint 1, O_i at the far end of link i; x"
        " red, y green, z blue."
    )
    table = Table(
        ("frame", "a_i [m]", "d_i [m]", "alpha_i", "theta_i"),
        rows,
        caption="Table I, from the arm file",
    )
    return Section("Figs. 1 and 2, Table I: the arm", [Figure(figure, caption), table])


def table_i(robot: Robot) -> list[tuple[str, DH]]:
    """Return the Denavit-Hartenberg rows of the description: O_0 and each joint."""
    rows = [robot.base_dh, *(joint.dh for joint in robot.joints)]
    return [(f"O_{k}", row) for k, row in enumerate(rows) if row is not None]


def _turned(k: int, row: DH) -> str:
    offset = f"{math.degrees(row.offset):g}°"
    if k == 0:
        return offset
    return f"theta_{k}" if row.offset == 0.0 else f"theta_{k} + {offset}"


def _arm(ax: Axes3D, robot: Robot, pose: Array) -> Array:
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
    low = np.min(corners, axis=0) - 0.2
    high = np.max(corners, axis=0) + 0.2
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set_box_aspect(high - low, zoom=0.95)  # with more its labels are cut off
    ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    ax.locator_params(nbins=4)
    ax.tick_params(labelsize=7)
    ax.view_init(elev=14.0, azim=-70.0)
    return joints


def prototype(result: StudyResult) -> Section:
    """What the models are compared with."""
    words = (
        f"Links, rotors, wave generators and splines are bodies of a {result.engine}"
        " model, which shares no dynamics code with mod1 to mod3. A bushing of six"
        " springs and dampers connects the link to its spline, with"
        f" {Bushing().translation_stiffness:.0e} N/m in translation. Rotors, wave"
        " generators and splines follow exact ratios: the engine's mass matrix and"
        " bias forces are projected on theta and the bushings, the bushings are"
        " integrated (Runge-Kutta, fourth order), and the torque at the harmonic-drive"
        " output follows. tau^l of a model is the residual of its first row on the"
        " prototype's motion. With locked bushings, mod3 leaves"
        f" {result.locked_link:.1g} Nm of it."
    )
    return Section("The virtual prototype mod_ad", [Text(words)])


def figure_4a(result: StudyResult) -> Section:
    """Fig. 4a."""
    caption = (
        "The same motion. In tau^m the models are visually indistinguishable (third"
        " row: their differences); in tau^l mod1 and mod2 leave the part that S would"
        " explain."
    )
    return Section(
        "Fig. 4a: the three models", [Figure(_torques(result.at_highest(), MODELS), caption)]
    )


def _torques(comparison: ModelComparison, models: tuple[str, ...]) -> MplFigure:
    """Draw tau^m and tau^l of models over time; of several models the differences of tau^m from
    that of mod3, too."""
    n = comparison.run.q.shape[1]
    several = PROTOTYPE not in models
    with drawing(2 + several, n, size=(11.0, 4.6 + 2.0 * several), sharex=True) as (figure, axes):
        for joint in range(n):
            for row, side in enumerate((*SIDES, "motor")[: 2 + several]):
                for model in models if row < 2 else ("mod1", "mod2"):
                    values = (
                        comparison.torques[model].side(side)
                        if row < 2
                        else comparison.error(model, "mod3", side)
                    )
                    width = 2.6 if model == PROTOTYPE else 1.2
                    drawn = {
                        "color": COLOURS[model],
                        "ls": DASHES[model],
                        "lw": width,
                        "label": LABELS[model],
                    }
                    axes[row, joint].plot(comparison.run.t, values[:, joint], **drawn)
                less = "" if row < 2 else " less that of mod$_3$"
                axes[row, joint].set_title(
                    f"{_torque_name(side, joint + 1)}{less} [Nm]", loc="left"
                )
            axes[-1, joint].set_xlabel("t [s]")
        axes[0, 0].legend(loc="best")
    return figure


def figure_4c(result: StudyResult) -> Section:
    """Fig. 4c and its numbers."""
    n = result.robot.n
    joints = [f"joint {j + 1} [Nm]" for j in range(n)]
    smooth = {(m, s): rms(result.smooth.error(m, PROTOTYPE, s)) for s in SIDES for m in MODELS}
    translations = [
        (f"{each.stiffness:.0e}", model, *map(float, each.e_max[k]), *map(float, each.e_rmse[k]))
        for each in result.translations
        for k, model in enumerate(MODELS)
    ]
    return Section(
        "Fig. 4c: all three with respect to mod_ad",
        [
            Figure(
                _stacked_errors(result.against_prototype, MODELS),
                "Stacked as in the paper: e_max below, e_rmse above. The part of tau^l that"
                " no model explains is the vibration of the bearings.",
            ),
            Table(
                ("model", "side", *joints),
                [(m, s, *map(float, values)) for (m, s), values in smooth.items()],
                "e_rmse on a ramp without jumps of acceleration (quintic), which excites"
                " little vibration, at the highest ratio",
                3,
            ),
            _error_table(result.against_prototype),
            Table(
                (
                    "K_t [N/m]",
                    "model",
                    *(f"{what}, {joint}" for what in ("e_max", "e_rmse") for joint in joints),
                ),
                translations,
                "tau^l relative to mod_ad at the highest ratio, for several translational"
                " stiffnesses of the bushing, which the paper does not state: they determine"
                " which model is best by e_max at a joint",
                3,
            ),
        ],
    )


def figure_3(result: StudyResult) -> Section:
    """Fig. 3."""
    return Section(
        "Fig. 3: mod3 against the prototype",
        [
            Figure(
                _torques(result.at_highest(), (PROTOTYPE, "mod3")),
                "Step ramp of 0.1 rad in 1 s (cubic), all joints at once from the zero pose,"
                f" r_tot = {result.highest:g}. As in the paper, tau^m of mod3 coincides with"
                " that of mod_ad, and tau^l of mod3 is not zero: the bearings tilt and vibrate"
                " after the jumps of the ramp's acceleration. Samples at 1 kHz; at the two"
                " jumps the sample is the limit from before the jump, because the bushings"
                " have not yet responded half a millisecond after it.",
            )
        ],
    )


def _torque_name(side: str, joint: int) -> str:
    """Return the symbol of a torque; `joint` counts from 1."""
    return rf"$\tau_{{{joint}}}^{{{SYMBOLS[side]}}}$"


def figure_4b(result: StudyResult) -> Section:
    """Fig. 4b and its numbers."""
    return Section(
        "Fig. 4b: mod1 and mod2 with respect to mod3",
        [
            Figure(
                _stacked_errors(result.against_mod3, ("mod1", "mod2")),
                "Stacked as in the paper: e_max below, e_rmse above.",
            ),
            _error_table(result.against_mod3),
        ],
    )


def _error_table(errors: TorqueErrors) -> Table:
    """A row a torque and model, a pair of columns a ratio."""
    rows: list[Row] = []
    for side in SIDES:
        models = [model for its_side, model in errors.e_max if its_side == side]
        for joint, model in product(range(errors.e_max[side, models[0]].shape[1]), models):
            pairs = [table[side, model][:, joint] for table in (errors.e_max, errors.e_rmse)]
            values = np.column_stack(pairs).ravel().tolist()
            rows.append((f"tau_{joint + 1}^{SYMBOLS[side]}", model, *values))
    heads = [f"{what}, {r_tot:g}" for r_tot in errors.ratios for what in ("e_max", "e_rmse")]
    return Table(["torque", "model", *heads], rows, caption="Nm, by r_tot", digits=3)


def _stacked_errors(errors: TorqueErrors, models: tuple[str, ...]) -> MplFigure:
    """Draw e_max (bottom) and e_rmse (top) as stacked bars over r_tot, per side and joint (Figs. 4b
    and 4c)."""
    n = errors.e_max[SIDES[0], models[0]].shape[1]
    width = 0.8 / len(models)
    with drawing(2, n, size=(11.0, 5.0), sharex=True) as (figure, axes):
        for (row, side), joint in product(enumerate(SIDES), range(n)):
            ax = axes[row, joint]
            for k, model in enumerate(models):
                place = np.arange(len(errors.ratios)) + (k - 0.5 * (len(models) - 1)) * width
                low = errors.e_max[side, model][:, joint]
                top = errors.e_rmse[side, model][:, joint]
                ax.bar(place, low, 0.92 * width, color=COLOURS[model])
                ax.bar(place, top, 0.92 * width, bottom=low, color=COLOURS[model], alpha=0.45)
            ax.set_title(_torque_name(side, joint + 1) + " [Nm]", loc="left")
            if ax.get_ylim()[1] < 1e-6:  # rounding errors are not blown up to full height
                ax.set_ylim(0.0, 1e-3)
            ax.set_xticks(range(len(errors.ratios)), [f"{r_tot:g}" for r_tot in errors.ratios])
        for ax in axes[-1]:
            ax.set_xlabel("r$_{tot}$")
        handles = [Patch(color=COLOURS[model], label=LABELS[model]) for model in models]
        handles += [
            Patch(color=GREY, label="e$_{max}$ (bottom)"),
            Patch(color=GREY, alpha=0.45, label="e$_{rmse}$ (top)"),
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


def coupling(result: StudyResult) -> Section:
    """S in symbols, and what tau^m is made of."""
    flat = result.coupling
    tilted = result.tilted_coupling
    n = result.robot.n
    terms = []
    rows = []
    for i in range(n):
        names = []
        for j in range(n):
            name = "0"
            if flat.matrix[i, j] != 0:
                name = f"S_{i + 1},{j + 1}"
                terms.append((name, _text(flat.matrix[i, j])))
            names.append(name)
        rows.append(f"[{', '.join(names)}]")
    pattern = "; ".join(rows)
    sigma = [
        (tilted.rows[i], j + 1, _text(entry), _text(linearized(entry)))
        for i in range(tilted.sigma.shape[0])
        for j in range(tilted.sigma.shape[1])
        if (entry := tilted.sigma[i, j]) != 0
    ]
    values = [(name, *(float(v) for v in column)) for name, column in result.inertial.items()]
    return Section(
        "The coupling S",
        [
            Text(
                f"With locked bearings, S = {pattern}, derived symbolically by the recursion"
                " that also gives the numbers."
            ),
            Table(("entry", "terms as in (9)"), terms, caption="Bearings locked"),
            Table(
                ("row", "motor", "sigma(q)", "to first order in the tilts"),
                sigma,
                caption=(
                    "With bearing tilts q_ix, q_iy: S_row,motor = (sum of I_zz times ratio of that"
                    " motor's spinning bodies) times sigma; entries not listed are zero"
                ),
            ),
            Table(
                ("part of tau^m", *(f"joint {j + 1} [Nm]" for j in range(n))),
                values,
                caption="Contributions to tau^m of the step ramp at the highest ratio, rms",
            ),
        ],
    )


def _text(expression: sympy.Expr) -> str:
    """Write an expression on one line, with the symbols of the paper."""
    return str(expression).replace("**", "^").replace("*", " ")


def _shares_of(estimates: list[Any]) -> MplFigure:
    """Draw Fig. 5: shares of the coefficients per error category, a group a category, a bar a
    model."""
    with drawing(1, 1, size=(6.4, 3.2)) as (figure, axes):
        ax = axes[0, 0]
        for k, estimate in enumerate(estimates):
            values = [getattr(estimate.shares, name) for name, _, _ in CATEGORIES]
            place = np.arange(3) + 0.27 * (k - 1)
            bars = ax.bar(
                place, values, 0.25, color=COLOURS[estimate.model], label=LABELS[estimate.model]
            )
            ax.bar_label(bars, fmt="%.1f", fontsize=7)
        ax.set_xticks(range(3), [label for _, label, _ in CATEGORIES])
        ax.set_ylabel("coefficients [%]")
        ax.set_ylim(0, 110)
        ax.legend()
    return figure


def _error_sources(estimates: list[Any]) -> MplFigure:
    """Draw, per coefficient, the model's own error, what the bushing adds, and the spread under
    noise."""
    with drawing(1, len(estimates), size=(11.0, 4.2), sharey=True) as (figure, axes):
        for ax, estimate in zip(axes[0], estimates, strict=True):
            order = np.argsort(estimate.torque)[::-1]
            place = np.arange(len(order))
            for values, marker, colour, label in (
                (estimate.model_error, "s", VERMILION, "model (bushing locked)"),
                (estimate.bushing_error, "o", BLUE, "bushing"),
                (estimate.noise_spread, "^", GREY, "noise, 10 Hz (std)"),
                (estimate.fast_noise_spread, "v", PURPLE, "noise, 1 kHz (std)"),
            ):
                ax.semilogy(
                    place,
                    np.maximum(np.abs(values[order]), 1e-4),
                    marker,
                    ms=3.5,
                    color=colour,
                    label=label,
                )
            ax.axhspan(20.5, 50.5, color=ORANGE, alpha=0.15, lw=0)
            ax.axhspan(50.5, 1e5, color=VERMILION, alpha=0.1, lw=0)
            ax.set_ylim(5e-5, 1e5)
            ax.set_title(f"{LABELS[estimate.model]}: error of each coefficient [%]", loc="left")
            ax.set_xlabel("coefficient, by falling torque")
        axes[0, 0].legend(loc="upper left", fontsize=7)
    return figure


def excitation(result: StudyResult) -> Section:
    """The searches of each model's trajectory, at the highest ratio."""
    rows: list[Row] = [
        (
            m,
            e.evaluations,
            e.condition_before,
            float(np.median(e.random)),
            float(e.random.min()),
            e.condition_after,
        )
        for m, e in result.excited.items()
    ]
    header = (
        "model",
        "evaluations",
        "start of the search",
        "random, median",
        "random, best",
        "found",
    )
    caption = (
        "Condition number of the base regressor F of (12), columns equilibrated; one search serves"
        " all ratios"
    )
    return Section("Excitation", [Table(header, rows, caption)])


def figure_5(result: StudyResult) -> Section:
    """Fig. 5, with noise, and at the other ratios."""
    found = [result.estimate(m) for m in MODELS]
    rows: list[Row] = []
    for e in result.estimates:
        kinds = [("no noise", e.error), ("merged", e.merged_error)]
        kinds += [] if e.unfolded_error is None else [("unfolded", e.unfolded_error)]
        for what, error in kinds:
            rows.append((e.model, e.r_tot, what, len(error), *astuple(shares(error))))
        noisy = (
            ("10 Hz", e.noisy_shares),
            ("10 Hz, merged", e.merged_noisy_shares),
            ("1 kHz", e.fast_noisy_shares),
        )
        for what, many in noisy:
            pairs = zip(*map(astuple, mean_shares(many)), strict=True)
            rows.append(
                (
                    e.model,
                    e.r_tot,
                    f"noise, {what}",
                    None,
                    *(f"{mean:.1f} ± {std:.1f}" for mean, std in pairs),
                )
            )
    rows += [
        (m, None, f"paper, of {PAPER_COUNTS[m]}", None, *PAPER_SHARES[m], None) for m in MODELS
    ]
    caption = (
        "'merged': coefficients that this motion does not separate (columns dependent"
        " to 1e-4) are merged; 'unfolded': mod1 relative to a true Psi without the"
        " splines, which it counts with the links; mean ± standard deviation over"
        f" seeds of torque noise of {result.robot.torque_noise_std} Nm"
    )
    shown = f"r_tot = {result.highest:g}, 100 samples at 10 Hz, no noise, (11) to (13)."
    table = Table(("model", "r_tot", "", "coefficients", *NAMES), rows, caption, 4)
    return Section(
        "Fig. 5: errors of the identified coefficients", [Figure(_shares_of(found), shown), table]
    )


def noise(result: StudyResult) -> Section:
    """Where errors come from."""
    caption = (
        "Per coefficient: the error of the model (prototype with locked bushings),"
        " the contribution of the bushing, and the standard deviation under torque"
        f" noise of {result.robot.torque_noise_std} Nm at 10 Hz and at 1 kHz. Bands:"
        " mid and high as in the paper."
    )
    shown = Figure(_error_sources([result.estimate(m) for m in MODELS]), caption)
    return Section("Noise, sample rate and sources of errors", [shown])


def tracking(result: StudyResult) -> Section:
    """The tool's error under feed-forward by each model.

    No model at all is left to the table.
    """
    ratios = sorted({t.r_tot for t in result.tracking})
    with drawing(1, len(ratios), size=(5.2 * len(ratios), 3.2)) as (figure, axes):
        for ax, r_tot in zip(axes[0], ratios, strict=True):
            picked = [t for t in result.tracking if t.r_tot == r_tot and t.feedforward != "none"]
            colours = [COLOURS.get(t.feedforward.removeprefix("identified "), GREY) for t in picked]
            place = np.arange(len(picked))
            for shift, what, alpha in ((-0.2, "tool_rms", 1.0), (0.2, "joints_rms", 0.45)):
                bars = ax.bar(
                    place + shift,
                    [getattr(t, what) for t in picked],
                    0.38,
                    color=colours,
                    alpha=alpha,
                )
                ax.bar_label(bars, fmt="%.4f", fontsize=7)
            ax.set_xticks(place, [t.feedforward.replace(" ", "\n") for t in picked])
            ax.set_title(
                f"tool error, rms [mm], r$_{{tot}}$ = {r_tot:g}; pale: without tilt", loc="left"
            )
            ax.margins(y=0.15)
    rows: list[Row] = [astuple(t)[:-1] for t in result.tracking]
    header = (
        "feed-forward", "r_tot", "tool, rms [mm]", "tool, largest [mm]", "joints' part, rms [mm]",
        "q, rms [mrad]", "feedback torque, rms [Nm]",
    )  # fmt: skip
    caption = (
        "Held-out motions, feedback with a natural frequency of"
        f" {FEEDBACK_FREQUENCY:g} rad/s on the motor side; 'true mod3' uses the numbers"
        " of the description: its remaining error is the tilt of the bearings, which"
        " no model here represents"
    )
    shown = Figure(
        figure, "Tool error of the prototype under feed-forward of each identified model."
    )
    return Section("Benefit of a better model", [shown, Table(header, rows, caption)])


READINGS = Section(
    "Readings",
    [
        Text(
            "The paper states both that mod1 merges the spline into the link (IV-B) and"
            " that I_spl is absent from M (IV-C). Only merging gives tau_3^l a constant"
            " error, so it is merged here."
        ),
        Text(
            "The step ramp is interpreted as the cubic STEP; r_tot is split into r_b and"
            " r_hd according to the arm file."
        ),
        Text(
            "The errors of Fig. 4b are those of mod1 and mod2 relative to mod3, as the"
            " paper states. Those of Fig. 4c are interpreted relative to mod_ad: the paper"
            " names no reference there, but mod3 has an error, and relative to itself it"
            " would have none."
        ),
        Text(
            f"The Fourier series of the excitation is interpreted as {SHAPE.harmonics}"
            f" harmonics of 1/{SHAPE.period:g} Hz per joint, and a constant; the paper"
            " states the duration of 10 s and refers to another work for the rest. The"
            " optimiser is a pattern search, as in the paper."
        ),
        Text(
            "The translational stiffness of the bushing (2e8 N/m) is our assumption: the"
            " paper calls it high. Its influence is listed under Fig. 4c."
        ),
        Text(
            "The true Psi of mod1 counts the spline with the link into which it is"
            " merged. The other interpretation omits it; its shares are also under Fig. 5."
        ),
        Text(
            "The paper counts 64 coefficients for mod1 and 38 for mod2 and mod3 (its"
            " percentages correspond to 19/64, 40/64, 23/38 and 26/38) without naming"
            " them. Ours are the base parameters of each model's regressor, with solids of"
            " revolution reduced to mass, first moment and two moments of inertia."
        ),
    ],
)

SECTIONS = (
    figures_1_and_2, prototype, figure_3, figure_4a, figure_4b, figure_4c, coupling, excitation,
    figure_5, noise, tracking,
)  # fmt: skip
