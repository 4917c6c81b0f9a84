"""Sections of the paper's report on torques: Figs. 3 and 4, and the coupling S."""

from __future__ import annotations

import numpy as np
import sympy

from elastic_arm.report.html import Figure, Section, Table, Text
from elastic_arm.studies.paper.comparison import MODELS, PROTOTYPE, SIDES, Metric, ModelComparison
from elastic_arm.studies.paper.coupling import SymbolicCoupling, linearized
from elastic_arm.studies.paper.report import figures as draw
from elastic_arm.studies.paper.study import StudyResult


def figure_3(result: StudyResult) -> Section:
    """Fig. 3."""
    return Section(
        "Fig. 3: mod3 against the prototype",
        [
            Figure(
                draw.torques(result.at_highest(), (PROTOTYPE, "mod3")),
                "Step ramp of 0.1 rad in 1 s (cubic), all joints at once from the zero pose, r_tot = "
                f"{result.highest:g}. As in the paper, tau^m of mod3 lies on that of mod_ad, and tau^l of mod3 is not "
                "zero: the bearings tilt and ring after the jumps of the ramp's acceleration. Samples at 1 kHz; at "
                "the two jumps the sample is the limit from before, as in the half millisecond after a jump the "
                "bushings have not yet answered.",
            )
        ],
    )


def figure_4a(result: StudyResult) -> Section:
    """Fig. 4a, and other starting poses."""
    rows = [
        (", ".join(f"{angle:.2f}" for angle in pose), *(float(v) for v in _peaks(comparison)))
        for pose, comparison in [(np.zeros(result.robot.n), result.at_highest()), *result.poses]
    ]
    n = result.robot.n
    header = ["pose at the start [rad]"]
    header += [f"{m} tau_{j + 1}^{s}" for m in ("mod1", "mod3") for s in ("m", "l") for j in range(n)]
    return Section(
        "Fig. 4a: the three models",
        [
            Figure(
                draw.torques(result.at_highest(), MODELS, differences=True),
                "The same motion. In tau^m the models cannot be told apart by eye (third row: by how much they "
                "differ); in tau^l mod1 and mod2 leave what S would explain.",
            ),
            Table(header, rows, caption="Largest difference from mod_ad by starting pose, Nm", digits=3),
        ],
    )


def _peaks(comparison: ModelComparison) -> np.ndarray:
    return np.concatenate(
        [np.abs(comparison.error(m, PROTOTYPE, s)).max(axis=0) for m in ("mod1", "mod3") for s in ("motor", "link")]
    )


def figure_4b(result: StudyResult) -> Section:
    """Fig. 4b and its numbers."""
    models = ("mod1", "mod2")
    return Section(
        "Fig. 4b: mod1 and mod2 with respect to mod3",
        [
            Figure(
                draw.stacked_metrics(result.against_mod3, models, result.ratios, result.robot.n),
                "Stacked as in the paper: e_max below, e_rmse above.",
            ),
            _metric_table(result.against_mod3),
        ],
    )


def figure_4c(result: StudyResult) -> Section:
    """Fig. 4c and its numbers."""
    smooth = [(m, s, *_rms(result.smooth.error(m, PROTOTYPE, s))) for s in SIDES for m in MODELS]
    return Section(
        "Fig. 4c: all three with respect to mod_ad",
        [
            Figure(
                draw.stacked_metrics(result.against_prototype, MODELS, result.ratios, result.robot.n),
                "Stacked as in the paper: e_max below, e_rmse above. The part of tau^l that no model explains is the "
                "ringing of the bearings.",
            ),
            Table(
                ("model", "side", *(f"joint {j + 1} [Nm]" for j in range(result.robot.n))),
                smooth,
                caption="e_rmse on a ramp without jumps of acceleration (quintic), where little rings, at the "
                "highest ratio",
                digits=3,
            ),
            _metric_table(result.against_prototype),
            _translations(result),
        ],
    )


def _translations(result: StudyResult) -> Table:
    """Errors of tau^l by the bushing's translation stiffness: a row a stiffness and model."""
    n = result.robot.n
    rows = [
        (f"{each.stiffness:.0e}", model, *map(float, each.e_max[k]), *map(float, each.e_rmse[k]))
        for each in result.translations
        for k, model in enumerate(MODELS)
    ]
    header = [f"{what}, joint {j + 1} [Nm]" for what in ("e_max", "e_rmse") for j in range(n)]
    return Table(
        ("K_t [N/m]", "model", *header),
        rows,
        caption="tau^l with respect to mod_ad at the highest ratio, by the translation stiffness of the bushing, which "
        "the paper does not state: which model is best by e_max at a joint depends on it",
        digits=3,
    )


