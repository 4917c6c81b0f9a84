"""A commanded arm in closed loop: MuJoCo's servos follow the recorded commands from the recorded
state.

    e(t_k) = q(t_k; x_0, r) - q_k

    t_k stamps of the positions q_k, r commands, held until the next

The state x_0 is that of the recording at the start of the simulation: angles, and their rates from
a polynomial through neighbouring samples; the commands on their way to a delayed actuator; the
content of its filter; and the integral of a controller with one, fitted to the first second. The
simulation starts when commands are known for the longest delay of an actuator.
"""

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from elastic_arm.arrays import Array, Indices, Mask
from elastic_arm.mujoco.friction_by_step import acting_by_step, laws_beside, with_laws
from elastic_arm.recording import Recording
from elastic_arm.robot import JointController, Robot
from elastic_arm.robot.mjcf import MjcfArm, engine
from elastic_arm.robot.mjcf.drives import (
    controller_of,
    drives_of,
    follows_angles,
    set_controller,
)

SETTLED = 1.0  # s, over which the integral that a recording begins with is fitted
AROUND = 0.03  # s on either side of a sample, within which samples tell its rate
FEWEST = 5  # samples of which a rate is told
PUNCTUAL = 1e-3  # of a time step: a command that is due now is not late by rounding
Span = tuple[float, float]  # s from the start of a recording


@dataclass(frozen=True)
class StartState:
    """What a motion begins with, (n,) each: angles rad, rates rad/s, integrals of the error of
    position rad s."""

    angles: Array
    rates: Array
    integrals: Array

    @staticmethod
    def at_rest(angles: Array) -> "StartState":
        """Return the state of an arm that stands."""
        return StartState(angles, np.zeros_like(angles), np.zeros_like(angles))


@dataclass(frozen=True)
class Play:
    """A recording as one model plays it: errors of angles at the stamps."""

    t: Array  # (N,) s from the first command
    errors: Array  # (N, n) rad, or m of joints that slide
    resolution: Array  # (n,) the smallest step between recorded positions
    motion: "Motion"

    def after(self, seconds: float) -> "Play":
        """Return it without what it begins with."""
        kept = self.t >= self.t[0] + seconds
        return replace(self, t=self.t[kept], errors=self.errors[kept])


@dataclass(frozen=True)
class Motion:
    """What a model did: K time steps of it."""

    t: Array  # (K + 1,) s, as of a play
    angles: Array  # (K + 1, n) rad
    commands: Array  # (K, n) that were given over each step, rad


def play(
    arm: MjcfArm, recording: Recording, *, span: Span | None = None, late: float = 0.0
) -> Play | None:
    """Play a recording's commands by a model's servos, and compare angles with the recorded ones.

    span: which part is played, the whole when None; late: s for which commands have to be known
    before, if more than the model's own delays are. None where there are no commands, positions or
    servos, or nothing is left to play.
    """
    reference = recording.reference
    side = recording.link if recording.link is not None else recording.motor
    if reference is None or reference.position is None or side is None or side.position is None:
        return None
    if not has_servos(arm) or not len(reference) or not np.isfinite(reference.position).all():
        return None
    arm = at_gains(arm, recording.firmware_gains)
    given = np.asarray(reference.stamp_ns - reference.stamp_ns[0], dtype=float) * 1e-9
    t = np.asarray(side.stamp_ns - reference.stamp_ns[0], dtype=float) * 1e-9
    begin, end = (-np.inf, np.inf) if span is None else span
    offset = 1e-9 * float(recording.start_ns - reference.stamp_ns[0])
    whole = np.isfinite(side.position).all(axis=1)
    first = max(float(given[0]) + max(late, latest(arm)), begin + offset)
    played = np.flatnonzero(
        whole & (t >= first - 1e-9) & (t <= min(float(given[-1]), end + offset))
    )
    if len(played) < FEWEST:
        return None
    start = int(played[0])
    step = float(arm.model.opt.timestep)
    count = int(np.ceil((t[played[-1]] - t[start]) / step)) + 1
    followed = _commands(arm, given, reference.position)
    commands = followed(t[start] + step * np.arange(count))
    before = followed(t[start] - step * np.arange(_history(arm.model), 0, -1))
    known = t[whole], side.position[whole]
    state = _state(known, t[start], lead(arm.model, step))
    if _integrating(arm).any():
        state = _settled(arm, state, commands, before, known, t[start])
    found = servo_motion(arm, state, commands, before)
    times = t[start] + step * np.arange(count + 1)
    motion = Motion(times, np.vstack([state.angles[None], found]), commands)
    angles = interpolated(t[played], times, motion.angles)
    moved = np.abs(np.diff(side.position[whole], axis=0))
    smallest = np.min(np.where(moved > 0.0, moved, np.inf), axis=0, initial=np.inf)
    resolution = np.where(np.isfinite(smallest), smallest, 0.0)
    return Play(t[played], angles - side.position[played], resolution, motion)


