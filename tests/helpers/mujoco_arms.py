"""Inverse dynamics of a model's arm as MuJoCo computes them, and as this package does from what it
read."""

from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics import build_model
from elastic_arm.effects import robot_effects
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect_set import EffectSet
from elastic_arm.effects.motion import SymbolicMotion
from elastic_arm.mujoco import attach
from elastic_arm.mujoco.elements import DEFLECTION
from elastic_arm.robot import Robot
from elastic_arm.robot.mjcf import MjcfArm, engine

Array = NDArray[np.float64]
MODELS = Path(__file__).parents[1] / "data" / "mjcf"


def random_motion(n: int, samples: int = 20) -> tuple[Array, Array, Array]:
    """Return q, dq, ddq (samples, n) of every size."""
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-1.5, 1.5, (3, samples, n))
    return q, dq, 3.0 * ddq


def stated_torque(robot: Robot, q: Array, dq: Array, ddq: Array) -> Array:
    """Return the torque (N, n) that a description states: the rigid arm and its effects."""
    effects, equations, n = EffectSet(robot_effects(robot), robot), ArmEquations(robot), robot.n
    x, dx, ddx = (ca.SX.sym(name, n) for name in ("x", "dx", "ddx"))
    none = ca.SX.zeros(n)
    motion = SymbolicMotion(
        equations, x, dx, ddx, none, none, none, none, sign=lambda side, i: ca.sign(dx[i])
    )
    added, _ = effects.contribution(motion)
    law = ca.Function("law", [x, dx, ddx, effects.p, equations.Psi], [added.link + added.motor])
    rows = [
        np.array(law(*sample, effects.numbers(), equations.nominal)).ravel()
        for sample in zip(q, dq, ddq, strict=True)
    ]
    return build_model(robot).inverse_dynamics(q, dq, ddq) + np.array(rows)


def mujoco_torque(
    arm: MjcfArm, q: Array, dq: Array, ddq: Array, *, friction_loss: bool = False
) -> Array:
    """Return the torque (N, n) of `mj_inverse`, without contacts and limits, and at will without
    friction loss."""
    mj, model = engine(), arm.model
    off = mj.mjtDisableBit
    for flag in (off.mjDSBL_CONTACT, off.mjDSBL_LIMIT, off.mjDSBL_EQUALITY):
        model.opt.disableflags |= int(flag)
    if not friction_loss:
        model.opt.disableflags |= int(off.mjDSBL_FRICTIONLOSS)
    data, found = mj.MjData(model), []
    for at, rate, acceleration in zip(q, dq, ddq, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = arm.qpos, 0.0, 0.0
        data.qpos[arm.positions], data.qvel[arm.dofs], data.qacc[arm.dofs] = at, rate, acceleration
        mj.mj_inverse(model, data)
        found.append(data.qfrc_inverse[arm.dofs].copy())
    return np.array(found)


def played(
    robot: Robot, text: str, commands: Array, start: Array, *, substeps: int, attached: bool = False
) -> Array:
    """Return the angles q and theta (N, 2n) that an elastic arm's new MJCF has under motor torques
    (N, n)."""
    mj, n, angles = engine(), robot.n, []
    model = mj.MjModel.from_xml_string(text)
    model.opt.disableflags |= int(mj.mjtDisableBit.mjDSBL_LIMIT)
    data = mj.MjData(model)
    theta, wound = (
        [model.joint(f"{name}{end}").qposadr[0] for name in robot.joint_names]
        for end in ("", DEFLECTION)
    )
    for values, state in ((data.qpos, start[: 2 * n]), (data.qvel, start[2 * n : 4 * n])):
        values[theta], values[wound] = state[n:], state[:n] - state[n:]
    handle = attach(model, robot) if attached else None
    for command in commands:
        angles.append([*(data.qpos[theta] + data.qpos[wound]), *data.qpos[theta]])
        data.ctrl[:] = command
        for _ in range(substeps):
            mj.mj_step(model, data)
    if handle is not None:
        handle.detach()
    return np.array(angles)
