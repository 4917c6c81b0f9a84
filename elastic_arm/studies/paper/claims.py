"""The claims of the paper, in its order, each with a verdict by our numbers: holds, holds in part,
does not hold, or undecided.

Each function states its rule in code. Where the paper refers to joints 1, 2 and 3, the rule refers
to the joints before the last and to the last one.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from elastic_arm.arrays import Array, rms
from elastic_arm.studies.paper.identification_study import (
    ErrorShares,
    mean_shares,
    shares,
    smallness,
)
from elastic_arm.studies.paper.study import StudyResult
from elastic_arm.studies.paper.torques import (
    MODELS,
    PROTOTYPE,
    LinearTrend,
    LinkErrors,
    TorqueErrors,
    line_over_ratio,
    link_errors_of,
)

SECTIONS = ("IV-A", "IV-C", "V", "VI-A", "VI-B", "VII")
HOLDS = "holds"
IN_PART = "holds in part"
FAILS = "does not hold"
UNDECIDED = "undecided"
# A difference counts from this number of its standard deviations on.
DECIDED = 2.0


@dataclass(frozen=True)
class Claim:
    """A statement of the paper, and the verdict of the study on it.

    `by_choice` states which number of the arm file was chosen so that the claim holds; empty where
    none was.
    """

    key: str
    section: str
    claim: str
    finding: str
    verdict: str
    by_choice: str = ""


def verdict(parts: Sequence[bool | None]) -> str:
    """Return whether a claim holds: if all parts do, in part if some do.

    Undecided where that hangs on undecided parts.
    """
    known = {bool(part) for part in parts if part is not None}
    if len(known) == 2:
        return IN_PART
    if any(part is None for part in parts):
        return UNDECIDED
    return HOLDS if known == {True} else FAILS


def beyond_noise(difference: float, noise: float) -> bool | None:
    """Return whether a difference is above zero, or None where its noise leaves that open.

    The noise is a standard deviation.
    """
    return None if abs(difference) <= DECIDED * noise else difference > 0.0


def listed(values: Array | Sequence[float], digits: int = 2) -> str:
    """Write numbers, one a joint, in a row."""
    return ", ".join(f"{value:.{digits}g}" for value in np.atleast_1d(values))


Judged = tuple[str, Sequence[bool | None]]
RULES: list[Callable[[StudyResult], Claim]] = []


def _rule(key: str, section: str, claim: str, by_choice: str = "") -> Callable[[Any], None]:
    def add(decide: Callable[[StudyResult], Judged]) -> None:
        def judged(result: StudyResult) -> Claim:
            finding, parts = decide(result)
            return Claim(key, section, claim, finding, verdict(parts), by_choice)

        RULES.append(judged)

    return add


def judge(result: StudyResult) -> list[Claim]:
    """Decide every claim, in the order of the paper's sections."""
    return sorted((rule(result) for rule in RULES), key=lambda claim: SECTIONS.index(claim.section))


SENSOR_NOISE = 0.26  # Nm, VII-1
LINEAR = 0.99  # share of the variation over r_tot that a line must explain
# Nm; what is smaller at every ratio is no error that grows, whatever its shape
LEAST = 0.01 * SENSOR_NOISE
EQUAL = 1e-9  # relative difference of errors that are the same but for rounding


@_rule("motor_mod3_close", "IV-A", "tau^m of mod3 correlates well with that of mod_ad")
def _mod3_follows(result: StudyResult) -> Judged:
    top = result.at_highest()
    error = np.abs(top.error("mod3", "mod_ad", "motor")).max(axis=0)
    span = np.ptp(top.run.tau_m, axis=0)
    finding = (
        f"largest difference {listed(error)} Nm per joint, at most"
        f" {100 * (error / span).max():.2g} % of the range of the torque"
    )
    return finding, list(error < 0.01 * span)


@_rule(
    "link_mod3_not_zero",
    "IV-A",
    "tau^l of mod3 is not exactly zero, because of the 6-DoF bushing of mod_ad",
)
def _link_not_zero(result: StudyResult) -> Judged:
    top = result.at_highest()
    left = np.abs(top.torques["mod3"].link).max(axis=0)
    locked = result.locked_link
    finding = (
        f"largest residual {listed(left)} Nm per joint; {locked:.1g} Nm with the bushing locked, so"
        " the bushing is the cause"
    )
    return finding, [bool((left > 1e-3).all()), locked < 1e-6]


