"""Bearings that tilt."""

from dataclasses import replace

import casadi as ca

from elastic_arm.effects.equations import ArmEquations
from elastic_arm.effects.law import (
    Contribution,
    Effect,
    Numbers,
    Plant,
    Scope,
    StructuralEffect,
    SymbolicMotion,
    searched,
)
from elastic_arm.effects.library.tilts import TiltRegressor
from elastic_arm.errors import EffectError
from elastic_arm.robot import Robot


def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """What the links feel when the bearings give way as springs, without ringing.

    The tilts follow the moment that the rigid arm puts on its bearings; their rates follow from those of the motion.
    Without the motion's third and fourth derivative about a tenth of the effect's power is missed. A simulated arm does
    not need this law: there the tilts are coordinates.
    """
    n, zero = motion.n, ca.SX.zeros(2 * motion.n)
    _check(motion.robot)
    whole = ArmEquations(motion.robot, motion.equations.model_name, bearings=True)
    x, dx, ddx, dddx, ddddx = (ca.SX.sym(name, 2 * n) for name in ("x", "dx", "ddx", "dddx", "ddddx"))

    def left_side(tilt: ca.SX, rate: ca.SX, acceleration: ca.SX) -> ca.SX:
        parts = ((x, tilt), (dx, rate), (ddx, acceleration))
        return whole.left_side(*(ca.vertcat(own, added) for own, added in parts))

    def rate_of(expression: ca.SX) -> ca.SX:
        pairs = ((x, dx), (dx, ddx), (ddx, dddx), (dddx, ddddx))
        return sum((ca.jtimes(expression, known, rate) for known, rate in pairs), ca.SX.zeros(2 * n))

    rigid = left_side(zero, zero, zero)
    tilt = -rigid[2 * n :] / (p["stiffness_scale"] * ca.repmat(_stiffness(motion.robot), 2, 1))
    rate = rate_of(tilt)
    rows = left_side(tilt, rate, rate_of(rate))[: 2 * n] - rigid[: 2 * n]
    known = ca.vertcat(x, dx, ddx, dddx, ddddx, whole.Psi)
    jerk, snap = (ca.SX.zeros(2 * n) + value for value in (motion.dddx, motion.ddddx))
    here = ca.vertcat(motion.x, motion.dx, motion.ddx, jerk, snap, ca.DM(whole.nominal))
    return motion.everywhere(ca.substitute(rows, known, here))


def _stiffness(robot: Robot) -> ca.DM:
    return ca.DM([j.transmission.bearing.stiffness for j in robot.joints if j.transmission and j.transmission.bearing])


def _check(robot: Robot) -> None:
    """Refuse an arm without bearings."""
    for joint in robot.joints:
        if joint.transmission is None or joint.transmission.bearing is None:
            raise EffectError(
                f"{joint.name} of robot {robot.name} has no bearing", "Give its stiffness and damping in the arm file."
            )


def change(plant: Plant, p: Numbers) -> Plant:
    """Free the tilts q_x, q_y, with the arm file's bearings times the scale."""
    _check(plant.robot)
    joints = []
    for joint in plant.robot.joints:
        gear = joint.transmission
        if gear is not None and gear.bearing is not None:
            bearing = replace(gear.bearing, stiffness=gear.bearing.stiffness * p["stiffness_scale"])
            joints.append(replace(joint, transmission=replace(gear, bearing=bearing)))
    return replace(plant, robot=plant.robot.with_(joints=tuple(joints)), bearings=True)


EFFECT: Effect = StructuralEffect(
    id="bearing_compliance",
    formula="tilts q_ix, q_iy of every joint, bearing stiffness times the scale",
    description="The joints' bearings give way about x and y; the model holds them rigid.",
    plain="has bearings that give way, {stiffness_scale} times as stiff as described",
    signature="Link residuals of all joints that grow with the tilting moments and ring at the bearings' resonances.",
    law=law,
    parameters=(searched("stiffness_scale", "1", 0.01, 10.0, "true / arm file", default=1.0, above=0.0, inverse=True),),
    scope=Scope.ARM,
    sides=("link",),
    regime="frequency",
    change=change,
    regressor=TiltRegressor,
)
