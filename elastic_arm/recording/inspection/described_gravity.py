"""Torques against what the arm's description predicts: signs, places and mountings that are not as taken.

Of each joint's torque a zero, friction, the inertia as described and that of its motor are regressed out, and the same
of the gravity torque as described. What is left of the two should rise together. Where it runs against each other, all
torques have the wrong sign, or the arm is mounted otherwise. Where it rises far more or less, a unit is not what it is
taken for; where it hardly rises at all, gravity has been taken out of the torque before it was recorded.

Joints that turn the other way or have their zero elsewhere, torques of the wrong sign, and channels of two joints that
were exchanged are tried: masses and inertias are left free, tau = Y(q, dq, ddq) pi, so that the geometry alone decides,
however wrong the described masses are.

Slow samples resemble each other: N of them are worth as few independent ones as the two series' autocorrelations say
(M. S. Bartlett, Journal of the Royal Statistical Society 98 (1935) 536).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import fftconvolve, savgol_filter
from scipy.stats import t as student

from elastic_arm.dynamics import build_model
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.formatting import rounded
from elastic_arm.recording.inspection.plausibility import is_motion
from elastic_arm.recording.inspection.report import FEWEST, Finding, warning
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, Samples
from elastic_arm.robot import Robot

ENOUGH = 5000  # samples that are looked at; bounds the time
CHANCE = 0.01  # probability that unrelated torques correlate so; convention
# Times the described gravity: of a sign alone -1, and masses are off. Beyond, something else than gravity is at work.
FACTOR = (1.0 / 3.0, 3.0)
# Beyond, a unit is mistaken. Masses of a description are not off by so much; convention.
FAR = (0.2, 5.0)
LIKE_DEGREES = (57.3 / 2.5, 57.3 * 2.5)  # masses are off, and a small angle is not a small part of a sine
LIKE_KILO = (0.5e-3, 2e-3)
# Another direction of gravity, here and where `identification.batch.mounting` looks for it; conventions.
TURNED = 0.35  # rad from the described direction: beyond the tilts that linear columns describe
SIZE = (0.6, 1.5)  # of the described gravity: masses are off as well
LEFT = 0.3  # of the squares that the described direction leaves
OVERHEAD = 0.75 * np.pi  # rad: nearer to upside down, which all signs together are, too, than to any side
RANK = 1e-9  # of the largest singular value; numerical
SIDES = {"tau_J": "link", "tau_m": "motor"}
TURN = 0.05  # rad, over which squares are a parabola of a joint's zero; numerical
# Another arrangement is named where it is e^10 times as likely, and of the torques that it changes leaves a tenth, and
# a third of what was left as given: poor motions fit many.
CERTAIN, EXPLAINED, BETTER = 10.0, 0.1, 1.0 / 3.0


_Regressor = Callable[[Array, Array, Array], Array]


class _Change(NamedTuple):
    """Columns (n,) in another order, with signs."""

    order: Any
    sign: Array

    def __call__(self, values: Array) -> Array:
        return np.asarray(values[..., self.order] * self.sign)


class _SideMotion(NamedTuple):
    """Angles, rates, accelerations and torques (N, n) of a side, and the joints whose torque was measured."""

    q: Array
    dq: Array
    ddq: Array
    torque: Array
    measured: list[int]


class GravityFit(NamedTuple):
    """Torques of one side beside the described gravity, less what is not gravity.

    What is left of the torques, of gravity as described, Nm, (N, m) of the joints with a torque, and of its derivative
    by the gravity vector, (N, m, 3); correlation of the two, factor of the first over the second, the probability that
    unrelated series correlate so, and whether no joint that gravity loads shows half of it, but for chance.
    """

    torque: Array
    gravity: Array
    pull: Array
    correlation: float
    factor: float
    chance: float
    missing: bool

    @property
    def certain(self) -> bool:
        """Whether the torques follow gravity, or run against it."""
        # 0.5 is the correlation that gravity has at least where masses alone are off; convention
        return abs(self.correlation) > 0.5 and self.chance < CHANCE


def contradicted_gravity(recording: Recording, robot: Robot) -> list[Finding]:
    """Return which torques are at odds with the description, of a recording without damaged samples.

    They belong to another joint, way to turn or zero, "exchanged", "mirrored", "other_zero"; run against gravity,
    "gravity_sign"; show another direction, "mounting"; are far larger or smaller, "gravity_size"; or hold no gravity,
    "gravity_missing".
    """
    found = []
    for side, motion, fit in _fits(recording, robot):
        found += _size(fit, side) or _geometry(motion, side, robot) or _judged(fit, side, robot)
    return found


def misread_channels(recording: Recording, robot: Robot, *, weight: bool) -> str | None:
    """Return which channels are not what they are taken for, by unit, sign or joint; None where all are.

    weight: whether torques without gravity are among them.
    """
    for side, motion, fit in _fits(recording, robot):
        for one in _size(fit, side) or _geometry(motion, side, robot):
            if one.code != "other_zero":
                return one.message
        missing = (one for one in _judged(fit, side, robot) if weight and one.code == "gravity_missing")
        if (found := next(missing, None)) is not None:
            return found.message
    return None


def _fits(recording: Recording, robot: Robot) -> Iterator[tuple[str, _SideMotion, GravityFit]]:
    """Yield the torques of each side, and beside the described gravity; none of a recording without motion."""
    samples = recording.select(robot.joint_names).samples()
    position = samples.q if samples.q is not None else samples.theta
    # 1.0 s; the ends that differentiation spoils take 0.2 s
    if position is None or len(samples) < FEWEST or samples.t[-1] < 1.0 or not is_motion(samples.t, position):
        return
    for channel, side in SIDES.items():
        if getattr(samples, channel) is not None:
            motion = _motion(samples, position, channel)
            fit = _fit_gravity(motion, robot, motors=side == "motor")
            if len(motion.q) >= FEWEST and fit.gravity.any():
                yield side, motion, fit


def _motion(samples: Samples, position: Array, channel: str) -> _SideMotion:
    step = float(np.median(np.diff(samples.t)))
    # 0.1 s over which positions are differentiated: gravity changes more slowly
    width = max(round(0.1 / step) // 2 * 2 + 1, 5)
    dq, ddq = (savgol_filter(position, width, 3, deriv=k, delta=step, axis=0) for k in (1, 2))
    # Across a hole there is no derivative.
    holes = np.zeros(len(position), np.bool_)
    for row in np.flatnonzero(np.diff(samples.t) > 2.5 * step).tolist():
        holes[max(row - width // 2, 0) : row + width // 2 + 2] = True
    rows = np.flatnonzero(~holes)[width:-width]
    rows = rows[:: max(1, len(rows) // ENOUGH)]
    torque: Array = getattr(samples, channel)
    lacking = [(channel, j) in samples.lacking for j in range(position.shape[1])]
    # 1e-9 Nm; what changes less is none
    measured = np.flatnonzero((np.ptp(torque, axis=0) > 1e-9) & ~np.array(lacking)).tolist()
    return _SideMotion(position[rows], dq[rows], ddq[rows], torque[rows], measured)


def _fit_gravity(motion: _SideMotion, robot: Robot, *, motors: bool) -> GravityFit:
    """Compare the torques of one side with described gravity, of all joints together."""
    states = (np.hstack([rate, rate]) if robot.elastic else rate for rate in motion[:3])
    moved, pull = ArmEquations(robot).moved_and_pulled(*states, motors=motors)
    count = len(motion.measured)
    left, weight, free = np.zeros((len(pull), count)), np.zeros((len(pull), count, 3)), np.zeros(count)
    for k, j in enumerate(motion.measured):
        basis = _own(motion, j, moved[:, j])
        left[:, k], weight[:, k] = (rows - basis @ (basis.T @ rows) for rows in (motion.torque[:, j], pull[:, j]))
        free[k] = max(_independent(left[:, k], weight[:, k] @ robot.gravity) - 2.0, 0.1)
    gravity = weight @ robot.gravity
    # What rounding leaves of the gravity of a joint that has none is no gravity.
    if not count or np.abs(gravity).max() <= RANK * float(np.abs(pull @ robot.gravity).max()):
        return GravityFit(left, np.zeros_like(gravity), weight, 0.0, 0.0, 1.0, False)
    squares, power, both = np.sum(left**2, axis=0), np.sum(gravity**2, axis=0), np.sum(left * gravity, axis=0)
    # 0.05 of the largest gravity among the joints; less of it, as wrists have, a payload turns over
    heavy = power > 0.05**2 * power.max()
    factors, rest = both[heavy] / power[heavy], squares[heavy] - both[heavy] ** 2 / power[heavy]
    most = np.abs(factors) + 3.0 * np.sqrt(np.maximum(rest, 0.0) / power[heavy] / free[heavy])
    correlation = float(both.sum() / np.sqrt(squares.sum() * power.sum()))
    size = abs(correlation) * np.sqrt(free.sum() / max(1.0 - correlation**2, 1e-12))
    chance = float(student.sf(size, free.sum()))
    factor = float(both.sum() / power.sum())
    # 0.5 times the described gravity; below for certain it was taken out, in part at least
    return GravityFit(left, gravity, weight, correlation, factor, chance, bool((most < 0.5).all()))


def _own(motion: _SideMotion, j: int, *more: Array) -> Array:
    """Return an orthonormal basis (N, r) of a joint's zero, friction, motor inertia, and of further columns."""
    friction = np.tanh(motion.dq[:, j] / 0.01)  # 0.01 rad/s within which friction turns over; convention
    columns = [np.ones(len(friction)), friction, motion.dq[:, j], motion.ddq[:, j], *more]
    scaled = np.column_stack([column / max(float(np.linalg.norm(column)), 1e-300) for column in columns])
    basis, sizes, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(basis[:, sizes > RANK * sizes[0]])


