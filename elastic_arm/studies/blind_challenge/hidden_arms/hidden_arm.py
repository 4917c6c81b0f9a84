"""The hidden arm: Pinocchio's bodies with effects, a drive that holds its command, and sensors."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from elastic_arm.arrays import Array
from elastic_arm.errors import SimulationError
from elastic_arm.recording import Recording
from elastic_arm.robot import Inertia, Robot, Transmission
from elastic_arm.robot.kinematics import lumped
from elastic_arm.studies.blind_challenge.hidden_arms.compiled_arm import (
    StateHistory,
    compiled_arm,
    inertial_numbers,
)
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault, joint_numbers
from elastic_arm.studies.blind_challenge.hidden_arms.further_laws import (
    further_numbers,
    needs_further_laws,
)
from elastic_arm.studies.blind_challenge.hidden_arms.kinematic_tree import KinematicTree
from elastic_arm.studies.blind_challenge.hidden_arms.motion import HiddenMotion, TrueChannels
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel, measure

RATE = 1000.0
SUBSTEPS = (
    4  # RK4 steps a sample; those between also give tau_J for its mean over the sample interval
)
BEARING_SUBSTEPS = 8  # bearing modes lie at some hundred Hz
# rad/s, below which dry friction may turn over gradually: faster, it is no dry friction any more
TURNOVER = 2e-3
MOST_FINER = (
    4  # times as many steps, at most, for light joints with strong friction; bounds the time
)
CHECKED = 20  # instants of a run that are compared with Pinocchio
CONTROL_BANDWIDTH = 20.0  # rad/s


class HiddenArm:
    """An arm with effects that the diagnosis has no access to."""

    def __init__(
        self,
        robot: Robot,
        faults: Sequence[Fault] = (),
        *,
        standstill: float | None = None,
        geometry: Robot | None = None,
    ) -> None:
        self.nominal = robot
        self.faults = tuple(faults)
        self.robot = altered(robot, faults)
        self.n = n = robot.n
        by_effect = {fault.effect: fault for fault in faults}
        soft = by_effect.get("bearing_compliance")
        tilt = by_effect.get("base_tilt")
        angles = (tilt.parameters["x"], tilt.parameters["y"]) if tilt else (0.0, 0.0)
        self.tree = KinematicTree(self.robot, bearings=soft is not None, base_tilt=angles)
        self._further = needs_further_laws(faults)
        self._engine = compiled_arm(
            robot if geometry is None else geometry, soft is not None, self._further
        )
        self.substeps = BEARING_SUBSTEPS if soft else SUBSTEPS
        self._h = 1.0 / RATE / self.substeps
        gears = [joint.transmission for joint in self.robot.joints if joint.transmission]
        r_hd = np.array([gear.harmonic_drive_ratio for gear in gears])
        r_tot = r_hd * np.array([gear.belt_ratio for gear in gears])
        numbers = joint_numbers(faults, n, r_hd, r_tot)
        numbers["stiffness"] = self._K = np.array([gear.stiffness for gear in gears])
        numbers["damping"] = np.array([gear.damping for gear in gears])
        if standstill is None:
            finer = int(np.clip(np.ceil(self._standstill(numbers).max() / TURNOVER), 1, MOST_FINER))
            self.substeps = finer * self.substeps
            self._h = self._h / finer
        numbers["standstill"] = (
            self._standstill(numbers) if standstill is None else np.full(n, standstill)
        )
        numbers["armature"] = self._armature = self._added_inertia()
        # Gravity turns the other way in the frame of a tilted base.
        base = KinematicTree(self.robot, bearings=soft is not None)
        gravity = Rotation.from_euler("XY", angles).as_matrix().T @ robot.gravity
        tilts = self._tilts(soft.parameters["stiffness_scale"]) if soft else np.zeros(0)
        self._numbers = [inertial_numbers(base), gravity, *numbers.values()], tilts
        self._parameters = self._all_numbers(1.0)

    def _all_numbers(self, duration: float) -> Array:
        """Return all numbers of arm and effects as the engine takes them, for a run of so many
        seconds."""
        numbers, tilts = self._numbers
        others = further_numbers(self.faults, self.n, duration).values() if self._further else ()
        return np.concatenate([*numbers, *others, tilts])

    def _added_inertia(self) -> Array:
        """Inertia (n,) that the motors have in B alone."""
        added = np.zeros(self.n)
        M, _ = self.tree.terms(np.zeros(self.tree.dof), np.zeros(self.tree.dof))
        for fault in self.faults:
            if fault.effect == "rotor_inertia_mismatch" and not fault.parameters.get("coupled"):
                at = self.n + (fault.joint or 0)
                added[fault.joint or 0] += (fault.parameters["inertia"] - 1.0) * M[at, at]
        return added

    def _tilts(self, scale: float) -> Array:
        """Stiffness and damping of the bearings, ordered [q_x of all joints, q_y of all joints]."""
        gears = [joint.transmission for joint in self.robot.joints if joint.transmission]
        bearings = [gear.bearing for gear in gears if gear.bearing]
        return np.array(
            [*(scale * b.stiffness for b in bearings * 2), *(b.damping for b in bearings * 2)]
        )

    def _standstill(self, numbers: Mapping[str, Array]) -> Array:
        """Speeds below which dry friction is smoothed: small, but wide enough for the steps to stay
        stable."""
        M, _ = self.tree.terms(np.zeros(self.tree.dof), np.zeros(self.tree.dof))
        inertia = 1.0 / np.diag(np.linalg.inv(M))[: 2 * self.n]
        torque = np.concatenate(
            [numbers[f"coulomb_{side}"] + numbers[f"stribeck_{side}"] for side in ("link", "motor")]
        )
        if self._further:
            others = further_numbers(self.faults, self.n, 1.0)
            torque[self.n :] += others["worn"] + others["brake"]
        speeds = torque * self._h / (1.5 * inertia)
        return np.maximum(np.maximum(speeds[: self.n], speeds[self.n :]), 1e-4)

    def rate(self, state: Array, u: Array) -> Array:
        """Return the rate of a state under motor torques u (n,).

        Coordinates, velocities, further states.
        """
        return self._engine.rate(state, u, self._parameters)[0]

    def run(self, motion: HiddenMotion) -> TrueChannels:
        """Follow a motion from rest."""
        n = self.n
        dof = self.tree.dof
        N = round(motion.duration * RATE)
        self._parameters = self._all_numbers(motion.duration)
        t = np.arange(N + 1) / RATE
        desired = motion.evaluate(t)
        feed_forward = self._feed_forward(*desired)
        M0, _ = self.tree.terms(np.zeros(dof), np.zeros(dof))
        inertia = np.diag(M0)[:n] + np.diag(M0)[n : 2 * n]
        gains = inertia * CONTROL_BANDWIDTH**2, 1.4 * inertia * CONTROL_BANDWIDTH
        reference = feed_forward, desired[0], desired[1]
        rest = self._rest(desired[0][0], feed_forward[0])
        found = self._engine.run(rest, self._parameters, reference, gains, RATE, self.substeps)
        if not np.isfinite(found.states).all():
            k = int(np.flatnonzero(~np.isfinite(found.states).all(axis=1))[0])
            raise SimulationError(
                f"the simulation of the hidden arm diverged at {t[k]:.3f} s", "Draw smaller effects"
            )
        self._check(found)
        tau_m = 0.5 * (found.commands[1:N] + found.commands[: N - 1])
        x = found.states[1:N, :dof]
        dx = found.states[1:N, dof : 2 * dof]
        tau_J = _means(found.torques, self.substeps)
        gravity = (
            self._gravity(x)
            if any(f.effect == "gravity_compensation" for f in self.faults)
            else None
        )
        return TrueChannels(
            t[1:N], x[:, :n], dx[:, :n], x[:, n : 2 * n], dx[:, n : 2 * n], tau_J, tau_m, gravity
        )

    def _check(self, found: StateHistory) -> None:
        """Compare the forces along a run with Pinocchio's for the same motion."""
        n = self.n
        dof = self.tree.dof
        for k in np.linspace(0, len(found.states) - 1, CHECKED).astype(int):
            rate, _, applied = self._engine.rate(
                found.states[k], found.commands[k], self._parameters
            )
            state = found.states[k]
            expected = self.tree.torque(state[:dof], state[dof : 2 * dof], rate[dof : 2 * dof])
            expected[n : 2 * n] += self._armature * rate[dof + n : dof + 2 * n]
            if not np.allclose(applied, expected, rtol=1e-8, atol=1e-6):
                raise SimulationError(
                    f"at sample {k} the equations of the hidden arm differ from Pinocchio's by"
                    f" {np.abs(applied - expected).max():.1e} Nm",
                    "Report this: the challenge's engine is wrong",
                )

    def record(
        self, motion: HiddenMotion, instruments: SensorModel, rng: np.random.Generator
    ) -> Recording:
        """Follow a motion and return the recording of the sensors."""
        course = self.run(motion)
        return measure(course, self.nominal.joint_names, self.faults, instruments, rng)

    def _gravity(self, x: Array) -> Array:
        """Torque (N, n) that holds the nominal arm, which is what a controller knows."""
        tree = KinematicTree(self.nominal)
        some = _every_tenth(len(x))
        held = np.array([tree.gravity(row[: 2 * self.n])[: self.n] for row in x[some]])
        return CubicSpline(some, held)(np.arange(len(x)))

    def _feed_forward(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Torque (N, n) of the arm as if its joints were stiff, from the nominal numbers."""
        tree = KinematicTree(self.nominal)
        some = _every_tenth(len(q))
        both = [np.hstack([v[some], v[some]]) for v in (q, dq, ddq)]
        torque = np.array([tree.torque(*row) for row in zip(*both, strict=True)])
        return CubicSpline(some, torque[:, : self.n] + torque[:, self.n :])(np.arange(len(q)))

    def _rest(self, theta: Array, torque: Array) -> Array:
        """State at rest with the springs loaded by gravity (`torque` (n,))."""
        dof = self.tree.dof
        n = self.n
        x = np.zeros(dof)
        x[n : 2 * n] = theta
        x[:n] = theta - torque / self._K
        return np.concatenate([x, np.zeros(self._engine.states - dof)])


def altered(robot: Robot, faults: Sequence[Fault]) -> Robot:
    """Return the arm with those effects that change its numbers."""
    joints = list(robot.joints)
    for fault in faults:
        p = fault.parameters
        if fault.effect in ("payload", "load"):
            j = -1 if fault.joint is None else fault.joint
            point = Inertia(p["mass"], _position(p))
            joints[j] = replace(joints[j], link=lumped([joints[j].link, point]))
        elif fault.effect == "link_inertia_mismatch" and fault.joint is not None:
            link = joints[fault.joint].link
            scaled = replace(
                link, mass=link.mass * p["mass"], inertia=np.asarray(link.inertia) * p["mass"]
            )
            joints[fault.joint] = replace(joints[fault.joint], link=scaled)
        elif fault.effect in ("stiffness_mismatch", "damping_mismatch") or p.get("coupled"):
            joint = joints[fault.joint or 0]
            if joint.transmission is not None:
                joints[fault.joint or 0] = replace(
                    joint, transmission=_altered_gear(joint.transmission, fault)
                )
    return robot.with_(joints=tuple(joints))


def _altered_gear(gear: Transmission, fault: Fault) -> Transmission:
    p = fault.parameters
    if fault.effect == "stiffness_mismatch":
        return replace(gear, stiffness=gear.stiffness * p["stiffness"])
    if fault.effect == "damping_mismatch":
        return replace(gear, damping=gear.damping * p["damping"])
    return gear.with_inertias(p["inertia"])


def _position(parameters: Mapping[str, float]) -> Array:
    return np.array([parameters[f"position_{axis}"] for axis in "xyz"])


def _means(torques: Array, substeps: int) -> Array:
    """Means (N - 1, n) over the sample intervals centred on the samples 1 to N - 1, by Simpson's
    rule."""
    weights = np.ones(substeps + 1)
    weights[1:-1:2] = 4.0
    weights[2:-1:2] = 2.0
    weights /= 3.0 * substeps
    flat = torques.reshape(-1, torques.shape[2])
    first = substeps // 2
    count = len(torques) - 2
    parts = (w * flat[first + s :: substeps][:count] for s, w in enumerate(weights))
    return np.sum(list(parts), axis=0)


def _every_tenth(N: int) -> Array:
    """Every tenth of N samples, and the last: the motion is slow, and they determine a torque to
    1e-6 of itself."""
    return np.append(np.arange(N)[:-1:10], N - 1)
