"""Compare recorded torques with the gravity that the arm's description predicts, to find wrong
signs, exchanged joints, wrong units and another mounting.

From the torque of each joint and from its described gravity torque, the following are regressed
out: a zero, friction, the described inertia, and the inertia of the motor. The two remainders
should have a positive correlation. If it is negative, all torques have the wrong sign or the arm is
mounted upside down. If one remainder is far larger than the other, a unit is wrong. If the torque
has no such part, gravity was subtracted before the torque was recorded.

Further hypotheses are tested one by one: joints that turn the other way, joints with another zero,
torques with the wrong sign, and exchanged channels of two joints. The likelihood of a hypothesis is
that of the torques of the measured joints j under

    tau_j = (1 + g_j) Y_j(q, dq, ddq) pi + own_j + e_j,   e_j ~ N(0, v_j)
    pi_k ~ N(described, s_k² spread_k²),   g_j ~ N(0, 0.15²),   1/s_k² ~ gamma

The zero, friction and motor inertia own_j may have any size. The masses and inertias pi_k of each
body k and the gains g_j are integrated out (D. J. C. MacKay, Neural Computation 4 (1992) 415). s_k,
the deviation of body k from the description, is estimated: a body may be as drawn, or carry a
payload, a tool or another motor. Therefore the geometry decides, and a wrong mass or gain is not
mistaken for a wrong zero.

Motion and torques are smoothed in the same way, so that friction reverses as gradually as in the
smoothed torque. Torques enter through products of columns: another torque for the same motion costs
only the likelihood of these products.

Successive samples are correlated. N samples count as the number of independent samples that follows
from the autocorrelations of the two series (M. S. Bartlett, Journal of the Royal Statistical
Society 98 (1935) 536).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import chain, combinations
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.optimize import minimize_scalar
from scipy.signal import fftconvolve, savgol_coeffs, savgol_filter
from scipy.stats import t as student

from elastic_arm.dynamics import Model, build_model
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.formatting import rounded, short_numbers
from elastic_arm.recording.inspection.plausibility import is_motion
from elastic_arm.recording.inspection.report import FEWEST, Finding, warning
from elastic_arm.recording.made_torque import joints_with_duty, with_made_torque
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
TURNOVER = 0.01  # rad/s within which friction turns over; convention
# of places in the window; their number is numerical
SMOOTHING = np.convolve(savgol_coeffs(21, 3), savgol_coeffs(21, 3))
SIDES = {"tau_J": "link", "tau_m": "motor"}
# Another arrangement is named where it is e^10 times as likely, shared among those that are tried;
# others beside it that are at most a hundred times less likely, as in the contract.
CERTAIN = 10.0
BESIDE = float(np.log(100.0))
# relative, of a body as drawn and of the arm's mean body; a tenth is the convention, and two
# degrees of freedom make tails in which payloads and tools lie
MASSES = 0.1
TAILS = 2.0
GAIN = 0.15  # of a torque constant, as the challenge's level `field` draws them
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


class _Turn(NamedTuple):
    """Replace columns (n,) by sums of columns: values times the transpose of a matrix (n, n)."""

    matrix: Array

    def __call__(self, values: Array) -> Array:
        return np.asarray(values @ self.matrix.T)

    @property
    def is_none(self) -> bool:
        """Whether all columns stay as they are."""
        return np.array_equal(self.matrix, np.eye(len(self.matrix)))

    def samples(self, free: Array) -> Array:
        """Return the independent samples of the new columns, given those of the old ones (n,).

        The torques of motors that turn two joints keep those of the joints.
        """
        exchanges = np.count_nonzero(self.matrix) == len(free)
        return np.abs(self(free)) if exchanges else free


class SideMotion(NamedTuple):
    """Motion and torques (N, n) of a side, the joints with a measured torque, and the width of the
    smoothing window in seconds."""

    q: Array
    dq: Array
    ddq: Array
    torque: Array
    measured: list[int]
    window: float
    of_duty: bool = False  # whether described electrics make the torques of a recorded duty

    def moved(self, turn: Callable[[Array], Array]) -> Self:
        """Return the motion with other angles."""
        return self._replace(q=turn(self.q), dq=turn(self.dq), ddq=turn(self.ddq))

    def every(self, step: int) -> Self:
        """Return every `step`-th sample."""
        return self.moved(lambda rate: rate[::step])._replace(torque=self.torque[::step])

    def friction(self, j: int) -> Array:
        """Return the dry friction (N,) of a joint with 1 Nm, smoothed in the same way as the
        torques."""
        ahead = self.window * np.linspace(-0.5, 0.5, len(SMOOTHING))
        speeds = self.dq[:, j, None] + self.ddq[:, j, None] * ahead
        return np.asarray(np.tanh(speeds / TURNOVER) @ SMOOTHING)


Motions = list[tuple[str, SideMotion]]  # with the sides whose torques they hold


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
    found = list[Finding]()
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
    samples: tuple[bytes, ...]  # q, dq, ddq and torque of the motion: float64, (N, n)
    measured: tuple[int, ...]
    window: float  # s
    of_duty: bool

    @classmethod
    def of(cls, motion: SideMotion, side: str, robot: Robot) -> Self:
        """Return the comparison of a motion with the torques of one side."""
        arrays = (motion.q, motion.dq, motion.ddq, motion.torque)
        samples = tuple(np.asarray(array, dtype=np.float64).tobytes() for array in arrays)
        measured = tuple(motion.measured)
        return cls(robot, side, samples, measured, motion.window, motion.of_duty)

    @property
    def motion(self) -> SideMotion:
        """The motion, with arrays that cannot be written to."""
        q, dq, ddq, torque = (
            np.frombuffer(content).reshape(-1, self.robot.n) for content in self.samples
        )
        measured = list(self.measured)
        return SideMotion(q, dq, ddq, torque, measured, self.window, self.of_duty)


def _comparisons(motions: Motions, robot: Robot) -> Iterator[_Comparison]:
    """Yield the comparison of each side, with all its motions together."""
    for side in SIDES.values():
        own = [motion for name, motion in motions if name == side]
        if not own:
            continue
        every = max(1, sum(len(motion.q) for motion in own) // ENOUGH)
        q, dq, ddq, torque = (
            np.concatenate(parts)[::every] for parts in list(zip(*own, strict=True))[:4]
        )
        measured = sorted(set.intersection(*(set(motion.measured) for motion in own)))
        of_duty = any(motion.of_duty for motion in own)
        whole = SideMotion(q, dq, ddq, torque, measured, own[0].window, of_duty)
        if len(whole.q) >= FEWEST:  # fewer are left if there are holes everywhere
            yield _Comparison.of(whole, side, robot)


def side_motions(recording: Recording, robot: Robot) -> Iterator[tuple[str, SideMotion]]:
    """Yield the sides with torques and their motion; nothing if the arm does not move.

    The described electrics make the torques of a recorded duty.

    Raises a RobotError if the description states no electrics of a joint whose duty was recorded.
    """
    recording = recording.select(robot.joint_names)
    of_duty = bool(joints_with_duty(recording))
    if of_duty:
        recording = with_made_torque(replace(recording, reference=None), robot)
    samples = recording.samples()
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
            motion = _motion(samples, position, channel)
            yield side, motion._replace(of_duty=of_duty and side == "motor")


def _motion(samples: Samples, position: Array, channel: str) -> SideMotion:
    step = float(np.median(np.diff(samples.t)))
    # 0.1 s over which all is smoothed: gravity changes more slowly
    width = max(round(0.1 / step) // 2 * 2 + 1, 5)

    def smooth(values: Array) -> Array:
        """Smooth as well as a derivative needs it, of motion and torques alike."""
        once = savgol_filter(values, width, 3, axis=0)
        return np.asarray(savgol_filter(once, width, 3, axis=0))

    # Over numbers of samples, and of the times at these: some may be missing.
    q = smooth(position)
    t = smooth(samples.t[:, None])
    slope = np.gradient(t, axis=0)
    dq = np.gradient(q, axis=0) / slope
    ddq = (_bend(q) - dq * _bend(t)) / slope**2
    # Across a hole there is no derivative.
    holes = np.zeros(len(position), np.bool_)
    for row in np.flatnonzero(np.diff(samples.t) > 2.5 * step).tolist():
        holes[max(row - width, 0) : row + width + 2] = True
    rows = np.flatnonzero(~holes)[width:-width]
    rows = rows[:: max(1, len(rows) // ENOUGH)]
    torque = smooth(getattr(samples, channel))
    lacking = [(channel, j) in samples.lacking for j in range(position.shape[1])]
    # 1e-9 Nm; what changes less is none
    measured = np.flatnonzero((np.ptp(torque, axis=0) > 1e-9) & ~np.array(lacking)).tolist()
    window = 2 * (width - 1) * step
    return SideMotion(q[rows], dq[rows], ddq[rows], torque[rows], measured, window)


def _bend(values: Array) -> Array:
    """Return the second differences (N, k) of values; zero at the ends."""
    return np.pad(np.diff(values, n=2, axis=0), [(1, 1), (0, 0)])


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
        free[k] = max(_independent(left[:, k], gravity[:, k]) - 2.0, 0.1)
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
        basis = _own(motion, j, moved[:, j])
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


def _own(motion: SideMotion, j: int, *more: Array) -> Array:
    """Return an orthonormal basis (N, r) of the zero, friction and motor inertia of a joint, and of
    further columns."""
    friction = motion.friction(j)
    columns = [np.ones(len(friction)), friction, motion.dq[:, j], motion.ddq[:, j], *more]
    scaled = np.column_stack(
        [column / max(float(np.linalg.norm(column)), 1e-300) for column in columns]
    )
    basis, sizes, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(basis[:, sizes > RANK * sizes[0]])


def _independent(one: Array, other: Array) -> float:
    """Return the number of independent samples to which two series (N,) correspond."""
    alike = [
        fftconvolve(each, each[::-1])[len(each) :] / max(float(each @ each), 1e-300)
        for each in (one, other)
    ]
    return len(one) / max(1.0, 1.0 + 2.0 * float(alike[0] @ alike[1]))


class _Arm(NamedTuple):
    """The regressor Y(q, dq, ddq) (N, n, P) of the torques of a side, mean and spread of its
    parameters (P,), the body of each parameter (P,), and which are of the last link (P,)."""

    regressor: Callable[[Array, Array, Array], Array]
    mean: Array
    spread: Array
    body: NDArray[np.intp]
    of_last_link: NDArray[np.bool_]


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
    several = len(motion.measured) > 1 and float(np.sqrt(np.mean(motion.dq**2))) > CREEP
    confused = _size(fit, side, of_duty=motion.of_duty)
    arm = _arm(robot, side)
    # No gravity was subtracted from a duty: it is what the motor received.
    may_lack_gravity = several and not robot.elastic and not motion.of_duty
    load = _load_alone(few, arm) if may_lack_gravity else None
    # What weighs more than the arm is no load: torques of another unit do.
    if load is not None and load > sum(joint.link.mass for joint in robot.joints):
        load = None
    if confused and load is not None:
        confused = []
    if several and not confused:
        confused = _arranged(few, side, robot, arm, _shown(fit))
    # None where a single joint, or too little motion, leaves it open.
    upside = _upside_down(few, side, robot, arm) if several and not confused else None
    judged = [] if confused else _judged(fit, side, robot, upside)
    if several and not confused and not judged:
        judged = _sized(few, side, robot, arm)
    if load is not None:
        carried = f". What remains is the gravity of about {load:.2g} kg on the last link"
        judged = [
            replace(one, message=one.message + carried) if one.code == MISSING else one
            for one in judged
        ]
    return tuple(confused), tuple(judged)


def _arm(robot: Robot, side: str) -> _Arm:
    # A few thousand samples: compiling would take longer than all that is computed.
    n = robot.n
    model = build_model(robot, engine="numpy")

    def regressor(q: Array, dq: Array, ddq: Array) -> Array:
        if robot.elastic:
            q = np.hstack([q, q])
            dq = np.hstack([dq, dq])
            ddq = np.hstack([ddq, ddq])
        Y = model.regressor(q, dq, ddq)
        return Y[:, :n] + Y[:, n:] if robot.elastic and side == "motor" else Y[:, :n]

    spread, body = _spread(model)
    # The last body may be the rotor of the last joint, of which no parameter is a mass.
    masses = [k for k, one in enumerate(model.parameters) if one.name.endswith(".m")]
    return _Arm(regressor, model.Psi, spread, body, body == body[masses[-1]])


def _spread(model: Model) -> tuple[Array, NDArray[np.intp]]:
    """Return the scale of the mass, first moments and inertias of each body, (P,), and the number
    of the body; stiffness and damping have scale zero."""
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
        sizes.append(by_unit.get(parameter.unit, 0.0))
    numbers = {owner: k for k, owner in enumerate(mass)}
    return np.array(sizes), np.array([numbers[owner] for owner, *_ in names])


class _Products(NamedTuple):
    """Products of the columns of the measured joints (m joints), without the contributions of each
    joint alone.

    Columns are the parameters of the arm and the gains, in units of their spreads, (Q,); rows are
    the torques of all joints, the described gravity, and the described torque, (T,).
    """

    grams: Array  # (m, Q, Q) of the columns
    rights: Array  # (m, Q, T) of columns and rows
    powers: Array  # (m, T, T) of the rows
    columns: list[Array]  # (N, Q) of each joint
    rows: list[Array]  # (N, T) of each joint
    measured: list[int]
    body: NDArray[np.intp]  # (Q,), -1 of gains
    samples: int

    def coefficients(self, torques: Array, missing: Array | None = None) -> Array:
        """Return the coefficients (m, T) of the rows that the arm has to explain.

        torques: (n, n), the assumed torques in terms of the recorded ones; missing: (n,) share of
        the described gravity that each torque lacks.
        """
        n = torques.shape[1]
        found = np.zeros((len(self.measured), n + 2))
        found[:, :n] = torques[self.measured]
        found[:, n] = 0.0 if missing is None else missing[self.measured]
        found[:, n + 1] = -1.0
        return found


def _products(motion: SideMotion, arm: _Arm, own: Sequence[Array], weight: Array) -> _Products:
    """Form the products.

    own: basis of the contributions of each measured joint alone; weight: described gravity (N, n).
    """
    Y = arm.regressor(*motion[:3])
    predicted = Y @ arm.mean
    free = np.flatnonzero(arm.spread)
    m = len(motion.measured)
    columns = []
    rows = []
    for k, (j, basis) in enumerate(zip(motion.measured, own, strict=True)):
        gains = np.zeros((len(Y), m))
        gains[:, k] = GAIN * predicted[:, j]
        moved = Y[:, j, free] * arm.spread[free]
        both = np.column_stack([moved, gains, motion.torque, weight[:, j], predicted[:, j]])
        both -= basis @ (basis.T @ both)
        columns.append(both[:, : len(free) + m])
        rows.append(both[:, len(free) + m :])
    return _Products(
        np.array([c.T @ c for c in columns]),
        np.array([c.T @ r for c, r in zip(columns, rows, strict=True)]),
        np.array([r.T @ r for r in rows]),
        columns,
        rows,
        motion.measured,
        np.concatenate([arm.body[free], np.full(m, -1)]),
        len(Y),
    )


def _owns(motion: SideMotion) -> list[Array]:
    return [_own(motion, j) for j in motion.measured]


class _Fit(NamedTuple):
    likelihood: float  # its logarithm
    size: Array  # (Q,) of the columns
    squares: Array  # (m,) that are left
    scale2: Array  # (Q,) of the columns


def _likelihood(products: _Products, coefficients: Array, free: Array, near: _Fit | None) -> _Fit:
    """Return the logarithm of the likelihood of the torques.

    The noise of each joint and the deviation of each body from the description are estimated by
    expectation and maximisation.

    coefficients: (m, T) of the rows; free: number of independent samples of each joint's remainder,
    (m,); near: a similar fit from which the iteration starts.
    """
    grams = products.grams
    rights = np.einsum("jqt,jt->jq", products.rights, coefficients)
    power = np.einsum("js,jst,jt->j", coefficients, products.powers, coefficients)
    power = np.maximum(power, 1e-300)
    bodies = np.unique(products.body[products.body >= 0])
    belongs = (products.body[:, None] == bodies).astype(float)
    numbers = belongs.sum(axis=0)
    flat = grams.reshape(len(grams), -1)
    of_gains = products.body < 0
    squares = power if near is None else near.squares
    scale2 = np.where(of_gains, 1.0, MASSES**2) if near is None else near.scale2
    for _ in range(40):
        # Expectation: size of all columns under the present noise and deviations.
        weight = free / np.maximum(squares, 1e-12 * power)
        right = weight @ rights
        covariance, logdet = _covariance(weight, flat, scale2)
        size = covariance @ right
        # Maximisation: noise of the joints, and deviations of the bodies.
        left = power - 2.0 * rights @ size + (grams @ size) @ size
        left += flat @ covariance.ravel()
        second = (size**2 + np.diag(covariance)) @ belongs
        deviations = (TAILS * MASSES**2 + second) / (TAILS + numbers + 2.0)
        used = squares, scale2
        squares = np.maximum(left, 1e-12 * power)
        scale2 = np.where(of_gains, 1.0, belongs @ deviations)
        before = np.concatenate(used)
        change = np.abs(np.concatenate([squares, scale2]) - before)
        if np.all(change <= 0.01 * before):
            break
    squares, scale2 = used
    of_noise = free @ np.log(squares / products.samples)
    likely = -0.5 * float(of_noise + weight @ power - right @ covariance @ right)
    likely -= 0.5 * logdet
    of_bodies = scale2[~of_gains] @ belongs[~of_gains] / numbers
    gamma = (TAILS / 2.0 + 1.0) * np.log(of_bodies) + TAILS * MASSES**2 / 2.0 / of_bodies
    likely -= float(gamma.sum())
    return _Fit(likely, size, squares, scale2)


def _covariance(weight: Array, flat: Array, scale2: Array) -> tuple[Array, float]:
    """Return the posterior covariance (Q, Q) of the columns, and ln of the determinant of its
    inverse in units of the prior.

    weight: (m,) of the joints; flat: (m, Q²) products; scale2: (Q,) prior variances.
    """
    std = np.sqrt(scale2)
    scales = np.outer(std, std)
    known = scales * (weight @ flat).reshape(scales.shape)
    known[np.diag_indices_from(known)] += 1.0
    inverse, logdet = _inverse(known)
    return scales * inverse, logdet


def _inverse(matrix: Array) -> tuple[Array, float]:
    """Return the inverse of a positive definite matrix (Q, Q), and ln of its determinant."""
    factor, _ = lapack.dpotrf(matrix, lower=1)
    half, _ = lapack.dpotri(factor, lower=1)
    inverse = half + half.T  # LAPACK's lower half and zeros above it
    np.fill_diagonal(inverse, np.diag(half))
    logdet = 2.0 * float(np.sum(np.log(np.diag(factor))))
    return inverse, logdet


def _given(products: _Products) -> tuple[_Fit, Array]:
    """Return the fit with the description, and the number of independent samples of each remainder
    (m,)."""
    n = products.rows[0].shape[1] - 2
    coefficients = products.coefficients(np.eye(n))
    m = len(products.measured)
    every = np.full(m, float(products.samples))
    fit = _likelihood(products, coefficients, every, None)
    joints = zip(products.rows, products.columns, coefficients, strict=True)
    rests = [rows @ own - columns @ fit.size for rows, columns, own in joints]
    free = np.array([_independent(rest, rest) for rest in rests])
    return _likelihood(products, coefficients, free, fit), free


def _sized(motion: SideMotion, side: str, robot: Robot, arm: _Arm) -> list[Finding]:
    """Return the joint whose zero differs from the description, or whose torque lacks a share of
    gravity, with the size.

    For the last link, another zero is equivalent to another mass. If a gain of the torque is the
    better explanation, nothing is reported.
    """
    unit = np.eye(robot.n)
    own = _owns(motion)
    still = np.zeros_like(motion.q)
    weight = arm.regressor(motion.q, still, still) @ arm.mean
    as_given = _products(motion, arm, own, weight)
    given, free = _given(as_given)

    def zero(at: Array, size: float) -> float:
        moved = _products(motion._replace(q=motion.q - size * at), arm, own, weight)
        return _likelihood(moved, moved.coefficients(unit), free, given).likelihood

    def share(at: Array, size: float) -> float:
        coefficients = as_given.coefficients(unit, size * at)
        return _likelihood(as_given, coefficients, free, given).likelihood

    def gain(at: Array, size: float) -> float:
        # The noise stays with the torques as they were given.
        coefficients = as_given.coefficients(np.diag(np.exp(-size * at)))
        likely = _likelihood(as_given, coefficients, free, given).likelihood
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


def _upside_down(motion: SideMotion, side: str, robot: Robot, arm: _Arm) -> bool | None:
    """Return whether an arm mounted upside down is more likely than torques that all have the wrong
    sign, which also reverse the inertia; None if neither is far more likely."""
    unit = np.eye(robot.n)
    still = np.zeros_like(motion.q)
    own = _owns(motion)
    as_given = _products(motion, arm, own, still)
    given, free = _given(as_given)
    signs = _likelihood(as_given, as_given.coefficients(-unit), free, given).likelihood
    turned = _products(motion, _along(robot, side, -robot.gravity), own, still)
    mounted = _likelihood(turned, turned.coefficients(unit), free, given).likelihood
    return mounted > signs if abs(mounted - signs) > CERTAIN else None


def _load_alone(motion: SideMotion, arm: _Arm) -> float | None:
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
        basis = _own(motion, j, moved[:, j])
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


def _arranged(
    motion: SideMotion, side: str, robot: Robot, arm: _Arm, shown: Array
) -> list[Finding]:
    """Return which joints turn the other way, or have exchanged channels.

    The result is empty if another mounting explains the torques as well.

    shown: (3,) gravity that the torques show.
    """
    found: list[Finding] = []
    n = robot.n
    unit = np.eye(n)
    no_weight = np.zeros_like(motion.q)
    for _ in range(n):
        products = _products(motion, arm, _owns(motion), no_weight)
        given, free = _given(products)
        tried = []
        changes = []
        worth = np.zeros(n)
        worth[motion.measured] = free
        for angles, ways in _arrangements(robot.joint_names, motion.measured):
            moved = motion.moved(angles.__call__)
            there = products
            if not angles.is_none:
                there = _products(moved, arm, _owns(moved), no_weight)
            for code, words, torques in ways:
                # The noise stays with the torques as they were given.
                own_free = torques.samples(worth)[motion.measured]
                coefficients = there.coefficients(torques.matrix)
                likely = _likelihood(there, coefficients, own_free, given).likelihood
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
                mounted = _along(robot, side, gravity)
                there = _products(motion, mounted, _owns(motion), no_weight)
                likely = _likelihood(there, there.coefficients(unit), free, given).likelihood
                if likely - given.likelihood > max(tried)[0] - BESIDE:
                    return []
        found += one
        motion = moved._replace(torque=torques(motion.torque))
    return found


def _along(robot: Robot, side: str, gravity: Array) -> _Arm:
    """Return the arm with gravity of the described size in another direction (3,)."""
    size = float(np.linalg.norm(robot.gravity))
    direction = gravity / max(float(np.linalg.norm(gravity)), RANK)
    return _arm(robot.with_(gravity=size * direction), side)


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


_Way = tuple[str, str, _Turn]


def _coupled(joints: Sequence[str]) -> Iterator[tuple[_Turn, list[_Way]]]:
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
            same = _Turn(np.eye(len(joints)))
            yield _Turn(angles), [(COUPLED, alone, same), (COUPLED, both, _Turn(torques))]


def _arrangements(
    joints: Sequence[str], measured: Sequence[int]
) -> Iterator[tuple[_Turn, list[_Way]]]:
    """Yield possible confusions: corrections of the angles (…, n), each with the corrections of the
    torques that may accompany it."""

    yield from _coupled(joints)
    unit = np.eye(len(joints))
    same = _Turn(unit)
    alone: list[_Way] = []
    for j, name in enumerate(joints):
        mirrored = _Turn(unit - 2.0 * np.diag(unit[j]))
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
    backwards = _Turn(-unit)
    words = (
        "every joint turns in the opposite direction of the description; the signs of"
        " angles and torques are wrong"
    )
    yield backwards, [("mirrored", words, backwards)]
    pairs = [[i, j] for i, j in combinations(measured, 2)]
    for old in [*pairs, *([list(measured)] if len(measured) > 3 else [])]:
        order = np.arange(len(joints))
        order[old] = old[::-1]
        exchanged = _Turn(unit[order])
        names = " and ".join(joints[k] for k in old)
        whose = (
            f"of {names} seem to be exchanged" if len(old) == 2 else "are in reversed joint order"
        )
        yield exchanged, [("exchanged", f"all channels {whose}", exchanged)]
        alone.append(("exchanged", f"efforts {whose}", exchanged))
    yield same, alone


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


def angle_between(one: Array, other: Array) -> float:
    """Return the angle between two vectors (3,), rad."""
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.arccos(np.clip(one @ other / max(size, 1e-300), -1.0, 1.0)))
