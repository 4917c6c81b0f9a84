"""Claims on torques (sections IV, V and VII), each decided by our numbers.

Each function states its rule in code. Where the paper speaks of joints 1, 2 and 3 the rule speaks of the joints before
the last and of the last one.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from elastic_arm.studies.paper.claims.claim import Claim, listed, verdict
from elastic_arm.studies.paper.comparison import MODELS, PROTOTYPE, LinearTrend, Metric, line_over_ratio
from elastic_arm.studies.paper.torque_study import LinkErrors, TorqueResult

SENSOR_NOISE = 0.26  # Nm, VII-1
LINEAR = 0.99  # share of the variation over r_tot that a line must explain
LEAST = 0.01 * SENSOR_NOISE  # Nm; what is smaller at every ratio is no error that grows, whatever its shape
EQUAL = 1e-9  # relative difference of errors that are the same but for rounding


def _rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt((values**2).mean(axis=0))


def _of(rows: list[Metric], model: str, side: str, joint: int) -> list[Metric]:
    return [row for row in rows if (row.model, row.side, row.joint) == (model, side, joint)]


def _mod3_follows(result: TorqueResult) -> Claim:
    top = result.at_highest()
    error = np.abs(top.error("mod3", "mod_ad", "motor")).max(axis=0)
    span = np.ptp(top.run.tau_m, axis=0)
    return Claim(
        "motor_mod3_close",
        "IV-A",
        "tau^m of mod3 correlates well with that of mod_ad",
        f"largest difference {listed(error)} Nm per joint, {100 * (error / span).max():.2g} % of the torque's span "
        "at most",
        verdict(list(error < 0.01 * span)),
    )


def _link_not_zero(result: TorqueResult) -> Claim:
    top = result.at_highest()
    left = np.abs(top.torques["mod3"].link).max(axis=0)
    locked = result.locked_link
    return Claim(
        "link_mod3_not_zero",
        "IV-A",
        "tau^l of mod3 is not exactly zero, because of the 6-DoF bushing of mod_ad",
        f"largest residual {listed(left)} Nm per joint; {locked:.1g} Nm with the bushing locked, so the bushing is "
        "the cause",
        verdict([bool((left > 1e-3).all()), locked < 1e-6]),
    )


def _simple_drive_in_motor_torque(result: TorqueResult) -> Claim:
    top = result.at_highest()
    difference = _rms(top.error("mod1", "mod2", "motor"))
    share = difference / _rms(top.run.tau_m)
    most = int(np.argmax(difference)) + 1
    return Claim(
        "motor_mod1_mod2_close",
        "IV-C",
        "mod1 and mod2 differ very little in tau^m, most for joint 1, whose spline is the heavy one",
        f"rms difference {listed(difference)} Nm, {100 * share.max():.2g} % of tau^m at most; largest for joint {most}",
        verdict([bool((share < 0.01).all()), most == 1]),
        "the spline of joint 1 was given ten times the inertia of joint 2's, as the paper states",
    )


def _detailed_drive_in_link_torque(result: TorqueResult) -> Claim:
    wins = []
    for joint in range(1, result.robot.n + 1):
        pairs = zip(
            _of(result.against_mod3, "mod1", "link", joint),
            _of(result.against_mod3, "mod2", "link", joint),
            strict=True,
        )
        wins.append([two.e_rmse < one.e_rmse for one, two in pairs])
    counts = ", ".join(f"{sum(w)} of {len(w)}" for w in wins)
    return Claim(
        "link_mod2_better",
        "IV-C",
        "in tau^l, mod2 reports less error than mod1",
        f"mod2's e_rmse with respect to mod3 is the smaller at {counts} ratios (joint 1, 2, …). Where S dominates, "
        "mod1's spline, counted with the link, cancels a part of the missing S",
        verdict([flag for w in wins for flag in w]),
    )


def _grows_linearly(line: LinearTrend, share: float) -> bool:
    """Return whether an error grows along a line over r_tot and is large enough to be spoken of (:data:`LEAST`)."""
    return line.r_squared > share and line.slope > 0.0 and line.highest > LEAST


def _linear_in_ratio(result: TorqueResult) -> Claim:
    lines = [
        line_over_ratio(result.against_mod3, model, "link", joint)
        for model in ("mod1", "mod2")
        for joint in range(1, result.robot.n)
    ]
    return Claim(
        "link_linear",
        "IV-C",
        "the tau^l errors of mod1 and mod2 grow linearly with r_tot for joints 1 and 2",
        f"a line explains at least {100 * min(line.r_squared for line in lines):.2f} % of the variation of e_max over "
        f"r_tot, which reaches {listed([line.highest for line in lines], 3)} Nm (mod1 joint by joint, then mod2; at "
        f"least {LEAST:.2g} Nm wanted)",
        verdict([_grows_linearly(line, LINEAR) for line in lines]),
    )


def _difference_linear(result: TorqueResult) -> Claim:
    gaps = []
    for joint in range(result.robot.n - 1):
        rms = [_rms(c.error("mod1", "mod2", "link"))[joint] for c in result.comparisons]
        gaps.append(max(rms) / min(rms))
    return Claim(
        "link_difference_grows",
        "IV-C",
        "the difference between mod1 and mod2 in tau^l grows with r_tot for joints 1 and 2",
        f"its rms changes by a factor of {listed(np.array(gaps), 3)} from the lowest to the highest ratio: the "
        "difference is the spline's inertia alone, which no ratio multiplies",
        verdict([gap > 1.5 for gap in gaps]),
    )


def _last_joint(result: TorqueResult) -> Claim:
    n = result.robot.n
    one = np.array([row.e_max for row in _of(result.against_mod3, "mod1", "link", n)])
    two = np.array([row.e_max for row in _of(result.against_mod3, "mod2", "link", n)])
    return Claim(
        "link_last_constant",
        "IV-C",
        "for joint 3 the tau^l error is constant over r_tot in mod1 and zero in mod2",
        f"mod1: {one.min():.3g} to {one.max():.3g} Nm; mod2: at most {two.max():.1g} Nm",
        verdict([bool(np.ptp(one) < 0.05 * one.mean()), bool(two.max() < 1e-9)]),
    )


def _shape_of_coupling(result: TorqueResult) -> Claim:
    n = result.robot.n
    S, tilted = result.coupling.matrix, result.tilted_coupling.matrix
    zero = all(S[i, j] == 0 for i in range(n) for j in range(n) if (j < i) or (j == i and i > 0))
    expected = [(i, j) for i in range(n) for j in range(n) if (i, j) == (0, 0) or j > i]
    there = [(i, j) for i, j in expected if S[i, j] != 0]
    tilting = [(i, j) for i, j in expected if S[i, j] == 0 and tilted[i, j] != 0]

    def names(entries: list[tuple[int, int]]) -> str:
        return ", ".join(f"S_{i + 1}{j + 1}" for i, j in entries) or "none"

    never = [entry for entry in expected if entry not in there and entry not in tilting]
    return Claim(
        "coupling_shape",
        "V",
        "S has the shape of (8): S_11, S_12, S_13, S_23 and zeros elsewhere, with sigma a function of q",
        f"the zeros of (8) are zero: {'yes' if zero else 'no'}. Not zero and constant: {names(there)}; only under "
        f"bearing tilt: {names(tilting)}; zero for every pose and tilt: {names(never)}",
        verdict([zero, len(there) + len(tilting) == len(expected)]),
    )


def _coupling_halves_motor_error(result: TorqueResult) -> Claim:
    n = result.robot.n
    gains = []
    for joint in range(1, n + 1):
        two, three = (_of(result.against_prototype, m, "motor", joint)[-1].e_rmse for m in ("mod2", "mod3"))
        gains.append(1.0 - three / two)
    better = [gain > 0.5 for gain in gains]
    return Claim(
        "motor_mod3_half",
        "V",
        "e_max and e_rmse of tau^m are about 50 % less in mod3 than in the other models",
        f"at r_tot = {result.highest:g}, mod3's e_rmse is {listed(100 * np.array(gains), 3)} % less than mod2's "
        "(joint 1, 2, …); where S does not enter a joint's tau^m, there is nothing to gain",
        verdict(better),
    )


def _mod3_linear(result: TorqueResult) -> Claim:
    lines = [
        line_over_ratio(result.against_prototype, "mod3", "motor", joint) for joint in range(1, result.robot.n + 1)
    ]
    return Claim(
        "motor_mod3_linear",
        "V",
        "tau^m errors of mod3 grow linearly with r_tot",
        f"a line explains {listed([100 * line.r_squared for line in lines], 4)} % of e_max; slopes "
        f"{listed([line.slope for line in lines])} Nm per unit of r_tot; e_max reaches "
        f"{listed([line.highest for line in lines])} Nm (joint 1, 2, …). Below {LEAST:.2g} Nm, a hundredth of the "
        "sensor's noise, an error counts as none",
        verdict([_grows_linearly(line, 0.95) for line in lines]),
    )


def _smallest(errors: LinkErrors) -> list[bool]:
    """Return for e_rmse of each joint, then for e_max, whether mod3's tau_l is the smallest."""
    return [
        bool(column[-1] <= column.min() * (1 + EQUAL)) for table in (errors.e_rmse, errors.e_max) for column in table.T
    ]