@_rule(
    "motor_mod1_mod2_close",
    "IV-C",
    "mod1 and mod2 differ very little in tau^m, most for joint 1, whose spline is the heavy one",
    "the spline of joint 1 has ten times the inertia of joint 2's, in agreement"
    " with the statement of the paper",
)
def _simple_drive_in_motor_torque(result: StudyResult) -> Judged:
    top = result.at_highest()
    difference = rms(top.error("mod1", "mod2", "motor"))
    share = difference / rms(top.run.tau_m)
    most = int(np.argmax(difference)) + 1
    finding = (
        f"rms difference {listed(difference)} Nm, at most {100 * share.max():.2g} % of"
        f" tau^m; largest for joint {most}"
    )
    return finding, [bool((share < 0.01).all()), most == 1]


@_rule("link_mod2_better", "IV-C", "in tau^l, mod2 reports less error than mod1")
def _detailed_drive_in_link_torque(result: StudyResult) -> Judged:
    e_rmse = result.against_mod3.e_rmse
    wins = (e_rmse["link", "mod2"] < e_rmse["link", "mod1"]).T  # (n, ratios)
    counts = ", ".join(f"{w.sum()} of {len(w)}" for w in wins)
    finding = (
        f"the e_rmse of mod2 relative to mod3 is smaller at {counts} ratios (joint 1,"
        " 2, …). Where S dominates, mod1's spline, which belongs to the link, cancels"
        " part of the missing S"
    )
    return finding, wins.ravel().tolist()


def _lines(result: StudyResult, errors: TorqueErrors, side: str, model: str) -> list[LinearTrend]:
    """Return the line of each joint's e_max over r_tot."""
    return [line_over_ratio(result.ratios, e_max) for e_max in errors.e_max[side, model].T]


def _grows_linearly(line: LinearTrend, share: float) -> bool:
    """Return whether an error grows along a line over r_tot and is large enough to be spoken of
    (:data:`LEAST`)."""
    return line.r_squared > share and line.slope > 0.0 and line.highest > LEAST


@_rule(
    "link_linear",
    "IV-C",
    "the tau^l errors of mod1 and mod2 grow linearly with r_tot for joints 1 and 2",
)
def _linear_in_ratio(result: StudyResult) -> Judged:
    lines = [
        line
        for model in ("mod1", "mod2")
        for line in _lines(result, result.against_mod3, "link", model)[:-1]
    ]
    finding = (
        f"a line explains at least {100 * min(line.r_squared for line in lines):.2f}"
        " % of the variation of e_max over r_tot; e_max reaches"
        f" {listed([line.highest for line in lines], 3)} Nm (mod1 joint by joint, then"
        f" mod2; required: at least {LEAST:.2g} Nm)"
    )
    return finding, [_grows_linearly(line, LINEAR) for line in lines]


@_rule(
    "link_difference_grows",
    "IV-C",
    "the difference between mod1 and mod2 in tau^l grows with r_tot for joints 1 and 2",
)
def _difference_linear(result: StudyResult) -> Judged:
    gaps = []
    for joint in range(result.robot.n - 1):
        sizes = [rms(c.error("mod1", "mod2", "link"))[joint] for c in result.comparisons]
        gaps.append(max(sizes) / min(sizes))
    finding = (
        f"its rms changes by a factor of {listed(np.array(gaps), 3)} from the lowest"
        " to the highest ratio: the difference is only the inertia of the spline,"
        " which is not multiplied by a ratio"
    )
    return finding, [gap > 1.5 for gap in gaps]


@_rule(
    "link_last_constant",
    "IV-C",
    "for joint 3 the tau^l error is constant over r_tot in mod1 and zero in mod2",
)
def _last_joint(result: StudyResult) -> Judged:
    one = result.against_mod3.e_max["link", "mod1"][:, -1]
    two = result.against_mod3.e_max["link", "mod2"][:, -1]
    finding = f"mod1: {one.min():.3g} to {one.max():.3g} Nm; mod2: at most {two.max():.1g} Nm"
    return finding, [bool(np.ptp(one) < 0.05 * one.mean()), bool(two.max() < 1e-9)]


