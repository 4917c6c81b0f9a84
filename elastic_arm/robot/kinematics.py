"""The poses of an arm's links for whole arrays of angles, and simple shapes of links."""

from collections.abc import Iterable

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.robot.description import Robot
from elastic_arm.robot.parts import Inertia

# Radius of the cylinders that stand for links, in lengths of the stretched arm; real arms have 0.04
# to 0.07.
SLENDERNESS = 0.05
# Radius for an arm whose joints all meet in a point, m.
SMALLEST_RADIUS = 0.01


def link_placements(robot: Robot, q: Array) -> tuple[Array, Array]:
    """Forward kinematics in the ground frame, tilts zero (paper, (2) and (3))."""
    q = np.atleast_2d(q)
    joints = np.empty((*q.shape, 4, 4))
    links = np.empty_like(joints)
    frame = np.broadcast_to(robot.base_placement, (len(q), 4, 4))
    turn = np.zeros((*q.shape, 4, 4))
    turn[..., 0, 0] = turn[..., 1, 1] = np.cos(q)
    turn[..., 1, 0] = np.sin(q)
    turn[..., 0, 1] = -turn[..., 1, 0]
    turn[..., 2, 2] = turn[..., 3, 3] = 1.0
    slides = np.array([joint.prismatic for joint in robot.joints])
    turn[:, slides] = np.eye(4)
    turn[:, slides, 2, 3] = q[:, slides]
    for i, joint in enumerate(robot.joints):
        joints[:, i] = frame @ joint.before @ turn[:, i]
        links[:, i] = frame = joints[:, i] @ joint.after
    return joints, links


def link_points(robot: Robot, q: Array) -> Array:
    """Return the ends of the links (N, n + 2, 3) in the ground frame, m.

    The ground's origin, the origins of the n joints and the last link's frame: link k runs from
    point k to point k + 1, and link 0 is the base.
    """
    joints, links = link_placements(robot, q)
    ground = np.zeros((len(joints), 1, 3))
    return np.concatenate([ground, joints[..., :3, 3], links[:, -1:, :3, 3]], axis=1)


def link_radius(robot: Robot) -> float:
    """Radius of the cylinders or capsules that stand for links, m."""
    ends = link_points(robot, np.zeros((1, robot.n)))[0]
    return max(
        SLENDERNESS * float(np.linalg.norm(np.diff(ends, axis=0), axis=1).sum()), SMALLEST_RADIUS
    )


def moved(body: Inertia, placement: Array) -> Inertia:
    """Return the body in another frame, in which its own is at `placement` (4, 4)."""
    rotation = placement[:3, :3]
    return _inertia(
        body.mass, rotation @ body.com + placement[:3, 3], rotation @ body.inertia @ rotation.T
    )


def lumped(bodies: Iterable[Inertia]) -> Inertia:
    """Return rigidly joined bodies, described in one frame, as one body."""
    bodies = list(bodies)
    mass = sum(body.mass for body in bodies)
    if mass == 0.0:
        return Inertia(0.0)
    com = sum((body.mass * body.com for body in bodies), np.zeros(3)) / mass
    tensor = np.zeros((3, 3))
    for body in bodies:
        arm = body.com - com
        tensor = tensor + body.inertia + body.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return _inertia(mass, com, tensor)


def _inertia(mass: float, com: Array, tensor: Array) -> Inertia:
    return Inertia(mass, com, 0.5 * (tensor + tensor.T))
