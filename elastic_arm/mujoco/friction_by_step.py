"""Friction that depends on speed or load in MuJoCo, by the friction loss of a joint at each step.

    frictionloss(t + dt) = own + F(w(t), tau_J(t))

F is the size of the torque of the effects' laws, own the friction loss in the file without the part
that approximates these laws, and tau_J the torque behind the gear (:mod:`.carried`), because the
friction of teeth follows their load. MuJoCo solves for dry friction, so a sticking joint does not
creep, as it does with a law whose sign is regularised over the speed.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.effects import EffectInstance
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect_set import EffectSet
from elastic_arm.mujoco.carried import carried
from elastic_arm.mujoco.elements import Elements
from elastic_arm.mujoco.stand_ins import take_stand_in_away
from elastic_arm.mujoco.stated_arm import stated_arm
from elastic_arm.robot import Robot
from elastic_arm.robot.mjcf import MjcfArm
from elastic_arm.simulation.assembly import law_rows

SLOWEST = 1e-9  # rad/s, smallest speed with a direction; numerical


def laws_beside(arm: MjcfArm, robot: Robot) -> tuple[EffectInstance, ...]:
    """Return the friction laws of a rigid robot that the numbers and elements of a model lack."""
    if robot.elastic:
        return ()
    step = float(arm.model.opt.timestep)
    own = [one.to_dict() for one, _ in stated_arm(arm.robot).left]
    left = Elements(robot, stated_arm(robot), step).left_by(arm.model)
    # Laws with internal states have no size at an instant.
    sizes = [one for one in left if one.effect.friction and not one.effect.states]
    return tuple(one for one in sizes if one.to_dict() not in own)


class FrictionLevel:
    """The size of friction laws (n,) Nm at angles, rates and torques behind the gears (n,)."""

    def __init__(self, robot: Robot, laws: Sequence[EffectInstance]) -> None:
        equations = ArmEquations(robot)
        effects = EffectSet(laws, robot)
        z = np.zeros(int(effects.z.numel()))
        sharp = np.full(2 * robot.n, 1e-3 * SLOWEST)
        still = np.zeros(robot.n)
        given = equations.nominal.copy(), effects.numbers(), sharp
        self._law: ca.Function = law_rows(equations, effects)
        # The buffer points into the function and the arrays, so both must stay alive.
        self._arguments = [still.copy(), still.copy(), still, z, still.copy(), *given]
        self._rows = np.zeros(robot.n)
        self._buffer, self._evaluate = self._law.buffer()
        for k, array in enumerate(self._arguments):
            values = np.ascontiguousarray(array, dtype=float)
            self._arguments[k] = values
            self._buffer.set_arg(k, memoryview(values))  # type: ignore[call-arg, arg-type]
        self._buffer.set_res(0, memoryview(self._rows))  # type: ignore[call-arg, arg-type]

    def __call__(self, q: Array, dq: Array, tau_J: Array) -> Array:
        moving = np.where(np.abs(dq) < SLOWEST, SLOWEST, dq)
        for k, values in ((0, q), (1, moving), (4, tau_J)):
            self._arguments[k][:] = values
        self._evaluate()
        return np.maximum(0.0, self._rows * np.sign(moving))

    def along(self, q: Array, dq: Array, tau_J: Array) -> Array:
        """Return the sizes (N, n) along a motion (N, n)."""
        return np.array([self(*values) for values in zip(q, dq, tau_J, strict=True)])


def with_laws(arm: MjcfArm, laws: Sequence[EffectInstance]) -> MjcfArm:
    """Return a model on which laws act by step, without the friction that approximates them."""
    if not laws:
        return replace(arm, laws=())
    model = copy.copy(arm.model)
    sharp = 2.0 * float(model.opt.timestep)
    for i in {k for law in laws for k in law.joint_indices(arm.robot)}:
        dof = int(arm.dofs[i])
        if not model.dof_frictionloss[dof]:
            # By default friction changes its sign some 10 ms before the velocity.
            model.dof_solref[dof] = sharp, 1.0
        stand_in = take_stand_in_away(model, arm.robot.joint_names[i], dof)
        stand_in[:] = 0.0
    return replace(arm, model=model, laws=tuple(laws))


def acting_by_step(arm: MjcfArm, laws: Sequence[EffectInstance]) -> Callable[[Any], None]:
    """Return a function of MuJoCo's data that sets the friction loss for the next step."""
    if not laws:
        return lambda data: None
    level = FrictionLevel(arm.robot, laws)
    positions = arm.positions
    dofs = arm.dofs
    own = np.array(arm.model.dof_frictionloss[arm.dofs])

    def act(data: Any) -> None:
        load = carried(arm.model, data, dofs)
        size = level(data.qpos[positions], data.qvel[dofs], load)
        arm.model.dof_frictionloss[dofs] = own + size

    return act