@_rule(
    "coupling_shape",
    "V",
    "S has the shape of (8): S_11, S_12, S_13, S_23 and zeros elsewhere, with sigma a function"
    " of q",
)
def _shape_of_coupling(result: StudyResult) -> Judged:
    n = result.robot.n
    S = result.coupling.matrix
    tilted = result.tilted_coupling.matrix
    zero = all(S[i, j] == 0 for i in range(n) for j in range(n) if (j < i) or (j == i and i > 0))
    expected = [(i, j) for i in range(n) for j in range(n) if (i, j) == (0, 0) or j > i]
    there = [(i, j) for i, j in expected if S[i, j] != 0]
    tilting = [(i, j) for i, j in expected if S[i, j] == 0 and tilted[i, j] != 0]

    def names(entries: list[tuple[int, int]]) -> str:
        return ", ".join(f"S_{i + 1}{j + 1}" for i, j in entries) or "none"

    never = [entry for entry in expected if entry not in there and entry not in tilting]
    finding = (
        f"the zeros of (8) are zero: {'yes' if zero else 'no'}. Nonzero and"
        f" constant: {names(there)}; nonzero only under bearing tilt: {names(tilting)};"
        f" zero for every pose and tilt: {names(never)}"
    )
    return finding, [zero, len(there) + len(tilting) == len(expected)]


@_rule(
    "motor_mod3_half",
    "V",
    "e_max and e_rmse of tau^m are about 50 % less in mod3 than in the other models",
)
def _coupling_halves_motor_error(result: StudyResult) -> Judged:
    e_rmse = result.against_prototype.e_rmse
    gains = 1.0 - e_rmse["motor", "mod3"][-1] / e_rmse["motor", "mod2"][-1]
    finding = (
        f"at r_tot = {result.highest:g}, the e_rmse of mod3 is"
        f" {listed(100 * gains, 3)} % smaller than that of mod2 (joint 1, 2,"
        " …); there is no difference at joints whose tau^m does not contain S"
    )
    return finding, (gains > 0.5).tolist()


@_rule("motor_mod3_linear", "V", "tau^m errors of mod3 grow linearly with r_tot")
def _mod3_linear(result: StudyResult) -> Judged:
    lines = _lines(result, result.against_prototype, "motor", "mod3")
    finding = (
        f"a line explains {listed([100 * line.r_squared for line in lines], 4)} % of"
        f" e_max; slopes {listed([line.slope for line in lines])} Nm per unit of r_tot;"
        f" e_max reaches {listed([line.highest for line in lines])} Nm (joint 1, 2,"
        f" …). Errors below {LEAST:.2g} Nm, a hundredth of the sensor noise, count as"
        " zero"
    )
    return finding, [_grows_linearly(line, 0.95) for line in lines]


def _smallest(errors: LinkErrors) -> list[bool]:
    """Return for e_rmse of each joint, then for e_max, whether mod3's tau_l is the smallest."""
    return [
        bool(column[-1] <= column.min() * (1 + EQUAL))
        for table in (errors.e_rmse, errors.e_max)
        for column in table.T
    ]


def _in_columns(table: Array) -> str:
    """Write (models, n) joint by joint, the models of each apart by strokes."""
    return "; ".join(" / ".join(f"{value:.3g}" for value in column) for column in table.T)


@_rule(
    "link_mod3_minimal",
    "V",
    "tau^l errors of mod3 are very minimal, the smallest of the three models",
)
def _link_minimal(result: StudyResult) -> Judged:
    n = result.robot.n
    step = link_errors_of(result.at_highest(), 0.0)
    smooth = np.array([rms(result.smooth.error(m, PROTOTYPE, "link")) for m in MODELS])
    counts = []
    for varied in result.translations:
        wins = _smallest(varied)
        counts.append(f"{varied.stiffness:.0e} N/m: {sum(wins[:n])} and {sum(wins[n:])}")
    finding = (
        f"mod1 / mod2 / mod3 with respect to mod_ad at r_tot = {result.highest:g}, joint by joint:"
        f" e_rmse {_in_columns(step.e_rmse)} Nm, e_max {_in_columns(step.e_max)} Nm, most of it the"
        f" bearings' ringing; e_rmse {_in_columns(smooth)} Nm on a ramp without jumps. It depends"
        f" on the bushing's translation stiffness, which the paper does not state: joints of {n}"
        f" where mod3 is smallest by e_rmse and by e_max at {'; '.join(counts)}"
    )
    return finding, [
        *_smallest(step),
        *(bool(row[-1] <= row.min() * (1 + EQUAL)) for row in smooth.T),
    ]


@_rule("link_last_identical", "V", "tau_3^l is identical in mod2 and mod3")
def _last_link_identical(result: StudyResult) -> Judged:
    gap = max(
        float(np.abs(c.error("mod2", "mod3", "link")[:, -1]).max()) for c in result.comparisons
    )
    finding = f"largest difference over all ratios {gap:.1g} Nm"
    return finding, [gap < 1e-9]


