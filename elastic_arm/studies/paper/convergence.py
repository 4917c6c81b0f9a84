"""Convergence of the prototype over step size, coupler stiffness and bushing stiffness."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elastic_arm.dynamics import build_model
from elastic_arm.robot.description import Robot
from elastic_arm.studies.paper.comparison import model_torques
from elastic_arm.studies.paper.virtual_prototype.couplers import SoftCouplers
from elastic_arm.studies.paper.virtual_prototype.mechanism import Bushing
from elastic_arm.studies.paper.virtual_prototype.motions import QUINTIC, StepRamp
from elastic_arm.studies.paper.virtual_prototype.prototype import Prototype


@dataclass(frozen=True)
class ConvergenceCheck:
    """One setting and the largest deviation it leaves, Nm.

    `tau_m` is against the reference named by the table; `tau_l` is mod3's link-side residual where there is one.
    """

    setting: float
    tau_m: float
    tau_l: float | None = None


def over_steps(robot: Robot, steps: tuple[float, ...], motion: StepRamp) -> list[ConvergenceCheck]:
    """Compare tau_m at each integration step with that at the last, the finest."""
    prototype = Prototype(robot)
    torques = [prototype.follow(motion, step=step).tau_m for step in steps]
    return [
        ConvergenceCheck(step, float(np.abs(tau_m - torques[-1]).max()))
        for step, tau_m in zip(steps, torques, strict=True)
    ][:-1]


def over_couplers(
    robot: Robot, frequencies: tuple[float, ...], motion: StepRamp, step: float
) -> list[ConvergenceCheck]:
    """Compare tau_m of soft couplers (engine constraints, rad/s) with that of exact ones.

    On a ramp without jumps of acceleration: no coupler of finite stiffness follows a jump.
    """
    motion = replace(motion, shape=QUINTIC)
    exact = Prototype(robot).follow(motion, step=step)
    checks = []
    for frequency in frequencies:
        tau_m, _ = SoftCouplers(robot, frequency).follow(motion, step=step)
        checks.append(ConvergenceCheck(frequency, float(np.abs(tau_m - exact.tau_m[: len(tau_m)]).max())))
    return checks


def over_bushings(robot: Robot, scales: tuple[float, ...], motion: StepRamp, step: float) -> list[ConvergenceCheck]:
    """Compare mod3 with the prototype as the bushing grows stiff; an infinite scale has it locked.

    On a ramp without jumps of acceleration, after which bearings of any stiffness would ring.
    """
    motion = replace(motion, shape=QUINTIC)
    mod3 = build_model(robot, "mod3")
    checks = []
    for scale in scales:
        bushing = Bushing(locked=True) if np.isinf(scale) else Bushing(bearing_scale=scale)
        fine = step if np.isinf(scale) else step / max(1.0, scale**0.5)
        run = Prototype(robot, bushing).follow(motion, step=fine)
        torques = model_torques(mod3, run)
        checks.append(
            ConvergenceCheck(
                float(scale), float(np.abs(torques.motor - run.tau_m).max()), float(np.abs(torques.link).max())
            )
        )
    return checks
