"""A recorded torque that has passed a low-pass filter."""

from functools import partial

import casadi as ca
import numpy as np

from elastic_arm.effects.law import (
    Choice,
    Confusion,
    Contribution,
    Effect,
    Numbers,
    Parameter,
    Scope,
    SensorEffect,
    SymbolicMotion,
)
from elastic_arm.effects.library.sensor_error import TORQUES, misread, sides_of
from elastic_arm.effects.library.torque_filters import LowPassedTorques
from elastic_arm.sensors import Sensors

REFERENCE = 5.0  # Hz


def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """Return recorded less true torque, -T y' of a recorded torque y.

    y + T y' is the true one, with T = 1 / (2 pi cutoff).
    """
    rates = {"joint_torque": motion.dtau_J, "motor_torque": motion.dtau_m}
    total = motion.nothing()
    for channel in p["channels"]:
        total += misread(channel, partial(_error, rates[channel]))(motion, i, p)
    return total


def _error(rate: ca.SX, motion: SymbolicMotion, i: int, p: Numbers) -> ca.SX:
    return -rate[i] / (2 * np.pi * p["cutoff"])


def change(sensors: Sensors, i: int, n: int, p: Numbers) -> Sensors:
    """Filter the named channels of a joint."""
    for channel in p["channels"]:
        sensors = sensors.changed(channel, i, n, cutoff=p["cutoff"])
    return sensors


EFFECT: Effect = SensorEffect(
    id="torque_lowpass",
    formula="named channels y with y' = 2 pi cutoff (true - y)",
    description=(
        "A torque, or the current from which it was computed, was filtered before it was recorded."
    ),
    plain="has its {channels} filtered at {cutoff} before recording",
    signature=(
        "The residual follows the rate of the filtered torque, and the recording lacks fast torque."
    ),
    law=law,
    parameters=(
        Parameter(
            "cutoff",
            "Hz",
            0.5,
            500.0,
            default=REFERENCE,
            above=0.0,
            # The law's derivative by the cutoff at the reference is y' / (2 pi reference²).
            from_coefficient=lambda c: -(REFERENCE**2) / c,
            inverse=True,
            draw=(0.5, 50.0),
            meaning="corner",
        ),
    ),
    choices=(Choice("channels", TORQUES, ("joint_torque",), several=True),),
    scope=Scope.EACH_OR_ARM,
    sides=("link", "drive", "motor"),
    sides_of=sides_of,
    regime="frequency",
    change=change,
    regressor=LowPassedTorques,
    confusions=(
        Confusion(
            "time_delay",
            "the torque changes slowly compared with the cut-off: both act as T times its rate",
            "faster motion: a filter also reduces the amplitude, a delay does not",
        ),
    ),
)