@_rule(
    "B_dominates",
    "V",
    "the torque of rotor and harmonic drive in B dominates tau^m, as r_b and r_hd multiply it",
)
def _motor_inertia_dominates(result: StudyResult) -> Judged:
    B = result.inertial["B ddtheta"]
    S = result.inertial["S' ddq"]
    drive = result.inertial["K (theta - q) + D (dtheta - dq)"]
    finding = (
        f"rms of B ddtheta {listed(B, 3)} Nm against {listed(S)} Nm of S' ddq and"
        f" {listed(drive, 3)} Nm of the drive (gravity included)"
    )
    return finding, [*(B > 10 * S), *(drive < B)]


def _largest_motor_errors(result: StudyResult) -> Array:
    """Largest e_max over models and ratios of each joint's tau^m, (n,), mod1 and mod2 with respect
    to mod3."""
    e_max = result.against_mod3.e_max
    return np.max([e_max["motor", model] for model in ("mod1", "mod2")], axis=(0, 1))


@_rule(
    "motor_first_below_half",
    "VII",
    "the largest error of tau_1^m is below 0.5 Nm at every r_tot",
    "the inertias of the arm file were chosen to satisfy this bound",
)
def _first_joint_bound(result: StudyResult) -> Judged:
    largest = _largest_motor_errors(result)
    finding = f"{largest[0]:.3f} Nm"
    return finding, [bool(largest[0] < 0.5)]


@_rule(
    "motor_only_first_noise",
    "VII",
    "of the torque errors only those of tau_1^m are of the size of the sensor noise"
    f" ({SENSOR_NOISE} Nm) and drown in it",
)
def _only_first_below_noise(result: StudyResult) -> Judged:
    largest = _largest_motor_errors(result)
    below = largest < 0.5
    finding = (
        f"largest errors of tau^m: {listed(largest, 3)} Nm (joint 1, 2, …):"
        f" {'all are' if below.all() else 'not all are'} of this size or smaller, not"
        " only those of joint 1"
    )
    return finding, [bool(below[0]), bool(not below[1:].any())]


# What another search's trajectory changes, as standard deviations over four searches (seeds 1 to 3
# of the quick study, seed 1 of the full one): the difference of two models' shares, in
# coefficients, and the change of a share by noise.
SEARCH_COEFFICIENTS = 1.8
SEARCH_POINTS = 4.0
# Errors of the tool under feed-forward differ by as much from motion to motion and search to
# search.
ALIKE = 0.1


@_rule(
    "counts",
    "VI-A",
    "75 parameters can be estimated with mod2 and mod3, 65 with mod1 (percentages: of 38 and 64"
    " coefficients)",
)
def _counts(result: StudyResult) -> Judged:
    found = {m: result.estimate(m) for m in MODELS}
    ours = [found[m].estimable for m in ("mod2", "mod3", "mod1")]
    text = "; ".join(
        f"{m}: {found[m].estimable} parameters in {len(found[m].names)} coefficients"
        for m in MODELS
    )
    finding = (
        f"{text}. mod2 and mod3 equal, mod1 fewer:"
        f" {'yes' if ours[0] == ours[1] > ours[2] else 'no'}; the numbers differ"
        " because the paper counts parameters that it does not name"
    )
    return finding, [ours[0] == ours[1], ours[1] > ours[2], ours == [75, 75, 65]]


def _orders(many: list[ErrorShares], coefficient: float) -> list[bool | None]:
    """Return whether low errors grow and high ones shrink from each model to the next.

    `coefficient` is what one coefficient makes of a share, percent.
    """
    pairs = list(itertools.pairwise(many))
    gains = [two.low - one.low for one, two in pairs] + [one.high - two.high for one, two in pairs]
    return [beyond_noise(gain, SEARCH_COEFFICIENTS * coefficient) for gain in gains]


def _listed_shares(split: ErrorShares) -> str:
    return f"{split.low:.1f} / {split.mid:.1f} / {split.high:.1f} %"


@_rule(
    "shares_order",
    "VI-B",
    "shares of low and high errors improve from mod1 to mod2 to mod3 (low 29.7, 60.5, 68.4 %; high"
    " 62.5, 26.3, 21 %)",
)
def _shares(result: StudyResult) -> Judged:
    found = [result.estimate(m) for m in MODELS]
    plain = [e.shares for e in found]
    merged = [shares(e.merged_error) for e in found]
    texts = []
    for many in (plain, merged):
        of_models = zip(MODELS, many, strict=True)
        texts.append("; ".join(f"{m}: {_listed_shares(s)}" for m, s in of_models))
    sizes = min(len(e.names) for e in found), min(len(e.merged_error) for e in found)
    finding = (
        f"low / mid / high at r_tot = {result.highest:g}, no noise: {texts[0]}. After"
        f" merging coefficients that the motion does not separate: {texts[1]}"
    )
    return finding, _orders(plain, 100.0 / sizes[0]) + _orders(merged, 100.0 / sizes[1])


