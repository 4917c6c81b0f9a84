"""Torques against the gravity that the arm's description predicts: signs and mountings that are not as taken.

Of each joint's torque a zero, friction, the inertia as described and that of its motor are regressed out, and the same
of the gravity torque as described. What is left of the two should rise together. Where it runs against each other, a
torque or an angle has the wrong sign, or the arm is mounted otherwise. Where it rises far more or less, a unit is not
what it is taken for; where the torque of one joint follows the gravity of another, two columns have been exchanged.

Slow samples resemble each other: N of them are worth as few independent ones as the two series' autocorrelations say
(M. S. Bartlett, Journal of the Royal Statistical Society 98 (1935) 536).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve, savgol_filter
from scipy.stats import t as student

from elastic_arm.effects.equations import ArmEquations
from elastic_arm.recording.inspection.plausibility import is_motion, listed, span_of
from elastic_arm.recording.inspection.report import Finding
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, Samples
from elastic_arm.robot import Robot

FEWEST = 200  # samples; below, nothing is concluded
SHORTEST = 1.0  # s; the ends that differentiation spoils take 0.2 s
ENOUGH = 5000  # samples that are looked at; bounds the time
WINDOW = 0.1  # s over which positions are differentiated: gravity changes more slowly
STANDSTILL = 0.01  # rad/s within which friction turns over; convention
AGAINST = -0.5  # correlation; a description that is right, masses aside, gives none below zero
CHANCE = 0.01  # probability that unrelated torques correlate so; convention
PLAIN = -0.9  # correlation of further joints beside one that is certain; convention
# Of the largest gravity among the joints: less of it, as wrists have, a payload beside their axis turns over.
CONSIDERABLE = 0.05
# Times the described gravity: of a sign alone -1, and masses are off. Beyond, something else than gravity is at work.
FACTOR = (1.0 / 3.0, 3.0)
# Of all joints together; beyond, a unit is mistaken. Masses of a description are not off by so much; convention.
FAR = (0.2, 5.0)
LIKE_DEGREES = (57.3 / 2.5, 57.3 * 2.5)  # masses are off, and a small angle is not a small part of a sine
LIKE_KILO = (0.5e-3, 2e-3)
CLEARLY = 0.2  # of the squares that the joint's own torque leaves of its gravity; convention
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


@dataclass(frozen=True)
class GravityFit:
    """Torques of one side beside the described gravity, less what is not gravity.

    Parameters
    ----------
    torque, gravity : (N, n)
        What is left of the measured torque and of the gravity torque as described, Nm; zero where there is neither.
    pull : (N, n, 3)
        What is left of the derivative of the described one by the gravity vector, Nm per m/s².
    correlation, factor : (n,)
        Of the two, and of the torque over the described one; zero where there is no gravity.
    chance : (n,)
        Probability that unrelated series correlate as much with this sign.
    others : (3, n, n)
        Correlation, factor and chance of the torque of each joint (row) with the gravity of each joint (column).
    """

    torque: Array
    gravity: Array
    pull: Array
    correlation: Array
    factor: Array
    chance: Array
    others: Array

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


def contradicted_gravity(recording: Recording, robot: Robot) -> list[Finding]:
    """Return which torques are at odds with the gravity of the description.

    They run against it, "gravity_sign"; show another direction, "mounting"; are far larger or smaller, "gravity_size";
    or are those of another joint, "exchanged".

    Parameters
    ----------
    recording
        Of the arm; without damaged samples.
    robot
        Its description.
    """
    fits = _fits(recording, robot)
    return [finding for side, fit in fits.items() for finding in _judged(fit, side, robot)]


def opposed_joints(recording: Recording, robot: Robot) -> tuple[str, ...]:
    """Return the joints whose torque runs against gravity as described, and the arm is not mounted otherwise.

    Parameters
    ----------
    recording, robot
        As of :func:`contradicted_gravity`.
    """
    opposed = np.zeros(robot.n, dtype=bool)
    for side, fit in _fits(recording, robot).items():
        if any(finding.code == "gravity_sign" for finding in _judged(fit, side, robot)):
            opposed |= fit.against
    return tuple(name for name, against in zip(robot.joint_names, opposed.tolist(), strict=True) if against)


def _fits(recording: Recording, robot: Robot) -> dict[str, GravityFit]:
    """Return the torques of each side beside the described gravity, by side; none of a recording without motion."""
    samples = recording.select(robot.joint_names).samples()
    position = samples.q if samples.q is not None else samples.theta
    if position is None or len(samples) < FEWEST or not np.any(robot.gravity):
        return {}
    if not is_motion(samples.t, position) or samples.t[-1] < SHORTEST:
        return {}
    fits = {
        side: fit_gravity(samples, position, channel, robot)
        for channel, side in SIDES.items()
        if getattr(samples, channel) is not None
    }
    return {side: fit for side, fit in fits.items() if fit.gravity.any()}


def wrong_torques(recording: Recording, robot: Robot) -> list[str]:
    """Return in words which torques cannot belong to gravity as described; another mounting is looked for elsewhere."""
    return [found.message for found in contradicted_gravity(recording, robot) if found.code != "mounting"]


def fit_gravity(samples: Samples, position: Array, channel: str, robot: Robot) -> GravityFit:
    """Compare the torques of one channel with described gravity.

    Parameters
    ----------
    samples
        Of the recording.
    position : (N, n)
        Angles of the links, rad.
    channel
        "tau_J" or "tau_m".
    robot
        The description.
    """
    step, n = float(np.median(np.diff(samples.t))), robot.n
    width = max(round(WINDOW / step) // 2 * 2 + 1, 5)
    dq, ddq = (savgol_filter(position, width, 3, deriv=k, delta=step, axis=0) for k in (1, 2))
    every = slice(width, -width, max(1, len(position) // ENOUGH))
    q, dq, ddq, torque = (values[every] for values in (position, dq, ddq, getattr(samples, channel)))
    equations = ArmEquations(robot)
    states = (np.hstack([rate, rate]) for rate in (q, dq, ddq)) if robot.elastic else (q, dq, ddq)
    moved, pull = equations.moved_and_pulled(*states, motors=channel == "tau_m")
    left, weight = np.zeros_like(torque), np.zeros_like(pull)
    related = np.tile(np.array([0.0, 0.0, 1.0])[:, None, None], (1, n, n))
    measured = [j for j in range(n) if (channel, j) not in samples.lacking]
    least = RANK * float(np.abs(pull @ robot.gravity).max())
    for j in measured:
        friction = np.tanh(dq[:, j] / STANDSTILL)
        others = _orthonormal([np.ones(len(q)), friction, dq[:, j], ddq[:, j], moved[:, j]])
        beside, weight[:, j] = (rows - others @ (others.T @ rows) for rows in (torque, pull[:, j]))
        left[:, j], gravity = beside[:, j], weight[:, j] @ robot.gravity
        # What rounding leaves of the gravity of a joint that has none is no gravity.
        if np.abs(gravity).max() >= least:
            for i in measured:
                related[:, i, j] = _related(beside[:, i], gravity)
    gravity = weight @ robot.gravity
    gravity[:, np.abs(gravity).max(axis=0) < least] = 0.0
    correlation, factor, chance = np.diagonal(related, axis1=1, axis2=2)
    return GravityFit(left, gravity, weight, correlation, factor, chance, related)


def _orthonormal(columns: Sequence[Array]) -> Array:
    """Return an orthonormal basis (N, r) of what columns (N,) span."""
    scaled = np.column_stack([column / max(float(np.linalg.norm(column)), 1e-300) for column in columns])
    basis, sizes, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(basis[:, sizes > RANK * sizes[0]])


def _related(torque: Array, gravity: Array) -> tuple[float, float, float]:
    """Return correlation, factor and probability of chance of two series (N,); of none where there is no gravity."""
    powers = float(torque @ torque), float(gravity @ gravity)
    if min(powers) <= 0.0:
        return 0.0, 0.0, 1.0
    both = float(torque @ gravity)
    correlation = both / np.sqrt(powers[0] * powers[1])
    alike = [fftconvolve(each, each[::-1])[len(each) :] / (each @ each) for each in (torque, gravity)]
    free = len(torque) / max(1.0, 1.0 + 2.0 * float(alike[0] @ alike[1])) - 2.0
    if free <= 0.0:
        return correlation, both / powers[1], 1.0
    size = abs(correlation) * np.sqrt(free / max(1.0 - correlation**2, 1e-12))
    return correlation, both / powers[1], float(student.sf(size, free))


def _judged(fit: GravityFit, side: str, robot: Robot) -> list[Finding]:
    """Return what the torques of a side show: gravity of another joint, direction, sign or size, or nothing."""
    if exchanged := _exchanged(fit, side, robot):
        return exchanged
    shown, left = _free_gravity(fit, robot)
    signs = np.where(fit.correlation < 0.0, -1.0, 1.0) * fit.gravity
    by_sign = fit.torque - signs * float(np.sum(signs * fit.torque) / np.sum(signs**2))
    turned, size = angle_between(shown, robot.gravity), float(np.linalg.norm(shown) / np.linalg.norm(robot.gravity))
    if left < LEFT * float(np.sum(by_sign**2)) and turned > TURNED and SIZE[0] < size < SIZE[1]:
        numbers = (" ".join(f"{value:.3g}" for value in each) for each in (shown, robot.gravity))
        message = "{} effort shows gravity of {} m/s², where the description has {}".format(side, *numbers)
        remedy = "the arm is mounted otherwise (base in its arm file; identify and diagnose look for it themselves)"
        return [Finding("warning", "mounting", f"{message}: {remedy}")]
    against, along = fit.against, fit.along
    if not against.any():
        return _size(fit, side, robot)
    joints = listed(robot.joint_names, against)
    message = (
        f"{side} effort of {joints} runs against the gravity that the description predicts (correlation "
        f"{span_of(fit.correlation[against])}): measured gravity is {span_of(fit.factor[against])} times the described "
        "one"
    )
    if turned > OVERHEAD and not along.any():
        return [Finding("warning", "gravity_sign", f"{message}: {EITHER}")]
    if along.any():
        message += f", and at {listed(robot.joint_names, along)} it has the described sign"
    remedy = f"check the sign of {joints} in the map, of the torque (sign) and of the angle, or what it carries"
    return [Finding("warning", "gravity_sign", f"{message}: {remedy}")]


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
    return [Finding("warning", "gravity_size", f"{message}: {remedy}")]


def _exchanged(fit: GravityFit, side: str, robot: Robot) -> list[Finding]:
    """Return which torques follow the gravity of another joint, while its own torque does not."""
    correlation, factor, chance = fit.others
    left = 1.0 - correlation**2
    usual = (factor > FACTOR[0]) & (factor < FACTOR[1]) & (chance < CHANCE) & (correlation > -PLAIN)
    own = np.diagonal(usual)
    # One that follows its own gravity is in its place, however alike those of two parallel axes are.
    other = usual & fit.heavy & (left < CLEARLY * np.diagonal(left)) & ~own & ~own[:, None]
    pairs = [(i, j) for i, j in np.argwhere(other & other.T).tolist() if i < j]
    if not pairs:
        return []
    names, words = robot.joint_names, []
    for i, j in pairs:
        swapped, alone = (
            (f"{one:.3g} and {other:.3g}")
            for one, other in ((correlation[i, j], correlation[j, i]), (correlation[i, i], correlation[j, j]))
        )
        whose = f"that of {names[i]} follows the gravity that the description predicts for {names[j]} and vice versa"
        words.append(f"{whose} (correlations {swapped}; with their own ones {alone})")
    message = f"{side} effort of two joints seems to be exchanged: {'; '.join(words)}"
    return [Finding("warning", "exchanged", f"{message}: check the order of the columns, or of the joints, in the map")]


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
