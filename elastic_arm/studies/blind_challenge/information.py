"""The information of a recording about an effect, with everything ordinary marginalised, and sizes
from it.

Nothing of the diagnosis is used: residuals are those of Pinocchio's tree along the true motion, and
their noise follows from the drawn sensors. With the whitened change r of the residuals by an
effect, and the whitened changes N by one standard deviation of each ordinary number, the distance
is the square root of

    r'r - r'N (1 + N'N)^-1 N'r,

the size of the effect over its Cramér-Rao bound, with all ordinary numbers estimated together with
it from their priors. An exact arm has no ordinary numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import decimate

from elastic_arm.arrays import Array
from elastic_arm.errors import SimulationError
from elastic_arm.robot import Joint, Robot
from elastic_arm.studies.blind_challenge.hidden_arms.base_arms import strained
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import SENSOR_EFFECTS, Fault
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import RATE
from elastic_arm.studies.blind_challenge.hidden_arms.kinematic_tree import KinematicTree
from elastic_arm.studies.blind_challenge.hidden_arms.motion import HiddenMotion, TrueChannels
from elastic_arm.studies.blind_challenge.hidden_arms.realistic_sensors import (
    BOTH,
    LINK,
    RealisticSensors,
)
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel, measure
from elastic_arm.studies.blind_challenge.levels import Level

Key = tuple[str, int]

EVERY = 10  # samples at 1000 Hz, a row of the residuals
EDGE = 40.0  # Hz, upper edge of what counts; with one encoder alone:
EDGE_ONE_ENCODER = 5.0
FREE = 100.0  # a prior so wide that it states nothing: friction known by name
STEP = 1e-3  # of an ordinary number, for derivatives
# of the torques' noise power that each equation has on its own, as equations are never exact
OWN = 1e-2
ENDS = 50  # rows left out at either end, where derivatives are inexact
# Standard deviations of what is ordinary, as :mod:`.base_arms` draws it.
ORDINARY = {
    "mass": 0.05,
    "com": 0.006,
    "inertia": 0.03,
    "rotor": 0.03,
    "stiffness": 0.06,
    "damping": 0.12,
}
SHAPE = 0.012  # strain of a link's shape, each entry
SHAPES = tuple(f"shape_{a}{b}" for a in range(3) for b in range(3))
SENSOR_GAIN = 0.006
SENSOR_OFFSET = 0.3
ENCODER_OFFSET = 1e-5
WARMING = 0.06

ROUNDS = 4  # corrections of a size
NEAR = 0.05  # of the wanted distance
IDEAL = SensorModel(torque_noise=0.0, velocity_noise=0.0)
# Which ordinary numbers of its joint an effect is itself; their priors do not stand against it.
ITSELF = {
    "link_inertia_mismatch": ("mass", "inertia", *SHAPES),
    "rotor_inertia_mismatch": ("rotor",),
    "stiffness_mismatch": ("stiffness",),
    "damping_mismatch": ("damping",),
    "coulomb_friction": ("coulomb",),
    "viscous_friction": ("viscous",),
    "thermal_friction": ("thermal", "thermal_viscous"),
    "torque_drift": ("drift_1", "drift_2", "drift_3"),
    "encoder_offset": ("encoder_offset",),
    **{
        e: (e,)
        for e in (
            "motor_torque_gain",
            "joint_torque_gain",
            "motor_torque_offset",
            "joint_torque_offset",
        )
    },
}


@dataclass(frozen=True)
class TrueMotion:
    """A true motion with its accelerations."""

    channels: TrueChannels  # the motion and torques, at 1000 Hz
    # ddq, ddtheta: (N, n) rad/s²
    ddq: Array
    ddtheta: Array

    @staticmethod
    def of(channels: TrueChannels) -> TrueMotion:
        """Differentiate the velocities of a motion."""
        ddq = CubicSpline(channels.t, channels.dq)(channels.t, 1)
        ddtheta = CubicSpline(channels.t, channels.dtheta)(channels.t, 1)
        return TrueMotion(channels, ddq, ddtheta)

    def rows(self) -> tuple[Array, Array, Array]:
        """Return coordinates, velocities and accelerations (N / 10, 2 n) of every tenth sample."""
        c = self.channels
        pairs = ((c.q, c.theta), (c.dq, c.dtheta), (self.ddq, self.ddtheta))
        q, dq, ddq = (np.hstack(pair)[::EVERY] for pair in pairs)
        return q, dq, ddq


class MarginalInformation:
    """What sensors tell of effects on one arm."""

    def __init__(
        self, robot: Robot, sensors: RealisticSensors, motion: TrueChannels, level: Level
    ) -> None:
        self._robot = robot
        self._sensors = sensors
        self.n = robot.n
        self._warming = WARMING if level.warming else 0.0
        self._motor_gain = max(SENSOR_GAIN, 0.6 * level.torque_constant)
        gears = [joint.transmission for joint in robot.joints if joint.transmission]
        self._K = np.array([g.stiffness for g in gears])
        self._D = np.array([g.damping for g in gears])
        self._ratios = np.array([g.r_tot for g in gears])
        M = KinematicTree(robot).terms(np.zeros(2 * self.n), np.zeros(2 * self.n))[0]
        self._M = np.diag(M)[: self.n]
        self._B = np.diag(M)[self.n :]
        columns = {} if level.exact else self._ordinary(TrueMotion.of(motion))
        self._keys = tuple(columns)
        self._white = (
            self._whiten(np.stack(list(columns.values()), axis=-1)) if columns else np.zeros((0, 0))
        )

    def residuals(self, read: TrueChannels) -> Array:
        """Return what torques exceed the arm's own equations by, (N / 10, R, n)."""
        left = self._torque(self._robot, TrueMotion.of(read).rows())
        spring = self._K * (read.theta - read.q) + self._D * (read.dtheta - read.dq)
        slow = {
            name: decimate(getattr(read, name), EVERY, ftype="fir", axis=0)
            for name in ("tau_J", "tau_m")
        }
        spring = decimate(spring, EVERY, ftype="fir", axis=0)
        link = slow["tau_J"] - left[:, : self.n]
        motor = slow["tau_m"] - left[:, self.n :] - slow["tau_J"]
        return self.seen(link, slow["tau_J"] - spring, motor)

    def distance(self, change: Array, *, without: Collection[Key] = ()) -> float:
        """Return the whitened size of a change, everything ordinary marginalised."""
        r = self._whiten(change[..., None])[:, 0]
        if not self._keys:
            return float(np.linalg.norm(r))
        N = self._white[:, [k for k, key in enumerate(self._keys) if key not in without]]
        explained = N.T @ r
        left = float(r @ r - explained @ np.linalg.solve(np.eye(N.shape[1]) + N.T @ N, explained))
        return float(np.sqrt(max(left, 0.0)))

    def seen(self, link: Array, drive: Array, motor: Array) -> Array:
        """Stack the equations that the recorded sides leave, (N, R, n)."""
        if self._sensors.sides == BOTH:
            return np.stack([link, drive, motor], axis=1)
        return (link if self._sensors.sides == LINK else link + motor)[:, None]

    def _ordinary(self, course: TrueMotion) -> dict[Key, Array]:
        """Return the changes of the residuals by one standard deviation of each ordinary number."""
        rows = course.rows()
        n = self.n
        plain = self._torque(self._robot, rows)
        found = {}
        for j in range(n):
            for what, std, altered in _alterations(self._robot, j):
                change = (self._torque(altered, rows) - plain) / STEP * std
                found[what, j] = self.seen(
                    -change[:, :n], np.zeros_like(change[:, :n]), -change[:, n:]
                )
        found |= self._of_drives_and_sensors(course)
        return found

    def _of_drives_and_sensors(self, course: TrueMotion) -> dict[Key, Array]:
        c = course.channels
        part = {
            name: getattr(c, name)[::EVERY]
            for name in ("q", "theta", "dq", "dtheta", "tau_J", "tau_m")
        }
        N, n = part["q"].shape
        time = np.linspace(-0.5, 0.5, N)
        noise = np.asarray(self._sensors.torque_noise)
        found = {}
        for j in range(n):

            def at(
                link: Array | float = 0.0,
                drive: Array | float = 0.0,
                motor: Array | float = 0.0,
                j: int = j,
            ) -> Array:
                rows = np.zeros((3, N, n))
                rows[0, :, j] = link
                rows[1, :, j] = drive
                rows[2, :, j] = motor
                return self.seen(*rows)

            sign = np.sign(part["dtheta"][:, j])
            w = part["dtheta"][:, j]
            tau_J = part["tau_J"][:, j]
            tau_m = part["tau_m"][:, j]
            d = part["theta"][:, j] - part["q"][:, j]
            rate = part["dtheta"][:, j] - part["dq"][:, j]
            found["stiffness", j] = at(drive=-ORDINARY["stiffness"] * self._K[j] * d)
            found["damping", j] = at(drive=-ORDINARY["damping"] * self._D[j] * rate)
            found["coulomb", j] = at(motor=FREE * sign)
            found["viscous", j] = at(motor=FREE * w)
            found["joint_torque_gain", j] = SENSOR_GAIN * at(tau_J, tau_J, -tau_J)
            found["joint_torque_offset", j] = SENSOR_OFFSET * at(1.0, 1.0, -1.0)
            found["encoder_offset", j] = at(drive=ENCODER_OFFSET * self._K[j])
            found["motor_torque_gain", j] = self._motor_gain * at(motor=tau_m)
            found["motor_torque_offset", j] = SENSOR_OFFSET * at(motor=1.0)
            if self._warming:
                warm = self._warming * 10.0 * time
                found["thermal", j] = at(motor=warm * sign)
                found["thermal_viscous", j] = at(motor=warm * w)
            if self._sensors.drift:
                for k in (1, 2, 3):
                    wander = noise[j] * np.cos(k * np.pi * (time + 0.5))
                    found[f"drift_{k}", j] = at(wander, 0.0, wander)
        return found

    @staticmethod
    def _torque(robot: Robot, rows: tuple[Array, Array, Array]) -> Array:
        tree = KinematicTree(robot)
        return np.array([tree.torque(*row) for row in zip(*rows, strict=True)])

    def _whiten(self, columns: Array) -> Array:
        """Whiten columns (N, R, n, k) in the frequency domain, (N' R n, k): real and imaginary
        parts side by side."""
        columns = columns[ENDS:-ENDS]
        N = len(columns)
        f = np.fft.rfftfreq(N, EVERY / RATE)
        edge = EDGE if self._sensors.sides == BOTH else EDGE_ONE_ENCODER
        inside = (f <= edge) & (f <= 0.4 * self._sensors.rate)
        spectrum = np.fft.rfft(columns, axis=0)[inside] * (EVERY / RATE)
        S = self._noise(np.asarray(f[inside], dtype=float))
        # |X(f)|² over the power density of a stretch of T seconds has mean 1 a real part where the
        # noise is white.
        T = N * EVERY / RATE
        root = np.linalg.cholesky(S * T / 4.0)
        root[0] *= np.sqrt(2.0)  # a mean has no imaginary part
        found = []
        for j in range(self.n):
            white = np.linalg.solve(root[:, j], spectrum[:, :, j])
            found += [
                white.real.reshape(-1, columns.shape[-1]),
                white.imag.reshape(-1, columns.shape[-1]),
            ]
        return np.concatenate(found)

    def _noise(self, f: Array) -> Array:
        """One-sided cross-spectral density (F, n, R, R) of the residuals of each joint, Nm²/Hz."""
        s = self._sensors
        rate = self._sensors.rate
        variance = np.asarray(s.torque_noise) ** 2
        torque = np.full((len(f), self.n), 2.0 / rate) * variance
        if s.corner is not None:
            torque = (
                0.1 * torque
                + 0.9 * variance * (2 / (np.pi * s.corner) / (1 + (f / s.corner) ** 2))[:, None]
            )
        link = np.full(self.n, (s.link_step**2 / 12 + s.encoder_noise**2) * 2 / rate)
        motor = (s.motor_steps(self._ratios) ** 2 / 12 + s.encoder_noise**2) * 2 / rate
        w2 = ((2 * np.pi * f) ** 2)[:, None]
        # Rows: how tau_J, tau_m, q and theta enter link, drive and motor.
        H = np.zeros((len(f), self.n, 3, 4))
        H[:, :, 0, 0] = 1.0
        H[:, :, 1, 0] = 1.0
        H[:, :, 2, 0] = -1.0
        H[:, :, 2, 1] = 1.0
        H[:, :, 0, 2] = self._M * w2
        H[:, :, 1, 2] = self._K
        H[:, :, 1, 3] = -self._K
        H[:, :, 2, 3] = self._B * w2
        if s.sides == LINK:
            H = H[:, :, :1]
        elif s.sides != BOTH:
            # q is not seen: theta stands in its place.
            H = (H[:, :, 0] + H[:, :, 2])[:, :, None]
            H[..., 3] += H[..., 2]
            H[..., 2] = 0.0
        power = np.stack(
            [
                torque,
                torque,
                np.broadcast_to(link, torque.shape),
                np.broadcast_to(motor, torque.shape),
            ],
            -1,
        )
        S = np.einsum("fnrc,fnc,fnsc->fnrs", H, power, H)
        return S + OWN * variance[:, None, None] * np.eye(S.shape[-1]) * 2.0 / rate


