"""Compare recorded torques with the gravity that the arm's description predicts, to find wrong
signs, exchanged joints, wrong units and another mounting.

From the torque of each joint and from its described gravity torque, the following are regressed
out: a zero, friction, the described inertia, and the inertia of the motor. The two remainders
should have a positive correlation. If it is negative, all torques have the wrong sign or the arm is
mounted upside down. If one remainder is far larger than the other, a unit is wrong. If the torque
has no such part, gravity was subtracted before the torque was recorded. Successive samples are
correlated: N samples count as the number of independent ones.

`arrangements.py` tries further hypotheses one by one, by the likelihood of the torques in
`torque_likelihood.py`.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import chain
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from elastic_arm.arrays import rms
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.formatting import short_numbers
from elastic_arm.recording.inspection.arrangements import (
    MISSING,
    TAKEN,
    arranged,
    sized,
    upside_down,
)
from elastic_arm.recording.inspection.report import Finding, warning
from elastic_arm.recording.inspection.side_motion import (
    RANK,
    Motions,
    SideMotion,
    independent,
    side_motions,
    together,
)
from elastic_arm.recording.inspection.torque_likelihood import Arm
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array
from elastic_arm.robot import Robot

CHANCE = 0.01  # probability that unrelated torques correlate so; convention
# Times the described gravity: of a sign alone -1, and masses are off. Beyond, something else than
# gravity is at work.
FACTOR = (1.0 / 3.0, 3.0)
# Beyond, a unit is mistaken. Masses of a description are not off by so much; convention.
FAR = (0.2, 5.0)
# masses are off, and a small angle is not a small part of a sine
LIKE_DEGREES = (57.3 / 2.5, 57.3 * 2.5)
LIKE_KILO = (0.5e-3, 2e-3)
# Another direction of gravity; conventions.
TURNED = 0.35  # rad from the described direction: beyond the tilts that linear columns describe
SIZE = (0.6, 1.5)  # of the described gravity: masses are off as well
LEFT = 0.3  # of the squares that the described direction leaves
# rad/s, root mean square over joints and samples, below which single joints are not judged
CREEP = 0.05


class GravityFit(NamedTuple):
    """The torques of one side compared with the described gravity; all other contributions are
    regressed out of both.

    torque, gravity: remainders of the torques and of the described gravity, Nm, (N, m) for the
    joints with a torque; pull: derivative of the latter with respect to the gravity vector, (N, m,
    3); correlation: of the two; factor: first over second; chance: probability that unrelated
    series have such a correlation; missing: whether every joint loaded by gravity certainly has
    less than half of it.
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


def contradicted(motions: Motions, robot: Robot) -> list[Finding]:
    """Return which torques contradict the description, given the motions of a recording or of all
    its parts.

    The codes are "exchanged", "mirrored" and "other_zero" for joints; "gravity_sign", "mounting"
    and "gravity_size" for the sign, direction and size of gravity; and "gravity_missing" if the
    torques contain no gravity.
    """
    found = []
    for comparison in _comparisons(motions, robot):
        confused, judged = _findings(comparison)
        found += [*confused, *judged]
    return found


def misread_channels(recording: Recording, robot: Robot, *, weight: bool) -> str | None:
    """Return in words which channels have the wrong unit, sign or joint; None if there are none.

    weight: whether torques without gravity count as misread.
    """
    for comparison in _comparisons([*side_motions(recording, robot)], robot):
        confused, judged = _findings(comparison)
        lacking = (one for one in (judged if weight else []) if one.code == MISSING)
        if (first := next(chain(confused, lacking), None)) is not None:
            return first.message
    return None


@dataclass(frozen=True)
class _Comparison:
    """The motion of one side and the description with which its torques are compared.

    Equal comparisons have equal findings. Descriptions are equal if they are the same object.
    """

    robot: Robot
    side: str
    motion: SideMotion = field(compare=False)
    content: tuple[object, ...]  # of the motion


def _comparisons(motions: Motions, robot: Robot) -> Iterator[_Comparison]:
    """Yield the comparison of each side, with all its motions together."""
    for side, motion in together(motions):
        for array in motion[:4]:
            array.setflags(write=False)  # Findings are kept by content.
        content = (
            *map(np.ndarray.tobytes, motion[:4]),
            tuple(motion.measured),
            motion.window,
            motion.of_duty,
        )
        yield _Comparison(robot, side, motion, content)


