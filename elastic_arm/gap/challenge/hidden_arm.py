"""The hidden arm: forward simulation in Pinocchio, with effects, a drive that holds its command, and sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from elastic_arm.errors import SimulationError
from elastic_arm.gap.challenge.instruments import Instruments, measure
from elastic_arm.gap.challenge.laws import Fault, JointLaws
from elastic_arm.gap.challenge.motion import MultiSine
from elastic_arm.gap.challenge.tree import Tree
from elastic_arm.recording import Recording
from elastic_arm.robot import Component, Inertia, Robot, Transmission

RATE = 1000.0
SUBSTEPS = 2  # RK4 steps a sample; the middle one also gives tau_J for its mean over the sample interval
BEARING_SUBSTEPS = 8  # bearing modes lie at some hundred Hz
CONTROL_BANDWIDTH = 20.0  # rad/s


@dataclass(frozen=True)
class Course:
    """What really happened, at the samples.

    Parameters
    ----------
    t
        (N,) s.
    q, dq, theta, dtheta
        (N, n) at the instant of the sample.
    tau_J, tau_m
        (N, n) means over the sample interval centred on it.
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    theta: np.ndarray
    dtheta: np.ndarray
    tau_J: np.ndarray
    tau_m: np.ndarray


class HiddenArm:
    """An arm with effects that nobody but the challenge knows.

    Parameters
    ----------
    robot
        The nominal arm.
    faults
        What the real arm has more.
    """

    def __init__(self, robot: Robot, faults: Sequence[Fault] = ()) -> None:
        self.nominal, self.faults = robot, tuple(faults)
        self.robot = altered(robot, faults)
        by_effect = {fault.effect: fault for fault in faults}
        soft = by_effect.get("bearing_compliance")
        tilt = by_effect.get("base_tilt")
        angles = (tilt.parameters["x"], tilt.parameters["y"]) if tilt else (0.0, 0.0)
        self.tree = Tree(self.robot, bearings=soft is not None, base_tilt=angles)
        self.n = robot.n
        self.substeps = BEARING_SUBSTEPS if soft else SUBSTEPS
        gears = [joint.transmission for joint in self.robot.joints if joint.transmission]
        bearings = [gear.bearing for gear in gears if gear.bearing] if soft else []
        scale = soft.parameters["stiffness_scale"] if soft else 1.0
        # Tilts are ordered [q_x of all joints, q_y of all joints].
        self._tilt_stiffness = scale * np.array([b.stiffness for b in bearings * 2])
        self._tilt_damping = np.array([b.damping for b in bearings * 2])
        self._h = 1.0 / RATE / self.substeps
        r_hd = np.array([gear.harmonic_drive_ratio for gear in gears])
        r_tot = r_hd * np.array([gear.belt_ratio for gear in gears])
        self.laws = JointLaws(
            faults,
            np.array([gear.stiffness for gear in gears]),
            np.array([gear.damping for gear in gears]),
            r_hd,
            r_tot,
            self._standstill(),
        )

    def _standstill(self) -> np.ndarray:
        """Speeds below which dry friction is smoothed: small, but wide enough for RK4 to stay stable."""
        M, _ = self.tree.terms(np.zeros(self.tree.dof), np.zeros(self.tree.dof))
        inertia = 1.0 / np.diag(np.linalg.inv(M))[: 2 * self.n]
        torque = np.zeros(2 * self.n)
        for fault in self.faults:
            if fault.effect in ("coulomb_friction", "stribeck_friction") and fault.joint is not None:
                torque[fault.joint + (self.n if fault.side == "motor" else 0)] += fault.parameters["torque"]
        speeds = torque * self._h / (1.5 * inertia)
        return np.maximum(np.maximum(speeds[: self.n], speeds[self.n :]), 1e-4)

    def run(self, motion: MultiSine) -> Course:
        """Follow a motion from rest.

        Raises
        ------
        SimulationError
            When the motion leaves the finite numbers.
        """
        n, N = self.n, round(motion.duration * RATE)
        t = np.arange(N + 1) / RATE
        desired = motion.evaluate(t)
        feed_forward = self._feed_forward(*desired)
        M0, _ = self.tree.terms(np.zeros(self.tree.dof), np.zeros(self.tree.dof))
        inertia = np.diag(M0)[:n] + np.diag(M0)[n : 2 * n]
        Kp, Kd = inertia * CONTROL_BANDWIDTH**2, 1.4 * inertia * CONTROL_BANDWIDTH
        state = self._rest(desired[0][0], feed_forward[0])
        half = self.substeps // 2
        states = np.empty((N + 1, len(state)))
        commands = np.empty((N + 1, n))
        torques = np.empty((N + 1, self.substeps + 1, n))  # tau_J over the interval around each sample
        torques[0] = self._joint_torque(state)
        for k in range(N):
            states[k] = state
            theta, dtheta = self._motor(state)
            u = feed_forward[k] + Kp * (desired[0][k] - theta) + Kd * (desired[1][k] - dtheta)
            commands[k] = u
            for step in range(self.substeps):
                state = self._rk4(state, u)
                tau_J = self._joint_torque(state)
                if step + 1 <= half:
                    torques[k, half + step + 1] = tau_J
                if step + 1 >= half:
                    torques[k + 1, step + 1 - half] = tau_J
            if not np.isfinite(state).all():
                raise SimulationError(f"the hidden arm left the finite numbers at {t[k]:.3f} s", "Draw smaller effects")
        weights = _simpson(self.substeps)
        tau_J = np.einsum("s,ksn->kn", weights, torques[1:N])
        tau_m = 0.5 * (commands[1:N] + commands[: N - 1])
        x, dx = states[1:N, : self.tree.dof], states[1:N, self.tree.dof : 2 * self.tree.dof]
        return Course(t[1:N], x[:, :n], dx[:, :n], x[:, n : 2 * n], dx[:, n : 2 * n], tau_J, tau_m)

    def record(self, motion: MultiSine, instruments: Instruments, rng: np.random.Generator) -> Recording:
        """Follow a motion and return what the sensors say."""
        course = self.run(motion)
        return measure(course, self.nominal.joint_names, self.faults, instruments, rng)

    def _feed_forward(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """Torque (N, n) of the arm as if its joints were stiff, from the nominal numbers."""
        tree = Tree(self.nominal)
        both = [np.hstack([v, v]) for v in (q, dq, ddq)]
        torque = np.array([tree.torque(*row) for row in zip(*both, strict=True)])
        return torque[:, : self.n] + torque[:, self.n :]

    def _rest(self, theta: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """State at rest with the springs loaded by gravity (`torque` (n,))."""
        dof, n = self.tree.dof, self.n
        x = np.zeros(dof)
        x[n : 2 * n] = theta
        x[:n] = theta - torque / self.laws.K
        return np.concatenate([x, np.zeros(dof), np.zeros(n)])

    def _motor(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        dof, n = self.tree.dof, self.n
        return state[n : 2 * n], state[dof + n : dof + 2 * n]

    def _joint_torque(self, state: np.ndarray) -> np.ndarray:
        dof, n = self.tree.dof, self.n
        theta, dtheta = self._motor(state)
        return self.laws.joint_torque(state[:n], theta, state[dof : dof + n], dtheta, state[2 * dof :])[0]

    def _rate(self, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        dof, n = self.tree.dof, self.n
        x, dx, z = state[:dof], state[dof : 2 * dof], state[2 * dof :]
        laws, w_link, w_motor = self.laws, dx[:n], dx[n : 2 * n]
        M, h = self.tree.terms(x, dx)
        tau_J, lever, dz = laws.joint_torque(x[:n], x[n : 2 * n], w_link, w_motor, z)
        f = -h
        f[:n] += tau_J - laws.friction("link", w_link, tau_J)
        f[n : 2 * n] += u + laws.ripple(x[n : 2 * n]) - lever * tau_J - laws.friction("motor", w_motor, tau_J)
        if dof > 2 * n:
            f[2 * n :] -= self._tilt_stiffness * x[2 * n :] + self._tilt_damping * dx[2 * n :]
        return np.concatenate([dx, np.linalg.solve(M, f), dz if laws.has_state else np.zeros(n)])

    def _rk4(self, y: np.ndarray, u: np.ndarray) -> np.ndarray:
        h = self._h
        k1 = self._rate(y, u)
        k2 = self._rate(y + 0.5 * h * k1, u)
        k3 = self._rate(y + 0.5 * h * k2, u)
        k4 = self._rate(y + h * k3, u)
        return y + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)


def altered(robot: Robot, faults: Sequence[Fault]) -> Robot:
    """Return the arm with those effects that change its numbers."""
    joints = list(robot.joints)
    for fault in faults:
        p = fault.parameters
        if fault.effect == "payload":
            joints[-1] = replace(joints[-1], link=_with_point(joints[-1].link, p["mass"], _position(p)))
        elif fault.effect == "link_inertia_mismatch" and fault.joint is not None:
            link = joints[fault.joint].link
            scaled = replace(link, mass=link.mass * p["mass"], inertia=np.asarray(link.inertia) * p["mass"])
            joints[fault.joint] = replace(joints[fault.joint], link=scaled)
        elif fault.effect in ("rotor_inertia_mismatch", "stiffness_mismatch", "damping_mismatch"):
            joint = joints[fault.joint or 0]
            if joint.transmission is not None:
                joints[fault.joint or 0] = replace(joint, transmission=_altered_gear(joint.transmission, fault))
    return robot.with_(joints=tuple(joints))


def _altered_gear(gear: Transmission, fault: Fault) -> Transmission:
    p = fault.parameters
    if fault.effect == "stiffness_mismatch":
        return replace(gear, stiffness=gear.stiffness * p["stiffness"])
    if fault.effect == "damping_mismatch":
        return replace(gear, damping=gear.damping * p["damping"])
    factor = p["inertia"]
    return replace(
        gear,
        rotor=_scaled(gear.rotor, factor),
        wave_generator=_scaled(gear.wave_generator, factor),
        spline=_scaled(gear.spline, factor),
    )


def _scaled(part: Component, factor: float) -> Component:
    return replace(part, ixx=part.ixx * factor, izz=part.izz * factor)


def _with_point(link: Inertia, mass: float, position: np.ndarray) -> Inertia:
    """Return the link's inertia with a point mass added (parallel axes)."""
    total = link.mass + mass
    old = np.asarray(link.com, dtype=float)
    com = (link.mass * old + mass * position) / total
    inertia = np.asarray(link.inertia) + _steiner(link.mass, old - com) + _steiner(mass, position - com)
    return replace(link, mass=total, com=com, inertia=inertia)


def _steiner(mass: float, r: np.ndarray) -> np.ndarray:
    return mass * (r @ r * np.eye(3) - np.outer(r, r))


def _position(parameters: Mapping[str, float]) -> np.ndarray:
    return np.array([parameters[f"position_{axis}"] for axis in "xyz"])


def _simpson(intervals: int) -> np.ndarray:
    """Weights (intervals + 1,) of the mean over an even number of intervals."""
    weights = np.ones(intervals + 1)
    weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
    return weights / (3.0 * intervals)