def _alterations(robot: Robot, j: int) -> list[tuple[str, float, Robot]]:
    """Return arms with one inertial number of joint j changed by STEP, with its name and ordinary
    deviation."""
    joint = robot.joints[j]
    link = joint.link
    gear = joint.transmission
    assert gear is not None
    found = []

    def add(what: str, std: float, changed: Joint) -> None:
        joints = [*robot.joints[:j], changed, *robot.joints[j + 1 :]]
        found.append((what, std, robot.with_(joints=tuple(joints))))

    up = 1 + STEP
    add(
        "mass",
        ORDINARY["mass"],
        replace(joint, link=replace(link, mass=link.mass * up, inertia=link.inertia * up)),
    )
    for axis in range(3):
        com = np.asarray(link.com) + STEP * np.eye(3)[axis]
        add(f"com_{'xyz'[axis]}", ORDINARY["com"], replace(joint, link=replace(link, com=com)))
    add(
        "inertia",
        ORDINARY["inertia"],
        replace(joint, link=replace(link, inertia=link.inertia * up)),
    )
    for name, strain in zip(SHAPES, np.eye(9).reshape(9, 3, 3), strict=True):
        shape = strained(np.asarray(link.inertia), STEP * strain)
        add(name, SHAPE, replace(joint, link=replace(link, inertia=shape)))
    add("rotor", ORDINARY["rotor"], replace(joint, transmission=gear.with_inertias(up)))
    return found


