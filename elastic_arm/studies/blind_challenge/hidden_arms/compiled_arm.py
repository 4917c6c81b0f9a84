"""Compiled forward simulation of hidden arms: bodies by the Newton-Euler recursion, effects by
:mod:`.effect_laws`.

One call of Pinocchio per step from Python takes ten times as long as everything else. The recursion
over its tree is therefore performed once with symbols and compiled. Every run is checked against
Pinocchio's own algorithm (:mod:`.hidden_arm`).

All numbers of arm and effects are arguments, so that one library serves all arms of one structure.
"""

import ctypes
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.codegen.loop import build_loop
from elastic_arm.robot import Robot
from elastic_arm.studies.blind_challenge.hidden_arms import effect_laws, further_laws
from elastic_arm.studies.blind_challenge.hidden_arms.kinematic_tree import KinematicTree

NUMBERS = 10  # of a body: mass, centre of mass, inertia about it (xx, xy, xz, yy, yz, zz)
AXES = {"JointModelRX": 0, "JointModelRY": 1, "JointModelRZ": 2, "JointModelPZ": 2}
SLIDES = "JointModelPZ"

# Runge and Kutta's rule of the fourth order; a command is held over its sample.
LOOP = """
#include <string.h>

void evaluate(const double* in, double* out) { rate(in, out); }

static void stage(double* in, const double* y, const double* slope, double h, double* out) {
  for (int i = 0; i < STATES; i++) in[i] = slope ? y[i] + h * slope[i] : y[i];
  rate(in, out);
}

void run(long samples, long substeps, double h, const double* parameters,
         const double* feed_forward, const double* position, const double* velocity,
         const double* Kp, const double* Kd, double* y, double* states, double* commands,
         double* torques) {
  double in[INPUTS], k1[OUTPUTS], k2[OUTPUTS], k3[OUTPUTS], k4[OUTPUTS];
  memcpy(in + STATES + JOINTS, parameters, (INPUTS - STATES - JOINTS) * sizeof(double));
  for (long k = 0; k < samples; k++) {
    memcpy(states + k * STATES, y, sizeof(double) * STATES);
    double* u = in + STATES;
    for (int i = 0; i < JOINTS; i++) {
      long at = k * JOINTS + i;
      u[i] = feed_forward[at] + Kp[i] * (position[at] - y[MOTOR + i])
             + Kd[i] * (velocity[at] - y[MOTOR_SPEED + i]);
      commands[at] = u[i];
    }
    for (long s = 0; s < substeps; s++) {
      stage(in, y, 0, 0.0, k1);
      memcpy(torques + (k * substeps + s) * JOINTS, k1 + STATES, sizeof(double) * JOINTS);
      stage(in, y, k1, 0.5 * h, k2);
      stage(in, y, k2, 0.5 * h, k3);
      stage(in, y, k3, h, k4);
      for (int i = 0; i < STATES; i++) y[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
    }
  }
}
"""


@dataclass(frozen=True)
class StateHistory:
    """What a simulation gives."""

    states: Array  # (N, S) at the samples: coordinates, velocities, states of hystereses
    commands: Array  # (N, n) motor torques, held over each sample
    torques: Array  # (N, substeps, n) joint torques from each sample on


class CompiledArm:
    """Equations of motion of an arm with whatever effects, compiled."""

    def __init__(self, robot: Robot, *, bearings: bool, further: bool = False) -> None:
        self.n = robot.n
        tree = KinematicTree(robot, bearings=bearings)
        function = _equations(tree, further=further)
        self.states = function.size1_in(0)
        self.inputs = sum(function.size1_in(k) for k in range(3))
        self.outputs = sum(function.size1_out(k) for k in range(3))
        self.dof = tree.dof
        sizes = {
            "STATES": self.states,
            "INPUTS": self.inputs,
            "OUTPUTS": self.outputs,
            "JOINTS": self.n,
            "MOTOR": self.n,
            "MOTOR_SPEED": self.dof + self.n,
        }
        self._library = build_loop(function, "rate", LOOP, sizes)

    def rate(self, state: Array, u: Array, parameters: Array) -> tuple[Array, Array, Array]:
        """Return the state's rate, tau_J (n,), and the forces (dof,) that act on the bodies."""
        out = np.empty(self.outputs)
        self._library.evaluate(_pointer(np.concatenate([state, u, parameters])), _pointer(out))
        return (
            out[: self.states],
            out[self.states : self.states + self.n],
            out[self.states + self.n :],
        )

    def run(
        self,
        state: Array,
        parameters: Array,
        reference: tuple[Array, Array, Array],
        gains: tuple[Array, Array],
        rate: float,
        substeps: int,
    ) -> StateHistory:
        """Follow a reference from a state."""
        N = len(reference[0])
        found = StateHistory(
            np.empty((N, self.states)), np.empty((N, self.n)), np.empty((N, substeps, self.n))
        )
        given = [np.ascontiguousarray(a, dtype=float) for a in (parameters, *reference, *gains)]
        arrays = [*given, np.array(state, dtype=float), found.states, found.commands, found.torques]
        h = ctypes.c_double(1.0 / rate / substeps)
        self._library.run(
            ctypes.c_long(N), ctypes.c_long(substeps), h, *(_pointer(a) for a in arrays)
        )
        return found


