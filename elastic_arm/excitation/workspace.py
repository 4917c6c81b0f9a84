"""A rough check for collisions with the floor and between links: links are capsules."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import scipy  # its parts are loaded when they are used

from elastic_arm.arrays import Array, Indices
from elastic_arm.excitation.fourier import require
from elastic_arm.robot.description import Robot
from elastic_arm.robot.kinematics import link_points, link_radius

PROBES = 256


@dataclass(frozen=True)
class Workspace:
    """What the links of an arm must stay clear of."""

    robot: Robot  # its kinematics
    radius: float  # of the capsules, m
    # height of the floor above the ground frame's origin, against gravity, m; None without a floor
    floor: float | None
    # indices of the link ends (:func:`elastic_arm.robot.kinematics.link_points`) that must stay
    # above the floor
    heights: Indices
    pairs: Indices  # (P, 2) links that must stay clear of each other

    @classmethod
    def of(cls, robot: Robot, *, radius: float | None = None, floor: float | None = 0.0) -> Self:
        """Make the workspace of `robot`, from what its links do in evenly spread poses.

        Neighbours are left out, and so are links that touch in every pose (a wrist whose axes meet)
        and link ends whose height no joint changes.
        """
        for name, value in (("radius of the links", radius), ("height of the floor", floor)):
            require(
                value is None or bool(np.isfinite(value)),
                f"the {name} is {value} m",
                "Give a finite number.",
            )
        radius = link_radius(robot) if radius is None else radius
        poses = np.pi * (2.0 * scipy.stats.qmc.Halton(robot.n, scramble=False).random(PROBES) - 1.0)
        points = link_points(robot, poses)
        height = points @ _upward(robot)
        heights = (
            np.flatnonzero(np.ptp(height, axis=0) > 1e-6)
            if floor is not None
            else np.array([], dtype=np.intp)
        )
        first, second = np.triu_indices(points.shape[1] - 1, k=2)
        pairs = np.column_stack([first, second])
        touching = (_distances(points, pairs) < 2.0 * radius).all(axis=0)
        return cls(robot, radius, floor, heights, pairs[~touching])

    def clearance(self, q: Array) -> tuple[Array, Array]:
        """Return the smallest gaps to the floor and between links, (N,) each, m.

        Negative where they overlap.

        Infinite where there is nothing to touch.
        """
        points = link_points(self.robot, q)
        floor = np.full(len(q), np.inf)
        links = np.full(len(q), np.inf)
        if self.floor is not None and len(self.heights):
            heights = points[:, self.heights] @ _upward(self.robot)
            floor = heights.min(axis=1) - self.radius - self.floor
        if len(self.pairs):
            links = _distances(points, self.pairs).min(axis=1) - 2.0 * self.radius
        return floor, links


def _upward(robot: Robot) -> Array:
    size = float(np.linalg.norm(robot.gravity))
    return -robot.gravity / size if size > 0.0 else np.array([0.0, 0.0, 1.0])


def _distances(points: Array, pairs: Indices) -> Array:
    """Return the distances (N, P) between the line segments of links.

    Segment k runs from `points[:, k]` to `points[:, k + 1]`; either may be a point (C. Ericson,
    Real-Time Collision Detection, 5.1.9).
    """
    p = points[:, pairs[:, 0]]
    q = points[:, pairs[:, 1]]
    u = points[:, pairs[:, 0] + 1] - p
    v = points[:, pairs[:, 1] + 1] - q
    w = p - q
    uu = np.einsum("npi,npi->np", u, u)
    vv = np.einsum("npi,npi->np", v, v)
    uv = np.einsum("npi,npi->np", u, v)
    uw = np.einsum("npi,npi->np", u, w)
    vw = np.einsum("npi,npi->np", v, w)
    crossing = uu * vv - uv * uv
    s = np.clip(_quotient(uv * vw - uw * vv, crossing, floor=1e-12 * uu * vv), 0.0, 1.0)
    t = _quotient(uv * s + vw, vv)
    # Where the nearest point of the second line lies beyond its segment, the segment's end decides.
    s = np.where(
        (t < 0.0) | (t > 1.0), np.clip(_quotient(np.clip(t, 0.0, 1.0) * uv - uw, uu), 0.0, 1.0), s
    )
    t = np.clip(t, 0.0, 1.0)
    return np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=2)


def _quotient(numerator: Array, denominator: Array, floor: Array | float = 0.0) -> Array:
    """Divide, with 0 where the denominator does not exceed `floor`."""
    large = denominator > np.maximum(floor, 1e-30)
    return np.where(large, numerator / np.where(large, denominator, 1.0), 0.0)
