"""Find angles and speeds that no moving arm has, or that are far beyond the limits of its
description.

They indicate a wrong unit: degrees instead of radians, millimetres instead of metres.
"""

import numpy as np

from elastic_arm.arrays import Mask, median_step, rms
from elastic_arm.recording.inspection.plausibility import is_motion
from elastic_arm.recording.inspection.report import FEWEST, Finding, WrongMotion, about
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, Stamps, joints_with, listed, span_of
from elastic_arm.robot import Joint, Robot

# rad/s and Nm, root mean square over a recording: of the fastest servos, of the largest arms, of a
# finger's servo.
FASTEST_JOINT = 30.0
STRONGEST = 5e4
WEAKEST = 1e-4


def hardly_usable(recording: Recording) -> list[str]:
    """Return in words why a whole recording cannot be used.

    It has too few samples, or joints without a position.
    """
    sides = recording.measured()
    words = []
    count = min((len(side) for side in sides.values()), default=0)
    if count < FEWEST:
        words.append(f"only {count} samples: at least {FEWEST} are necessary for any conclusion")
    have = np.zeros(len(recording.joints), np.bool_)
    for side in sides.values():
        have |= False if side.position is None else joints_with(side.position)
    if not have.all():
        which = "any joint" if not have.any() else listed(recording.joints, ~have)
        words.append(
            f"no position of {which}, of link or motor: identification and diagnosis need one"
        )
    return words


def of_no_arm(recording: Recording) -> list[Finding]:
    """Return speeds and torques that no arm has, because their unit is wrong."""
    findings = []
    joints = recording.joints
    for name, side in recording.measured().items():
        if len(side) < FEWEST:
            continue
        times = (side.stamp_ns - side.stamp_ns[0]) * 1e-9
        # What goes to and fro from sample to sample is no motion in any unit.
        if side.position is not None and not is_motion(times, np.nan_to_num(side.position)):
            continue
        moved = None if side.position is None else _advance(side.position, side.stamp_ns)
        what, speeds = (
            ("velocity", side.velocity) if side.velocity is not None else ("position", moved)
        )
        if speeds is not None:
            fast = _size(speeds) > FASTEST_JOINT
            words = (
                f"reaches {span_of(_size(speeds)[fast])} rad/s (root mean square), above the"
                f" {FASTEST_JOINT:g} rad/s of any arm"
            )
            remedy = (
                "degrees taken as radians, a rotor without its ratio, or times in another unit?"
            )
            # A velocity may have another unit than the angle.
            of_angle = moved is not None and bool((_size(moved) > FASTEST_JOINT)[fast].any())
            kind = WrongMotion if of_angle else Finding
            findings += about(joints, fast, "no_arm", f"{name} {what}", words, remedy, kind=kind)
        if side.effort is not None:
            size = _size(side.effort)
            for odd, hint in (
                (size > STRONGEST, "counts of a register, or Nmm taken as Nm?"),
                (
                    (size < WEAKEST) & (size > 0.0),
                    "kNm taken as Nm, or a fraction of the maximum torque?",
                ),
            ):
                words = (
                    f"is {span_of(size[odd])} Nm (root mean square), outside the range"
                    f" of any arm, {WEAKEST:g} to {STRONGEST:g} Nm"
                )
                findings += about(joints, odd, "no_arm", f"{name} effort", words, hint)
    return findings


def _advance(position: Array, stamp_ns: Stamps) -> Array:
    """Return the rates of positions (N, n) over 0.1 s, in which angles advance beyond noise."""
    step = median_step(stamp_ns) * 1e-9
    width = min(max(round(0.1 / max(step, 1e-9)), 1), len(position) - 1)
    seconds = (stamp_ns[width:] - stamp_ns[:-width])[:, None] * 1e-9
    return (position[width:] - position[:-width]) / seconds


def _size(values: Array) -> Array:
    """Return the root mean square (n,) of values (N, n); zero for a joint without them."""
    return np.nan_to_num(rms(values))


