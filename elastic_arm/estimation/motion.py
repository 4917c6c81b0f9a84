"""The smoothed motion of a recording, and substitutes for channels that were not recorded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
import scipy

from elastic_arm.arrays import Array, Indices, Mask
from elastic_arm.dynamics import Model
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.noise import StateNoise, noise_filter
from elastic_arm.recording.sides import Lacking

# Hz, up to which it follows a joint torque sensor: the widest band in which residuals are looked at
SENSED = 40.0
BEHIND = 12.0  # Hz, up to which the deflection behind a single encoder follows the load
PADDING = 500  # samples
_CHANNELS = ("q", "theta", "tau_J", "tau_m", "r")
_NO_CHANNELS = ("noise", "every", "span", "before", "lacking")


@dataclass(frozen=True)
class Motion:
    """Motion and torques after the derivative stage; the rows of all equations are made of it."""

    t: Array  # (N,) s
    # q, dq, ddq, theta, dtheta, ddtheta: (N, n), or None for a side that was not recorded
    q: Array | None = None
    dq: Array | None = None
    ddq: Array | None = None
    theta: Array | None = None
    dtheta: Array | None = None
    ddtheta: Array | None = None
    # tau_J, tau_m: (N, n) Nm, passed through the same filter as the motion, or None
    tau_J: Array | None = None
    tau_m: Array | None = None
    # (N, 3 n, k) columns of laws beyond the model, for link, drive and motor residuals, passed
    # through the same filter too (a law may jump where the motion does not); None where they are to
    # be evaluated as they stand
    laws: Array | None = None
    # (N, n) where a joint sticks, so that its dry friction may take any value; None where that does
    # not matter
    stuck: Mask | None = None
    noise: StateNoise | None = (
        None  # of positions and their derivatives; None where they are taken for exact
    )
    every: int = 1  # how many samples of the recording each of these stands for
    # begin and end of the whole recording on the axis of `t`, s; None where it is these samples
    # alone
    span: tuple[float, float] | None = None
    # the motion up to the first sample, where the recording was cut there: internal states of
    # effects go on from it
    before: Motion | None = None
    # channels with the index of a joint that lacks them while others have them; there the angle is
    # that of the joint's other side, and the torque is zero
    lacking: Lacking = frozenset()
    # (N, n) what controllers follow that made tau_m, rad or share of full duty, passed through the
    # same filter; None where it was measured
    r: Array | None = None

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, part: slice | Indices) -> Self:
        kept: dict[str, Any] = {name: values[part] for name, values in self.channels().items()}
        return replace(self, **kept)

    @property
    def recorded(self) -> frozenset[str]:
        """Names of the channels that are there, among q, theta, tau_J, tau_m, r."""
        return frozenset(self.channels()) & frozenset(_CHANNELS)

    def recorded_at(self, joint: int) -> frozenset[str]:
        """Return the names of the channels that a joint has, by its index."""
        return frozenset(name for name in self.recorded if (name, joint) not in self.lacking)

    def unrecorded(self, channel: str, n: int) -> Mask:
        """Return which of n joints (n,) lack a channel."""
        return np.array([channel not in self.recorded_at(j) for j in range(n)])

    def follows_link_at(self, joint: int) -> bool:
        """Whether a motor's motion has to be made of the link's motion.

        That is for an equation of its own beside torque sensors.
        """
        return self.recorded_at(joint) - {"r"} == {"q", "tau_J", "tau_m"}

    @property
    def encoders(self) -> Array:
        """Which encoders angles come from, (2 n, 2 n): [link, motor] to [q, theta].

        An angle that a joint lacks is made of its other one, with whose noise.
        """
        n = next(v.shape[1] for v in (self.q, self.theta) if v is not None)
        q = np.diag([float("q" in self.recorded_at(joint)) for joint in range(n)])
        theta = np.diag([float("theta" in self.recorded_at(joint)) for joint in range(n)])
        return np.block([[q, np.eye(n) - q], [np.eye(n) - theta, theta]])

    def channels(self) -> dict[str, Array]:
        """Return what is there for every sample, by name."""
        kept = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in _NO_CHANNELS}
        return {name: values for name, values in kept.items() if values is not None}

    @staticmethod
    def joined(parts: list[Motion]) -> Motion:
        """Put parts with the same channels, noise and spacing one after another."""
        if len(parts) == 1:
            return parts[0]
        whole: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in parts[0].channels()
        }
        first = parts[0]
        return replace(first, **whole)


@dataclass(frozen=True)
class CompletedMotion(Motion):
    """Motion with every channel, as :func:`completed` makes it."""

    q: Array
    dq: Array
    ddq: Array
    theta: Array
    dtheta: Array
    ddtheta: Array
    tau_J: Array
    tau_m: Array
    before: CompletedMotion | None = None

    def coordinates(self, rate: str = "", *, elastic: bool = True) -> Array:
        """Return coordinates [q, theta] (N, 2 n) or [q], or their `rate` "d" or "dd"."""
        q = getattr(self, rate + "q")
        theta = getattr(self, rate + "theta")
        return np.hstack([q, theta]) if elastic else q


Loads = Callable[["CompletedMotion"], Array]
Angles = tuple[Array | None, Array | None, Array | None]  # with rates and accelerations


def completed(motion: Motion, model: Model, loads: Loads | None = None) -> CompletedMotion:
    """Fill in missing channels by what cancels from the usable rows.

    loads: what loads the drives (N, n) Nm along a motion beside the model's own torques, such as a
    payload; it winds a drive whose deflection no encoder shows.
    """
    K, D = drive_constants(model)
    link = motion.q, motion.dq, motion.ddq
    motor = motion.theta, motion.dtheta, motion.ddtheta
    q, dq, ddq = _first_recorded(link, motor)
    theta, dtheta, ddtheta = _first_recorded(motor, link)
    if q is None or dq is None or ddq is None or theta is None or dtheta is None or ddtheta is None:
        raise DiagnosisError(
            "the recording contains no positions",
            "Record /motor_states or /joint_states with positions",
        )
    without_q = motion.unrecorded("q", model.n)
    if without_q.any() and model.robot.elastic:
        load = model.inverse_dynamics(*(np.hstack([v, v]) for v in (q, dq, ddq)))[:, : model.n]
        wound = _deflection(model, motion.t, load, BEHIND)
        q, dq, ddq = _moved((q, dq, ddq), -1.0, wound, without_q)
        if loads is not None:
            more = loads(completed(motion, model))
            wound = _deflection(model, motion.t, more, BEHIND)
            q, dq, ddq = _moved((q, dq, ddq), -1.0, wound, without_q)
    follows = np.array([motion.follows_link_at(j) for j in range(model.n)])
    if follows.any() and motion.tau_J is not None and model.robot.elastic:
        wound = _deflection(model, motion.t, motion.tau_J, SENSED)
        theta, dtheta, ddtheta = _moved((theta, dtheta, ddtheta), 1.0, wound, follows)
    tau_J = K * (theta - q) + D * (dtheta - dq)
    if motion.tau_J is not None:
        tau_J = np.where(motion.unrecorded("tau_J", model.n), tau_J, motion.tau_J)
    tau_m = motion.tau_m if motion.tau_m is not None else np.zeros_like(tau_J)
    before = None if motion.before is None else completed(motion.before, model, loads)
    return CompletedMotion(
        motion.t,
        q,
        dq,
        ddq,
        theta,
        dtheta,
        ddtheta,
        tau_J,
        tau_m,
        span=motion.span,
        before=before,
        r=motion.r,
    )


def _first_recorded(own: Angles, other: Angles) -> Angles:
    """Return angles and their rates of one side; of the other where the first lacks them."""
    position, rate, acceleration = (
        mine if mine is not None else theirs for mine, theirs in zip(own, other, strict=True)
    )
    return position, rate, acceleration


def _moved(
    angles: tuple[Array, Array, Array],
    sign: float,
    wound: Sequence[Array],
    where: Mask,
) -> tuple[Array, Array, Array]:
    """Return angles and their rates (N, n) with a deflection added at some joints."""
    position, rate, acceleration = (
        v + sign * np.where(where, w, 0.0) for v, w in zip(angles, wound, strict=True)
    )
    return position, rate, acceleration


def with_filtered_deflection(
    motion: Motion, rate: float, f: Array, noise: Array, finer_motors: Mask
) -> Motion:
    """Return motion with less noise in the deflections.

    The coarser encoder of each joint is made of the finer one and the filtered deflection.

    A deflection is little more than the steps of the encoders that it is the difference of. What a
    drive's laws are made of, first of all laws with a state, then follows the noise: loops of
    hysteresis come out too large.

    motion: with both encoders; returned as it is where it lacks one; f: (F,) Hz, as far as the
    motion reaches; noise: (F, n) in the deflection, rad²; 1 is white noise of one rad a sample.
    Null where a joint lacks an encoder; finer_motors: (n,) whether the motor's encoder is the finer
    one.
    """
    names = (("q", "theta"), ("dq", "dtheta"), ("ddq", "ddtheta"))
    if any(getattr(motion, name) is None for pair in names for name in pair):
        return motion
    changed: dict[str, Any] = {
        name: np.array(getattr(motion, name)) for pair in names for name in pair
    }
    for joint in np.flatnonzero(noise.any(axis=0)):
        filtered = noise_filter(
            changed["theta"][:, joint] - changed["q"][:, joint], rate, f, noise[:, joint]
        )
        for q, theta in names:
            deflection = filtered(changed[theta][:, joint] - changed[q][:, joint])
            if finer_motors[joint]:
                changed[q][:, joint] = changed[theta][:, joint] - deflection
            else:
                changed[theta][:, joint] = changed[q][:, joint] + deflection
    return replace(motion, **changed)


def wound_by_load(
    model: Model, motion: CompletedMotion, loads: Loads | None = None
) -> CompletedMotion:
    """Return motion whose deflections follow the model's load, not the two encoders.

    Where no joint torque is measured, the deflection stands in the residual itself, times the
    stiffness. Made of it, the columns of effects of the drive would hold the errors of both
    encoders, and a drive that carries no torque would fit best (errors in variables, Fuller 1987).
    """
    theta = motion.theta
    dtheta = motion.dtheta
    ddtheta = motion.ddtheta
    motor_side = Motion(
        motion.t, theta=theta, dtheta=dtheta, ddtheta=ddtheta, tau_m=motion.tau_m, r=motion.r
    )
    return completed(motor_side, model, loads)


def _deflection(model: Model, t: Array, load: Array, cutoff: float) -> tuple[Array, Array, Array]:
    """Deflection of the drives (N, n), and two derivatives, under a load; it stands in for an
    encoder that is missing.

    t: (N,) s; load: (N, n) Nm: what the arm would be if it were stiff, which hardly depends on the
    deflection at low frequencies, or what joint torque sensors measure.
    """
    K, D = drive_constants(model)
    padded = np.pad(load, ((PADDING, PADDING), (0, 0)), mode="reflect")
    f = np.fft.rfftfreq(len(padded), t[1] - t[0])[:, None]
    s = 2j * np.pi * f
    wound = np.fft.rfft(padded, axis=0) * np.exp(-0.5 * (f / cutoff) ** 2) / (K + s * D)
    kept = slice(PADDING, PADDING + len(load))
    found = [np.fft.irfft(wound * s**k, len(padded), axis=0)[kept] for k in range(3)]
    return found[0], found[1], found[2]


def drive_constants(model: Model) -> tuple[Array, Array]:
    """Return K (n,) Nm/rad and D (n,) Nm s/rad; zero without transmissions."""
    drives = [spring for spring in model.bodies.springs if spring.against is not None]
    if not drives:
        return np.zeros(model.n), np.zeros(model.n)
    stiffness = [spring.stiffness for spring in drives]
    damping = [spring.damping for spring in drives]
    return model.Psi[stiffness], model.Psi[damping]


def rates_of(t: Array, values: Array) -> Array:
    """Return time derivatives (N, …) of signals (N, …) at their times t (N,), by cubic splines."""
    spline = scipy.interpolate.CubicSpline(t, values)
    # At an instant the derivative is a coefficient of the piece that begins there.
    return np.concatenate([spline.c[2], spline(t[-1:], 1)])


def moved_in_time(spline: scipy.interpolate.CubicSpline, later: float) -> Array:
    """Return what a spline through samples is `later` s after each of them, (N,).

    Beyond the first and the last sample it is what it is there.
    """
    t = spline.x
    steps = int(np.floor(later * (len(t) - 1) / (t[-1] - t[0])))
    moved = slice(max(0, -steps), min(len(t), len(t) - 1 - steps))
    pieces = slice(moved.start + steps, moved.stop + steps)
    # Of samples at nearly regular times each comes to lie in the same piece beside its own: nothing
    # needs to be looked for.
    is_regular = moved.start < moved.stop
    if is_regular:
        after = t[moved] + later - t[pieces]
        is_regular = bool(np.all((after >= 0.0) & (after <= np.diff(t)[pieces])))
    if not is_regular:
        return spline(np.clip(t + later, t[0], t[-1]))
    found = np.empty(len(t))
    found[: moved.start] = spline.c[-1, 0]
    found[moved] = _cubic(spline.c[:, pieces], after)
    found[moved.stop :] = spline(t[-1])
    return found


def _cubic(c: Array, after: Array) -> Array:
    """Return cubic polynomials of coefficients (4, N), highest first, each at its place (N,)."""
    found = c[0] * after
    for one in c[1:-1]:
        found += one
        found *= after
    found += c[-1]
    return np.asarray(found)
