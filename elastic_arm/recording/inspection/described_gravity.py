"""Torques against what the arm's description predicts: signs, places and mountings that are not as taken.

Of each joint's torque a zero, friction, the inertia as described and that of its motor are regressed out, and the same
of the gravity torque as described. What is left of the two should rise together. Where it runs against each other, a
torque or an angle has the wrong sign, or the arm is mounted otherwise. Where it rises far more or less, a unit is not
what it is taken for; where it hardly rises at all, gravity has been taken out of the torque before it was recorded.

Joints that turn the other way, and channels of two joints that were exchanged, are tried: masses and inertias are left
free, tau = Y(q, dq, ddq) pi, so that what tells is the geometry alone, however wrong the described masses are.

Slow samples resemble each other: N of them are worth as few independent ones as the two series' autocorrelations say
(M. S. Bartlett, Journal of the Royal Statistical Society 98 (1935) 536).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve, savgol_filter
from scipy.stats import t as student

from elastic_arm.dynamics import build_model
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.recording.inspection.plausibility import is_motion
from elastic_arm.recording.inspection.report import Finding, warning
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, Samples, listed, span_of
from elastic_arm.robot import Robot

FEWEST = 200  # samples; below, nothing is concluded
SHORTEST = 1.0  # s; the ends that differentiation spoils take 0.2 s
ENOUGH = 5000  # samples that are looked at; bounds the time
TRIED = 500  # of them, with every other arrangement
WINDOW = 0.1  # s over which positions are differentiated: gravity changes more slowly
STANDSTILL = 0.01  # rad/s within which friction turns over; convention
AGAINST = -0.5  # correlation; a description that is right, masses aside, gives none below zero
CHANCE = 0.01  # probability that unrelated torques correlate so; convention
PLAIN = -0.9  # correlation of further joints beside one that is certain; convention
# Of the largest gravity among the joints: less of it, as wrists have, a payload beside their axis turns over.
CONSIDERABLE = 0.05
# Times the described gravity: of a sign alone -1, and masses are off. Beyond, something else than gravity is at work.
FACTOR = (1.0 / 3.0, 3.0)
MISSING = 0.5  # times the described gravity; below for certain it was taken out, in part at least
# Of all joints together; beyond, a unit is mistaken. Masses of a description are not off by so much; convention.
FAR = (0.2, 5.0)
LIKE_DEGREES = (57.3 / 2.5, 57.3 * 2.5)  # masses are off, and a small angle is not a small part of a sine
LIKE_KILO = (0.5e-3, 2e-3)
# Another direction of gravity, here and where `identification.batch.mounting` looks for it; conventions.
TURNED = 0.35  # rad from the described direction: beyond the tilts that linear columns describe
SIZE = (0.6, 1.5)  # of the described gravity: masses are off as well
LEFT = 0.3  # of the squares that the described direction leaves
OVERHEAD = 0.75 * np.pi  # rad: nearer to upside down, which all signs together are, too, than to any side
EITHER = (
    "either all torques have the wrong sign (sign: -1 in the map), or the arm hangs upside down (base in its arm "
    "file); gravity alone does not tell the two apart"
)
RANK = 1e-9  # of the largest singular value; numerical
SIDES = {"tau_J": "link", "tau_m": "motor"}
# Another arrangement is named where it is e^10 times as likely, and leaves a tenth of the torques that it changes.
CERTAIN, EXPLAINED = 10.0, 0.1
NO_TORQUE = 1e-9  # Nm; what changes less is none
CHANGED = 0.1  # of the logarithm of what is left


class _Motion(NamedTuple):
    """Angles, rates, accelerations and torques (N, n) of a side, and the joints whose torque was measured."""

    q: Array
    dq: Array
    ddq: Array
    torque: Array
    measured: list[int]


@dataclass(frozen=True)
class GravityFit:
    """Torques of one side beside the described gravity, less what is not gravity."""

    # (N, n) What is left of the measured torque and of the gravity torque as described, Nm; zero where there is
    # neither
    torque: Array
    gravity: Array
    pull: Array  # (N, n, 3) What is left of the derivative of the described one by the gravity vector, Nm per m/s²
    # (n,) Of the two; of the torque over the described one, with its deviation. Zero where there is no gravity.
    correlation: Array
    factor: Array
    std: Array
    chance: Array  # (n,) Probability that unrelated series correlate as much with this sign

    @property
    def against(self) -> NDArray[np.bool_]:
        """Which joints (n,) certainly have gravity of the other sign, and which beside them plainly have."""
        size = -self.factor
        usual = (size > FACTOR[0]) & (size < FACTOR[1])
        certain = usual & (self.correlation < AGAINST) & (self.chance < CHANCE)
        heavy = self.heavy
        plain = usual & (self.correlation < PLAIN) & heavy
        # All of them together are no payload.
        found = certain & (heavy | (not self.along.any()))
        return (found | plain) if (certain & heavy).any() else np.zeros_like(certain)

    @property
    def along(self) -> NDArray[np.bool_]:
        """Which joints (n,) certainly have gravity of the described sign."""
        return (self.correlation > -AGAINST) & (self.chance < CHANCE)

    @property
    def heavy(self) -> NDArray[np.bool_]:
        """Which joints (n,) carry a gravity that counts beside the largest."""
        spread = self.gravity.std(axis=0)
        return np.asarray(spread > CONSIDERABLE * spread.max())

    @property
    def missing(self) -> NDArray[np.bool_]:
        """Which joints (n,) certainly have much less gravity than described, and not that of the other sign."""
        least, most = self.factor - 3.0 * self.std, self.factor + 3.0 * self.std
        return self.heavy & (most < MISSING) & (least > -MISSING)


def contradicted_gravity(recording: Recording, robot: Robot) -> list[Finding]:
    """Return which torques are at odds with the description.

    They belong to another joint or way to turn, "exchanged", "mirrored"; run against gravity, "gravity_sign"; show
    another direction, "mounting"; are far larger or smaller, "gravity_size"; or hold no gravity, "gravity_missing".
    """
    found = []
    for side, motion, fit in _fits(recording, robot):
        if fit.gravity.any():
            found += _size(fit, side, robot) or _arranged(motion, side, robot) or _judged(fit, side, robot)
    return found


def opposed_joints(recording: Recording, robot: Robot) -> tuple[str, ...]:
    """Return the joints whose torque runs against gravity as described, and the arm is not mounted otherwise."""
    opposed = np.zeros(robot.n, dtype=bool)
    for side, _, fit in _fits(recording, robot):
        if fit.gravity.any() and any(finding.code == "gravity_sign" for finding in _judged(fit, side, robot)):
            opposed |= fit.against
    return tuple(name for name, against in zip(robot.joint_names, opposed.tolist(), strict=True) if against)


def _fits(recording: Recording, robot: Robot) -> Iterator[tuple[str, _Motion, GravityFit]]:
    """Yield the torques of each side, and beside the described gravity; none of a recording without motion."""
    samples = recording.select(robot.joint_names).samples()
    position = samples.q if samples.q is not None else samples.theta
    if position is None or len(samples) < FEWEST or samples.t[-1] < SHORTEST or not is_motion(samples.t, position):
        return
    for channel, side in SIDES.items():
        if getattr(samples, channel) is not None:
            motion = _motion(samples, position, channel)
            yield side, motion, _fit_gravity(motion, robot, motors=side == "motor")


def _motion(samples: Samples, position: Array, channel: str) -> _Motion:
    step = float(np.median(np.diff(samples.t)))
    width = max(round(WINDOW / step) // 2 * 2 + 1, 5)
    dq, ddq = (savgol_filter(position, width, 3, deriv=k, delta=step, axis=0) for k in (1, 2))
    # Across a hole there is no derivative.
    half = width // 2
    apart = np.flatnonzero(np.diff(samples.t) > 2.5 * step)
    holes = np.zeros(len(position), np.bool_)
    for row in apart.tolist():
        holes[max(row - half, 0) : row + half + 2] = True
    rows = np.flatnonzero(~holes)[width:-width]
    rows = rows[:: max(1, len(rows) // ENOUGH)]
    measured = [j for j in range(position.shape[1]) if (channel, j) not in samples.lacking]
    torque: Array = getattr(samples, channel)
    return _Motion(position[rows], dq[rows], ddq[rows], torque[rows], measured)


def _fit_gravity(motion: _Motion, robot: Robot, *, motors: bool) -> GravityFit:
    """Compare the torques of one side with described gravity."""
    states = (np.hstack([rate, rate]) if robot.elastic else rate for rate in motion[:3])
    moved, pull = ArmEquations(robot).moved_and_pulled(*states, motors=motors)
    left, weight = np.zeros_like(motion.torque), np.zeros_like(pull)
    related = np.tile(np.array([0.0, 0.0, 0.0, 1.0])[:, None], (1, robot.n))
    least = RANK * float(np.abs(pull @ robot.gravity).max())
    for j in motion.measured:
        basis = _own(motion, j, moved[:, j])
        left[:, j], weight[:, j] = (rows - basis @ (basis.T @ rows) for rows in (motion.torque[:, j], pull[:, j]))
        gravity = weight[:, j] @ robot.gravity
        # What rounding leaves of the gravity of a joint that has none is no gravity.
        if np.abs(gravity).max() >= least:
            related[:, j] = _related(left[:, j], gravity)
    gravity = weight @ robot.gravity
    gravity[:, np.abs(gravity).max(axis=0) < least] = 0.0
    return GravityFit(left, gravity, weight, *related)


def _own(motion: _Motion, j: int, *more: Array) -> Array:
    """Return an orthonormal basis (N, r) of a joint's zero, friction and motor inertia, and of further columns."""
    friction = np.tanh(motion.dq[:, j] / STANDSTILL)
    columns = [np.ones(len(friction)), friction, motion.dq[:, j], motion.ddq[:, j], *more]
    scaled = np.column_stack([column / max(float(np.linalg.norm(column)), 1e-300) for column in columns])
    basis, sizes, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(basis[:, sizes > RANK * sizes[0]])