def beyond_limits(recording: Recording, robot: Robot) -> list[Finding]:
    """Return which angles and speeds are far beyond the limits of the description."""
    findings = []
    for name, side in recording.select(robot.joint_names).measured().items():
        if len(side) >= FEWEST and side.position is not None:
            findings += _positions(name, side.position, robot)
        if len(side) >= FEWEST and side.velocity is not None:
            findings += _speeds(name, side.velocity, robot)
    return findings


def _positions(name: str, position: Array, robot: Robot) -> list[Finding]:
    ends = np.stack([position.min(axis=0), position.max(axis=0)], axis=1)
    found = joints_with(position) & [
        not _within(joint, *own) for joint, own in zip(robot.joints, ends, strict=True)
    ]
    if not found.any():
        return []
    j = int(np.argmax(np.where(found, np.ptp(ends, axis=1), -np.inf)))
    limits = robot.joints[j].limits
    low, high = ends[j]
    words = (
        f"exceeds the limits of the description: {robot.joint_names[j]} moves from"
        f" {low:.3g} to {high:.3g} {robot.joints[j].unit('rad')}, its limits are"
        f" {limits.position_min or 0.0:.3g} to {limits.position_max or 0.0:.3g}"
    )
    units, what = _other_units(robot, found)
    fit = [
        _within(joint, *own / unit)
        for joint, own, unit in zip(robot.joints, ends, units, strict=True)
    ]
    kind = Finding
    remedy = "check units, columns and zeros (offset)"
    # Less than the smaller of both units a motion is off by its zero.
    if np.all(np.array(fit)[found]) and (
        np.abs(ends[j]).max() > 5.0 * max(map(abs, _range(robot.joints[j])))
    ):
        remedy = (
            f"after division by {span_of(units[found])} all are within: check the unit ({what})"
        )
        kind = WrongMotion
    what = f"{name} position"
    return about(robot.joint_names, found, "beyond_limits", what, words, remedy, kind=kind)


def _range(joint: Joint) -> tuple[float, float]:
    least = joint.limits.position_min
    most = joint.limits.position_max
    return (-np.inf, np.inf) if least is None or most is None else (least, most)


def _within(joint: Joint, low: float, high: float) -> bool:
    """Return whether a joint stays within its limits, or would if its angle were shifted by whole
    turns."""
    least, most = _range(joint)
    if np.isinf(least):
        return True
    # 0.1 of a joint's range: more than a zero, or a limit, that is set a little otherwise
    more = 0.1 * (most - least)
    turns = 0.0
    if not joint.prismatic:
        off = 0.5 * (least + most - low - high)
        turns = 2 * np.pi * round(off / (2 * np.pi))
    return bool(least - more <= low + turns and high + turns <= most + more)


def _speeds(name: str, velocity: Array, robot: Robot) -> list[Finding]:
    """Check the root mean square of the velocities; for a joint that always moves at its limit it
    equals the limit."""
    limit = np.array([joint.limits.velocity or np.inf for joint in robot.joints])
    share = rms(velocity) / limit
    found = share > 3.0  # 3.0 times the limit of the velocity; controllers may pass that a little
    if not found.any():
        return []
    units, what = _other_units(robot, found)
    times = f"is {span_of(share[found])} times the limit of the description (root mean square)"
    remedy = (
        f"check the unit ({what})"
        if share[found].max() < units[found].max()
        else "check units and columns"
    )
    return about(robot.joint_names, found, "beyond_limits", f"{name} velocity", times, remedy)


def _other_units(robot: Robot, found: Mask) -> tuple[Array, str]:
    """Return the factor (n,) by which positions are too large in the most frequently mistaken unit,
    and that unit."""
    slides = np.array([joint.prismatic for joint in robot.joints])
    words = {False: "degrees taken as radians", True: "millimetres taken as metres"}
    return np.where(slides, 1000.0, 180.0 / np.pi), " and ".join(
        words[kind] for kind in sorted(set(slides[found]))
    )
