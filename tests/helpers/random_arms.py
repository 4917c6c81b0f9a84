"""Random arms of any length, for benchmarks and tests: no number of theirs is special."""

from collections.abc import Container

import numpy as np

from elastic_arm.robot.description import Joint, Robot
from elastic_arm.robot.parts import Bearing, Component, Inertia, Transmission


def random_arm(
    n: int, rng: np.random.Generator, *, elastic: bool = True, prismatic: Container[int] = ()
) -> Robot:
    """Draw an arm of n joints.

    Axes point anywhere, inertias are those of random point clouds, each component rides on either
    body at its joint.
    """
    names = ["base", *(f"link_{i + 1}" for i in range(n))]
    joints = []
    for i in range(n):
        size = 1.0 / (1 + i)
        transmission = (
            _random_transmission(rng, size, (names[i], names[i + 1])) if elastic else None
        )
        joints.append(
            Joint(
                name=f"joint_{i + 1}",
                link_name=names[i + 1],
                link=_random_inertia(rng, 20.0 * size, 0.3),
                before=_random_placement(rng, 0.4),
                after=_random_placement(rng, 0.2),
                transmission=transmission,
                prismatic=i in prismatic,
            )
        )
    return Robot(f"random_{n}", tuple(joints), base_placement=_random_placement(rng, 0.5))


def _random_inertia(rng: np.random.Generator, mass: float, extent: float) -> Inertia:
    """Inertia of eight random points of equal mass: consistent by construction."""
    points = rng.normal(0.0, extent, (8, 3))
    com = points.mean(axis=0)
    offsets = points - com
    spread = offsets.T @ offsets * mass / 8
    tensor = np.trace(spread) * np.eye(3) - spread
    return Inertia(mass, com, 0.5 * (tensor + tensor.T))


def _random_placement(rng: np.random.Generator, extent: float) -> np.ndarray:
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    placement = np.eye(4)
    placement[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    placement[:3, 3] = rng.normal(0.0, extent, 3)
    return placement


def _random_transmission(
    rng: np.random.Generator, size: float, carriers: tuple[str, str]
) -> Transmission:
    def solid(mass: float, radius: float) -> Component:
        izz = mass * radius**2
        ixx = izz * rng.uniform(0.6, 2.0)
        return Component(mass, ixx, izz, carriers[rng.integers(2)], rng.normal(0.0, 0.1, 3))

    return Transmission(
        rotor=solid(2.0 * size, 0.03),
        wave_generator=solid(1.0 * size, 0.04),
        spline=solid(3.0 * size, 0.08),
        stiffness=1e5 * size,
        damping=80.0 * size,
        belt_ratio=rng.uniform(1.0, 3.0),
        harmonic_drive_ratio=rng.uniform(50.0, 160.0),
        bearing=Bearing(2e6 * size, 1e3 * size),
    )
