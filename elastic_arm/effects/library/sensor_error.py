"""Torque sensors and encoders with a wrong gain or zero, or a disc off centre, and what all sensor
effects share."""

from collections.abc import Callable
from typing import Any

import casadi as ca

from elastic_arm.effects.law import (
    Confusion,
    Contribution,
    Law,
    Numbers,
    Parameter,
    SensorEffect,
    SymbolicMotion,
    phase,
    ratio,
    signed,
)
from elastic_arm.sensors import Sensors

# Which residuals hold a channel.
SIDES = {
    "joint_torque": ("link", "drive", "motor"),
    "motor_torque": ("motor",),
    "link_encoder": ("link", "drive"),
}
TORQUES = ("joint_torque", "motor_torque")


def sides_of(p: Numbers) -> tuple[str, ...]:
    """Return the residuals that hold the channels of an effect.

    Its choice is `channels` or `channel`.
    """
    chosen = p["channels"] if "channels" in p else (p["channel"],)
    return tuple(
        side
        for side in ("link", "drive", "motor")
        if any(side in SIDES[channel] for channel in chosen)
    )


def misread(channel: str, error: Callable[[SymbolicMotion, int, Numbers], Any]) -> Law:
    """Return the law of a channel's error.

    (motion, joint index, parameters) -> recorded - true torque, Nm

    The motor equation holds the joint torque with the other sign.
    """

    def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
        more = error(motion, i, p)
        if channel == "motor_torque":
            return motion.at(i, motor=more)
        return motion.at(i, link=more, drive=more, motor=-more)

    return law


def changing(channel: str, **numbers: str) -> Callable[[Sensors, int, int, Numbers], Sensors]:
    """Return the change that sets numbers of a joint's channel to parameters: `gain="gain"`."""

    def change(sensors: Sensors, i: int, n: int, p: Numbers) -> Sensors:
        return sensors.changed(
            channel, i, n, **{number: p[name] for number, name in numbers.items()}
        )

    return change


def gain(channel: str, symbol: str, prior: float, **words: Any) -> SensorEffect:
    """Return a wrong gain of a torque channel.

    The error is linear in 1 - 1/gain, the coefficient of its column.
    """
    recorded = {
        "joint_torque": lambda motion: motion.tau_J,
        "motor_torque": lambda motion: motion.tau_m,
    }[channel]
    numbers = ratio(
        "gain", 0.5, 2.0, "recorded / true", above=0.0, from_coefficient=lambda c: 1.0 / (1.0 - c)
    )
    return SensorEffect(
        f"{channel}_gain",
        formula=f"{symbol} recorded = gain * true",
        law=misread(channel, lambda motion, i, p: (1.0 - 1.0 / p["gain"]) * recorded(motion)[i]),
        parameters=(numbers,),
        sides=SIDES[channel],
        regime="load",
        change=changing(channel, gain="gain"),
        prior=lambda rate: prior,
        **words,
    )


def zero(
    channel: str, law: Law, unit: str, most: float, prior: float, **words: Any
) -> SensorEffect:
    """Return a wrong zero of a channel, which may be set anew at each start."""
    return SensorEffect(
        law=law,
        parameters=(signed("offset", unit, most, "recorded - true"),),
        regime="always",
        change=changing(channel, offset="offset"),
        prior=lambda rate: prior,
        set_at_start=True,
        **words,
    )


