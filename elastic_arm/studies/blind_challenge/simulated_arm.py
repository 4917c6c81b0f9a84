"""A hidden arm whose effect the independent engine does not have: the suite's own simulator moves it.

Such an arm flatters the diagnosis: simulator and regressors share the effect's law. The challenge states it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from elastic_arm.effects import Catalogue
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot
from elastic_arm.sensors import Sensors
from elastic_arm.simulation import SimulationSettings
from elastic_arm.simulation.simulator import Simulator
from elastic_arm.studies.blind_challenge.effect_sampling import instance_of
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import KNOWN, SENSOR_EFFECTS, Fault
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import RATE, HiddenArm
from elastic_arm.studies.blind_challenge.hidden_arms.motion import MultiSine
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel, measure
from elastic_arm.studies.blind_challenge.hidden_arms.true_channels import TrueChannels


class Arm(Protocol):
    """An arm with faults, as :class:`HiddenArm` and :class:`SimulatedArm` are."""

    def run(self, motion: MultiSine) -> TrueChannels:
        """Follow a motion from rest."""

    def record(self, motion: MultiSine, instruments: SensorModel, rng: np.random.Generator) -> Recording:
        """Follow a motion and return what the sensors read."""


class SimulatedArm:
    """An arm in the suite's own simulator."""

    def __init__(self, robot: Robot, faults: Sequence[Fault], catalogue: Catalogue) -> None:
        self._robot, self._faults = robot, tuple(faults)
        # The faults of sensors that the challenge's own sensors have act there.
        moved = [fault for fault in faults if fault.effect not in SENSOR_EFFECTS]
        self._effects = [instance_of(fault, catalogue[fault.effect], robot) for fault in moved]

    def run(self, motion: MultiSine) -> TrueChannels:
        """Follow a motion from rest; a user's effects of sensors act on what is returned."""
        t = np.arange(round(motion.duration * RATE) + 1) / RATE
        reference = motion.evaluate(t)
        settings = SimulationSettings(effects=self._effects, sensors=Sensors.exact(), rate=RATE)
        rng = np.random.default_rng(0)
        simulator = Simulator(self._robot, settings, q0=reference[0][0], rng=rng, duration=motion.duration)
        _, read = simulator.follow(*reference)
        channels = {name: values[1:-1] for name, values in read.items()}
        return TrueChannels(t[1:-1], **channels)

    def record(self, motion: MultiSine, instruments: SensorModel, rng: np.random.Generator) -> Recording:
        """Follow a motion and return what the sensors read."""
        return measure(self.run(motion), self._robot.joint_names, self._faults, instruments, rng)


def arm_maker(robot: Robot, effects: Sequence[str], catalogue: Catalogue) -> Callable[[Sequence[Fault]], Arm]:
    """Return what makes arms with some of these effects: in the independent engine where it has all of them."""
    if all(effect in KNOWN for effect in effects):
        return lambda faults: HiddenArm(robot, faults)
    return lambda faults: SimulatedArm(robot, faults, catalogue)
