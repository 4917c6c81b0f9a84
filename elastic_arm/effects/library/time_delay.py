"""Channels that come late."""

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
from elastic_arm.effects.library.sensor_error import SIDES, sides_of
from elastic_arm.effects.library.torque_filters import DelayedTorques
from elastic_arm.sensors import Sensors


def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """The delay times the rate of what comes late: first order in the delay.

    A late link encoder makes the link equation compare tau_J with the torque of a moment ago, so
    the difference is the rate of tau_J; in the drive it is as if the link were `delay` times its
    velocity further on.
    """
    delay = p["delay"]
    total = motion.nothing()
    if "joint_torque" in p["channels"]:
        late = -delay * motion.dtau_J[i]
        total += motion.at(i, link=late, drive=late, motor=-late)
    if "motor_torque" in p["channels"]:
        total += motion.at(i, motor=-delay * motion.dtau_m[i])
    if "link_encoder" in p["channels"]:
        wound = motion.K[i] * motion.dq[i] + motion.D[i] * motion.ddq[i]
        total += motion.at(i, link=delay * motion.dtau_J[i], drive=-delay * wound)
    return total


def change(sensors: Sensors, i: int, n: int, p: Numbers) -> Sensors:
    """Delay the named channels of a joint."""
    for channel in p["channels"]:
        # A fit may end a rounding error below zero.
        sensors = sensors.changed(channel, i, n, delay=max(0.0, p["delay"]))
    return sensors


EFFECT: Effect = SensorEffect(
    id="time_delay",
    formula="named channels: recorded(t) = true(t - delay), relative to the motor encoder",
    description="Channels that reach the recorder with a delay: filters, buses, other clocks.",
    plain="has its {channels} recorded with a delay of {delay}",
    signature=(
        "The residual follows the rate of the delayed channel: zero where the channel"
        " is constant, largest where it changes fastest."
    ),
    law=law,
    parameters=(
        Parameter(
            "delay",
            "s",
            1e-4,
            0.05,
            neutral=0.0,
            above=-1e-12,
            draw=(1.5e-3, 0.01),
            meaning="relative to the motor encoder",
        ),
    ),
    choices=(Choice("channels", tuple(SIDES), ("joint_torque",), several=True),),
    scope=Scope.EACH_OR_ARM,
    sides=("link", "drive", "motor"),
    sides_of=sides_of,
    regime="frequency",
    change=change,
    regressor=DelayedTorques,
    prior=lambda rate: 0.3 / rate,  # channels that are sampled one after another
    confusions=(
        Confusion(
            "damping_mismatch",
            "only the drive equation is available: a delay of tau_J acts there as dD = -K delay",
            "the link or motor equation, in which damping is not visible",
        ),
        Confusion(
            "torque_lowpass",
            "the torque changes slowly compared with the delay: both act as the delay"
            " times its rate",
            "faster motion: a filter also reduces the amplitude, a delay does not",
        ),
    ),
)
