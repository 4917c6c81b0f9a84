"""Torques against what the arm's description predicts: signs, places and mountings that are not as
taken.

Of each joint's torque a zero, friction, the inertia as described and that of its motor are
regressed out, and the same of the gravity torque as described. What is left of the two should rise
together. Where it runs against each other, all torques have the wrong sign, or the arm is mounted
otherwise. Where it rises far more or less, a unit is not what it is taken for; where it hardly
rises at all, gravity has been taken out of the torque before it was recorded.

Joints that turn the other way or have their zero elsewhere, torques of the wrong sign, and channels
of two joints that were exchanged are tried: each is as likely as the torques are, tau = Y(q, dq,
ddq) pi, with the masses and inertias pi integrated out of a wide prior about the description (D. J.
C. MacKay, Neural Computation 4 (1992) 415), so that the geometry decides, however wrong the
described masses are.

Slow samples resemble each other: N of them are worth as few independent ones as the two series'
autocorrelations say (M. S. Bartlett, Journal of the Royal Statistical Society 98 (1935) 536).
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import chain, combinations
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import fftconvolve, savgol_filter
from scipy.stats import t as student

from elastic_arm.dynamics import Model, build_model
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.formatting import rounded, short_numbers
from elastic_arm.recording.inspection.plausibility import is_motion
from elastic_arm.recording.inspection.report import FEWEST, Finding, warning
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, Samples
from elastic_arm.robot import Robot

ENOUGH = 5000  # samples that are looked at; bounds the time
CHANCE = 0.01  # probability that unrelated torques correlate so; convention
# Times the described gravity: of a sign alone -1, and masses are off. Beyond, something else than
# gravity is at work.
FACTOR = (1.0 / 3.0, 3.0)
# Beyond, a unit is mistaken. Masses of a description are not off by so much; convention.
FAR = (0.2, 5.0)
# masses are off, and a small angle is not a small part of a sine
LIKE_DEGREES = (57.3 / 2.5, 57.3 * 2.5)
LIKE_KILO = (0.5e-3, 2e-3)
# Another direction of gravity, here and where `identification.batch.mounting` looks for it;
# conventions.
TURNED = 0.35  # rad from the described direction: beyond the tilts that linear columns describe
SIZE = (0.6, 1.5)  # of the described gravity: masses are off as well
LEFT = 0.3  # of the squares that the described direction leaves
# rad: nearer to upside down, which all signs together are, too, than to any side
OVERHEAD = 0.75 * np.pi
RANK = 1e-9  # of the largest singular value; numerical
# rad/s, root mean square over joints and samples, below which single joints are not judged
CREEP = 0.05
SIDES = {"tau_J": "link", "tau_m": "motor"}
# Another arrangement is named where it is e^10 times as likely, shared among those that are tried;
# others beside it that are at most a hundred times less likely, as in the contract.
CERTAIN = 10.0
BESIDE = float(np.log(100.0))
# relative: a payload, a tool, another motor; of links as described and of the arm's mean link;
# convention
MASSES = 0.3
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


class _Change(NamedTuple):
    """Columns (n,) in another order, with signs."""

    order: Any
    sign: Array

    def __call__(self, values: Array) -> Array:
        return np.asarray(values[..., self.order] * self.sign)


class _Mix(NamedTuple):
    """Columns (n,) as sums of columns: values by a matrix (n, n)."""

    matrix: Array

    def __call__(self, values: Array) -> Array:
        return np.asarray(values @ self.matrix.T)


class SideMotion(NamedTuple):
    """Motion and torques (N, n) of a side, and the joints with measured torque."""

    q: Array
    dq: Array
    ddq: Array
    torque: Array
    measured: list[int]


Motions = list[tuple[str, SideMotion]]  # with the sides whose torques they hold


class GravityFit(NamedTuple):
    """Torques of one side beside the described gravity, less what is not gravity.

    What is left of the torques, of gravity as described, Nm, (N, m) of the joints with a torque,
    and of its derivative by the gravity vector, (N, m, 3); correlation of the two, factor of the
    first over the second, the probability that unrelated series correlate so, and whether no joint
    that gravity loads shows half of it, but for chance.
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
    """Return which torques contradict the description.

    The motions are those of a recording, or of all its parts.

    They belong to another joint, way to turn or zero, "exchanged", "mirrored", "other_zero"; run
    against gravity, "gravity_sign"; show another direction, "mounting"; are far larger or smaller,
    "gravity_size"; or hold no gravity, "gravity_missing".
    """
    found = []
    for side, motion, fit in _fits(motions, robot):
        found += [one for stage in _told(motion, side, fit, robot) for one in stage]
    return found