def _fit_gravity(motion: SideMotion, robot: Robot, *, motors: bool) -> GravityFit:
    """Compare the torques of one side with the described gravity, all joints together."""
    states = (np.hstack([rate, rate]) if robot.elastic else rate for rate in motion[:3])
    moved, pull = ArmEquations(robot).moved_and_pulled(*states, motors=motors)
    left, weight = _remainders(motion, moved, pull)
    gravity = weight @ robot.gravity
    # Without gravity at any joint, the remainder is rounding.
    rounding = RANK * float(np.abs(pull @ robot.gravity).max())
    if not motion.measured or np.abs(gravity).max() <= rounding:
        return GravityFit(left, np.zeros_like(gravity), weight, 0.0, 0.0, 1.0, False)
    free = np.zeros(len(motion.measured))
    for k in range(len(free)):
        free[k] = max(independent(left[:, k], gravity[:, k]) - 2.0, 0.1)
    squares = np.sum(left**2, axis=0)
    power = np.sum(gravity**2, axis=0)
    both = np.sum(left * gravity, axis=0)
    correlation = float(both.sum() / np.sqrt(squares.sum() * power.sum()))
    size = abs(correlation) * np.sqrt(free.sum() / max(1.0 - correlation**2, 1e-12))
    chance = float(student.sf(size, free.sum()))
    factor = float(both.sum() / power.sum())
    missing = _lacks_gravity(squares, power, both, free)
    return GravityFit(left, gravity, weight, correlation, factor, chance, missing)


def _remainders(motion: SideMotion, moved: Array, pull: Array) -> tuple[Array, Array]:
    """Return the torques (N, m) of the measured joints, and their derivatives (N, m, 3) by gravity.

    The contributions of each joint alone, and those of its described motion, are regressed out.
    """
    left = np.zeros((len(pull), len(motion.measured)))
    weight = np.zeros((*left.shape, 3))
    for k, j in enumerate(motion.measured):
        basis = motion.own(j, moved[:, j])
        torque = motion.torque[:, j]
        left[:, k] = torque - basis @ (basis.T @ torque)
        weight[:, k] = pull[:, j] - basis @ (basis.T @ pull[:, j])
    return left, weight


def _lacks_gravity(squares: Array, power: Array, both: Array, free: Array) -> bool:
    """Whether every loaded joint certainly has less than half of the described gravity.

    squares, power, both: (m,) sums of squares of torque and gravity, and of their product; free:
    (m,) numbers of independent samples. Less gravity was at least partly subtracted.
    """
    # 0.05 of the largest gravity of a joint; below, as in wrists, a payload may reverse its sign
    loaded = power > 0.05**2 * power.max()
    factors = both[loaded] / power[loaded]
    rest = np.maximum(squares[loaded] - both[loaded] ** 2 / power[loaded], 0.0)
    most = np.abs(factors) + 3.0 * np.sqrt(rest / power[loaded] / free[loaded])
    return bool((most < 0.5).all())


Findings = tuple[Finding, ...]


