"""Hypotheses that contradict the description, tried one by one: joints that turn the other way,
joints with another zero, torques with the wrong sign, and exchanged channels of two joints."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from elastic_arm.formatting import rounded
from elastic_arm.recording.inspection.report import Finding, warning
from elastic_arm.recording.inspection.side_motion import RANK, SideMotion
from elastic_arm.recording.inspection.torque_likelihood import Arm, Products
from elastic_arm.recording.sides import Array
from elastic_arm.robot import Robot

# Another arrangement is named where it is e^10 times as likely, shared among those that are tried;
# others beside it that are at most a hundred times less likely, as in the contract.
CERTAIN = 10.0
BESIDE = float(np.log(100.0))
COUPLED = "coupled"
# Long and short words of readings of torques, with places for the joint and the size.
OTHER_ZERO = (
    "the zero of {} seems to differ by {} rad from the description",
    "the zero of {} ({})",
)
LACKING = (
    "the torque of {} lacks a share of {} of the described gravity",
    "gravity of {} ({})",
)
MISSING = "gravity_missing"
TAKEN = (
    "gravity was subtracted before the torque was recorded, or something else"
    " supports the arm: record the full torque, or describe the support"
    " (gravity_compensation)"
)
# of gravity that is compensated, and of gains, by logarithm: as `effects.library` draws them
SHARE = 0.4
# rad, of the zeros of exchanged motors and encoders, as `effects.library.joint_zero` draws them
ZERO = 0.1


def arranged(motion: SideMotion, side: str, robot: Robot, arm: Arm, shown: Array) -> list[Finding]:
    """Return which joints turn the other way, or have exchanged channels.

    The result is empty if another mounting explains the torques as well.

    shown: (3,) gravity that the torques show.
    """
    found: list[Finding] = []
    unit = np.eye(robot.n)
    for _ in range(robot.n):
        products = Products.of(motion, arm)
        given, free = products.given()
        tried = []
        changes = []
        worth = np.zeros(robot.n)
        worth[motion.measured] = free
        for angles, ways in _arrangements(robot.joint_names, motion.measured):
            same = np.array_equal(angles, unit)
            moved = motion if same else motion.moved(partial(_turned, angles))
            there = products if same else Products.of(moved, arm)
            for code, words, torques in ways:
                # The noise stays with the torques as they were given; the torques of motors that
                # turn two joints keep that of the joints.
                exchanges = np.count_nonzero(torques) == robot.n
                own_free = np.abs(torques @ worth) if exchanges else worth
                likely = there.fit(torques, own_free[motion.measured], given).likelihood
                tried.append((likely - given.likelihood, words, words))
                changes.append((code, moved, torques))
        code, moved, torques = changes[int(np.argmax([gain for gain, *_ in tried]))]
        remedy = "check names, order and signs of the columns in the map, for angle and torque"
        if code == COUPLED:
            remedy = "the given line corrects it in the map (docs/channel_maps.md)"
        if not (one := _named(tried, code, side, remedy)):
            break
        if not found:
            # Masses that are off turn the gravity that is shown; upside down it is exact.
            for gravity in (shown, -robot.gravity):
                mounted = _mounted(motion, side, robot, gravity).fit(unit, free, given)
                if mounted.likelihood - given.likelihood > max(tried)[0] - BESIDE:
                    return []
        found += one
        motion = moved._replace(torque=_turned(torques, motion.torque))
    return found


def _turned(matrix: Array, values: Array) -> Array:
    """Replace the columns of values (N, n) by sums of them, by a matrix (n, n)."""
    return values @ matrix.T


def _mounted(motion: SideMotion, side: str, robot: Robot, gravity: Array) -> Products:
    """Return the products with gravity of the described size in another direction (3,)."""
    size = float(np.linalg.norm(robot.gravity))
    direction = gravity / max(float(np.linalg.norm(gravity)), RANK)
    return Products.of(motion, Arm.of(robot.with_(gravity=size * direction), side))


def upside_down(motion: SideMotion, side: str, robot: Robot, arm: Arm) -> bool | None:
    """Return whether an arm mounted upside down is more likely than torques that all have the wrong
    sign, which also reverse the inertia; None if neither is far more likely."""
    unit = np.eye(robot.n)
    as_given = Products.of(motion, arm)
    given, free = as_given.given()
    signs = as_given.fit(-unit, free, given).likelihood
    mounted = _mounted(motion, side, robot, -robot.gravity).fit(unit, free, given).likelihood
    return mounted > signs if abs(mounted - signs) > CERTAIN else None


# A code, words, and the torques (n, n) in terms of the recorded ones.
_Way = tuple[str, str, Array]


def _coupled(joints: Sequence[str]) -> Iterator[tuple[Array, list[_Way]]]:
    """Yield angles that are recorded relative to the previous joint, as sum or difference, as in a
    parallelogram.

    The torque of the previous joint then lacks the torque of the other motor, or the torques are
    those of the joints.
    """
    for j in range(1, len(joints)):
        for sign, way in ((-1.0, "plus"), (1.0, "minus")):
            angles = np.eye(len(joints))
            angles[j, j - 1] = sign
            torques: Array = np.asarray(np.linalg.inv(angles).T, dtype=np.float64)
            first = joints[j - 1]
            name = joints[j]
            line = f"coupling: {{{name}: {{{name}: 1.0, {first}: {sign:g}}}}}"
            words = (
                f"the recorded angle of {name} is its own angle {way} that of {first}, as for"
                f" a coupled drive ({line}, "
            )
            alone = (
                f"{words}with the angle under motor and the torque under link, as it belongs to"
                " the joint itself)"
            )
            both = f"{words}with angle and torque under motor)"
            yield angles, [(COUPLED, alone, np.eye(len(joints))), (COUPLED, both, torques)]


def _arrangements(
    joints: Sequence[str], measured: Sequence[int]
) -> Iterator[tuple[Array, list[_Way]]]:
    """Yield possible confusions: corrections of the angles (…, n), each with the corrections of the
    torques that may accompany it."""

    yield from _coupled(joints)
    unit = np.eye(len(joints))
    alone: list[_Way] = []
    for j, name in enumerate(joints):
        mirrored = unit - 2.0 * np.diag(unit[j])
        both = (
            f"{name} turns in the opposite direction of the description; the signs of"
            " its angle and torque are wrong"
        )
        angle = f"the angle of {name} has the opposite sign of the description"
        yield mirrored, [("mirrored", both, mirrored), ("mirrored", angle, unit)]
        if j in measured:
            alone.append(
                (
                    "gravity_sign",
                    f"the torque of {name} has the opposite sign of the description",
                    mirrored,
                )
            )
    words = (
        "every joint turns in the opposite direction of the description; the signs of"
        " angles and torques are wrong"
    )
    yield -unit, [("mirrored", words, -unit)]
    pairs = [[i, j] for i, j in combinations(measured, 2)]
    for old in [*pairs, *([list(measured)] if len(measured) > 3 else [])]:
        order = np.arange(len(joints))
        order[old] = old[::-1]
        exchanged = unit[order]
        names = " and ".join(joints[k] for k in old)
        whose = (
            f"of {names} seem to be exchanged" if len(old) == 2 else "are in reversed joint order"
        )
        yield exchanged, [("exchanged", f"all channels {whose}", exchanged)]
        alone.append(("exchanged", f"efforts {whose}", exchanged))
    yield unit, alone


def sized(motion: SideMotion, side: str, robot: Robot, arm: Arm) -> list[Finding]:
    """Return the joint whose zero differs from the description, or whose torque lacks a share of
    gravity, with the size.

    For the last link, another zero is equivalent to another mass. If a gain of the torque is the
    better explanation, nothing is reported.
    """
    unit = np.eye(robot.n)
    own = [motion.own(j) for j in motion.measured]  # whatever the zeros are
    as_given = Products.of(motion, arm, arm.weight(motion), own)
    given, free = as_given.given()

    def zero(at: Array, size: float) -> float:
        moved = Products.of(motion._replace(q=motion.q - size * at), arm, own=own)
        return moved.fit(unit, free, given).likelihood

    def share(at: Array, size: float) -> float:
        return as_given.fit(unit, free, given, size * at).likelihood

    def gain(at: Array, size: float) -> float:
        # The noise stays with the torques as they were given.
        likely = as_given.fit(np.diag(np.exp(-size * at)), free, given).likelihood
        return likely - size * float(free @ at[as_given.measured])

    others = []
    for joint, at in zip(robot.joints, unit, strict=True):
        if not joint.prismatic:
            others.append(_Reading(joint.name, *OTHER_ZERO, ZERO, partial(zero, at)))
    loaded = [(robot.joint_names[j], unit[j]) for j in motion.measured]
    for name, at in (*loaded, ("all joints", unit[motion.measured].sum(axis=0))):
        others.append(_Reading(name, *LACKING, SHARE, partial(share, at)))
        others.append(_Reading(name, "", "the gain of {}", SHARE, partial(gain, at)))
    tried = [_likeliest(other, given.likelihood) for other in others]
    said = max(tried)[1]
    if said.startswith("the zero"):
        return _named(tried, "other_zero", side, "measure it, or state it (joint_zero)")
    return _named(tried, MISSING, side, TAKEN) if said else []


class _Reading(NamedTuple):
    """A hypothesis that differs from the description by a size."""

    place: str  # name of a joint, or all of them
    words: str  # with places for the name and the size; empty for a reading that is not said
    short: str
    usual: float  # standard deviation of the size
    likelihood: Callable[[float], float]  # ln of the likelihood of the torques by the size


def _likeliest(reading: _Reading, given: float) -> tuple[float, str, str]:
    """Return the log odds of a hypothesis with its size integrated out, and its description with
    the size.

    given: log-likelihood of the description.
    """

    def worth(size: float) -> float:
        return float(reading.likelihood(size)) - given - 0.5 * (size / reading.usual) ** 2

    most = 3 * reading.usual
    coarse = minimize_scalar(
        lambda size: -worth(size),
        bounds=(-most, most),
        method="bounded",
        options={"xatol": 0.05 * reading.usual},  # numerical: a parabola ends it
    )
    size = float(coarse.x)
    here = -float(coarse.fun)
    step = 0.1 * ZERO
    low = worth(size - step)
    high = worth(size + step)
    std = max((2.0 * here - low - high) / step**2, reading.usual**-2) ** -0.5
    move = float(np.clip(0.5 * (high - low) / step * std**2, -step, step))
    size += move
    here += 0.5 * (move / std) ** 2
    text = " ± ".join(rounded(size, std))
    odds = here + np.log(std / reading.usual)
    words = reading.words.format(reading.place, text)
    return odds, words, reading.short.format(reading.place, text)


def _named(tried: list[tuple[float, str, str]], code: str, side: str, remedy: str) -> list[Finding]:
    """Return the most likely hypothesis, together with those of similar probability, if its odds
    are high enough; hypotheses are (log odds, description, short description)."""
    (odds, words, _), *others = sorted(tried, reverse=True)
    if odds < CERTAIN + np.log(len(tried)):
        return []
    beside = "".join(f", or {short}" for gain, _, short in others if odds - gain < BESIDE)
    likely = (
        f"the torques are then 10^{int(odds / np.log(10.0))} times as likely as with"
        " the description"
    )
    return [warning(code, f"{side} side: {words}{beside}: {likely}", remedy)]
