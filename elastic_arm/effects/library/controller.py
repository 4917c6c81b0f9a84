"""Controllers of drives that are not as stated, where motor torques are made of commands and states by them.

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
    no_controller,
    ratio,
)
from elastic_arm.errors import EffectError
from elastic_arm.robot import JointController


def _made(law: Callable[[SymbolicMotion, int, float, float, Numbers], Any]) -> Law:
    """Return the law of what the stated controller makes more than the true one, where its torque is not at its limit.

    It is written in kp, kd and parameters.
    """

    def motor(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
        joint = motion.robot.joints[i]
        if joint.controller is None:
            raise no_controller(joint.name)
        if motion.r is None or motion.dr is None:
            raise EffectError("no commands are known", "Leave out effects of the controller where torques are given.")
        kp, kd, _ = joint.controller.gains
        limits = [one for one in (joint.controller.torque, joint.limits.torque) if one is not None]
        torque = law(motion, i, kp, kd, p)
        if limits:
            whole = kp * _error(motion, i) + kd * _rate_error(motion, i)
            torque = ca.if_else(ca.fabs(whole) < min(limits), torque, 0.0)
        return motion.at(i, motor=torque)

    return motor


def _rate(motion: SymbolicMotion, i: int) -> Any:
    assert motion.dr is not None
    return motion.dr[i]


def _error(motion: SymbolicMotion, i: int) -> Any:
    assert motion.r is not None
    return motion.r[i] - motion.theta[i]


def _rate_error(motion: SymbolicMotion, i: int) -> Any:
    """Return the error of the rate; the motor's own where the rate of the command is not followed."""
    controller = motion.robot.joints[i].controller
    assert motion.dr is not None and controller is not None
    return controller.follows_rate * motion.dr[i] - motion.dtheta[i]


def _scaled(name: str) -> Callable[[JointController, Numbers], JointController]:
    """Return the change of a gain; of a controller of speeds, kp is the gain of the integral."""

    def change(controller: JointController, p: Numbers) -> JointController:
        own = "ki" if name == "kp" and controller.mode == "velocity" else name
        return replace(controller, **{own: p["gain"] * getattr(controller, own)})

    return change


def _late(controller: JointController, p: Numbers) -> JointController:
    return replace(controller, delay=max(0.0, controller.delay + p["delay"]))


SCALE = Confusion(
    "motor_torque_gain",
    "the other gain hardly makes a torque, so that both scale all of it",
    "faster motion: kp and kd then make torques of their own",
)

EFFECTS = (
    ControllerEffect(
        "position_gain",
        formula="kp true = gain * stated",
        description="The controller's gain of the error of position is not what the description states.",
        signature="The motor residual follows the error of position: command less angle, in motion and at rest.",
        law=_made(lambda motion, i, kp, kd, p: (1.0 - p["gain"]) * kp * _error(motion, i)),
        parameters=(ratio("gain", 0.5, 2.0, "true / stated kp", above=0.0, draw=(0.7, 1.4)),),
        sides=("motor",),
        regime="load",
        change=_scaled("kp"),
        confusions=(SCALE,),
    ),
    ControllerEffect(
        "velocity_gain",
        formula="kd true = gain * stated",
        description="The controller's gain of the error of speed is not what the description states; a servo's back-EMF "
        "acts as a part of it.",
        signature="The motor residual follows the error of speed.",
        law=_made(lambda motion, i, kp, kd, p: (1.0 - p["gain"]) * kd * _rate_error(motion, i)),
        parameters=(ratio("gain", 0.2, 5.0, "true / stated kd", least=0.0, draw=(0.5, 2.0)),),
        sides=("motor",),
        regime="high_speed",
        needs_motion=True,
        change=_scaled("kd"),
        confusions=(
            SCALE,
            Confusion(
                "viscous_friction",
                "the controller damps the motor's own speed: viscous friction then is the same torque",
                "a controller that follows the rate of commands, or motion that something else drives",
            ),
        ),
    ),
    ControllerEffect(
        "command_delay",
        formula="the drive follows r(t - delay)",
        description="Commands reach the drive later than stated: buses, queues, filters of set-points.",
        signature="The motor residual follows the rate of the command times kp.",
        law=_made(lambda motion, i, kp, kd, p: p["delay"] * kp * _rate(motion, i)),
        parameters=(
            Parameter("delay", "s", 1e-4, 0.2, neutral=0.0, draw=(0.01, 0.05), meaning="beyond the one stated"),
        ),
        scope=Scope.EACH_OR_ARM,
        sides=("motor",),
        regime="frequency",
        needs_motion=True,
        change=_late,
        prior=lambda rate: 0.3 / rate,  # commands and states that are sampled one after another
        confusions=(
            Confusion(
                "velocity_gain",
                "the arm follows its commands closely: a delay acts as damping of kp times it",
                "faster motion, or resting commands while something else moves the arm",
            ),
            Confusion("viscous_friction", "the arm follows its commands closely", "motion of several speeds"),
        ),
    ),
)