# A recording is checked when it is read, and again before a corrected arm is written.
@lru_cache(maxsize=8)
def _findings(comparison: _Comparison) -> tuple[Findings, Findings]:
    """Return the findings about confused channels, and, if there are none, all others."""
    robot = comparison.robot
    side = comparison.side
    motion = comparison.motion
    fit = _fit_gravity(motion, robot, motors=side == "motor")
    if not fit.gravity.any():
        return (), ()
    few = motion.every(max(1, len(motion.q) // 500))  # are tried with every other arrangement
    # Of joints that creep friction is of either sign, by the encoders' steps, and its error
    # outweighs what is compared.
    several = len(motion.measured) > 1 and float(rms(motion.dq, None)) > CREEP
    confused = _size(fit, side, of_duty=motion.of_duty)
    arm = Arm.of(robot, side)
    # No gravity was subtracted from a duty: it is what the motor received.
    may_lack_gravity = several and not robot.elastic and not motion.of_duty
    load = _load_alone(few, arm) if may_lack_gravity else None
    # What weighs more than the arm is no load: torques of another unit do.
    if load is not None and load > sum(joint.link.mass for joint in robot.joints):
        load = None
    if confused and load is not None:
        confused = []
    if several and not confused:
        confused = arranged(few, side, robot, arm, _shown(fit))
    # None where a single joint, or too little motion, leaves it open.
    upside = upside_down(few, side, robot, arm) if several and not confused else None
    judged = [] if confused else _judged(fit, side, robot, upside)
    if several and not confused and not judged:
        judged = sized(few, side, robot, arm)
    if load is not None:
        carried = f". What remains is the gravity of about {load:.2g} kg on the last link"
        judged = [
            replace(one, message=one.message + carried) if one.code == MISSING else one
            for one in judged
        ]
    return tuple(confused), tuple(judged)


def _load_alone(motion: SideMotion, arm: Arm) -> float | None:
    """Return the mass, kg, of a load on the last link whose gravity explains the torques better
    than a multiple of the described gravity does; None if it does not.

    This happens if the gravity of the arm without its load was subtracted.
    """
    still = np.zeros_like(motion.q)
    Y = arm.regressor(motion.q, still, still)
    weight = Y @ arm.mean
    moved = arm.regressor(*motion[:3]) @ arm.mean - weight
    of_load = Y[:, :, arm.of_last_link]
    parts = []
    for j in motion.measured:
        basis = motion.own(j, moved[:, j])
        part = np.column_stack([motion.torque[:, j], weight[:, j], of_load[:, j]])
        parts.append(part - basis @ (basis.T @ part))
    rows = np.vstack(parts)
    torque = rows[:, 0]
    described = rows[:, 1:2]
    load = rows[:, 2:]
    left = []
    for columns in (described, load):
        size = np.linalg.lstsq(columns, torque, rcond=RANK)[0]
        left.append(float(np.sum((torque - columns @ size) ** 2)))
    return float(size[0]) if left[1] < left[0] and size[0] > 0.0 else None


def _size(fit: GravityFit, side: str, *, of_duty: bool) -> list[Finding]:
    """Return whether torques that certainly follow gravity are far larger or smaller than
    described.

    of_duty: whether described electrics make them of a recorded duty.
    """
    factor = fit.factor
    if not fit.certain or factor < 0.0 or FAR[0] <= factor <= FAR[1]:
        return []
    what = "the torque of the recorded duty (pwm)" if of_duty else f"{side} effort"
    message = (
        f"{what} follows the predicted gravity (correlation"
        f" {fit.correlation:.3g}), but is {factor:.3g} times as large as described"
    )
    if of_duty:
        remedy = (
            "check the full_scale of pwm (a wrong one is kept in the bag: import the recording"
            " again), the supply and torque_per_volt of the description, the unit of the angles,"
            " and the masses of the description"
        )
        return [warning("gravity_size", message, remedy)]
    remedy = (
        "check its unit (Nm, Nm_motor with its ratio, A), the unit of the angles, and"
        " the masses of the description"
    )
    if LIKE_DEGREES[0] < factor < LIKE_DEGREES[1]:
        remedy += (
            "; with angles in radians taken for degrees, angles and gravity are 57 times too small"
        )
    elif LIKE_KILO[0] < factor < LIKE_KILO[1]:
        remedy += "; torques in kNm taken for Nm are 1000 times too small"
    return [warning("gravity_size", message, remedy)]


def _shown(fit: GravityFit) -> Array:
    """Return the gravity (3,) m/s² that the torques of a side show."""
    found = np.linalg.lstsq(fit.pull.reshape(-1, 3), fit.torque.ravel(), rcond=None)[0]
    return np.asarray(found, dtype=np.float64)


def _judged(fit: GravityFit, side: str, robot: Robot, upside: bool | None) -> list[Finding]:
    """Return whether the torques of a side show another direction or the opposite sign of gravity,
    or contain no gravity.

    upside: whether inertia has the right sign although gravity is reversed; None if unknown.
    """
    columns = fit.pull.reshape(-1, 3)
    target = fit.torque.ravel()
    shown = _shown(fit)
    left = float(np.sum((target - columns @ shown) ** 2))
    straight = float(np.sum((target - columns @ (fit.factor * robot.gravity)) ** 2))
    if is_turned(shown, np.asarray(robot.gravity), left, straight):
        message = (
            f"{side} effort shows gravity of {short_numbers(shown)} m/s², but the description"
            f" has {short_numbers(robot.gravity)}"
        )
        remedy = (
            "the arm is mounted differently (base in its arm file; identify and diagnose"
            " detect the mounting)"
        )
        return [warning("mounting", message, remedy)]
    times = f"{fit.factor:.3g} times the described one, correlation {fit.correlation:.3g}"
    if fit.certain and FACTOR[0] < -fit.factor < FACTOR[1]:
        message = f"{side} effort has the opposite sign of the predicted gravity ({times})"
        signs = "all torques have the wrong sign (sign: -1 in the map)"
        mounted = "the arm is mounted upside down (base in its arm file)"
        if upside is None:
            remedy = f"either {signs}, or {mounted}; gravity cannot separate the two"
            return [warning("gravity_sign", message, remedy)]
        if upside:
            return [warning("mounting", f"{message}, but inertia has the right sign", mounted)]
        return [warning("gravity_sign", f"{message}, as has inertia", signs)]
    if fit.missing:
        part = "no" if abs(fit.factor) < FAR[0] else "only part of the"
        message = f"{side} effort contains {part} gravity predicted by the description ({times})"
        return [warning(MISSING, message, TAKEN)]
    return []


def is_turned(shown: Array, described: Array, left: float, straight: float) -> bool:
    """Return whether gravity (3,) m/s² that torques show has another direction than described.

    left, straight: squares of the torques that the shown and the described direction leave.
    """
    size = float(np.linalg.norm(shown) / np.linalg.norm(described))
    turned = angle_between(shown, described) > TURNED
    return left < LEFT * straight and turned and SIZE[0] < size < SIZE[1]


def angle_between(one: Array, other: Array) -> float:
    """Return the angle between two vectors (3,), rad."""
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.arccos(np.clip(one @ other / max(size, 1e-300), -1.0, 1.0)))
