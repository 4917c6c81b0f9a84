"""Motions and a planar arm on which limits can be checked by hand."""

from pathlib import Path

import numpy as np

from elastic_arm.excitation import FourierTrajectory
from elastic_arm.robot import Inertia, Joint, Limits, Robot


def trajectory(
    seed: int = 0, n: int = 3, harmonics: int = 4, **changes: float
) -> FourierTrajectory:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, n, harmonics))
    settings_ = {"period": 7.0, "periods": 2, "ramp": 1.5, **changes}
    return FourierTrajectory.of_periods(a=a, b=b, q0=rng.normal(size=n), **settings_)


def lively_excitation(folder: Path, seconds: float) -> Path:
    """Write a trajectory of some seconds for the package's arm, and return its file."""
    rng = np.random.default_rng(5)
    a, b = (rng.normal(0.0, 0.3, (3, 5)) for _ in range(2))
    file = folder / "trajectory.yaml"
    names = ("joint_1", "joint_2", "joint_3")
    FourierTrajectory(2 * np.pi / 5.0, a, b, np.zeros(3), seconds, 0.5, names).save(file)
    return file


def planar_arm(links: int, **limits: float) -> Robot:
    """Links of 0.5 m that swing in the vertical plane from 1 m above the floor, straight up at q =
    0."""
    body = Inertia(1.0, np.array([-0.25, 0.0, 0.0]), np.diag([1e-3, 1e-2, 1e-2]))
    first, after = np.eye(4), np.eye(4)
    first[:3, :3] = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
    after[0, 3] = 0.5
    base = np.eye(4)
    base[2, 3] = 1.0
    joints = [
        Joint(
            f"j{i}", f"l{i}", body, first if i == 0 else np.eye(4), after, limits=Limits(**limits)
        )
        for i in range(links)
    ]
    return Robot("planar", tuple(joints), base_placement=base)
