"""The recorded supply voltage of servos against the one that the description states."""

from collections.abc import Iterator

import numpy as np

from elastic_arm.recording.inspection.report import Finding, warning
from elastic_arm.recording.made_torque import joints_with_duty
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import joints_with
from elastic_arm.robot import Robot

# Nominal voltage of a lithium cell over that of an empty one; a charged one (4.2 V) is nearer.
FAR = 3.7 / 3.0


def other_supply(recording: Recording, robot: Robot) -> Iterator[Finding]:
    """Yield the joints whose recorded supply voltage is far from the stated one, and those whose
    recorded one counts for nothing, as none is stated."""
    motor = recording.motor
    if motor is None or motor.supply is None:
        return
    driven = joints_with_duty(recording)
    there = joints_with(motor.supply)
    drives = {joint.name: joint.controller for joint in robot.joints}
    for i, name in enumerate(recording.joints):
        drive = drives.get(name)
        if name not in driven or not there[i] or drive is None or drive.stall is None:
            continue
        volts = float(np.median(motor.supply[:, i]))
        if drive.supply is None:
            words = f"the description states no supply voltage of {name}"
            remedy = "the recorded one is not used: state the motor with its supply"
            yield warning("supply", words, remedy)
        elif not 1.0 / FAR <= volts / drive.supply <= FAR:
            words = (
                f"supply of {name} is {volts:.3g} V, where the description states"
                f" {drive.supply:.3g} V"
            )
            yield warning("supply", words, "check the factor of the channel, and the description")
