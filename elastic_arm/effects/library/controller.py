"""Controllers of drives that are not as stated, where motor torques are made of commands and states
by them.

    tau_m = limit(kp (r(t - d) - theta) + kd (dr(t - d) - dtheta) + ...)

What the drive truly makes with another number is missing in the torque that the stated one makes.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca

from elastic_arm.effects.law import (
    Confusion,
    Contribution,
    ControllerEffect,
    Law,
    Numbers,
    Parameter,
    Scope,
    SymbolicMotion,
    amount,
    no_controller,
    ratio,
    searched,
)
from elastic_arm.errors import EffectError
from elastic_arm.robot import JointController

LEAST = 1e-12  # Nm, numerical; of full duty, which samples without commands do not have


def made(
    law: Callable[[SymbolicMotion, int, JointController, Numbers], Any],
    *,
    limited: bool = True,
    asked: bool = True,
    commanded: bool = True,
) -> Law:
    """Return the law of what the stated controller makes more than the true one.

    It is written in the stated controller and parameters; limited: null where the controller
    commands more than its limit; asked: null where the duty is at its limit, as what the firmware
    commands then does not count; commanded: of commands alone, and not of a recorded duty, which
    holds all that the firmware did.
    """

    def motor(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
        joint = motion.robot.joints[i]
        if joint.controller is None:
            raise no_controller(joint.name)
        if motion.r is None:
            raise EffectError(
                "no commands are known",
                "Omit controller effects if torques are given.",
            )
        if commanded and joint.follows_duty:
            raise EffectError(
                f"the torque of {joint.name} comes from its recorded duty, not from commands",
                "Omit effects of its firmware, or leave pwm out of the recording.",
            )
        more = law(motion, i, joint.controller, p)
        limit = joint.most_torque
        if limited and limit is not None:
            wanted = _supplied(motion, i, joint.controller)
            wanted += _of_rate(motion, i, joint.controller)
            more = ca.if_else(ca.fabs(wanted) < limit, more, 0.0)
        if joint.controller.stall is not None and asked and not joint.follows_duty:
            assert motion.stall is not None
            more = ca.if_else(ca.fabs(asked_for(motion, i)) < motion.stall[i], more, 0.0)
        return motion.at(i, motor=more)

    return motor


def _of_rate(motion: SymbolicMotion, i: int, controller: JointController) -> Any:
    """Return what a controller makes of the error of the rate; that of commands may count as
    zero."""
    assert motion.dr is not None and motion.kd is not None
    return (
        motion.kd[i] * (controller.follows_rate * motion.dr[i] - motion.dtheta[i])
        if controller.kd
        else 0.0
    )


def _of_position(motion: SymbolicMotion, i: int, controller: JointController) -> Any:
    """Return what is left of the torque for the error of the angle.

    Not of the angles themselves: their noise is in the torque, too, and gains of zero would explain
    all of it.
    """
    assert motion.fed is not None
    return (
        motion.tau_m[i] - motion.fed[i] - _of_rate(motion, i, controller)
        if controller.gains[0]
        else 0.0
    )


def _of_delay(motion: SymbolicMotion, i: int, controller: JointController) -> Any:
    """Return the rate of what a controller makes of the command."""
    assert motion.dr is not None and motion.kp is not None
    return motion.kp[i] * motion.dr[i] if controller.gains[0] else 0.0


def _error(motion: SymbolicMotion, i: int) -> Any:
    controller = motion.robot.joints[i].controller
    assert motion.r is not None and controller is not None
    return motion.r[i] - controller.follows_angle * motion.theta[i]


def asked_for(motion: SymbolicMotion, i: int) -> Any:
    """Return the torque at rest that the firmware commands by the error of the angle, or by its
    recorded duty."""
    assert motion.kp is not None
    return motion.kp[i] * _error(motion, i)


def within_duty(motion: SymbolicMotion, i: int) -> tuple[Any, Any]:
    """Return what of it is within full duty, and the duty.

    The torque of full duty is the present one, as kp is: a scale of both changes no duty.
    """
    assert motion.stall is not None
    limited = asked_for(motion, i)
    if not motion.robot.joints[i].follows_duty:  # of which the recorded one is within its limit
        limited = _within(limited, motion.stall[i])
    return limited, limited / ca.fmax(motion.stall[i], LEAST)


def _supplied(motion: SymbolicMotion, i: int, controller: JointController) -> Any:
    """Return what the supply makes of it."""
    if controller.stall is None:
        return asked_for(motion, i)
    limited, duty = within_duty(motion, i)
    return limited * (1.0 - controller.sag * ca.fabs(duty))


def _within(value: Any, most: Any) -> Any:
    return ca.fmax(-most, ca.fmin(most, value))


def _beyond(motion: SymbolicMotion, i: int, controller: JointController, p: Numbers) -> Any:
    """Return what is beyond the true limit of the torque that the controller makes within its
    stated one.

    It is made of angles: beyond its limit a torque is far above the noise that they make.
    """
    assert motion.fed is not None
    own = _supplied(motion, i, controller)
    whole = motion.fed[i] + own + _of_rate(motion, i, controller)
    return whole - _within(whole, p["torque"])


def _not_felt(motion: SymbolicMotion, i: int, controller: JointController, p: Numbers) -> Any:
    assert motion.kp is not None
    return motion.kp[i] * _within(_error(motion, i), p["half_width"]) if controller.kp else 0.0


def _integral(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """Less by ki times the integral of the error, rad s, which begins at zero."""
    controller = motion.robot.joints[i].controller
    if controller is None or motion.r is None or controller.mode == "duty":
        return made(lambda *_: 0.0)(motion, i, p)  # which says what is missing
    rate = _error(motion, i) if controller.kp else 0.0  # of a controller of speeds, it is stated
    return motion.at(i, motor=-p["ki"] * p["integral"], rates={"integral": ca.SX(rate)})


def _late(controller: JointController, p: Numbers) -> JointController:
    return replace(controller, delay=max(0.0, controller.delay + p["delay"]))


EFFECTS = (
    ControllerEffect(
        "position_gain",
        formula="kp true = gain * stated",
        description=("The controller's gain for the position error differs from the description."),
        signature=(
            "The motor residual follows the position error, command minus angle, in"
            " motion and at rest."
        ),
        plain="has a controller with {gain} times the stated kp",
        law=made(lambda motion, i, stated, p: (1.0 - p["gain"]) * _of_position(motion, i, stated)),
        parameters=(ratio("gain", 0.3, 3.0, "true / stated kp", above=0.0, draw=(1.6, 2.5)),),
        sides=("motor",),
        regime="load",
        number="torque_scale",
        change=lambda controller, p: controller.scaled(kp=p["gain"]),
        confusions=(
            Confusion(
                "velocity_gain",
                "each gain contributes little to the torque: the other gain with all torques"
                " scaled gives nearly the same torque",
                "faster motion, in which kp and kd give different torques; a known weight,"
                " which determines their scale",
            ),
        ),
    ),
    ControllerEffect(
        "velocity_gain",
        formula="kd true = gain * stated",
        description=(
            "The controller's gain for the velocity error differs from the description;"
            " the back-EMF of a servo acts as part of it."
        ),
        signature="The motor residual follows the velocity error.",
        plain="has a controller with {gain} times the stated kd",
        law=made(
            lambda motion, i, stated, p: (1.0 - p["gain"]) * _of_rate(motion, i, stated),
            asked=False,
            commanded=False,
        ),
        parameters=(ratio("gain", 0.3, 3.0, "true / stated kd", above=0.0, draw=(0.5, 2.0)),),
        sides=("motor",),
        regime="high_speed",
        needs_motion=True,
        number="kd",
        change=lambda controller, p: controller.scaled(kd=p["gain"]),
        confusions=(
            Confusion(
                "position_gain",
                "each gain contributes little to the torque: the other gain with all torques"
                " scaled gives nearly the same torque",
                "faster motion, in which kp and kd give different torques; a known weight,"
                " which determines their scale",
            ),
            Confusion(
                "viscous_friction",
                "the controller damps the motor's own velocity, and viscous friction gives"
                " the same torque",
                "a controller that follows the rate of commands, or motion driven from outside",
            ),
        ),
    ),
    ControllerEffect(
        "command_delay",
        formula="the drive follows r(t - delay)",
        description=(
            "Commands reach the drive later than stated: buses, queues, set-point filters."
        ),
        signature="The motor residual follows the rate of the command times kp.",
        plain="receives its commands {delay} later than stated",
        law=made(lambda motion, i, stated, p: p["delay"] * _of_delay(motion, i, stated)),
        parameters=(
            Parameter(
                "delay",
                "s",
                1e-4,
                0.2,
                neutral=0.0,
                draw=(0.01, 0.05),
                meaning="in addition to the stated delay",
            ),
        ),
        scope=Scope.EACH_OR_ARM,
        sides=("motor",),
        regime="frequency",
        needs_motion=True,
        change=_late,
        prior=lambda rate: 3e-3,  # buses of servos and streams of set-points: 1 to 5 ms
        confusions=(
            Confusion(
                "velocity_gain",
                "the arm follows its commands closely: a delay acts as damping of kp times"
                " the delay",
                "faster motion, or constant commands while an external force moves the arm",
            ),
            Confusion(
                "viscous_friction",
                "the arm follows its commands closely",
                "motion at several speeds",
            ),
        ),
    ),
    ControllerEffect(
        "torque_saturation",
        formula="tau_m true = limit(controller torque, torque)",
        description=(
            "The drive gives less torque than stated: current limits, low supply voltage,"
            " overload protection."
        ),
        plain="gives at most {torque}",
        signature=(
            "The motor residual is the part of the controller torque beyond a limit, and"
            " zero below it."
        ),
        law=made(_beyond, limited=False, asked=False),
        parameters=(
            searched(
                "torque", "Nm", 0.02, 500.0, "largest torque of the drive", bounded_by="torque"
            ),
        ),
        sides=("motor",),
        regime="load",
        change=lambda controller, p: replace(controller, torque=p["torque"]),
        confusions=(
            Confusion(
                "position_gain",
                "the torque is at its limit most of the time",
                "slower motion or less load, with the drive below its limit",
            ),
        ),
    ),
    ControllerEffect(
        "position_dead_band",
        formula="kp acts on the part of r - theta beyond +-half_width",
        description="Small position errors give no torque, as in servos that avoid hunting.",
        plain="gives no torque for position errors within {half_width}",
        signature="The motor residual is kp times the error within the band, and constant outside.",
        law=made(_not_felt),
        parameters=(
            searched(
                "half_width", "rad", 2e-3, 0.1, "on either side of the command", bounded_by="error"
            ),
        ),
        sides=("motor",),
        regime="load",
        change=lambda controller, p: replace(controller, dead_band=p["half_width"]),
        confusions=(
            Confusion(
                "coulomb_friction",
                "the position error mostly has the sign of the velocity",
                "loads that change while the joint turns in one direction",
            ),
        ),
    ),
    ControllerEffect(
        "integral_gain",
        formula="tau_m true = controller torque + ki int(r - theta)",
        description="The controller has an integral term that the description does not state.",
        plain="integrates its position error with {ki}",
        signature=(
            "The motor residual follows the integral of command minus angle, and changes"
            " most slowly where it is largest."
        ),
        law=_integral,
        parameters=(amount("ki", "Nm/(rad s)", 0.5, 200.0, "in addition to the stated value"),),
        sides=("motor",),
        regime="load",
        states=("integral",),
        change=lambda controller, p: replace(controller, ki=controller.ki + max(0.0, p["ki"])),
        confusions=(
            Confusion(
                "position_gain",
                "the motion has a single frequency",
                "motion at several speeds, and rest",
            ),
        ),
    ),
)