def _off_centre(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """K and D times the false deflection and its rate."""
    motion.gear(i)
    angle = motion.q[i] + p["phase"]
    error = p["amplitude"] * ca.sin(angle)
    rate = p["amplitude"] * ca.cos(angle) * motion.dq[i]
    return motion.at(i, drive=motion.K[i] * error + motion.D[i] * rate)


def _apart(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """K times the offset: the deflection is read too small by it."""
    motion.gear(i)
    return motion.at(i, drive=motion.K[i] * p["offset"])


ONLY_DRIVE = "only the drive equation is available"

EFFECTS = (
    gain(
        "motor_torque",
        "tau_m",
        0.015,  # current sensors and calibrated torque constants: up to 3 %, as two deviations
        description="The torque constant of the motor differs from the value in the drive.",
        plain="records {gain} times its motor torque",
        signature=(
            "The motor residual is proportional to the motor torque, at rest and in motion."
        ),
        confusions=(
            Confusion(
                "rotor_inertia_mismatch",
                "neither gravity nor load acts on the joint, as on a vertical first axis",
                "motion in which other joints or gravity load this one",
            ),
        ),
    ),
    gain(
        "joint_torque",
        "tau_J",
        0.01,  # strain gauges: up to 2 % of the reading, as two deviations
        description="The joint torque sensor has a wrong scale.",
        plain="records {gain} times its joint torque",
        signature=(
            "All three residuals of the joint are proportional to the joint torque, with"
            " the opposite sign in the motor residual."
        ),
        confusions=(
            Confusion("stiffness_mismatch", ONLY_DRIVE, "the link or motor equation"),
            Confusion(
                "link_inertia_mismatch",
                "one common gain of all torque sensors scales all masses, K and D alike",
                "motor torques: they are independent of the joint torque sensors",
            ),
        ),
    ),
    zero(
        "motor_torque",
        misread("motor_torque", lambda motion, i, p: p["offset"]),
        "Nm",
        50.0,
        0.4,
        id="motor_torque_offset",
        formula="tau_m recorded = true + offset",
        description="The current measurement of the motor has a wrong zero.",
        plain="records its motor torque shifted by {offset}",
        signature="The motor residual is a constant, at rest and in motion.",
        sides=SIDES["motor_torque"],
        confusions=(
            Confusion(
                "coulomb_friction",
                "the joint turns in only one direction",
                "reversals: friction changes sign there",
            ),
        ),
    ),
    zero(
        "joint_torque",
        misread("joint_torque", lambda motion, i, p: p["offset"]),
        "Nm",
        50.0,
        0.4,
        id="joint_torque_offset",
        formula="tau_J recorded = true + offset",
        description="The joint torque sensor has a wrong zero.",
        plain="records its joint torque shifted by {offset}",
        signature=(
            "All three residuals of the joint are shifted by a constant, with the"
            " opposite sign in the motor residual."
        ),
        sides=SIDES["joint_torque"],
        confusions=(
            Confusion(
                "encoder_offset",
                ONLY_DRIVE,
                "the link or motor equation, in which an encoder offset is not visible",
            ),
        ),
    ),
    zero(
        "link_encoder",
        _apart,
        "rad",
        0.01,
        1e-5,
        id="encoder_offset",
        formula="link encoder = true + offset, relative to the motor encoder",
        description="The zeros of link and motor encoder differ.",
        plain="has a link encoder whose zero differs by {offset} from the motor encoder",
        signature=(
            "The drive residual is a constant: without load at rest, the drive seems to"
            " be deflected."
        ),
        sides=("drive",),
        confusions=(
            Confusion(
                "backlash",
                "the load of the joint always has the same sign",
                "motion in which the joint torque changes sign",
            ),
            Confusion("joint_torque_offset", ONLY_DRIVE, "the link or motor equation"),
        ),
    ),
    SensorEffect(
        "encoder_eccentricity",
        formula="link encoder = true + A sin(q + phi)",
        description="The disc of the link encoder is mounted eccentrically.",
        plain="has a link encoder whose disc is eccentric by {amplitude}",
        signature=(
            "The drive residual is a sine over one turn of the link, independent of speed and load."
        ),
        law=_off_centre,
        parameters=(Parameter("amplitude", "rad", 1e-6, 5e-3, neutral=0.0, meaning="A"), phase()),
        sides=("drive",),
        regime="position",
        change=changing("link_encoder", eccentricity="amplitude", phase="phase"),
        confusions=(
            Confusion(
                "encoder_offset",
                "the joint turns through a small angle",
                "motion over a wide range of the joint",
            ),
        ),
    ),
)
