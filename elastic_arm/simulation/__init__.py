"""Simulation of an arm: forward dynamics with effects, a controller and sensors, for whole runs or
sample by sample.
"""

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