@dataclass(frozen=True)
class EffectDraft:
    """An effect without its size."""

    make: Callable[[float], Fault]  # returns the effect with so much of it
    low: float  # smallest amount
    high: float  # largest amount
    first: float  # amount that is tried first


@dataclass(frozen=True)
class SizedEffect:
    """An effect of a size."""

    fault: Fault
    distance: float  # multiple of its bound that it is
    bound: float
    excess: float  # mean square of what it does to the residuals, Nm^2


class Sizing:
    """Sizes of effects on one arm.

    `run` moves the arm with some faults, without its ordinary friction.
    """

    def __init__(
        self,
        robot: Robot,
        sensors: RealisticSensors,
        level: Level,
        motion: HiddenMotion,
        friction: Sequence[Fault],
        run: Callable[[Sequence[Fault]], TrueChannels],
    ) -> None:
        self._robot = robot
        self._motion = motion
        self._run = run
        self._friction: dict[tuple[str, int | None], float] = {}
        self.add_friction(friction)
        self._plain = run(())
        self._information = MarginalInformation(robot, sensors, self._plain, level)
        self._left = self._information.residuals(self._plain)

    def add_friction(self, friction: Sequence[Fault]) -> None:
        """Give the arm friction that other effects scale."""
        self._friction |= {(f.effect, f.joint): next(iter(f.parameters.values())) for f in friction}

    def peak(self) -> Array:
        """Return the largest motor torques (n,) of the plain motion, Nm."""
        return np.abs(self._plain.tau_m).max(axis=0)

    def sized(self, draft: EffectDraft, wanted: float) -> SizedEffect:
        """Return an effect of the wanted distance, within its limits."""
        high = draft.high
        tried = reached = draft.first
        distance = excess = 0.0
        for _ in range(ROUNDS):
            try:
                distance, excess = self.change(draft.make(tried))
                reached = tried
            except SimulationError:
                high = tried = 0.5 * tried
                continue
            better = float(
                np.clip(tried * wanted / max(distance, 1e-9), min(draft.low, high), high)
            )
            if abs(better / tried - 1.0) < NEAR:
                break
            tried = better
        return SizedEffect(draft.make(reached), distance, reached / max(distance, 1e-9), excess)

    def change(self, fault: Fault) -> tuple[float, float]:
        """Return how far a fault changes the residuals, and their mean square in Nm².

        The change is whitened and marginalised.
        """
        if fault.effect in SCALING:
            change = self._of_friction(fault)
        else:
            read = _read(self._run((fault,)), fault, self._robot.joint_names)
            # What sampling leaves of the plain motion is no effect.
            change = self._information.residuals(read) - self._left
        without = {(name, fault.joint or 0) for name in ITSELF.get(fault.effect, ())}
        return self._information.distance(change, without=without), float(
            np.mean(change[ENDS:-ENDS] ** 2)
        )

    def _of_friction(self, fault: Fault) -> Array:
        """Change of the residuals by what scales friction, from its law: the arm is moved without
        its friction."""
        j = fault.joint or 0
        w = self._plain.dtheta[::EVERY, j]
        torque = self._friction.get(("coulomb_friction", j), 0.0) * np.sign(w)
        torque += self._friction.get(("viscous_friction", j), 0.0) * w
        rows = np.zeros((3, len(w), self._robot.n))
        rows[2, :, j] = torque * SCALING[fault.effect](fault, w)
        return self._information.seen(*rows)


# By what factor less 1 an effect scales friction, at velocities (N,) evenly over the run.
SCALING: dict[str, Callable[[Fault, Array], Array]] = {
    "thermal_friction": lambda fault, w: (
        fault.parameters["change"] * np.linspace(-0.5, 0.5, len(w))
    ),
    "asymmetric_friction": lambda fault, w: fault.parameters["asymmetry"] * np.sign(w),
}


def _read(true: TrueChannels, fault: Fault, joints: Sequence[str]) -> TrueChannels:
    """Return what ideal sensors with this fault read."""
    if fault.effect not in SENSOR_EFFECTS:
        return true
    read = measure(true, joints, [fault], IDEAL, np.random.default_rng(0))
    assert read.link is not None and read.motor is not None
    sides = {"q": read.link.position, "dq": read.link.velocity, "tau_J": read.link.effort}
    sides |= {
        "theta": read.motor.position,
        "dtheta": read.motor.velocity,
        "tau_m": read.motor.effort,
    }
    return TrueChannels(true.t, **{name: np.asarray(values) for name, values in sides.items()})