def _rms(error: np.ndarray) -> list[float]:
    return [float(value) for value in np.sqrt((error**2).mean(axis=0))]


def _metric_table(metrics: list[Metric]) -> Table:
    """A row a torque and model, a pair of columns a ratio."""
    ratios = sorted({m.r_tot for m in metrics})
    rows: dict[tuple[str, int, str], list[str | int | float]] = {}
    for m in sorted(metrics, key=lambda m: (SIDES.index(m.side), m.joint, m.model, m.r_tot)):
        row = rows.setdefault((m.side, m.joint, m.model), [f"tau_{m.joint}^{draw.SYMBOLS[m.side]}", m.model])
        row += [m.e_max, m.e_rmse]
    header = ["torque", "model", *(f"{what}, {r_tot:g}" for r_tot in ratios for what in ("e_max", "e_rmse"))]
    return Table(header, list(rows.values()), caption="Nm, by r_tot", digits=3)


def coupling(result: StudyResult) -> Section:
    """S in symbols, and what tau^m is made of."""
    flat, tilted = result.coupling, result.tilted_coupling
    n = result.robot.n
    terms = [
        (f"S_{i + 1},{j + 1}", _text(flat.matrix[i, j])) for i in range(n) for j in range(n) if flat.matrix[i, j] != 0
    ]
    pattern = "; ".join(
        "[" + ", ".join(f"S_{i + 1},{j + 1}" if flat.matrix[i, j] != 0 else "0" for j in range(n)) + "]"
        for i in range(n)
    )
    values = [(name, *(float(v) for v in column)) for name, column in result.inertial.items()]
    return Section(
        "The coupling S",
        [
            Text(
                f"With the bearings locked, S = {pattern}, derived in symbols by the recursion that also makes the "
                "numbers."
            ),
            Table(("entry", "terms as in (9)"), terms, caption="Bearings locked"),
            Table(
                ("row", "motor", "sigma(q)", "to first order in the tilts"),
                _sigma_rows(tilted),
                caption="With bearing tilts q_ix, q_iy: S_row,motor = (sum of I_zz times ratio of that motor's "
                "spinning bodies) times sigma; entries not listed are zero",
            ),
            Text(_coupling_words(result)),
            Table(
                ("part of tau^m", *(f"joint {j + 1} [Nm]" for j in range(n))),
                values,
                caption="What tau^m of the step ramp is made of at the highest ratio, rms",
            ),
        ],
    )


def _sigma_rows(coupling: SymbolicCoupling) -> list[tuple[str, int, str, str]]:
    rows, columns = coupling.sigma.shape
    return [
        (coupling.rows[i], j + 1, _text(coupling.sigma[i, j]), _text(linearized(coupling.sigma[i, j])))
        for i in range(rows)
        for j in range(columns)
        if coupling.sigma[i, j] != 0
    ]


def _coupling_words(result: StudyResult) -> str:
    flat, tilted, n = result.coupling.matrix, result.tilted_coupling.matrix, result.robot.n
    woken = [f"S_{i + 1},{j + 1}" for i in range(n) for j in range(n) if flat[i, j] == 0 and tilted[i, j] != 0]
    asleep = [f"S_{i + 1},{j + 1}" for i in range(n) for j in range(i + 1, n) if tilted[i, j] == 0]
    largest = float(np.abs(result.at_highest().run.tilt[0]).max())
    words = f"Bearing tilt wakes {', '.join(woken) or 'no entry'} of the joints' own rows"
    if asleep:
        words += (
            f"; {', '.join(asleep)} stays zero for every pose and tilt, because the whole transmission rides on a "
            "body whose joint axis is perpendicular to its own"
        )
    return words + (
        f". The tilt itself is small ({1e3 * largest:.2g} mrad at most on the ramp). What S does to the tilts' own "
        "rows is not small and depends on the pose: spinning rotors push against the bearings, and this is what "
        "makes them ring."
    )


def _text(expression: sympy.Expr) -> str:
    """Write an expression on one line, with the symbols of the paper."""
    return str(expression).replace("**", "^").replace("*", " ")
