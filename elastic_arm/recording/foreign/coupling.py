"""Wrists whose motors move several joints at once: from what motors do to what joints do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from elastic_arm.input_files import Number
from elastic_arm.recording.sides import Array, Side

# Joint -> motor -> how much the joint turns for one turn of the motor, both at the joint's output.
Coupling = dict[str, dict[str, Number]]


def coupling_matrix(coupling: Mapping[str, Mapping[str, float]], joints: Sequence[str]) -> Array:
    """Return the matrix C (n, n) of theta = C theta_motors; joints without an entry turn with their own motor alone."""
    matrix = np.eye(len(joints))
    for joint, motors in coupling.items():
        for name in (joint, *motors):
            if name not in joints:
                raise ValueError(f"coupling: there is no joint {name}; there are {', '.join(joints)}")
        matrix[joints.index(joint)] = [motors.get(name, 0.0) for name in joints]
    if not np.isfinite(matrix).all():
        raise ValueError("coupling: a factor is not finite")
    sizes = np.linalg.svd(matrix, compute_uv=False)
    if sizes[-1] < 1e-9 * sizes[0]:  # relative singular value below which motors cannot move the joints apart
        raise ValueError(
            "coupling: the motors cannot move these joints apart; each row names the joint's own motor too"
        )
    return matrix


def coupled(side: Side | None, matrix: Array) -> Side | None:
    """Return the motor side of joints: theta = C theta_motors, C' tau = tau_motors, so that power is kept."""
    if side is None or np.array_equal(matrix, np.eye(len(matrix))):
        return side
    inverse = np.linalg.inv(matrix)
    moved = {
        name: values @ inverse if name == "effort" else values @ matrix.T for name, values in side.channels().items()
    }
    return Side(side.stamp_ns, **moved)