def _related(torque: Array, gravity: Array) -> tuple[float, float, float, float]:
    """Return correlation, factor, its deviation and probability of chance of two series (N,)."""
    powers = float(torque @ torque), float(gravity @ gravity)
    if min(powers) <= 0.0:
        return 0.0, 0.0, 0.0, 1.0
    both = float(torque @ gravity)
    correlation, factor = both / np.sqrt(powers[0] * powers[1]), both / powers[1]
    alike = [fftconvolve(each, each[::-1])[len(each) :] / (each @ each) for each in (torque, gravity)]
    free = len(torque) / max(1.0, 1.0 + 2.0 * float(alike[0] @ alike[1])) - 2.0
    if free <= 0.0:
        return correlation, factor, np.inf, 1.0
    left = max(1.0 - correlation**2, 1e-12)
    size = abs(correlation) * np.sqrt(free / left)
    return correlation, factor, float(np.sqrt(powers[0] / powers[1] * left / free)), float(student.sf(size, free))


def _arranged(motion: _Motion, side: str, robot: Robot) -> list[Finding]:
    """Return which joints turn the other way, or have their channels exchanged, as the geometry shows it."""
    n, found = robot.n, []
    if len(motion.measured) < n or n < 2 or len(motion.q) < FEWEST or (np.ptp(motion.torque, axis=0) < NO_TORQUE).any():
        return []
    motion = motion._replace(**{k: getattr(motion, k)[:: max(1, len(motion.q) // TRIED)] for k in motion._fields[:4]})
    model = build_model(robot)

    def regressor(q: Array, dq: Array, ddq: Array) -> Array:
        if robot.elastic:
            q, dq, ddq = (np.hstack([rate, rate]) for rate in (q, dq, ddq))
        Y = model.regressor(q, dq, ddq)
        return np.asarray(Y[:, :n] + (Y[:, n:] if robot.elastic and side == "motor" else 0.0))

    left, power, free = _squares(motion, regressor)
    for _ in range(n):
        tried = []
        for words, code, angles, torques in _arrangements(robot.joint_names):
            q, dq, ddq = (angles(rate) for rate in motion[:3])
            other = _Motion(q, dq, ddq, torques(motion.torque), motion.measured)
            squares, *_ = _squares(other, regressor)
            change = np.log(_back(torques, squares, n) / left)
            tried.append((0.5 * float(free @ change), change, words, code, other))
        odds, change, words, code, other = min(tried, key=lambda each: each[0])
        changed = np.abs(change) > CHANGED
        if -odds < CERTAIN or not changed.any():
            break
        before, after = (
            float(np.exp(np.mean(np.log(x[changed])))) for x in (left / power, left * np.exp(change) / power)
        )
        # A torque that has the wrong sign is for gravity to say.
        if after > 100.0 * EXPLAINED or not code:
            break
        message = f"{side} side: {words}: so {after:.2g} % of the torques' squares are left, as given {before:.2g} %"
        remedy = "check names, order and signs of the columns in the map, of angle and torque"
        found.append(warning(code, message, remedy))
        motion = other
        left, power, free = _squares(motion, regressor)
    return found


def _arrangements(
    names: Sequence[str],
) -> Iterator[tuple[str, str, Callable[[Array], Array], Callable[[Array], Array]]]:
    """Yield what may have been confused: in words, as a code, and how angles and torques (N, n) come right."""

    def same(values: Array) -> Array:
        return values

    for j, name in enumerate(names):
        sign = np.ones(len(names))
        sign[j] = -1.0

        def mirrored(values: Array, sign: Array = sign) -> Array:
            return sign * values

        yield (
            f"{name} turns the other way than described, its angle and its torque have the other sign",
            "mirrored",
            mirrored,
            mirrored,
        )
        yield f"the angle of {name} has the other sign than described", "mirrored", mirrored, same
        yield f"the torque of {name} has the other sign", "", same, mirrored
    for i, j in combinations(range(len(names)), 2):
        order = list(range(len(names)))
        order[i], order[j] = j, i

        def exchanged(values: Array, order: Sequence[int] = tuple(order)) -> Array:
            return values[..., list(order)]

        both = f"{names[i]} and {names[j]}"
        yield f"effort of {both} seems to be exchanged", "exchanged", same, exchanged
        yield f"all channels of {both} seem to be exchanged", "exchanged", exchanged, exchanged


def _back(torques: Callable[[Array], Array], squares: Array, n: int) -> Array:
    """Return squares (n,) by the columns of the torques as they were given."""
    return squares[np.argsort(np.abs(torques(np.arange(1.0, n + 1.0)[None])[0]))]


def _squares(motion: _Motion, regressor: Callable[[Array, Array, Array], Array]) -> tuple[Array, Array, Array]:
    """Return what free masses leave of the torques' squares (n,), what there is, and independent samples of the rest.

    Each joint has its own friction, zero, motor inertia and noise.
    """
    Y, n = regressor(*motion[:3]), len(motion.measured)
    bases = [_own(motion, j) for j in range(n)]
    columns = [Y[:, j] - basis @ (basis.T @ Y[:, j]) for j, basis in enumerate(bases)]
    torques = [motion.torque[:, j] - basis @ (basis.T @ motion.torque[:, j]) for j, basis in enumerate(bases)]
    grams, rights = [c.T @ c for c in columns], [c.T @ t for c, t in zip(columns, torques, strict=True)]
    power = np.array([float(t @ t) for t in torques]) + 1e-300
    squares, rest = power, torques
    # Weighted by what is left before; three rounds are enough.
    for _ in range(3):
        gram, right = (sum(each / s for each, s in zip(parts, squares, strict=True)) for parts in (grams, rights))
        scale = 1.0 / np.sqrt(np.diag(gram) + 1e-12 * np.diag(gram).max())
        inverse = np.linalg.pinv(scale[:, None] * gram * scale, rcond=RANK, hermitian=True)
        rest = [t - c @ (scale * (inverse @ (scale * right))) for c, t in zip(columns, torques, strict=True)]
        squares = np.array([float(each @ each) for each in rest]) + 1e-300
    alike = [fftconvolve(each, each[::-1])[len(each) :] / s for each, s in zip(rest, squares, strict=True)]
    free = np.array([len(each) / (1.0 + 2.0 * float(a @ a)) for each, a in zip(rest, alike, strict=True)])
    return squares, power, free


def _judged(fit: GravityFit, side: str, robot: Robot) -> list[Finding]:
    """Return what the torques of a side show: another direction, sign or size of gravity, none of it, or nothing."""
    shown, left = _free_gravity(fit, robot)
    signs = np.where(fit.correlation < 0.0, -1.0, 1.0) * fit.gravity
    by_sign = fit.torque - signs * float(np.sum(signs * fit.torque) / np.sum(signs**2))
    turned, size = angle_between(shown, robot.gravity), float(np.linalg.norm(shown) / np.linalg.norm(robot.gravity))
    if left < LEFT * float(np.sum(by_sign**2)) and turned > TURNED and SIZE[0] < size < SIZE[1]:
        numbers = (" ".join(f"{value:.3g}" for value in each) for each in (shown, robot.gravity))
        message = "{} effort shows gravity of {} m/s², where the description has {}".format(side, *numbers)
        remedy = "the arm is mounted otherwise (base in its arm file; identify and diagnose look for it themselves)"
        return [warning("mounting", message, remedy)]
    against, along = fit.against, fit.along
    if not against.any():
        return _missing(fit, side, robot)
    joints = listed(robot.joint_names, against)
    message = (
        f"{side} effort of {joints} runs against the gravity that the description predicts (correlation "
        f"{span_of(fit.correlation[against])}): measured gravity is {span_of(fit.factor[against])} times the described "
        "one"
    )
    if turned > OVERHEAD and not along.any():
        return [warning("gravity_sign", message, EITHER)]
    if along.any():
        message += f", and at {listed(robot.joint_names, along)} it has the described sign"
    remedy = f"check the sign of {joints} in the map, of the torque (sign) and of the angle, or what it carries"
    return [warning("gravity_sign", message, remedy)]


def _size(fit: GravityFit, side: str, robot: Robot) -> list[Finding]:
    """Return whether the torques that certainly follow gravity are together far larger or smaller than described."""
    sure = fit.along & fit.heavy
    if not sure.any():
        return []
    gravity = fit.gravity[:, sure]
    factor = float(np.sum(gravity * fit.torque[:, sure]) / np.sum(gravity**2))
    if FAR[0] <= factor <= FAR[1]:
        return []
    message = (
        f"{side} effort of {listed(robot.joint_names, sure)} follows the gravity that the description predicts "
        f"(correlation {span_of(fit.correlation[sure])}), but is {factor:.3g} times the described one"
    )
    remedy = "check its unit (Nm, Nm_motor with its ratio, A), that of the angles, and the masses of the description"
    if LIKE_DEGREES[0] < factor < LIKE_DEGREES[1]:
        remedy += "; angles in radians taken for degrees are 57 times too small, and so is gravity then"
    elif LIKE_KILO[0] < factor < LIKE_KILO[1]:
        remedy += "; torques in kNm taken for Nm are 1000 times too small"
    return [warning("gravity_size", message, remedy)]


def _missing(fit: GravityFit, side: str, robot: Robot) -> list[Finding]:
    """Return of which joints the torque holds no gravity, or a part of it only."""
    missing = fit.missing
    if not missing.any():
        return []
    whole = bool((np.abs(fit.factor[missing]) < FAR[0]).all())
    words = (
        f"{side} effort of {listed(robot.joint_names, missing)} holds {'no' if whole else 'a part only of the'} gravity"
    )
    numbers = f"{span_of(fit.factor[missing])} times it, correlation {span_of(fit.correlation[missing])}"
    message = f"{words} that the description predicts ({numbers})"
    remedy = "gravity compensation was subtracted before the torque was recorded: record the whole torque"
    return [warning("gravity_missing", message, f"{remedy}, or compare masses of the description")]


def _free_gravity(fit: GravityFit, robot: Robot) -> tuple[Array, float]:
    """Return the gravity (3,), m/s², that explains the torques of joints that turn best, and the squares it leaves."""
    turning = [not joint.prismatic for joint in robot.joints]
    columns, target = fit.pull[:, turning].reshape(-1, 3), fit.torque[:, turning].ravel()
    shown: Any = np.linalg.lstsq(columns, target, rcond=None)[0]
    return shown, float(np.sum((target - columns @ shown) ** 2) + np.sum(fit.torque[:, np.logical_not(turning)] ** 2))


def angle_between(one: Array, other: Array) -> float:
    """Return the angle between two vectors (3,), rad."""
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.arccos(np.clip(one @ other / max(size, 1e-300), -1.0, 1.0)))
