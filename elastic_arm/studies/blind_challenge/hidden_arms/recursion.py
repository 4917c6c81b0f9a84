"""Newton and Euler's recursion over Pinocchio's tree of bodies, as an expression.

Pinocchio called once a step from Python takes ten times as long as all else. So its tree is walked once with symbols,
and the walk compiled; every run is checked against Pinocchio's own algorithm along its way (:mod:`.hidden_arm`).
Nothing here is shared with `elastic_arm.dynamics`, whose derivation the diagnosis uses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from elastic_arm.studies.blind_challenge.hidden_arms.kinematic_tree import KinematicTree

NUMBERS = 10  # of a body: mass, centre of mass, inertia about it (xx, xy, xz, yy, yz, zz)
AXES = {"JointModelRX": 0, "JointModelRY": 1, "JointModelRZ": 2, "JointModelPZ": 2}
SLIDES = "JointModelPZ"


def inertial_numbers(tree: KinematicTree) -> np.ndarray:
    """Return the numbers (10 bodies,) of all bodies of a tree."""
    rows = [[b.mass, *b.lever, *np.asarray(b.inertia)[np.triu_indices(3)]] for b in list(tree.model.inertias)[1:]]
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


def inverse_dynamics(tree: KinematicTree, numbers: Any, gravity: Any, x: Any, dx: Any, ddx: Any) -> Any:
    """Return the generalized forces (dof,) of a motion."""
    G = ca.sparsify(ca.DM(tree.gears))
    q, v, a = G @ x, G @ dx, G @ ddx
    zero = ca.SX.zeros(3)
    bodies = [_MovingBody(-1, None, None, None, zero, zero, -gravity)]
    for i in range(1, tree.model.njoints):
        bodies.append(_moved(tree, i, bodies, q[i - 1], v[i - 1], a[i - 1]))
    forces = [(zero, zero) for _ in bodies]
    tau = []
    for i in range(len(bodies) - 1, 0, -1):
        body = bodies[i]
        force, moment = _inertial(body, numbers[NUMBERS * (i - 1) : NUMBERS * i])
        force, moment = force + forces[i][0], moment + forces[i][1]
        tau.append(ca.dot(body.axis, force if body.slides else moment))
        carried = body.R @ force
        below = forces[body.parent]
        forces[body.parent] = below[0] + carried, below[1] + body.R @ moment + ca.cross(body.p, carried)
    return G.T @ ca.vertcat(*reversed(tau))


def _moved(tree: KinematicTree, i: int, bodies: list[_MovingBody], q: Any, v: Any, a: Any) -> _MovingBody:
    parent = bodies[tree.model.parents[i]]
    placement = tree.model.jointPlacements[i]
    k = AXES[tree.model.joints[i].shortname()]
    slides = tree.model.joints[i].shortname() == SLIDES
    R, p = ca.sparsify(ca.DM(_snapped(placement.rotation))), ca.DM(_snapped(placement.translation))
    axis = ca.DM(np.eye(3)[k])
    if slides:
        p += R @ axis * q
    else:
        R = R @ _turn(k, q)
    w = R.T @ parent.w
    rate, dw = axis * v, R.T @ parent.dw
    acceleration = R.T @ (parent.a + ca.cross(parent.dw, p) + ca.cross(parent.w, ca.cross(parent.w, p)))
    if slides:
        acceleration += axis * a + 2.0 * ca.cross(w, rate)
    else:
        dw += axis * a + ca.cross(w, rate)
        w += rate
    return _MovingBody(int(tree.model.parents[i]), R, p, axis, w, dw, acceleration, slides)


def _inertial(body: _MovingBody, numbers: Any) -> tuple[Any, Any]:
    """Force and moment about the frame's origin that a body's motion requires."""
    mass, com = numbers[0], numbers[1:4]
    xx, xy, xz, yy, yz, zz = (numbers[4 + k] for k in range(6))
    inertia = ca.vertcat(ca.horzcat(xx, xy, xz), ca.horzcat(xy, yy, yz), ca.horzcat(xz, yz, zz))
    force = mass * (body.a + ca.cross(body.dw, com) + ca.cross(body.w, ca.cross(body.w, com)))
    moment = inertia @ body.dw + ca.cross(body.w, inertia @ body.w)
    return force, moment + ca.cross(com, force)


def _turn(k: int, angle: Any) -> Any:
    """Rotation by an angle about the axis k."""
    c, s = ca.cos(angle), ca.sin(angle)
    i, j = (k + 1) % 3, (k + 2) % 3
    R = ca.SX(3, 3)
    R[k, k] = 1
    R[i, i], R[j, j], R[i, j], R[j, i] = c, c, -s, s
    return R


def _snapped(values: np.ndarray) -> np.ndarray:
    values = np.array(values, dtype=float)
    values[np.abs(values) < 1e-15] = 0.0
    return values
