"""First-order sensitivity of the motion of a commanded arm to its numbers p.

    R = kp (r - q) - kd dq + ki int(r - q) - inverse dynamics - B ddq - D dq - friction - spring

is zero along a simulated motion, so the change of the angles obeys

    M ddq' + C dq' + K q' + ki int q' = dR/dp,    K = -dR/dq, C = -dR/d(dq), M = -dR/d(ddq)

where q' is the derivative of the angles by a number. Derivatives of R are difference quotients at
all samples at once. Dry friction is a share of its limit, the remainder of R without it; where a
joint sticks, the share follows the speed, and C has the corresponding size. The accelerations are
those for which R is zero, so that derivatives by numbers that only scale all torques cancel.

One solution by backward differences of second order takes as long as one or two simulations, for
any number of numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics import Model, build_model
from elastic_arm.mujoco.closed_loop import Motion, interpolated
from elastic_arm.mujoco.friction_by_step import FrictionLevel
from elastic_arm.mujoco.stated_arm import StatedArm, stated_arm
from elastic_arm.robot import JointController, Robot

STEP = 4e-3  # s, of the equation of the derivatives
SLIDING = 0.95  # share of its limit, beyond which dry friction no longer follows the speed
SLOW = 1e-3  # rad/s, of the sign of a speed where a joint has no dry friction yet
SHIFT = 1e-6  # rad, rad/s and rad/s², of differences by the motion


@dataclass(frozen=True)
class _Sampled:
    """A motion, sampled: (N, n) each."""

    t: Array  # (N,) s
    q: Array
    dq: Array
    ddq: Array

    @staticmethod
    def of(motion: Motion) -> "_Sampled":
        """Sample a simulated motion at STEP."""
        step = float(motion.t[1] - motion.t[0])
        every = max(1, round(STEP / step))
        angles = motion.angles[::every]
        h = every * step
        ddq = np.zeros_like(angles)
        ddq[1:-1] = np.diff(angles, 2, axis=0) / h**2
        return _Sampled(motion.t[::every], angles, np.gradient(angles, h, axis=0), ddq)


def derivatives(
    robot: Robot, others: Sequence[tuple[Robot, float]], motion: Motion, at: Array
) -> Array:
    """Return the derivatives (k, N, n) of the angles at times (N,) s by numbers.

    robot: the arm that moved; others: arms with one number changed each, and by how much; motion:
    its own, with at least four samples at STEP.
    """
    sampled = _Sampled.of(motion)
    equation = _Equation(robot, motion, sampled)
    right = np.stack([equation.changed(other) / by for other, by in others], axis=2)
    angles = equation.solved(right)
    return np.stack([interpolated(at, sampled.t, own) for own in np.moveaxis(angles, 2, 0)])


class _Equation:
    """The equation of the derivatives along one motion."""

    def __init__(self, robot: Robot, motion: Motion, sampled: _Sampled) -> None:
        self.robot = robot
        self.motion = motion
        self.sampled = sampled
        self.arm = stated_arm(robot)
        self.model = _model(robot, self.arm)
        self.step = float(sampled.t[1] - sampled.t[0])
        n = robot.n
        q = sampled.q
        dq = sampled.dq
        ddq = sampled.ddq
        self.share = np.zeros_like(q)
        left = self._residual(robot, q, dq, ddq)
        limit = self._dry(robot, self.arm, q, dq, self._carried(self.model, self.arm, q, dq, ddq))
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(limit > 0.0, left / limit, np.tanh(dq / SLOW))
        self.share = np.clip(share, -1.0, 1.0)
        sticks = (np.abs(self.share) < SLIDING) & (self.share * dq > 0.0)
        stuck = np.where(sticks, limit * self.share / np.where(sticks, dq, 1.0), 0.0)
        here = self._residual(robot, q, dq, ddq)
        unit = SHIFT * np.eye(n)
        by_angle = [self._residual(robot, q + e, dq, ddq) - here for e in unit]
        by_rate = [self._residual(robot, q, dq + e, ddq) - here for e in unit]
        by_rate_2 = [self._residual(robot, q, dq, ddq + e) - here for e in unit]
        self.K = -np.stack(by_angle, axis=2) / SHIFT
        self.C = -np.stack(by_rate, axis=2) / SHIFT
        self.M = -np.stack(by_rate_2, axis=2) / SHIFT
        self.C[:, np.arange(n), np.arange(n)] += stuck
        # Accelerations with which the residual is null: then a ratio of all torques and masses
        # changes no motion.
        self.ddq = ddq + np.linalg.solve(self.M, here[:, :, None])[:, :, 0]
        self.here = self._residual(robot, q, dq, self.ddq)

    def changed(self, robot: Robot) -> Array:
        """Return by how much the residual (N, n) is another one with other numbers of the arm."""
        return self._residual(robot, self.sampled.q, self.sampled.dq, self.ddq) - self.here

    def solved(self, right: Array) -> Array:
        """Return angles (N, n, k) for right sides (N, n, k), from rest."""
        ki = np.array([_controller(joint.controller).ki for joint in self.robot.joints])[:, None]
        b = 2.0 / 3.0 * self.step
        integral = b**3 * np.diag(ki[:, 0])
        inverse = np.linalg.inv(self.M + b * self.C + b**2 * self.K + integral)
        angles = np.zeros_like(right)
        zero = np.zeros(right.shape[1:])
        q, q_before, v, v_before, z, z_before = (zero,) * 6
        for i in range(1, len(right)):
            rate = (4.0 * v - v_before) / 3.0
            angle = (4.0 * q - q_before) / 3.0 + b * rate
            held = (4.0 * z - z_before) / 3.0 + b * angle
            known = right[i] - self.C[i] @ rate - self.K[i] @ angle - ki * held
            acceleration = inverse[i] @ known
            v_before = v
            v = rate + b * acceleration
            q_before = q
            q = angle + b**2 * acceleration
            z_before = z
            z = held + b**3 * acceleration
            angles[i] = q
        return angles

    def _residual(self, robot: Robot, q: Array, dq: Array, ddq: Array) -> Array:
        """Return R (N, n) of an arm along a motion."""
        own = robot is self.robot
        arm = self.arm if own else stated_arm(robot)
        model = self.model if own else self.model.at(_model(robot, arm).Psi)
        carried = self._carried(model, arm, q, dq, ddq)
        found = -carried - _armatures(arm) * ddq
        dry = self._dry(robot, arm, q, dq, carried)
        for i, (joint, numbers) in enumerate(zip(robot.joints, arm.joints, strict=True)):
            passive = numbers.damping * dq[:, i] + numbers.stiffness * (q[:, i] - numbers.rest)
            passive += dry[:, i] * self.share[:, i]
            found[:, i] += self._driven(joint.controller, i, q[:, i], dq[:, i]) - passive
        return found

    @staticmethod
    def _carried(model: Model, arm: StatedArm, q: Array, dq: Array, ddq: Array) -> Array:
        """Return what the links' motion takes (N, n) Nm, behind the gears."""
        described = q - np.array([one.zero for one in arm.joints])
        return model.inverse_dynamics(described, dq, ddq) - _armatures(arm) * ddq

    @staticmethod
    def _dry(robot: Robot, arm: StatedArm, q: Array, dq: Array, carried: Array) -> Array:
        """Return the dry friction (N, n) Nm with which the joints of an arm can stick."""
        stated = np.array([one.friction_loss for one in arm.joints])
        laws = [law for law, _ in arm.left if law.effect.friction and not law.effect.states]
        if not laws:
            return np.broadcast_to(stated, q.shape)
        return stated + FrictionLevel(robot, laws).along(q, dq, carried)

    def _driven(self, controller: JointController | None, i: int, q: Array, dq: Array) -> Array:
        """Return the torque (N,) of a joint's drive."""
        drive = _controller(controller)
        t = self.sampled.t
        given = np.interp(t - drive.delay, self.motion.t[:-1], self.motion.commands[:, i])
        error = given - q
        acting = error - np.clip(error, -drive.dead_band, drive.dead_band)
        integral = np.concatenate([[0.0], np.cumsum(0.5 * self.step * (error[1:] + error[:-1]))])
        made = drive.supplied(drive.kp * acting + drive.ki * integral) - drive.kd * dq
        return made if drive.torque is None else np.clip(made, -drive.torque, drive.torque)


def _controller(controller: JointController | None) -> JointController:
    return controller or JointController()


def _armatures(arm: StatedArm) -> Array:
    return np.array([one.armature for one in arm.joints])


def _model(robot: Robot, arm: StatedArm) -> Model:
    """Return the dynamics of an arm with what of its effects is a number of it."""
    joints = []
    for joint, link, own in zip(robot.joints, arm.links, arm.joints, strict=True):
        joints.append(replace(joint, link=link, armature=own.armature))
    plain = robot.with_(effects=(), gravity=tuple(arm.gravity), joints=tuple(joints))
    return build_model(plain, "mod2")