def has_servos(arm: MjcfArm) -> bool:
    """Whether every joint has one actuator, which follows angles."""
    drives = [drives_of(arm.model, joint) for joint in arm.chain.joints]
    return all(len(own) == 1 and follows_angles(arm.model, own[0]) for own in drives)


def with_controllers(arm: MjcfArm, robot: Robot) -> MjcfArm:
    """Return a model that has of an arm what no number of a file states.

    Set-points are made as the arm's controllers make them, beyond what actuators have: a dead band,
    an integral, a supply that sags, the limit of the duty, and whether commands are held. Laws of
    friction act as the friction loss of each time step.
    """
    own = arm.robot
    for joint, stated in zip(arm.robot.joints, robot.joints, strict=True):
        drive = joint.controller
        wanted = stated.controller
        if drive is None or wanted is None or wanted.mode != "position":
            continue
        names = ("dead_band", "ki", "between", "stall", "sag", "firmware_gain")
        beside = replace(drive, **{name: getattr(wanted, name) for name in names})
        own = own.with_joint(joint.name, controller=beside)
    return with_laws(replace(arm, robot=own), laws_beside(arm, robot))


def at_gains(arm: MjcfArm, gains: Mapping[str, float]) -> MjcfArm:
    """Return a model whose servos have other numbers in their registers of the position gain."""
    if not gains:
        return arm
    model = copy.copy(arm.model)
    robot = robot_at_gains(arm.robot, gains)
    for place, before, after in zip(arm.chain.joints, arm.robot.joints, robot.joints, strict=True):
        if before.controller is not None and after.controller is not None:
            (actuator,) = drives_of(model, place)
            set_controller(model, actuator, before.controller, after.controller)
    return replace(arm, model=model, robot=robot)


def robot_at_gains(robot: Robot, gains: Mapping[str, float]) -> Robot:
    """Return an arm whose servos have other numbers in their registers of the position gain."""
    joints = []
    for joint in robot.joints:
        now = joint.controller
        if now is not None:
            now = now.with_firmware_gain(gains.get(joint.name))
        joints.append(replace(joint, controller=now))
    return robot.with_(joints=tuple(joints))


def latest(arm: MjcfArm) -> float:
    """Return the longest delay of the arm's actuators, s."""
    actuators = [drives_of(arm.model, joint)[0] for joint in arm.chain.joints]
    return float(np.max(arm.model.actuator_delay[actuators], initial=0.0))


def lead(model: Any, step: float) -> float:
    """Return by how much MuJoCo's angles are ahead of its velocities, s: half a time step, as it
    steps these first."""
    return 0.0 if model.opt.integrator == engine().mjtIntegrator.mjINT_RK4 else 0.5 * step


def servo_motion(
    arm: MjcfArm, start: StartState, commands: Array, before: Array | None = None
) -> Array:
    """Return the angles (K, n) after each time step of the model, under commands (K, n).

    before: (H, n) commands of the time steps before, of which late actuators take theirs; the first
    one when None.
    """
    # Delays, and friction by step, are changed in the model while it moves: others may use it.
    arm = replace(arm, model=copy.copy(arm.model))
    mj = engine()
    model = arm.model
    before = commands[:1] if before is None or not len(before) else before
    data = _started(arm, start, before)
    given = _inputs(arm)
    with _punctual(model):
        if not plays_by_step(arm):
            return _rolled_out(arm, data, given, commands)
        integral = start.integrals.copy()
        step = float(model.opt.timestep)
        hold = held(arm)
        found = np.empty_like(commands)
        rub = acting_by_step(arm, arm.laws)
        set_points = _set_points(arm)
        positions = arm.positions
        for k, command in enumerate(commands):
            angles = data.qpos[positions]
            data.ctrl[given] = set_points(command, angles, integral)
            integral += step * (command - angles)
            rub(data)
            mj.mj_step(model, data)
            hold(data)
            found[k] = data.qpos[positions]
    return found


def _set_points(arm: MjcfArm) -> Callable[[Array, Array, Array], Array]:
    """Return what makes the set-points (n,) that actuators are given of commands, angles and
    integrals of the error (n,).

    They hold what an actuator has not: a dead band, an integral, a supply that sags.
    """
    drives = [joint.controller or JointController() for joint in arm.robot.joints]
    dead_band = _dead_bands(arm)
    integrating = _beside(arm)
    kp = np.array([drive.kp or 1.0 for drive in drives])
    limited = [drive.stall is not None for drive in drives]

    def at(command: Array, angles: Array, integral: Array) -> Array:
        error = command - angles
        wanted = command - np.clip(error, -dead_band, dead_band) + integrating * integral
        if not any(limited):
            return np.asarray(wanted)
        asked = kp * (wanted - angles)
        pairs = zip(drives, asked, strict=True)
        made = np.array([drive.supplied(torque) for drive, torque in pairs])
        return np.where(limited, angles + made / kp, wanted)

    return at


