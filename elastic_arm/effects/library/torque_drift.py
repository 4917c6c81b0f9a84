"""A torque sensor whose zero wanders."""

import casadi as ca

from elastic_arm.effects.law import (
    Choice,
    Confusion,
    Contribution,
    Effect,
    Numbers,
    SensorEffect,
    SymbolicMotion,
    signed,
)
from elastic_arm.effects.library.sensor_error import TORQUES, misread, sides_of
from elastic_arm.sensors import Sensors

# Strain gauges and drives that warm up: up to 0.3 Nm a minute, as two deviations.
USUAL = 0.0025  # Nm/s


def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """The mean rate times the time since the recording began."""
    return misread(p["channel"], _drifted)(motion, i, p)


def _drifted(motion: SymbolicMotion, i: int, p: Numbers) -> ca.SX:
    return p["rate"] * motion.elapsed


def change(sensors: Sensors, i: int, n: int, p: Numbers) -> Sensors:
    """Let the zero of the channel move at the rate."""
    return sensors.changed(p["channel"], i, n, drift=p["rate"])


EFFECT: Effect = SensorEffect(
    id="torque_drift",
    formula="recorded = true + a zero that moves at the mean rate from the first sample",
    description=(
        "The zero of a torque channel drifts during the recording: a sensor or a"
        " drive that warms up."
    ),
    plain="has a {channel} whose zero drifts by {rate} during the recording",
    signature="The residuals that contain the channel drift from zero over time,"
    " independent of the motion.",
    law=law,
    parameters=(signed("rate", "Nm/s", 2.0, "mean over the recording"),),
    choices=(Choice("channel", TORQUES, "joint_torque"),),
    sides=("link", "drive", "motor"),
    sides_of=sides_of,
    regime="drift",
    in_time=True,
    change=change,
    prior=lambda rate: USUAL,
    set_at_start=True,
    confusions=(
        Confusion(
            "joint_torque_offset",
            "the recording is so short that the zero hardly moves",
            "a recording of several minutes",
        ),
    ),
)