@_rule(
    "mod1_mostly_high", "VI-B", "most coefficients of mod1 (62.5 %) are estimated with high error"
)
def _mod1_mostly_high(result: StudyResult) -> Judged:
    found = result.estimate("mod1")
    assert found.unfolded_error is not None
    other = shares(found.unfolded_error)
    readings = found.shares.high, other.high
    finding = (
        f"{readings[0]:.1f} % at r_tot = {result.highest:g}, where the merged spline"
        " is part of the true combinations. Without it, which is the other"
        f" interpretation of mod1's true Psi: {readings[1]:.1f} % (low / mid / high"
        f" {_listed_shares(other)})"
    )
    return finding, [beyond_noise(high - 50.0, 50.0 / len(found.names)) for high in readings]


@_rule(
    "high_errors_small", "VII", "high relative errors come from coefficients of small true value"
)
def _small_coefficients(result: StudyResult) -> Judged:
    found = {m: result.estimate(m) for m in MODELS}
    numbers = {m: smallness(e) for m, e in found.items()}
    text = "; ".join(
        f"{m}: {size:.2f} with the value, {torque:.2f} with its torque"
        for m, (size, torque) in numbers.items()
    )
    # A rank correlation of B pairs that have nothing to do with each other scatters by 1 / sqrt(B -
    # 1).
    parts = [
        beyond_noise(-value, 1.0 / (len(found[m].names) - 1) ** 0.5)
        for m, pair in numbers.items()
        for value in pair
    ]
    finding = f"rank correlation of the error: {text}"
    return finding, parts


MINOR = 5.0  # points


@_rule("noise_minor", "VII", "torque noise has only a minor effect on the estimation")
def _noise_is_minor(result: StudyResult) -> Judged:
    found = {m: result.estimate(m) for m in MODELS}
    texts = []
    parts = []
    for merged in (False, True):
        changes = {}
        for m, e in found.items():
            many = e.merged_noisy_shares if merged else e.noisy_shares
            quiet = shares(e.merged_error) if merged else e.shares
            mean, spread = mean_shares(many)
            changes[m] = mean.low - quiet.low
            noise = math.hypot(spread.low / len(many) ** 0.5, SEARCH_POINTS)
            parts.append(beyond_noise(MINOR - abs(changes[m]), noise))
        texts.append("; ".join(f"{m}: {value:+.1f} points" for m, value in changes.items()))
    finding = (
        f"mean change of the share of low errors with {result.robot.torque_noise_std} Nm at 10 Hz:"
        f" {texts[0]}; merged, as above: {texts[1]} (minor: below {MINOR:g} points)"
    )
    return finding, parts


def _always(errors: list[list[float]]) -> bool | None:
    """Return whether the last model's error is the smallest on every motion, or on none.

    None where motions disagree or a difference is within :data:`ALIKE`.
    """
    wins = {
        beyond_noise(min(run[:-1]) - run[-1], ALIKE / DECIDED * min(run))
        for run in zip(*errors, strict=True)
    }
    return wins.pop() if len(wins) == 1 else None


@_rule("accuracy", "VII", "the more detailed mod3 improves the manipulator's accuracy")
def _accuracy(result: StudyResult) -> Judged:
    named = {(t.feedforward, t.r_tot): t for t in result.tracking}
    known = sorted({t.r_tot for t in result.tracking})
    parts: list[bool | None] = []
    text = []
    for r_tot in known:
        rows = [named[f"identified {m}", r_tot] for m in MODELS]
        measures = (
            ("tool", [r.tool_rms for r in rows]),
            ("joints' part", [r.joints_rms for r in rows]),
        )
        for part, (what, errors) in enumerate(measures):
            of_runs = []
            for row in rows:
                of_runs.append([run[part] for run in row.each])
            parts.append(_always(of_runs))
            values = " / ".join(f"{value:.2g}" for value in errors)
            text.append(f"r_tot {r_tot:g}, {what}: {values}")
    finding = (
        "rms error under feed-forward of the identified mod1 / mod2 / mod3, mm:"
        f" {'; '.join(text)}. The rest of the tool error is the tilt of the bearings,"
        " which no model with locked bearings represents"
    )
    return finding, parts