def _in_columns(table: np.ndarray) -> str:
    """Write (models, n) joint by joint, the models of each apart by strokes."""
    return "; ".join(" / ".join(f"{value:.3g}" for value in column) for column in table.T)


def _link_minimal(result: TorqueResult) -> Claim:
    n, top = result.robot.n, result.at_highest()
    errors = np.array([top.error(m, PROTOTYPE, "link") for m in MODELS])
    step = LinkErrors(0.0, np.abs(errors).max(axis=1), np.sqrt((errors**2).mean(axis=1)))
    smooth = np.array([_rms(result.smooth.error(m, PROTOTYPE, "link")) for m in MODELS])
    counts = []
    for varied in result.translations:
        wins = _smallest(varied)
        counts.append(f"{varied.stiffness:.0e} N/m: {sum(wins[:n])} and {sum(wins[n:])}")
    return Claim(
        "link_mod3_minimal",
        "V",
        "tau^l errors of mod3 are very minimal, the smallest of the three models",
        f"mod1 / mod2 / mod3 with respect to mod_ad at r_tot = {result.highest:g}, joint by joint: e_rmse "
        f"{_in_columns(step.e_rmse)} Nm, e_max {_in_columns(step.e_max)} Nm, most of it the bearings' ringing; e_rmse "
        f"{_in_columns(smooth)} Nm on a ramp without jumps. It depends on the bushing's translation stiffness, which "
        f"the paper does not state: joints of {n} where mod3 is smallest by e_rmse and by e_max at {'; '.join(counts)}",
        verdict([*_smallest(step), *(bool(row[-1] <= row.min() * (1 + EQUAL)) for row in smooth.T)]),
    )


