"""Recording of a MuJoCo arm that follows a trajectory, as of a real arm."""

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.errors import SimulationError
from elastic_arm.mujoco.closed_loop import StartState, has_servos, lead, servo_motion
from elastic_arm.mujoco.replaying import without
from elastic_arm.recording import Recording, Side
from elastic_arm.robot import Robot, to_urdf
from elastic_arm.robot.mjcf import MjcfArm, engine
from elastic_arm.robot.mjcf.drives import torque_delays
from elastic_arm.simulation.controller import Controller, tuned
from elastic_arm.simulation.rollout import Trajectory


def record(
    arm: MjcfArm,
    trajectory: Trajectory,
    *,
    nominal: Robot | None = None,
    rate: float = 1000.0,
    torque_noise: float = 0.0,
    encoder_noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> Recording:
    """Let an arm follow a trajectory by computed torque, in MuJoCo, and record angles and motor
    torques.

    The model's own actuators are off: the torque comes from a controller tuned to `nominal`, the
    true rigid arm when None, held for a sample. Torques are recorded as late as the model's sensors
    (`jointactuatorfrc`) state, with noise of these standard deviations, Nm and rad. Raises a
    SimulationError if the motion leaves the finite numbers.
    """
    believed = arm.robot.with_(effects=()) if nominal is None else nominal.with_(effects=())
    controller = tuned(believed, rate=rate)
    every = controller.commands
    commanded = every * rate
    t = np.arange(round(trajectory.duration * rate) * every + 1) / commanded
    q, dq, command = _followed(arm, controller, trajectory.evaluate(t), commanded)
    # At the time of the angles, velocities and torques are further on than MuJoCo has them.
    ahead = lead(arm.model, _step(arm, commanded)) * commanded
    dq = dq + ahead * np.diff(dq, axis=0, append=dq[-1:])
    # Over an interval centred on its stamp the torque changes in the middle, but for what it is
    # further on.
    torque = (0.5 + ahead) * command + (0.5 - ahead) * np.vstack([command[:1], command[:-1]])
    if every > 1:
        # A sample of torque is the mean over its own interval, half of the outermost commands'.
        total = np.cumsum(0.5 * (torque[1:] + torque[:-1]), axis=0, dtype=float)
        summed = np.vstack([np.zeros((1, arm.robot.n)), total])
        ends = np.clip(np.arange(len(t))[:, None] + [-every // 2, every // 2], 0, len(t) - 1)
        torque = (summed[ends[:, 1]] - summed[ends[:, 0]]) / np.diff(ends)
    t = t[::every]
    q = q[::every]
    dq = dq[::every]
    torque = torque[::every]
    reference = trajectory.evaluate(t)
    late = torque_delays(arm.model, arm.chain)
    torque = np.stack([np.interp(t - late[i], t, torque[:, i]) for i in range(arm.robot.n)], axis=1)
    noise = np.random.default_rng() if rng is None else rng
    stamp_ns = np.round(t * 1e9).astype(np.int64)
    measured = q + encoder_noise * noise.standard_normal(q.shape)
    effort = torque + torque_noise * noise.standard_normal(q.shape)
    return Recording(
        joints=arm.robot.joint_names,
        motor=Side(stamp_ns, position=measured, velocity=dq, effort=effort),
        reference=Side(
            stamp_ns, position=reference[0], velocity=reference[1], acceleration=reference[2]
        ),
        robot_description=to_urdf(believed),
        source="MuJoCo",
    )


def record_commands(
    arm: MjcfArm, commands: Array, *, rate: float, bits: int | None = None
) -> Recording:
    """Let the model's own position servos follow commands (N, n), rad, and record commands and
    angles, no torques.

    The arm starts at rest at the first command, and each is held until the next, at a rate that is
    a whole number of the model's time steps. Angles are recorded as often as commands, by encoders
    of `bits` over a turn, exact ones when None. Raises a SimulationError if the model has no
    servos, or the motion leaves the finite numbers.
    """
    if not has_servos(arm):
        raise SimulationError("the model has no servos", "Give each joint one position actuator.")
    step = float(arm.model.opt.timestep)
    every = max(1, round(1.0 / (rate * step)))
    angles = servo_motion(arm, StartState.at_rest(commands[0]), np.repeat(commands, every, axis=0))
    if not np.isfinite(angles).all():
        raise SimulationError(
            "simulation diverged (NaN or infinity)", "Use slower commands or a smaller timestep."
        )
    q = np.vstack([commands[:1], angles])[:-1:every]
    if bits is not None:
        code = 2.0 * np.pi / 2**bits
        q = code * np.round(q / code)
    # MuJoCo's angles are ahead of the forces that moved them.
    told = step * every * np.arange(len(commands))
    stamps = [np.round(1e9 * t).astype(np.int64) for t in (told, told + lead(arm.model, step))]
    return Recording(
        joints=arm.robot.joint_names,
        link=Side(stamps[1], position=q),
        reference=Side(stamps[0], position=commands),
        source="MuJoCo",
    )


def _followed(
    arm: MjcfArm, controller: Controller, reference: tuple[Array, Array, Array], rate: float
) -> tuple[Array, Array, Array]:
    """Return angles, velocities and held torques (N, n) of the arm on its way along a reference."""
    mj = engine()
    model = arm.model
    q_ref, dq_ref, _ = reference
    forward = controller.feedforward(*reference)
    step = _step(arm, rate)
    substeps = round(1.0 / rate / step)
    data = mj.MjData(model)
    positions = arm.positions
    dofs = arm.dofs
    data.qpos[:] = arm.qpos
    data.qpos[positions] = q_ref[0]
    data.qvel[dofs] = dq_ref[0]
    q, dq, command = np.empty((3, len(q_ref), arm.robot.n))
    with without(model, "ACTUATION", timestep=step):
        for k in range(len(q_ref)):
            q[k] = data.qpos[positions]
            dq[k] = data.qvel[dofs]
            command[k] = forward[k] + controller.kp * (q_ref[k] - q[k])
            command[k] += controller.kd * (dq_ref[k] - dq[k])
            data.qfrc_applied[dofs] = command[k]
            for _ in range(substeps):
                mj.mj_step(model, data)
    if not (np.isfinite(q).all() and np.isfinite(dq).all()):
        raise SimulationError(
            "simulation diverged (NaN or infinity)", "Use a slower motion or a smaller timestep."
        )
    return q, dq, command


def _step(arm: MjcfArm, rate: float) -> float:
    """Return the time step, s: the model's, or shorter so that some make a sample interval."""
    return 1.0 / rate / max(1, int(np.ceil(1.0 / rate / arm.model.opt.timestep - 1e-9)))
