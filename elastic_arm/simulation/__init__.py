"""An arm that moves: forward dynamics with effects, a controller, sensors; whole runs, or one
sample at a time."""

from elastic_arm.simulation.controller import Controller, tuned
from elastic_arm.simulation.rollout import record, simulate
from elastic_arm.simulation.settings import SimulationSettings
from elastic_arm.simulation.simulator import Simulator, Truth, check_same_joints

__all__ = [
    "Controller",
    "SimulationSettings",
    "Simulator",
    "Truth",
    "check_same_joints",
    "record",
    "simulate",
    "tuned",
]