def plays_by_step(arm: MjcfArm) -> bool:
    """Whether something acts between time steps that MuJoCo does not do itself."""
    others = np.setdiff1d(np.arange(arm.model.nv), arm.dofs)
    beside = bool(beside_actuators(arm).any() or arm.laws)
    return bool(len(others)) or beside or engine().get_mjcb_passive() is not None


def beside_actuators(arm: MjcfArm) -> Mask:
    """Return the joints (n,) whose set-points hold what their actuators have not: a dead band, an
    integral, a supply that sags."""
    return (_dead_bands(arm) > 0.0) | (_beside(arm) > 0.0) | _sagging(arm)


def held(arm: MjcfArm) -> Callable[[Any], None]:
    """Return what puts joints outside the chain back after a step."""
    model = arm.model
    other_q = np.setdiff1d(np.arange(model.nq), arm.positions)
    other_v = np.setdiff1d(np.arange(model.nv), arm.dofs)

    def hold(data: Any) -> None:
        if len(other_v):
            data.qpos[other_q] = arm.qpos[other_q]
            data.qvel[other_v] = 0.0

    return hold


def _rolled_out(arm: MjcfArm, data: Any, given: Indices, commands: Array) -> Array:
    from mujoco import rollout

    mj = engine()
    model = arm.model
    kind = mj.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mj.mj_stateSize(model, kind))
    mj.mj_getState(model, data, state, kind)
    control = np.zeros((1, len(commands), len(data.ctrl)))
    control[0][:, given] = commands
    states, _ = rollout.rollout(model, data, state[None], control)
    return states[0][:, 1 + arm.positions]  # the time first


def _inputs(arm: MjcfArm) -> Indices:
    """Return where each joint's set-point of the angle stands among the controls: the first of an
    actuator's inputs."""
    actuators = [drives_of(arm.model, joint)[0] for joint in arm.chain.joints]
    return np.asarray(arm.model.actuator_ctrladr, dtype=np.intp)[actuators]


def _started(arm: MjcfArm, start: StartState, before: Array) -> Any:
    """Return MuJoCo's data in a state, with commands (H, n) on their way to late actuators."""
    mj = engine()
    model = arm.model
    data = mj.MjData(model)
    data.qpos[:] = arm.qpos
    data.qpos[arm.positions] = start.angles
    data.qvel[arm.dofs] = start.rates
    step = float(model.opt.timestep)
    for i, joint in enumerate(arm.chain.joints):
        (actuator,) = drives_of(model, joint)
        samples = int(model.actuator_history[actuator, 0])
        if samples:
            known = before[-samples:, i]
            values = np.concatenate([np.full(samples - len(known), known[0]), known])
            inputs = np.zeros((samples, int(model.actuator_ctrlnum[actuator])))
            inputs[:, 0] = values
            mj.mj_initCtrlHistory(
                model, data, actuator, -step * np.arange(samples, 0.0, -1.0), inputs
            )
        if int(model.actuator_actnum[actuator]):
            data.act[int(model.actuator_actadr[actuator])] = _activation(
                arm, i, actuator, start, before
            )
    return data


def _activation(arm: MjcfArm, i: int, actuator: int, start: StartState, before: Array) -> float:
    """Return what an actuator holds at the start: an integral of the error, an angle, or a filtered
    command."""
    mj = engine()
    model = arm.model
    if int(model.actuator_gaintype[actuator]) == int(mj.mjtGain.mjGAIN_PID):
        return float(start.integrals[i])
    if int(model.actuator_dyntype[actuator]) == int(mj.mjtDyn.mjDYN_INTEGRATOR):
        return float(start.angles[i])
    due = round(float(model.actuator_delay[actuator]) / float(model.opt.timestep)) + 1
    return float(before[max(0, len(before) - due), i])


def _dead_bands(arm: MjcfArm) -> Array:
    """Return the dead bands of the controllers, (n,) rad."""
    return np.array(
        [joint.controller.dead_band if joint.controller else 0.0 for joint in arm.robot.joints]
    )


def _beside(arm: MjcfArm) -> Array:
    """Return ki / kp of what is integrated beside the actuators, (n,) 1/s."""
    drives = [joint.controller or JointController() for joint in arm.robot.joints]
    return np.array(
        [drive.ki / drive.kp if drive.mode == "position" and drive.kp else 0.0 for drive in drives]
    )