def _independent(one: Array, other: Array) -> float:
    """Return how many independent samples two series (N,) are worth."""
    alike = [fftconvolve(each, each[::-1])[len(each) :] / max(float(each @ each), 1e-300) for each in (one, other)]
    return len(one) / max(1.0, 1.0 + 2.0 * float(alike[0] @ alike[1]))


def _geometry(motion: _SideMotion, side: str, robot: Robot) -> list[Finding]:
    """Return what the geometry alone shows: channels that were confused, or the zero of a joint."""
    if len(motion.measured) < 2:
        return []
    every = max(1, len(motion.q) // 500)  # so many samples are tried with every other arrangement
    motion = _SideMotion(*(rate[::every] for rate in motion[:4]), motion.measured)  # type: ignore[call-arg, arg-type]
    # A few thousand samples: compiling would take longer than all that is computed.
    n, model = robot.n, build_model(robot, engine="numpy")

    def regressor(q: Array, dq: Array, ddq: Array) -> Array:
        if robot.elastic:
            q, dq, ddq = (np.hstack([rate, rate]) for rate in (q, dq, ddq))
        Y = model.regressor(q, dq, ddq)
        return np.asarray(Y[:, :n] + (Y[:, n:] if robot.elastic and side == "motor" else 0.0))

    return _arranged(motion, side, robot, regressor) or _zero(motion, side, robot, regressor)


def _zero(motion: _SideMotion, side: str, robot: Robot, regressor: _Regressor) -> list[Finding]:
    """Return the joint whose zero is not where the description has it; a turned last link is another mass."""
    left, power, free = _squares(motion, regressor(*motion[:3]))
    best = (0.0, 0.0, 0.0, 0, left)
    for j in np.flatnonzero([not joint.prismatic for joint in robot.joints]).tolist():

        def squares_at(offset: float, j: int = j) -> Array:
            return _squares(motion, regressor(motion.q - offset * np.eye(robot.n)[j], *motion[1:3]))[0]

        # Squares are a parabola of a small angle.
        back, ahead = squares_at(-TURN), squares_at(TURN)
        slope, bend = (ahead - back) / (2.0 * TURN), (ahead - 2.0 * left + back) / TURN**2
        weight = free / left
        if (curvature := float(weight @ bend)) <= 0.0:
            continue
        offset = float(np.clip(-(weight @ slope) / curvature, -4.0 * TURN, 4.0 * TURN))
        squares = squares_at(offset)
        odds = 0.5 * float(free @ np.log(squares / left))
        best = min(best, (odds, offset, (0.5 * float((free / squares) @ bend)) ** -0.5, j, squares))
    odds, offset, std, j, squares = best
    changed = np.abs(np.log(squares / left)) > 0.1
    if -odds < CERTAIN or not changed.any():
        return []
    before, after = (float(np.exp(np.mean(np.log(each / power)[changed]))) for each in (left, squares))
    if after > BETTER * before or after > EXPLAINED:
        return []
    size = " ± ".join(rounded(offset, std))
    message = f"{side} side: the zero of {robot.joint_names[j]} seems to lie {size} rad from the described one"
    return [warning("other_zero", f"{message}: {_left_words(after, before)}", "measure it, or state it (joint_zero)")]


def _left_words(after: float, before: float) -> str:
    shown, given = (f"{100 * each:.2g} %" for each in (after, before))
    return f"so {shown} of the torques' squares are left, as given {given}"


def _arranged(motion: _SideMotion, side: str, robot: Robot, regressor: _Regressor) -> list[Finding]:
    """Return which joints turn the other way, or have their channels exchanged."""
    steps: list[Finding] = []
    found: list[Finding] = []
    for _ in range(robot.n):
        left, power, free = _squares(motion, regressor(*motion[:3]))
        tried = []
        for angles, ways in _arrangements(robot.joint_names, motion.measured):
            q, dq, ddq = (angles(rate) for rate in motion[:3])
            Y = regressor(q, dq, ddq)
            for code, words, torques in ways:
                squares, *_ = _squares(_SideMotion(q, dq, ddq, torques(motion.torque), motion.measured), Y)
                # In the order of the torques as they were given.
                order = np.argsort(torques.order[motion.measured])
                change = np.log(squares[order] / left)
                tried.append((0.5 * float(free @ change), change, code, words, angles, torques))
        odds, change, code, words, angles, torques = min(tried, key=lambda each: each[0])
        changed = np.abs(change) > 0.1  # logarithm of what is left
        if -odds < CERTAIN or not changed.any():
            break
        share = np.log(left / power)[changed]
        before, after = float(np.mean(share)), float(np.mean(share + change[changed]))
        message = f"{side} side: {words}: {_left_words(np.exp(after), np.exp(before))}"
        remedy = "check names, order and signs of the columns in the map, of angle and torque"
        steps.append(warning(code, message, remedy))
        if after - before < np.log(BETTER) and after < np.log(EXPLAINED):
            # What is only better beside another one comes before it.
            found = [*steps]
        q, dq, ddq = (angles(rate) for rate in motion[:3])
        motion = _SideMotion(q, dq, ddq, torques(motion.torque), motion.measured)
    return found


_Way = tuple[str, str, _Change]


def _arrangements(joints: Sequence[str], measured: Sequence[int]) -> Iterator[tuple[_Change, list[_Way]]]:
    """Yield what may have been confused: how angles (…, n) come right, and how torques do beside it."""

    every, plain = np.arange(len(joints)), np.ones(len(joints))
    same = _Change(every, plain)
    alone: list[_Way] = []
    for j, name in enumerate(joints):
        mirrored = _Change(every, np.where(every == j, -1.0, 1.0))
        both = f"{name} turns the other way than described, its angle and its torque have the other sign"
        angle = f"the angle of {name} has the other sign than described"
        yield mirrored, [("mirrored", both, mirrored), ("mirrored", angle, same)]
        if j in measured:
            alone.append(("gravity_sign", f"the torque of {name} has the other sign than described", mirrored))
    pairs = [[i, j] for i, j in combinations(measured, 2)]
    for old in [*pairs, *([list(measured)] if len(measured) > 3 else [])]:
        exchanged = _Change(every.copy(), plain)
        exchanged.order[old] = old[::-1]
        names = " and ".join(joints[k] for k in old)
        whose = f"of {names} seem to be exchanged" if len(old) == 2 else "are in the reversed order of joints"
        yield exchanged, [("exchanged", f"all channels {whose}", exchanged)]
        alone.append(("exchanged", f"efforts {whose}", exchanged))
    yield same, alone


def _squares(motion: _SideMotion, Y: Array) -> tuple[Array, Array, Array]:
    """Return what free masses leave of the torques' squares (m,), what there is, and independent samples of the rest.

    Each joint has its own friction, zero, motor inertia and noise.
    """
    bases = {j: _own(motion, j) for j in motion.measured}
    columns = [Y[:, j] - basis @ (basis.T @ Y[:, j]) for j, basis in bases.items()]
    torques = [motion.torque[:, j] - basis @ (basis.T @ motion.torque[:, j]) for j, basis in bases.items()]
    grams, rights = [c.T @ c for c in columns], [c.T @ t for c, t in zip(columns, torques, strict=True)]
    power = np.array([float(t @ t) for t in torques])
    squares, rest = power, torques
    # Weighted by what is left before; three rounds are enough.
    for _ in range(3):
        gram, right = (sum(each / s for each, s in zip(parts, squares, strict=True)) for parts in (grams, rights))
        scale = 1.0 / np.sqrt(np.diag(gram) + 1e-12 * np.diag(gram).max())
        inverse = np.linalg.pinv(scale[:, None] * gram * scale, rcond=RANK, hermitian=True)
        rest = [t - c @ (scale * (inverse @ (scale * right))) for c, t in zip(columns, torques, strict=True)]
        squares = np.array([float(each @ each) for each in rest]) + 1e-12 * power
    return squares, power, np.array([_independent(each, each) for each in rest])


def _size(fit: GravityFit, side: str) -> list[Finding]:
    """Return whether torques that certainly follow gravity are far larger or smaller than described."""
    factor = fit.factor
    if not fit.certain or factor < 0.0 or FAR[0] <= factor <= FAR[1]:
        return []
    message = (
        f"{side} effort follows the gravity that the description predicts (correlation {fit.correlation:.3g}), but is "
        f"{factor:.3g} times the described one"
    )
    remedy = "check its unit (Nm, Nm_motor with its ratio, A), that of the angles, and the masses of the description"
    if LIKE_DEGREES[0] < factor < LIKE_DEGREES[1]:
        remedy += "; angles in radians taken for degrees are 57 times too small, and so is gravity then"
    elif LIKE_KILO[0] < factor < LIKE_KILO[1]:
        remedy += "; torques in kNm taken for Nm are 1000 times too small"
    return [warning("gravity_size", message, remedy)]


def _judged(fit: GravityFit, side: str, robot: Robot) -> list[Finding]:
    """Return what the torques of a side show: another direction or sign of gravity, none of it, or nothing."""
    columns, target = fit.pull.reshape(-1, 3), fit.torque.ravel()
    shown: Any = np.linalg.lstsq(columns, target, rcond=None)[0]
    left, straight = (float(np.sum((target - columns @ g) ** 2)) for g in (shown, fit.factor * robot.gravity))
    turned, size = angle_between(shown, robot.gravity), float(np.linalg.norm(shown) / np.linalg.norm(robot.gravity))
    if left < LEFT * straight and turned > TURNED and SIZE[0] < size < SIZE[1]:
        numbers = (" ".join(f"{value:.3g}" for value in each) for each in (shown, robot.gravity))
        message = "{} effort shows gravity of {} m/s², where the description has {}".format(side, *numbers)
        remedy = "the arm is mounted otherwise (base in its arm file; identify and diagnose look for it themselves)"
        return [warning("mounting", message, remedy)]
    times = f"{fit.factor:.3g} times the described one, correlation {fit.correlation:.3g}"
    if fit.certain and FACTOR[0] < -fit.factor < FACTOR[1]:
        message = f"{side} effort runs against the gravity that the description predicts ({times})"
        remedy = "either all torques have the wrong sign (sign: -1 in the map), or the arm hangs upside down (base in "
        return [warning("gravity_sign", message, f"{remedy}its arm file); gravity alone does not tell the two apart")]
    if fit.missing:
        part = "no" if abs(fit.factor) < FAR[0] else "a part only of the"
        message = f"{side} effort holds {part} gravity that the description predicts ({times})"
        remedy = "it was subtracted before the torque was recorded, or something else carries the arm: record all of it"
        return [warning("gravity_missing", message, f"{remedy}, or describe what does (gravity_compensation)")]
    return []


def angle_between(one: Array, other: Array) -> float:
    """Return the angle between two vectors (3,), rad."""
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.arccos(np.clip(one @ other / max(size, 1e-300), -1.0, 1.0)))
