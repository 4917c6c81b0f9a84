"""Tolerances of a goal: what the request states, and defaults for the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from control_msgs.msg import JointTolerance

from elastic_arm.arrays import Array
from elastic_arm.errors import GraphError


@dataclass(frozen=True, eq=False)
class Tolerances:
    """Largest errors of position and velocity, (n,) each, rad and rad/s; infinite where any is allowed."""

    position: Array
    velocity: Array

    @classmethod
    def of(
        cls, stated: Sequence[JointTolerance], joints: Sequence[str], position: float = 0.0, velocity: float = 0.0
    ) -> Tolerances:
        """Take the tolerances of a request: 0 stands for the default there, and less for no limit.

        joints: of the arm, (n,).

        Raises a GraphError if one names another joint.
        """
        values = {"position": np.full(len(joints), position), "velocity": np.full(len(joints), velocity)}
        for tolerance in stated:
            if tolerance.name not in joints:
                raise GraphError(f"has a tolerance for {tolerance.name!r}", f"There are {', '.join(joints)}.")
            for name, column in values.items():
                if getattr(tolerance, name) != 0.0:
                    column[list(joints).index(tolerance.name)] = getattr(tolerance, name)
        return cls(**{name: np.where(column > 0.0, column, np.inf) for name, column in values.items()})

    def exceeded(self, joints: Sequence[str], position: Array, velocity: Array) -> str:
        """Return in words which error (n,) exceeds its tolerance first; empty where none does."""
        for name, errors, limits, unit in (
            ("position", position, self.position, "rad"),
            ("velocity", velocity, self.velocity, "rad/s"),
        ):
            for joint, error, limit in zip(joints, np.abs(errors), limits, strict=True):
                if error > limit:
                    return f"the {name} of {joint} is off by {error:.3g} {unit}, more than {limit:.3g} {unit}"
        return ""