@lru_cache(maxsize=8)
def compiled_arm(robot: Robot, bearings: bool, further: bool = False) -> CompiledArm:
    """Return the engine of an arm, made once."""
    return CompiledArm(robot, bearings=bearings, further=further)


def _equations(tree: KinematicTree, *, further: bool) -> Any:
    n = tree.n
    dof = tree.dof
    y = ca.SX.sym("y", 2 * dof + n + (n + 1 if further else 0))
    u = ca.SX.sym("u", n)
    numbers = ca.SX.sym("numbers", NUMBERS * len(tree.gears))
    gravity = ca.SX.sym("gravity", 3)
    joints = {name: ca.SX.sym(name, n) for name in effect_laws.NUMBERS}
    others = {name: ca.SX.sym(name, n) for name in further_laws.NEUTRAL} if further else {}
    tilts = ca.SX.sym("tilts", 2 * (dof - 2 * n))
    x = y[:dof]
    dx = y[dof : 2 * dof]
    z = y[2 * dof : 2 * dof + n]
    tau_J, lever, dz = effect_laws.joint_torque(
        joints, x[:n], x[n : 2 * n], dx[:n], dx[n : 2 * n], z
    )
    if further:
        relaxed = y[2 * dof + n : 2 * dof + 2 * n]
        tau_J += others["creep"] * relaxed
    friction = {
        side: effect_laws.friction(joints, side, w, tau_J)
        for side, w in (("link", dx[:n]), ("motor", dx[n : 2 * n]))
    }
    rates = [dz]
    if further:
        clock = y[2 * dof + 2 * n]
        friction = {
            side: further_laws.warmth(others, side, clock) * torque
            for side, torque in friction.items()
        }
        friction["link"] -= further_laws.link_torque(others, x[:n], relaxed, clock)
        friction["motor"] -= further_laws.motor_torque(
            others, x[:n], dx[n : 2 * n], joints["standstill"], clock
        )
        rates += [
            further_laws.relaxation(others, x[:n], dx[n : 2 * n] - dx[:n], relaxed),
            ca.SX.ones(1),
        ]
    link = tau_J - friction["link"]
    drive = further_laws.delivered(others, u) if further else u
    motor = drive + effect_laws.ripple(joints, x[n : 2 * n]) - lever * tau_J
    motor -= friction["motor"]
    held = -(tilts[: dof - 2 * n] * x[2 * n :] + tilts[dof - 2 * n :] * dx[2 * n :])
    f = ca.vertcat(link, motor, held)
    ddx = ca.SX.sym("ddx", dof)
    inertial = inverse_dynamics(tree, numbers, gravity, x, dx, ddx)
    inertial[n : 2 * n] += joints["armature"] * ddx[n : 2 * n]
    M = ca.substitute(ca.jacobian(inertial, ddx), ddx, ca.SX.zeros(dof))
    h = ca.substitute(inertial, ddx, ca.SX.zeros(dof))
    acceleration = ca.ldl_solve(f - h, *ca.ldl(ca.sparsify(M), True))
    parameters = ca.vertcat(numbers, gravity, *joints.values(), *others.values(), tilts)
    return ca.Function("rate", [y, u, parameters], [ca.vertcat(dx, acceleration, *rates), tau_J, f])


def _pointer(array: Array) -> Any:
    return array.ctypes.data_as(ctypes.c_void_p)


