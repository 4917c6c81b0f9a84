"""Compute the motor torque from recorded commands and states with the described controller, for
recordings without torques.

    tau_m = limit(kp (r(t - d) - q) + kd (dr(t - d) - dq) + ki int(r - q) + feed-forward)

If the controller has a dead band, it is subtracted from the error r - q to which kp applies. If a
servo states its electrics, everything except the damping is within the limit of its duty, reduced
by the sag of its supply.

Cubic splines give the angles between samples. A held command is the mean, over the last interval
between commands, of the motion whose samples are the commands: within the band, this equals
holding.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline, PPoly

from elastic_arm.dynamics import build_model
from elastic_arm.errors import RobotError
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, Side, joints_with, listed
from elastic_arm.robot import JointController, Robot

FINER = 8  # instants in a sample interval, over which a torque sample is the mean
FEWEST = 12  # samples and commands of which anything is made


def is_commanded(recording: Recording) -> bool:
    """Return whether a recording contains positions and commands but no torque."""
    measured = recording.measured().values()
    reference = recording.reference
    if (
        reference is None
        or len(reference) < FEWEST
        or (reference.position is None and reference.velocity is None)
    ):
        return False
    moved = any(side.position is not None and len(side) >= FEWEST for side in measured)
    return moved and all(side.effort is None for side in measured)


def at_common_gain(robot: Robot, recordings: Sequence[Recording]) -> Robot:
    """Return an arm whose servos state the firmware gain to which their kp belongs.

    If the description does not state it, it is the common firmware gain of all recordings whose
    torques are computed.

    Raises a RobotError if these recordings have different gains.
    """
    for joint in robot.joints:
        stated = joint.controller
        commanded = [one.firmware_gains for one in recordings if is_commanded(one)]
        own = [gains for gains in commanded if joint.name in gains]
        gains = sorted({gains[joint.name] for gains in own})
        if stated is None or stated.firmware_gain is not None or not gains:
            continue
        if len(gains) > 1:
            listed_gains = " and ".join(f"{gain:g}" for gain in gains)
            raise RobotError(
                f"the recordings have the firmware gains {listed_gains} at {joint.name}, and the"
                " description does not state the one to which its kp belongs",
                "State it: `firmware_gain` of the controller in an arm file, or <numeric"
                f' name="firmware_gain:{joint.name}" data="{gains[0]:g}"/> in <custom> of an MJCF',
            )
        known = replace(stated, firmware_gain=gains[0])
        robot = robot.with_joint(joint.name, controller=known)
    return robot


def with_made_torque(recording: Recording, robot: Robot) -> Recording:
    """Return a recording with motor torques that the described controllers compute from commands
    and positions.

    Any other recording is returned unchanged. The reference becomes the command as the drives
    receive it, at the stamps of the positions; samples before the first command and after the last
    one are removed.
    """
    side = recording.motor
    if side is None or side.position is None:
        side = recording.link
    reference = recording.reference
    stated = {joint.name: joint.controller for joint in robot.joints}
    if not is_commanded(recording) or reference is None or side is None or side.position is None:
        return recording
    there = joints_with(side.position)
    made: dict[str, JointController] = {}
    for i, name in enumerate(recording.joints):
        controller = stated.get(name)
        if controller is not None and there[i] and _is_told(reference, controller, i):
            limit = robot.joints[robot.joint_names.index(name)].most_torque
            own = controller.with_firmware_gain(recording.firmware_gains.get(name))
            made[name] = replace(own, torque=limit)
    if not made:
        return recording
    given = (reference.stamp_ns - reference.stamp_ns[0]) * 1e-9
    t = (side.stamp_ns - reference.stamp_ns[0]) * 1e-9
    first = max(own.delay for own in made.values()) + float(np.median(np.diff(given)))
    known = (t >= first) & (t <= given[-1])
    t = t[known]
    angles = side.position[known]
    stamps = side.stamp_ns[known]
    r, torque = np.full((2, *angles.shape), np.nan)
    commands: dict[int, _Command] = {}
    for name, own in made.items():
        i = recording.joints.index(name)
        commands[i] = _Command(reference, given, i, own, angles[0, i])
        r[:, i] = commands[i](t)[0]
    forward = _fed_forward(robot, t, np.where(np.isnan(r), angles, r), list(made.values()))
    for name, own in made.items():
        i = recording.joints.index(name)
        fed = forward[own.feedforward][:, i]
        torque[:, i] = _torque(own, commands[i], t, angles[:, i], fed)
    cut: dict[str, Side] = {}
    for name, one in recording.measured().items():
        cut[name] = one.at(np.isin(one.stamp_ns, stamps))
    motor = cut["motor"] if side is recording.motor else Side(stamps)
    whose = listed(recording.joints, [name in made for name in recording.joints])
    note = (
        "no torque was recorded: the described controllers give the torques of"
        f" {whose} from commands and positions, and estimates of torques, masses and"
        " friction scale with their gains"
    )
    return replace(
        recording,
        link=cut.get("link"),
        motor=replace(motor, effort=torque),
        reference=Side(stamps, position=r),
        made_by=made,
        notes=(*recording.notes, f"{recording.source or 'the recording'}: {note}"),
    )


def _is_told(reference: Side, controller: JointController, i: int) -> bool:
    """Return whether the commands contain the quantities that a controller follows."""
    needed = reference.velocity if controller.mode == "velocity" else reference.position
    return needed is not None and bool(joints_with(needed)[i])


class _Command:
    """The command of a joint over time, as its controller receives it."""

    def __init__(
        self, reference: Side, given: Array, i: int, controller: JointController, start: float
    ) -> None:
        def spline(values: Array | None) -> PPoly | None:
            there = values is not None and not np.isnan(values[:, i]).any()
            return CubicSpline(given, values[:, i]) if there and values is not None else None

        angle = spline(reference.position)
        rate = spline(reference.velocity)
        self._delay = controller.delay
        self._interval = float(np.median(np.diff(given)))
        self._held = controller.between == "held"
        self._begin = 0.0
        if controller.mode == "velocity":
            assert rate is not None
            # the integral of the error begins with none
            angle = rate.antiderivative()
            self._begin = start
        assert angle is not None
        self._splines = angle, angle.derivative() if rate is None else rate

    def __call__(self, t: Array) -> tuple[Array, Array]:
        """Return angle and rate, as they are followed at times t."""
        t = t - self._delay
        if not self._held:
            angle, rate = (spline(t) for spline in self._splines)
        else:
            sums = [spline.antiderivative() for spline in self._splines]
            angle, rate = (
                (total(t) - total(t - self._interval)) / self._interval for total in sums
            )
        return angle + self._begin, rate


def _torque(
    controller: JointController, command: _Command, t: Array, angle: Array, forward: Array
) -> Array:
    """Return the torque (N,) of a joint, Nm; each sample is the mean over its interval."""
    kp, kd, ki = controller.gains
    limit = np.inf if controller.torque is None else controller.torque
    q = CubicSpline(t, angle)
    step = float(np.median(np.diff(t)))
    at = t[:, None] + step * ((np.arange(FINER) + 0.5) / FINER - 0.5)
    r, dr = command(at)
    error = r - q(at)
    felt = error - np.clip(error, -controller.dead_band, controller.dead_band)
    asked = kp * felt + forward[:, None]
    if ki:
        asked += ki * CubicSpline(t, command(t)[0] - angle).antiderivative()(at)
    torque = controller.supplied(asked) + kd * (controller.follows_rate * dr - q(at, 1))
    return np.asarray(np.clip(torque, -limit, limit).mean(axis=1))


def _fed_forward(
    robot: Robot, t: Array, r: Array, controllers: list[JointController]
) -> dict[str, Array]:
    """Return the feed-forward torque of the named kind for a command (N, n), Nm, as if link and
    motor moved together."""
    found = {"none": np.zeros_like(r)}
    if all(controller.feedforward == "none" for controller in controllers):
        return found
    model = build_model(robot)
    spline = CubicSpline(t, r)
    for name, share in (("gravity", 0.0), ("model", 1.0)):
        motion = (r, share * spline(t, 1), share * spline(t, 2))
        sides = model.inverse_dynamics(*(np.hstack([x, x]) if robot.elastic else x for x in motion))
        found[name] = sides.reshape(len(t), -1, robot.n).sum(axis=1)
    return found