def misread_channels(recording: Recording, robot: Robot, *, weight: bool) -> str | None:
    """Return which channels are misread, by unit, sign or joint.

    weight: whether torques without gravity are among them.
    """
    for side, motion, fit in _fits([*side_motions(recording, robot)], robot):
        told = _told(motion, side, fit, robot)
        confused = next(told)
        lacking = (one for one in (next(told) if weight else []) if one.code == MISSING)
        if (first := next(chain(confused, lacking), None)) is not None:
            return first.message
    return None


def _fits(motions: Motions, robot: Robot) -> Iterator[tuple[str, SideMotion, GravityFit]]:
    """Yield the torques of each side, of all its motions together, beside the described gravity."""
    for side in SIDES.values():
        own = [motion for name, motion in motions if name == side]
        if not own:
            continue
        every = max(1, sum(len(motion.q) for motion in own) // ENOUGH)
        q, dq, ddq, torque = (
            np.concatenate(parts)[::every] for parts in list(zip(*own, strict=True))[:4]
        )
        measured = sorted(set.intersection(*(set(motion.measured) for motion in own)))
        whole = SideMotion(q, dq, ddq, torque, measured)
        if len(whole.q) < FEWEST:  # holes everywhere
            continue
        fit = _fit_gravity(whole, robot, motors=side == "motor")
        if fit.gravity.any():
            yield side, whole, fit


def side_motions(recording: Recording, robot: Robot) -> Iterator[tuple[str, SideMotion]]:
    """Yield the sides that have torques with their motion; none of a recording without motion."""
    samples = recording.select(robot.joint_names).samples()
    position = samples.q if samples.q is not None else samples.theta
    # 1.0 s; the ends that differentiation spoils take 0.2 s
    if (
        position is None
        or len(samples) < FEWEST
        or samples.t[-1] < 1.0
        or not is_motion(samples.t, position)
    ):
        return
    for channel, side in SIDES.items():
        if getattr(samples, channel) is not None:
            yield side, _motion(samples, position, channel)


def _motion(samples: Samples, position: Array, channel: str) -> SideMotion:
    step = float(np.median(np.diff(samples.t)))
    # 0.1 s over which positions are differentiated: gravity changes more slowly
    width = max(round(0.1 / step) // 2 * 2 + 1, 5)
    # Over numbers of samples, and of the times at these: some may be missing.
    slope, curvature = (savgol_filter(samples.t, width, 3, deriv=k)[:, None] for k in (1, 2))
    dq, ddq = (savgol_filter(position, width, 3, deriv=k, axis=0) for k in (1, 2))
    dq = dq / slope
    ddq = (ddq - dq * curvature) / slope**2
    # Across a hole there is no derivative.
    holes = np.zeros(len(position), np.bool_)
    for row in np.flatnonzero(np.diff(samples.t) > 2.5 * step).tolist():
        holes[max(row - width // 2, 0) : row + width // 2 + 2] = True
    rows = np.flatnonzero(~holes)[width:-width]
    rows = rows[:: max(1, len(rows) // ENOUGH)]
    torque: Array = savgol_filter(getattr(samples, channel), width, 3, axis=0)
    lacking = [(channel, j) in samples.lacking for j in range(position.shape[1])]
    # 1e-9 Nm; what changes less is none
    measured = np.flatnonzero((np.ptp(torque, axis=0) > 1e-9) & ~np.array(lacking)).tolist()
    return SideMotion(position[rows], dq[rows], ddq[rows], torque[rows], measured)


def _fit_gravity(motion: SideMotion, robot: Robot, *, motors: bool) -> GravityFit:
    """Compare the torques of one side with described gravity, of all joints together."""
    states = (np.hstack([rate, rate]) if robot.elastic else rate for rate in motion[:3])
    moved, pull = ArmEquations(robot).moved_and_pulled(*states, motors=motors)
    count = len(motion.measured)
    left = np.zeros((len(pull), count))
    weight = np.zeros((len(pull), count, 3))
    free = np.zeros(count)
    for k, j in enumerate(motion.measured):
        basis = _own(motion, j, moved[:, j])
        left[:, k], weight[:, k] = (
            rows - basis @ (basis.T @ rows) for rows in (motion.torque[:, j], pull[:, j])
        )
        free[k] = max(_independent(left[:, k], weight[:, k] @ robot.gravity) - 2.0, 0.1)
    gravity = weight @ robot.gravity
    # What rounding leaves of the gravity of a joint that has none is no gravity.
    if not count or np.abs(gravity).max() <= RANK * float(np.abs(pull @ robot.gravity).max()):
        return GravityFit(left, np.zeros_like(gravity), weight, 0.0, 0.0, 1.0, False)
    squares = np.sum(left**2, axis=0)
    power = np.sum(gravity**2, axis=0)
    both = np.sum(left * gravity, axis=0)
    # 0.05 of the largest gravity among the joints; less of it, as wrists have, a payload turns over
    heavy = power > 0.05**2 * power.max()
    factors = both[heavy] / power[heavy]
    rest = squares[heavy] - both[heavy] ** 2 / power[heavy]
    most = np.abs(factors) + 3.0 * np.sqrt(np.maximum(rest, 0.0) / power[heavy] / free[heavy])
    correlation = float(both.sum() / np.sqrt(squares.sum() * power.sum()))
    size = abs(correlation) * np.sqrt(free.sum() / max(1.0 - correlation**2, 1e-12))
    chance = float(student.sf(size, free.sum()))
    factor = float(both.sum() / power.sum())
    # 0.5 times the described gravity; below for certain it was taken out, in part at least
    return GravityFit(left, gravity, weight, correlation, factor, chance, bool((most < 0.5).all()))


def _own(motion: SideMotion, j: int, *more: Array) -> Array:
    """Return an orthonormal basis (N, r) of a joint's zero, friction, motor inertia, and of further
    columns."""
    # 0.01 rad/s within which friction turns over; convention
    friction = np.tanh(motion.dq[:, j] / 0.01)
    columns = [np.ones(len(friction)), friction, motion.dq[:, j], motion.ddq[:, j], *more]
    scaled = np.column_stack(
        [column / max(float(np.linalg.norm(column)), 1e-300) for column in columns]
    )
    basis, sizes, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(basis[:, sizes > RANK * sizes[0]])


def _independent(one: Array, other: Array) -> float:
    """Return how many independent samples two series (N,) are worth."""
    alike = [
        fftconvolve(each, each[::-1])[len(each) :] / max(float(each @ each), 1e-300)
        for each in (one, other)
    ]
    return len(one) / max(1.0, 1.0 + 2.0 * float(alike[0] @ alike[1]))


class _Arm(NamedTuple):
    """Y(q, dq, ddq) (N, n, P) of a side's torques, and mean and standard deviation of its pi
    (P,)."""

    regressor: Callable[[Array, Array, Array], Array]
    mean: Array
    spread: Array


def _told(motion: SideMotion, side: str, fit: GravityFit, robot: Robot) -> Iterator[list[Finding]]:
    """Yield which channels were confused, and then, if none were, what else is not as described."""
    every = max(1, len(motion.q) // 500)  # so many samples are tried with every other arrangement
    few = SideMotion(*(rate[::every] for rate in motion[:4]), motion.measured)  # type: ignore[call-arg, arg-type]
    # A few thousand samples: compiling would take longer than all that is computed.
    n = robot.n
    model = build_model(robot, engine="numpy")

    def regressor(q: Array, dq: Array, ddq: Array) -> Array:
        if robot.elastic:
            q, dq, ddq = (np.hstack([rate, rate]) for rate in (q, dq, ddq))
        Y = model.regressor(q, dq, ddq)
        return np.asarray(Y[:, :n] + (Y[:, n:] if robot.elastic and side == "motor" else 0.0))

    arm = _Arm(regressor, model.Psi, _spread(model))
    # Of joints that creep friction is of either sign, by the encoders' steps, and its error
    # outweighs what is compared.
    several = len(motion.measured) > 1 and float(np.sqrt(np.mean(motion.dq**2))) > CREEP
    confused = _size(fit, side) or (_arranged(few, side, robot, arm) if several else [])
    yield confused
    judged = [] if confused else _judged(fit, side, robot)
    if several and not confused and not judged:
        judged = _sized(few, side, robot, arm)
    yield judged


def _spread(model: Model) -> Array:
    """Return by how much masses, first moments and inertias may be off, (P,); stiffness and damping
    do not act here."""
    names = [parameter.name.rpartition(".") for parameter in model.parameters]
    mass = {owner: 0.0 for owner, *_ in names}
    inertia = dict(mass)
    for (owner, _, what), value in zip(names, model.Psi.tolist(), strict=True):
        mass[owner] += value if what == "m" else 0.0
        inertia[owner] += 0.5 * value if what in {"Ixx", "Iyy", "Izz"} else 0.0
    heavy = [owner for owner in mass if mass[owner]]
    mean_mass = float(np.mean([mass[owner] for owner in heavy]))
    mean_inertia = float(np.mean([inertia[owner] for owner in heavy]))
    sizes = []
    for (owner, *_), parameter in zip(names, model.parameters, strict=True):
        m = mass[owner] + mean_mass
        j = inertia[owner] + mean_inertia
        by_unit = {"kg": m, "kg m": np.sqrt(m * j), "kg m^2": j}
        sizes.append(MASSES * by_unit.get(parameter.unit, 0.0))
    return np.array(sizes)


def _sized(motion: SideMotion, side: str, robot: Robot, arm: _Arm) -> list[Finding]:
    """Return the joint whose zero is not as described, or whose torque lacks a share of its weight,
    with the size.

    A turned last link is another mass. What a gain of the torque explains better is said nothing
    of.
    """
    given, free = _likelihood(motion, motion.torque, arm)
    Y = arm.regressor(*motion[:3])
    still = np.zeros_like(motion.q)
    weight = arm.regressor(motion.q, still, still) @ arm.mean

    def zero(at: Array, size: float) -> float:
        return _likelihood(motion._replace(q=motion.q - size * at), motion.torque, arm, free)[0]

    def share(at: Array, size: float) -> float:
        return _likelihood(motion, motion.torque + size * at * weight, arm, free, Y)[0]

    def gain(at: Array, size: float) -> float:
        # The noise stays with the torques as they were given.
        likely = _likelihood(motion, motion.torque * np.exp(-size * at), arm, free, Y)[0]
        return likely - size * float(free @ at)

    unit = np.eye(robot.n)
    others = []
    for joint, at in zip(robot.joints, unit, strict=True):
        if not joint.prismatic:
            others.append(_Reading(joint.name, *OTHER_ZERO, ZERO, partial(zero, at)))
    loaded = [(robot.joint_names[j], unit[j]) for j in motion.measured]
    for name, at in (*loaded, ("all joints", unit[motion.measured].sum(axis=0))):
        others.append(_Reading(name, *LACKING, SHARE, partial(share, at)))
        others.append(_Reading(name, "", "the gain of {}", SHARE, partial(gain, at)))
    tried = [_likeliest(other, given) for other in others]
    said = max(tried)[1]
    if said.startswith("the zero"):
        return _named(tried, "other_zero", side, "measure it, or state it (joint_zero)")
    return _named(tried, MISSING, side, TAKEN) if said else []


class _Reading(NamedTuple):
    """Another reading of torques: it differs from the description by a size."""

    place: str  # name of a joint, or all of them
    words: str  # with places for the name and the size; empty for a reading that is not said
    short: str
    usual: float  # standard deviation of the size
    likelihood: Callable[[float], float]  # ln of the likelihood of the torques by the size


def _likeliest(reading: _Reading, given: float) -> tuple[float, str, str]:
    """Return ln of the odds of a reading, its size integrated out, and its words with the size.

    given: ln of the likelihood as described.
    """

    def worth(size: float) -> float:
        return float(reading.likelihood(size)) - given - 0.5 * (size / reading.usual) ** 2

    most = 3 * reading.usual
    best = minimize_scalar(lambda size: -worth(size), bounds=(-most, most), method="bounded")
    size = float(best.x)
    step = 0.1 * ZERO
    bend = (2.0 * worth(size) - worth(size - step) - worth(size + step)) / step**2
    std = max(bend, reading.usual**-2) ** -0.5
    text = " ± ".join(rounded(size, std))
    odds = float(-best.fun) + np.log(std / reading.usual)
    words = reading.words.format(reading.place, text)
    return odds, words, reading.short.format(reading.place, text)


def _arranged(motion: SideMotion, side: str, robot: Robot, arm: _Arm) -> list[Finding]:
    """Return which joints turn the other way, or have their channels exchanged."""
    found: list[Finding] = []
    n = robot.n
    for _ in range(n):
        given, free = _likelihood(motion, motion.torque, arm)
        tried = []
        changes = []
        for angles, ways in _arrangements(robot.joint_names, motion.measured):
            moved = motion._replace(
                q=angles(motion.q), dq=angles(motion.dq), ddq=angles(motion.ddq)
            )
            Y = arm.regressor(*moved[:3])
            for code, words, torques in ways:
                # The noise stays with the torques as they were given.
                worth = free if isinstance(torques, _Mix) else np.abs(torques(free))
                likely, _ = _likelihood(moved, torques(motion.torque), arm, worth, Y)
                tried.append((likely - given, words, words))
                changes.append((code, moved, torques))
        code, moved, torques = changes[int(np.argmax([gain for gain, *_ in tried]))]
        remedy = "check names, order and signs of the columns in the map, for angle and torque"
        if code == COUPLED:
            remedy = "the given line corrects it in the map (docs/channel_maps.md)"
        if not (one := _named(tried, code, side, remedy)):
            break
        found += one
        motion = moved._replace(torque=torques(motion.torque))
    return found


def _named(tried: list[tuple[float, str, str]], code: str, side: str, remedy: str) -> list[Finding]:
    """Return the likeliest of (logarithm of the odds, words, short words) with what is about as
    likely, if it is."""
    (odds, words, _), *others = sorted(tried, reverse=True)
    if odds < CERTAIN + np.log(len(tried)):
        return []
    beside = "".join(f", or {short}" for gain, _, short in others if odds - gain < BESIDE)
    likely = (
        f"the torques are then 10^{int(odds / np.log(10.0))} times as likely as with"
        " the description"
    )
    return [warning(code, f"{side} side: {words}{beside}: {likely}", remedy)]


_Turn = _Change | _Mix
_Way = tuple[str, str, _Turn]


def _coupled(joints: Sequence[str]) -> Iterator[tuple[_Turn, list[_Way]]]:
    """Yield angles that are given against the joint before: as their sum or difference, as of a
    parallelogram.

    Then the torque of the joint before lacks what the other motor bears, or torques are those of
    the joints.
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
            same = _Change(np.arange(len(joints)), np.ones(len(joints)))
            yield _Mix(angles), [(COUPLED, alone, same), (COUPLED, both, _Mix(torques))]


def _arrangements(
    joints: Sequence[str], measured: Sequence[int]
) -> Iterator[tuple[_Turn, list[_Way]]]:
    """Yield what may have been confused: how angles (…, n) come right, and how torques do beside
    it."""

    yield from _coupled(joints)
    every = np.arange(len(joints))
    plain = np.ones(len(joints))
    same = _Change(every, plain)
    alone: list[_Way] = []
    for j, name in enumerate(joints):
        mirrored = _Change(every, np.where(every == j, -1.0, 1.0))
        both = (
            f"{name} turns in the opposite direction of the description; the signs of"
            " its angle and torque are wrong"
        )
        angle = f"the angle of {name} has the opposite sign of the description"
        yield mirrored, [("mirrored", both, mirrored), ("mirrored", angle, same)]
        if j in measured:
            alone.append(
                (
                    "gravity_sign",
                    f"the torque of {name} has the opposite sign of the description",
                    mirrored,
                )
            )
    backwards = _Change(every, -plain)
    words = (
        "every joint turns in the opposite direction of the description; the signs of"
        " angles and torques are wrong"
    )
    yield backwards, [("mirrored", words, backwards)]
    pairs = [[i, j] for i, j in combinations(measured, 2)]
    for old in [*pairs, *([list(measured)] if len(measured) > 3 else [])]:
        exchanged = _Change(every.copy(), plain)
        exchanged.order[old] = old[::-1]
        names = " and ".join(joints[k] for k in old)
        whose = (
            f"of {names} seem to be exchanged" if len(old) == 2 else "are in reversed joint order"
        )
        yield exchanged, [("exchanged", f"all channels {whose}", exchanged)]
        alone.append(("exchanged", f"efforts {whose}", exchanged))
    yield same, alone


def _likelihood(
    motion: SideMotion, torque: Array, arm: _Arm, free: Array | None = None, Y: Array | None = None
) -> tuple[float, Array]:
    """Return the logarithm of the torques' likelihood, and how many independent samples the rest of
    each is worth (n,).

    Masses are integrated out, each joint's noise is the likeliest; friction, zero, motor inertia
    are its own. `free`: independent samples (n,), where arrangements are compared.
    """
    Y = arm.regressor(*motion[:3]) if Y is None else Y
    bases = [(j, _own(motion, j)) for j in motion.measured]
    columns = [(Y[:, j] - basis @ (basis.T @ Y[:, j])) * arm.spread for j, basis in bases]
    rows = [torque[:, j] - Y[:, j] @ arm.mean for j, _ in bases]
    rows = [row - basis @ (basis.T @ row) for row, (_, basis) in zip(rows, bases, strict=True)]
    grams = np.array([c.T @ c for c in columns])
    rights = np.array([c.T @ r for c, r in zip(columns, rows, strict=True)])
    power = np.array([float(row @ row) for row in rows])
    count = len(Y)
    squares = power
    worth = np.full(len(rows), float(count)) if free is None else free[motion.measured]
    # Expectation and maximisation of the noise.
    for _ in range(20):
        weight = worth / np.maximum(squares, 1e-12 * power)
        spread = np.linalg.inv(np.eye(len(arm.mean)) + np.tensordot(weight, grams, 1))
        size = spread @ (weight @ rights)
        before = squares
        squares = power - 2.0 * rights @ size + (grams @ size) @ size + np.tensordot(grams, spread)
        if np.allclose(squares, before, rtol=1e-3):
            break
    if free is None:
        free = np.zeros(motion.torque.shape[1])
        rests = [row - column @ size for row, column in zip(rows, columns, strict=True)]
        free[motion.measured] = [_independent(rest, rest) for rest in rests]
        return _likelihood(motion, torque, arm, free, Y)[0], free
    right = weight @ rights
    likely = -0.5 * float(worth @ np.log(squares / count) + weight @ power - right @ spread @ right)
    return likely + 0.5 * float(np.linalg.slogdet(spread)[1]), free


def _size(fit: GravityFit, side: str) -> list[Finding]:
    """Return whether torques that certainly follow gravity are far larger or smaller than
    described."""
    factor = fit.factor
    if not fit.certain or factor < 0.0 or FAR[0] <= factor <= FAR[1]:
        return []
    message = (
        f"{side} effort follows the predicted gravity (correlation"
        f" {fit.correlation:.3g}), but is {factor:.3g} times as large as described"
    )
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


def _judged(fit: GravityFit, side: str, robot: Robot) -> list[Finding]:
    """Return what the torques of a side show: another direction or sign of gravity, none of it, or
    nothing."""
    columns = fit.pull.reshape(-1, 3)
    target = fit.torque.ravel()
    shown: Any = np.linalg.lstsq(columns, target, rcond=None)[0]
    left, straight = (
        float(np.sum((target - columns @ g) ** 2)) for g in (shown, fit.factor * robot.gravity)
    )
    turned = angle_between(shown, robot.gravity)
    size = float(np.linalg.norm(shown) / np.linalg.norm(robot.gravity))
    if left < LEFT * straight and turned > TURNED and SIZE[0] < size < SIZE[1]:
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
        remedy = (
            "either all torques have the wrong sign (sign: -1 in the map), or the arm is"
            " mounted upside down (base in "
        )
        return [
            warning(
                "gravity_sign",
                message,
                f"{remedy}its arm file); gravity cannot separate the two",
            )
        ]
    if fit.missing:
        part = "no" if abs(fit.factor) < FAR[0] else "only part of the"
        message = f"{side} effort contains {part} gravity predicted by the description ({times})"
        return [warning(MISSING, message, TAKEN)]
    return []


def angle_between(one: Array, other: Array) -> float:
    """Return the angle between two vectors (3,), rad."""
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.arccos(np.clip(one @ other / max(size, 1e-300), -1.0, 1.0)))
