"""Recordings of the package's own arm that tests of what follows a diagnosis share."""

from functools import cache

import numpy as np

from elastic_arm.dynamics import build_model
from elastic_arm.effects import parse
from elastic_arm.excitation import FourierTrajectory, MotionLimits, Shape, random_trajectories
from elastic_arm.recording import Recording
from elastic_arm.robot import load_robot
from elastic_arm.sensors import Sensors
from elastic_arm.simulation import SimulationSettings, simulate

ROBOT = load_robot(None)
MODEL = build_model(ROBOT, "mod3")
LIMITS = MotionLimits.of(ROBOT)
RATE = 500.0  # Hz; at 250 the smoother takes a part of the residuals' band


@cache
def motions() -> tuple[FourierTrajectory, FourierTrajectory]:
    """Two lively motions of 6 s."""
    shape = Shape(5, 4.0, 1.0)
    first, second = random_trajectories(MODEL, LIMITS, 2, rng=np.random.default_rng(3), shape=shape)
    return first, second


def gentle(seed: int) -> FourierTrajectory:
    """A motion so small that gravity loads each drive one way throughout."""
    (lively,) = random_trajectories(
        MODEL, LIMITS, 1, rng=np.random.default_rng(seed), shape=Shape(3, 8.0, 1.0)
    )
    small, here = lively.scaled(0.05), np.array([0.3, 0.4, 0.5])
    return FourierTrajectory(
        small.omega, small.a, small.b, here, small.duration, small.ramp, small.joints
    )


def record(
    motion: FourierTrajectory,
    *effects: str,
    seed: int = 0,
    sensors: Sensors | None = None,
    rate: float = RATE,
) -> Recording:
    """Let the arm with effects follow a motion."""
    instances = [parse(text, ROBOT) for text in effects]
    settings = SimulationSettings(effects=instances, sensors=sensors, rate=rate)
    return simulate(ROBOT, motion, settings, rng=np.random.default_rng(seed))