def _last_link_identical(result: TorqueResult) -> Claim:
    gap = max(float(np.abs(c.error("mod2", "mod3", "link")[:, -1]).max()) for c in result.comparisons)
    return Claim(
        "link_last_identical",
        "V",
        "tau_3^l is identical in mod2 and mod3",
        f"largest difference over all ratios {gap:.1g} Nm",
        verdict([gap < 1e-9]),
    )


def _motor_inertia_dominates(result: TorqueResult) -> Claim:
    B, S, drive = (result.inertial[k] for k in ("B ddtheta", "S' ddq", "K (theta - q) + D (dtheta - dq)"))
    return Claim(
        "B_dominates",
        "V",
        "the torque of rotor and harmonic drive in B dominates tau^m, as r_b and r_hd multiply it",
        f"rms of B ddtheta {listed(B, 3)} Nm against {listed(S)} Nm of S' ddq and {listed(drive, 3)} Nm of the "
        "drive (gravity included)",
        verdict([*(B > 10 * S), *(drive < B)]),
    )


def _largest_motor_errors(result: TorqueResult) -> np.ndarray:
    """Largest e_max over models and ratios of each joint's tau^m, (n,), mod1 and mod2 with respect to mod3."""
    return np.array(
        [
            max(row.e_max for m in ("mod1", "mod2") for row in _of(result.against_mod3, m, "motor", joint))
            for joint in range(1, result.robot.n + 1)
        ]
    )


def _first_joint_bound(result: TorqueResult) -> Claim:
    largest = _largest_motor_errors(result)
    return Claim(
        "motor_first_below_half",
        "VII",
        "the largest error of tau_1^m is below 0.5 Nm at every r_tot",
        f"{largest[0]:.3f} Nm",
        verdict([bool(largest[0] < 0.5)]),
        "the inertias of the arm file were chosen so that it stays below",
    )


def _only_first_below_noise(result: TorqueResult) -> Claim:
    largest = _largest_motor_errors(result)
    below = largest < 0.5
    return Claim(
        "motor_only_first_noise",
        "VII",
        f"of the torque errors only those of tau_1^m are of the size of the sensor noise ({SENSOR_NOISE} Nm) and "
        "drown in it",
        f"largest errors of tau^m: {listed(largest, 3)} Nm (joint 1, 2, …): "
        f"{'all are' if below.all() else 'not all are'} of that size or below, not those of joint 1 alone",
        verdict([bool(below[0]), bool(not below[1:].any())]),
    )


TORQUE_RULES: tuple[Callable[[TorqueResult], Claim], ...] = (
    _mod3_follows,
    _link_not_zero,
    _simple_drive_in_motor_torque,
    _detailed_drive_in_link_torque,
    _linear_in_ratio,
    _difference_linear,
    _last_joint,
    _shape_of_coupling,
    _coupling_halves_motor_error,
    _mod3_linear,
    _link_minimal,
    _last_link_identical,
    _motor_inertia_dominates,
    _first_joint_bound,
    _only_first_below_noise,
)
