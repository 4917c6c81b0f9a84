"""The link angles of the paper's convention, with rates, from the prototype's chain of hinges.

The link of the prototype is attached to the turning spline: Rz(theta) Ry(b) Rx(a) Rz(delta). The
paper's (3) tilts first: Ry(q_y) Rx(q_x) Rz(q). Both describe one rotation; angles and rates are
converted exactly, without small-angle approximations.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

Y, X, Z = np.eye(3)[[1, 0, 2]]


def chain(
    axes: Sequence[np.ndarray], angles: np.ndarray, rates: np.ndarray, accelerations: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Compose rotations about successive axes.

    Returns rotation (N, 3, 3), angular velocity and acceleration (N, 3), and d omega / d
    rates (N, 3, len(axes)), all in the outermost frame.
    """
    count = len(angles)
    reached = np.broadcast_to(np.eye(3), (count, 3, 3))
    omega = np.zeros((count, 3))
    alpha = np.zeros((count, 3))
    columns = []
    for k, axis in enumerate(axes):
        world = reached @ axis
        alpha = (
            alpha + world * accelerations[:, k, None] + np.cross(omega, world) * rates[:, k, None]
        )
        omega = omega + world * rates[:, k, None]
        turn = Rotation.from_rotvec(angles[:, k, None] * axis)
        reached = reached @ turn.as_matrix()
        columns.append(world)
    return reached, omega, alpha, np.stack(columns, axis=2)


def link_coordinates(
    theta: Sequence[np.ndarray], bushing: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the paper's angles of one joint and their two derivatives.

    Columns (q_y, q_x, q), each (N, 3).
    """
    stacked = [np.column_stack([turn, rest]) for turn, rest in zip(theta, bushing, strict=True)]
    whole, omega, alpha, _ = chain((Z, Y, X, Z), *stacked)
    q_x = np.arcsin(-whole[:, 1, 2])
    q_y = np.arctan2(whole[:, 0, 2], whole[:, 2, 2])
    q = np.arctan2(whole[:, 1, 0], whole[:, 1, 1])
    # the turn theta is in
    q = q + 2.0 * np.pi * np.round((stacked[0][:, 0] + stacked[0][:, 3] - q) / (2.0 * np.pi))
    angles = np.column_stack([q_y, q_x, q])
    still = np.zeros_like(angles)
    jacobian = chain((Y, X, Z), angles, still, still)[3]
    rates = np.linalg.solve(jacobian, omega[..., None])[..., 0]
    drift = chain((Y, X, Z), angles, rates, still)[2]
    return angles, rates, np.linalg.solve(jacobian, (alpha - drift)[..., None])[..., 0]