def inertial_numbers(tree: KinematicTree) -> Array:
    """Return the numbers (10 bodies,) of all bodies of a tree."""
    rows = [
        [b.mass, *b.lever, *np.asarray(b.inertia)[np.triu_indices(3)]]
        for b in list(tree.model.inertias)[1:]
    ]
    return np.array(rows).ravel()


@dataclass(frozen=True)
class _MovingBody:
    """One body underway: how it turns against its parent, and its motion in its own frame."""

    parent: int
    R: Any
    p: Any
    axis: Any
    w: Any
    dw: Any
    a: Any
    slides: bool = False


def inverse_dynamics(
    tree: KinematicTree, numbers: Any, gravity: Any, x: Any, dx: Any, ddx: Any
) -> Any:
    """Return the generalized forces (dof,) of a motion."""
    G = ca.sparsify(ca.DM(tree.gears))
    q = G @ x
    v = G @ dx
    a = G @ ddx
    zero = ca.SX.zeros(3)
    bodies = [_MovingBody(-1, None, None, None, zero, zero, -gravity)]
    for i in range(1, tree.model.njoints):
        bodies.append(_moved(tree, i, bodies, q[i - 1], v[i - 1], a[i - 1]))
    forces = [(zero, zero) for _ in bodies]
    tau = []
    for i in range(len(bodies) - 1, 0, -1):
        body = bodies[i]
        force, moment = _inertial(body, numbers[NUMBERS * (i - 1) : NUMBERS * i])
        force = force + forces[i][0]
        moment = moment + forces[i][1]
        tau.append(ca.dot(body.axis, force if body.slides else moment))
        carried = body.R @ force
        below = forces[body.parent]
        forces[body.parent] = (
            below[0] + carried,
            below[1] + body.R @ moment + ca.cross(body.p, carried),
        )
    return G.T @ ca.vertcat(*reversed(tau))


def _moved(
    tree: KinematicTree, i: int, bodies: list[_MovingBody], q: Any, v: Any, a: Any
) -> _MovingBody:
    parent = bodies[tree.model.parents[i]]
    placement = tree.model.jointPlacements[i]
    k = AXES[tree.model.joints[i].shortname()]
    slides = tree.model.joints[i].shortname() == SLIDES
    R = ca.sparsify(ca.DM(_snapped(placement.rotation)))
    p = ca.DM(_snapped(placement.translation))
    axis = ca.DM(np.eye(3)[k])
    if slides:
        p += R @ axis * q
    else:
        R = R @ _turn(k, q)
    w = R.T @ parent.w
    rate = axis * v
    dw = R.T @ parent.dw
    acceleration = R.T @ (
        parent.a + ca.cross(parent.dw, p) + ca.cross(parent.w, ca.cross(parent.w, p))
    )
    if slides:
        acceleration += axis * a + 2.0 * ca.cross(w, rate)
    else:
        dw += axis * a + ca.cross(w, rate)
        w += rate
    return _MovingBody(int(tree.model.parents[i]), R, p, axis, w, dw, acceleration, slides)


def _inertial(body: _MovingBody, numbers: Any) -> tuple[Any, Any]:
    """Force and moment about the frame's origin that a body's motion requires."""
    mass = numbers[0]
    com = numbers[1:4]
    xx = numbers[4]
    xy = numbers[5]
    xz = numbers[6]
    yy = numbers[7]
    yz = numbers[8]
    zz = numbers[9]
    inertia = ca.vertcat(ca.horzcat(xx, xy, xz), ca.horzcat(xy, yy, yz), ca.horzcat(xz, yz, zz))
    force = mass * (body.a + ca.cross(body.dw, com) + ca.cross(body.w, ca.cross(body.w, com)))
    moment = inertia @ body.dw + ca.cross(body.w, inertia @ body.w)
    return force, moment + ca.cross(com, force)


def _turn(k: int, angle: Any) -> Any:
    """Rotation by an angle about the axis k."""
    c = ca.cos(angle)
    s = ca.sin(angle)
    i = (k + 1) % 3
    j = (k + 2) % 3
    R = ca.SX(3, 3)
    R[k, k] = 1
    R[i, i] = c
    R[j, j] = c
    R[i, j] = -s
    R[j, i] = s
    return R


def _snapped(values: Array) -> Array:
    values = np.array(values, dtype=float)
    values[np.abs(values) < 1e-15] = 0.0
    return values
