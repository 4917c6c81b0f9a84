"""Compute the motor torque of recordings without torques: from the recorded duty with the described
electrics, or from recorded commands and states with the described controller.

    tau_m = stall u (1 - sag |u|) - kd dq,   u the duty, times recorded over stated supply voltage

    tau_m = limit(kp (r(t - d) - q) + kd (dr(t - d) - dq) + ki int(r - q) + feed-forward)

If the controller has a dead band, it is subtracted from the error r - q to which kp applies. If a
servo states its electrics, everything except the damping is within the limit of its duty, reduced
by the sag of its supply.

Cubic splines give the angles between samples. A held command is the mean, over the last interval
between commands, of the motion whose samples are the commands: within the band, this equals
holding.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline, PPoly

from elastic_arm.arrays import median_step
from elastic_arm.dynamics import build_model
from elastic_arm.errors import RecordingError, RobotError
from elastic_arm.recording.inspection.report import Finding
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, Side, joints_with, listed
from elastic_arm.recording.timebase.joining import pair
from elastic_arm.robot import Joint, JointController, Robot

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
        if not stated.kp and not stated.ki:  # whose duty alone is used
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


def joints_with_duty(recording: Recording) -> tuple[str, ...]:
    """Return the names of the joints whose duty was recorded."""
    motor = recording.motor
    if motor is None or motor.pwm is None:
        return ()
    pairs = zip(recording.joints, joints_with(motor.pwm), strict=True)
    return tuple(name for name, there in pairs if there)


def with_recorded_duty(robot: Robot, recordings: Sequence[Recording]) -> Robot:
    """Return an arm whose joints follow their duty where all recordings contain it.

    Raises a RecordingError if some recordings contain the duty of a joint and others do not, and a
    RobotError if the description states no electrics of such a joint.
    """
    each = [set(joints_with_duty(one)) for one in recordings]
    for joint in robot.joints:
        there = [joint.name in names for names in each]
        if not any(there):
            continue
        if not all(there):
            with_it = recordings[there.index(True)].source or "a recording"
            without = recordings[there.index(False)].source or "another recording"
            raise RecordingError(
                f"{with_it} contains the pwm of {joint.name}, but {without} does not",
                "Map pwm for all recordings, or leave it out of all",
            )
        robot = robot.with_joint(joint.name, controller=_electrics(joint))
    return robot


def _electrics(joint: Joint) -> JointController:
    """Return what makes a torque of the duty of a joint."""
    stated = joint.controller
    if stated is None or stated.stall is None:
        raise RobotError(
            f"the pwm of {joint.name} was recorded, but the description states no electrics of its"
            " motor, which make a torque of it",
            f"State `controller: {{{joint.name}: {{motor: ...}}}}` in the arm file, or a <dcmotor>"
            " in the MJCF (docs/servo_arm.md), or leave pwm out",
        )
    return stated.of_duty()


def with_made_torque(recording: Recording, robot: Robot) -> Recording:
    """Return a recording with motor torques where only the duty, or commands and positions, were
    recorded.

    The described electrics compute them from the duty, and the described controllers from commands
    and positions. Any other recording is returned unchanged. The reference becomes the command as
    the drives receive it, or their duty, at the stamps of the positions; samples before the first
    command and after the last one are removed.

    Raises a RobotError if the description states no electrics of a joint whose duty was recorded.
    """
    recording = _with_duty_at_positions(recording)
    side = _with_positions(recording)
    if side is None or side.position is None:
        return recording
    driven = _driven(recording, robot, side)
    commanded = _commanded(recording, robot, side, driven)
    made = commanded | driven
    if not made:
        return recording
    reference = recording.reference
    # Without commands there is no other origin.
    origin = side.stamp_ns[0] if reference is None or not commanded else reference.stamp_ns[0]
    t = (side.stamp_ns - origin) * 1e-9
    known = np.ones(len(t), np.bool_)
    given = np.empty(0)
    if commanded:
        assert reference is not None
        given = (reference.stamp_ns - origin) * 1e-9
        latest = max(own.delay for own in commanded.values())
        known = (t >= latest + median_step(given)) & (t <= given[-1])
    t = t[known]
    angles = side.position[known]
    stamps = side.stamp_ns[known]
    cut = {
        name: one.at(np.isin(one.stamp_ns, stamps)) for name, one in recording.measured().items()
    }
    has_motor = side is recording.motor or bool(driven)
    motor = cut["motor"] if has_motor else Side(stamps)
    r = np.full(angles.shape, np.nan)
    torque = np.full(angles.shape, np.nan) if motor.effort is None else motor.effort.copy()
    voltages = _voltages(motor, recording.joints, driven)
    for name, own in driven.items():
        i = recording.joints.index(name)
        assert motor.pwm is not None
        r[:, i] = motor.pwm[:, i]
        if name in voltages:
            r[:, i] *= voltages[name]
        speed = CubicSpline(t, angles[:, i])(t, 1)
        torque[:, i] = own.supplied(own.gains[0] * r[:, i]) - own.kd * speed
    if reference is not None:
        _add_commanded(recording, robot, commanded, (given, t, angles), (r, torque))
    where = recording.source or "the recording"
    notes = [
        f"{where}: {words}" for words in _made_words(recording.joints, commanded, driven, voltages)
    ]
    return replace(
        recording,
        link=cut.get("link"),
        motor=replace(motor, effort=torque, pwm=None, supply=None),
        reference=Side(stamps, position=r),
        made_by=made,
        notes=(*recording.notes, *notes),
    )


def _with_positions(recording: Recording) -> Side | None:
    """Return the motor side if it has positions, otherwise the link side."""
    motor = recording.motor
    return recording.link if motor is None or motor.position is None else motor


def _with_duty_at_positions(recording: Recording) -> Recording:
    """Return a recording whose duty is at the stamps of its positions."""
    link = recording.link
    motor = recording.motor
    if link is None or motor is None or motor.pwm is None or motor.position is not None:
        return recording
    found: list[Finding] = []
    link, motor = pair(link, motor, "the duty", "the positions", found, recording.clock)
    words = [finding.message for finding in found]
    return replace(recording, link=link, motor=motor, notes=(*recording.notes, *words))


def _driven(recording: Recording, robot: Robot, side: Side) -> dict[str, JointController]:
    """Return the electrics of the joints whose duty was recorded."""
    assert side.position is not None
    there = joints_with(side.position)
    names = joints_with_duty(recording)
    return {
        joint.name: _electrics(joint)
        for joint in robot.joints
        if joint.name in names and there[recording.joints.index(joint.name)]
    }


def _voltages(
    motor: Side, joints: Sequence[str], driven: Mapping[str, JointController]
) -> dict[str, Array]:
    """Return the recorded supply voltages over the stated ones (N,), of joints that have both."""
    if motor.supply is None:
        return {}
    there = joints_with(motor.supply)
    found = {}
    for name, own in driven.items():
        i = joints.index(name)
        if there[i] and own.supply is not None:
            found[name] = motor.supply[:, i] / own.supply
    return found


def _commanded(
    recording: Recording, robot: Robot, side: Side, driven: Collection[str]
) -> dict[str, JointController]:
    """Return the controllers of the other joints that make torques of recorded commands."""
    reference = recording.reference
    if reference is None or side.position is None or not is_commanded(recording):
        return {}
    stated = {joint.name: joint.controller for joint in robot.joints}
    there = joints_with(side.position)
    made = {}
    for i, name in enumerate(recording.joints):
        controller = stated.get(name)
        if controller is None or name in driven:
            continue
        # Electrics without a gain of the firmware make nothing of commands.
        if controller.stall is not None and not controller.kp:
            continue
        if there[i] and _is_told(reference, controller, i):
            limit = robot.joints[robot.joint_names.index(name)].most_torque
            own = controller.with_firmware_gain(recording.firmware_gains.get(name))
            made[name] = replace(own, torque=limit)
    return made


def _add_commanded(
    recording: Recording,
    robot: Robot,
    commanded: Mapping[str, JointController],
    times_and_angles: tuple[Array, Array, Array],
    inputs_and_torques: tuple[Array, Array],
) -> None:
    """Fill in commands (N, n) as the drives receive them, and the torques (N, n) Nm made of them.

    times_and_angles: of the commands, (M,) s; of the positions, (N,) s; and these, (N, n) rad.
    """
    given, t, angles = times_and_angles
    r, torque = inputs_and_torques
    reference = recording.reference
    if reference is None or not commanded:
        return
    commands: dict[int, _Command] = {}
    for name, own in commanded.items():
        i = recording.joints.index(name)
        commands[i] = _Command(reference, given, i, own, angles[0, i])
        r[:, i] = commands[i](t)[0]
    followed = angles.copy()
    followed[:, list(commands)] = r[:, list(commands)]
    forward = _fed_forward(robot, t, followed, list(commanded.values()))
    for name, own in commanded.items():
        i = recording.joints.index(name)
        fed = forward[own.feedforward][:, i]
        torque[:, i] = _torque(own, commands[i], t, angles[:, i], fed)


def _made_words(
    joints: Sequence[str],
    commanded: Collection[str],
    driven: Collection[str],
    voltages: Collection[str],
) -> Iterator[str]:
    """Yield notes on whose torques were computed, and of what."""
    if driven:
        whose = listed(joints, [name in driven for name in joints])
        yield (
            f"the torques of {whose} are those that the described electrics make of the recorded"
            " duty (pwm) and the speed: estimates of torques, masses and friction scale with the"
            " supply voltage and the torque per volt"
        )
    if voltages:
        whose = listed(joints, [name in voltages for name in joints])
        yield f"the duty of {whose} is one of the recorded supply voltage, not of the stated one"
    if commanded:
        whose = listed(joints, [name in commanded for name in joints])
        yield (
            "no torque was recorded: the described controllers give the torques of"
            f" {whose} from commands and positions, and estimates of torques, masses and"
            " friction scale with their gains"
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
        self._interval = median_step(given)
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
    step = median_step(t)
    at = t[:, None] + step * ((np.arange(FINER) + 0.5) / FINER - 0.5)
    r, dr = command(at)
    error = r - q(at)
    felt = error - np.clip(error, -controller.dead_band, controller.dead_band)
    asked = kp * felt + forward[:, None]
    if ki:
        asked += ki * CubicSpline(t, command(t)[0] - angle).antiderivative()(at)
    torque = controller.supplied(asked) + kd * (controller.follows_rate * dr - q(at, 1))
    return np.clip(torque, -limit, limit).mean(axis=1)


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