def _sagging(arm: MjcfArm) -> Mask:
    """Return the joints (n,) whose set-points hold their supply: one that sags, or the limit of a
    duty that the actuator has not."""
    found = np.zeros(arm.robot.n, dtype=bool)
    for i, (joint, place) in enumerate(zip(arm.robot.joints, arm.chain.joints, strict=True)):
        drive = joint.controller
        own = controller_of(arm.model, place)
        if drive is not None and drive.stall is not None:
            found[i] = bool(drive.sag) or own is None or own.stall is None
    return found


def _integrating(arm: MjcfArm) -> Mask:
    """Return which joints (n,) have an integral of the error, beside their actuators or in them."""
    pid = int(engine().mjtGain.mjGAIN_PID)
    actuators = [drives_of(arm.model, joint)[0] for joint in arm.chain.joints]
    inside = np.asarray(arm.model.actuator_gaintype)[actuators] == pid
    return inside | (_beside(arm) > 0.0)


@contextmanager
def _punctual(model: Any) -> Iterator[None]:
    """Take rounding out of the delays of actuators: whole time steps are met to the step."""
    own = np.array(model.actuator_delay)
    rounding = PUNCTUAL * float(model.opt.timestep)
    model.actuator_delay[:] = np.where(own > rounding, own - rounding, own)
    try:
        yield
    finally:
        model.actuator_delay[:] = own


def _history(model: Any) -> int:
    """Return how many commands the actuators keep at most."""
    return int(np.max(model.actuator_history[:, 0], initial=0)) + 1


def _commands(arm: MjcfArm, given: Array, values: Array) -> Callable[[Array], Array]:
    """Return what gives the commands (K, n) that act over the time steps from angles at times (K,)
    on.

    The torques of a step stand for those of an interval as long as it: half a step before and after
    its angles, or all of it behind them with RK4. Of commands that change within it, the one in its
    middle acts, so that none acts half a step late on average.
    """
    step = float(arm.model.opt.timestep)
    middle = 0.5 * step - lead(arm.model, step)
    drives = [joint.controller or JointController() for joint in arm.robot.joints]
    is_held = [drive.between == "held" for drive in drives]

    def at(times: Array) -> Array:
        # A stamp that is rounded to a nanosecond still counts at its step.
        last = np.clip(np.searchsorted(given, times + middle + 1e-6, side="right") - 1, 0, None)
        if all(is_held):
            return values[last]
        between = interpolated(times + middle, given, values)
        return np.where(is_held, values[last], between)

    return at


def _state(known: tuple[Array, Array], at: float, behind: float) -> StartState:
    """Return the state at a sample: its angle, and its rate by a polynomial through the samples
    around it."""
    t, angles = known
    near = np.flatnonzero(np.abs(t - at) <= AROUND + 1e-9)
    if len(near) < FEWEST:
        near = np.sort(np.argsort(np.abs(t - at), kind="stable")[:FEWEST])
    degree = 3 if len(near) > FEWEST + 1 else 2
    scale = float(np.ptp(t[near]))
    powers = np.vander((t[near] - at) / scale, degree + 1, increasing=True)
    coefficients = np.linalg.lstsq(powers, angles[near], rcond=None)[0]
    rates = (coefficients[1] - 2.0 * coefficients[2] * behind / scale) / scale
    return StartState(coefficients[0], rates, np.zeros(angles.shape[1]))


def _settled(
    arm: MjcfArm,
    state: StartState,
    commands: Array,
    before: Array,
    known: tuple[Array, Array],
    at: float,
) -> StartState:
    """Return the state with the integrals with which the first second is followed best."""
    step = float(arm.model.opt.timestep)
    first = commands[: max(1, round(SETTLED / step))]
    times = np.asarray(at + step * np.arange(1, len(first) + 1), dtype=np.float64)
    wanted = interpolated(times, *known)
    found = state.integrals.copy()
    which = np.flatnonzero(_integrating(arm))
    size = 0.01  # rad s: the motion is linear in an integral, but for limits
    for _ in range(2):
        here = servo_motion(arm, replace(state, integrals=found), first, before)
        columns = []
        for i in which:
            moved = found.copy()
            moved[i] += size
            there = servo_motion(arm, replace(state, integrals=moved), first, before)
            columns.append((there - here).ravel() / size)
        change = np.linalg.lstsq(np.stack(columns, axis=1), (wanted - here).ravel(), rcond=None)[0]
        found[which] += change
    return replace(state, integrals=found)


def interpolated(at: Array, t: Array, values: Array) -> Array:
    """Return values (K, n) at times t (K,) at others (N,)."""
    columns: Sequence[Array] = [np.interp(at, t, column) for column in values.T]
    return np.stack(columns, axis=1)
