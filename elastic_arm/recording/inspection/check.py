"""What is wrong with a bag."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from elastic_arm.errors import RecordingError
from elastic_arm.recording.foreign.channels import ChannelMap
from elastic_arm.recording.inspection.described_gravity import contradicted_gravity
from elastic_arm.recording.inspection.magnitudes import beyond_limits
from elastic_arm.recording.inspection.outliers import find_outliers, without_outliers
from elastic_arm.recording.inspection.plausibility import implausible
from elastic_arm.recording.inspection.quality import moment, wrong_rate
from elastic_arm.recording.inspection.report import Report
from elastic_arm.recording.inspection.stuck_channels import clipped_torques, frozen, motionless, stuck
from elastic_arm.recording.namespaces import choose_namespace
from elastic_arm.recording.reading import Content, read_content, read_recording, urdf_joints
from elastic_arm.recording.series import Series
from elastic_arm.recording.sides import Stamps
from elastic_arm.recording.storage.bag import Bag, open_bag
from elastic_arm.recording.topics import JOINT_STATES, JOINT_TORQUES, MOTOR_STATES, REFERENCE, TYPES
from elastic_arm.robot import Robot

_STATES = (JOINT_STATES, MOTOR_STATES)
_GAP = 2.5  # sample intervals: more is a gap, not jitter
_JITTER = 0.05  # of the sample interval
_RATE_CHANGE = 0.2
_SAME_RATE = 0.01  # rates this close are meant to be equal
_DRIFT = 20e-6  # two good crystals differ by less


def check_bag(
    path: str | Path,
    channels: ChannelMap | None = None,
    robot: Robot | None = None,
    namespace: str | None = None,
) -> Report:
    """Look for everything that may be wrong with a bag.

    Parameters
    ----------
    path
        Bag folder, .mcap or .db3 file.
    channels
        A channel map, for a foreign bag.
    robot
        Whose names of joints and gravity to compare with.
    namespace
        Of the arm, where the bag holds several.

    Raises
    ------
    RecordingError
        If it is no bag at all, or empty.
    """
    report = Report(str(path))
    _check_messages(path, channels, None if robot is None else robot.joint_names, report, namespace)
    if report.usable:
        _check_whole(path, channels, robot, report, namespace)
    return report


def _check_messages(
    path: str | Path,
    channels: ChannelMap | None,
    joints: Sequence[str] | None,
    report: Report,
    namespace: str | None,
) -> None:
    """Add what the files of a bag and their messages show. They are closed behind it, as in `bag_info`."""
    bag = open_bag(path)
    wanted = (*_STATES, JOINT_TORQUES, REFERENCE) if channels is None else channels.topics()
    try:
        chosen = choose_namespace([bag], namespace) if channels is None else ""
        content = read_content([bag], wanted, strict=False, namespace=chosen)
    except RecordingError as error:
        report.add("error", "undecodable", str(error))
        return
    for damage in content.damage:
        missing = damage.endswith("metadata.yaml is missing")
        report.add(*(("warning", "missing_metadata") if missing else ("error", "damaged")), damage)
    for remark in bag.remarks():
        report.add("note", "unchecked", remark)
    _check_counts(bag, content, report)
    if not content.topics:
        report.add("error", "empty", "the bag holds no messages")
        return
    if channels is None:
        _check_topics(content, report, joints)
    for series in content.series.values():
        if series.count and (channels is not None or series.type_name == TYPES.get(series.topic)):
            _check_series(series, report)
    if channels is None:
        _check_drift(content, report)


def _check_whole(
    path: str | Path,
    channels: ChannelMap | None,
    robot: Robot | None,
    report: Report,
    namespace: str | None,
) -> None:
    """Add what reading refuses or remarks, and what no sensors of a moving arm measure."""
    try:
        joints = None if robot is None else robot.joint_names
        recording = read_recording(path, channels, joints, namespace=namespace)
        known = {finding.message for finding in report.findings}
        for note in (*recording.notes, *recording.samples().notes):
            if note not in known:
                report.add("note", "reading", note)
        for outliers in find_outliers(recording):
            report.add("warning", "outliers", f"outliers: {outliers.words()}: identify and diagnose leave them out")
        whole = without_outliers(recording)
        report.findings += [*motionless(whole), *stuck(whole), *frozen(recording), *clipped_torques(whole)]
        report.findings += implausible(whole)
        if robot is not None:
            report.findings += [*beyond_limits(whole, robot), *contradicted_gravity(whole, robot)]
    except RecordingError as error:
        report.add("error", "unusable", str(error))


def _check_counts(bag: Bag, content: Content, report: Report) -> None:
    promised = None if bag.metadata is None else bag.metadata.message_count
    if promised is not None and promised != content.messages:
        message = f"metadata.yaml promises {promised} messages, the files hold {content.messages}"
        report.add("error", "count", message)


def _check_topics(content: Content, report: Report, joints: Sequence[str] | None) -> None:
    for topic, series in content.series.items():
        if series.type_name != TYPES[topic]:
            report.add("error", "type", f"{topic} has type {series.type_name}, not {TYPES[topic]}", topic=topic)
    present = [topic for topic in _STATES if topic in content.series]
    if not present:
        topics = ", ".join(content.topics)
        message = f"neither {JOINT_STATES} nor {MOTOR_STATES} was recorded; there is {topics}"
        report.add("error", "no_joint_states", message)
    elif len(present) == 1:
        missing = next(topic for topic in _STATES if topic not in present)
        report.add("note", "one_side", f"{missing} was not recorded", topic=missing)
    known = list(joints) if joints is not None else urdf_joints(content.robot_description)
    for topic in present:
        series = content.series[topic]
        described, recorded = set(known), set(series.names())
        for name in [name for name in series.names() if known and name not in described]:
            message = f"{topic} names joint {name}, which the robot description does not have"
            report.add("error" if joints is not None else "warning", "unknown_joint", message, topic=topic, joint=name)
        for name in [name for name in known if joints is not None and name not in recorded]:
            report.add("error", "missing_joint", f"{topic} lacks joint {name}", topic=topic, joint=name)
        if not series.has("effort") and JOINT_TORQUES not in content.series:
            elsewhere = any(content.series[other].has("effort") for other in present)
            message = f"{topic} has no torques (effort is empty)"
            report.add("note" if elsewhere else "warning", "no_torque", message, topic=topic)


def _check_series(series: Series, report: Report) -> None:
    orders = {piece.names for piece in series.pieces}
    if len({frozenset(names) for names in orders}) > 1:
        sets = " | ".join(sorted({", ".join(names) for names in orders}))
        report.add(
            "warning", "joint_sets", f"{series.topic} holds messages of different joints: {sets}", topic=series.topic
        )
    elif len(orders) > 1:
        message = f"{series.topic} names its joints in {len(orders)} orders; they are matched by name"
        report.add("note", "joint_order", message, topic=series.topic)
    stamped = all(piece.stamp_ns is not None for piece in series.pieces)
    stamp_ns = series.stamp_ns if stamped else series.log_ns
    if not stamped:
        report.add("note", "no_stamps", f"{series.topic} has no header stamps", topic=series.topic)
    _check_numbers(series, stamp_ns, report)
    _check_times(series.topic, stamp_ns, report)


def _check_numbers(series: Series, stamp_ns: Stamps, report: Report) -> None:
    absent: dict[str, list[str]] = {}
    present = set()
    for name, joint, values in series.all_columns():
        bad = ~np.isfinite(values)
        where = {"topic": series.topic, "joint": joint}
        if np.isnan(values).all():
            absent.setdefault(name, []).append(joint)
            continue
        present.add(name)
        if bad.all():
            report.add("error", "nan", f"{series.topic}.{name} of {joint} is nowhere finite", **where)
        elif bad.any():
            first = int(np.argmax(bad))
            time = float((stamp_ns[first] - stamp_ns[0]) * 1e-9)
            words = f"{series.topic}.{name} of {joint} is not finite in {bad.sum()} samples"
            message = f"{words}, first at {moment(stamp_ns, first)}"
            report.add("error", "nan", message, time=time, **where)
        elif "effort" in name and not values.any():
            report.add("warning", "zero_torque", f"{series.topic}.{name} of {joint} is zero throughout", **where)
    for name, joints in absent.items():
        if name in present:
            # Not every joint needs an encoder on its link, or a torque sensor.
            message = f"{series.topic}.{name} is not there for {', '.join(joints)}"
            report.add("note", "absent_channel", message, topic=series.topic)
            continue
        for joint in joints:
            message = f"{series.topic}.{name} of {joint} is NaN throughout"
            report.add("warning", "nan_channel", message, topic=series.topic, joint=joint)


def _check_times(topic: str, stamp_ns: Stamps, report: Report) -> None:
    step = np.diff(stamp_ns)
    for code, bad, words in (
        ("backwards", step < 0, "jumps back in time"),
        ("duplicate", step == 0, "repeats a stamp"),
    ):
        if bad.any():
            first = int(np.argmax(bad))
            message = f"{topic} {words} {bad.sum()} times, first after {moment(stamp_ns, first)}"
            report.add("error", code, message, topic=topic, time=float((stamp_ns[first] - stamp_ns[0]) * 1e-9))
    forward = step[step > 0]
    if len(forward) < 10:
        report.add("warning", "short", f"{topic} has only {len(stamp_ns)} messages", topic=topic)
        return
    usual = float(np.median(forward))
    # A reference may hold few points.
    wrong = wrong_rate(1e9 / usual) if topic != REFERENCE else None
    if wrong is not None:
        report.add(
            "warning", "rate", f"{topic}: {wrong}: are the times in another unit than they were taken for?", topic=topic
        )
    gaps = np.flatnonzero(step > _GAP * usual)
    if len(gaps):
        longest = gaps[np.argmax(step[gaps])]
        message = (
            f"{topic} has {len(gaps)} gaps (about {int(np.sum(np.round(step[gaps] / usual) - 1))} samples lost), "
            f"the longest of {step[longest] * 1e-9:.4g} s after {moment(stamp_ns, int(longest))}"
        )
        report.add("warning", "gaps", message, topic=topic, time=float((stamp_ns[longest] - stamp_ns[0]) * 1e-9))
    _check_rate(topic, forward[forward <= _GAP * usual], report)


def _check_rate(topic: str, step: Stamps, report: Report) -> None:
    """Steps without gaps: do they spread, do they change?"""
    usual = float(np.median(step))
    parts = [float(np.median(part)) for part in np.array_split(step, min(10, len(step) // 5))]
    slow, fast = max(parts), min(parts)
    if slow > (1 + _RATE_CHANGE) * fast:
        message = f"{topic} has mixed rates: between {1e9 / slow:.6g} Hz and {1e9 / fast:.6g} Hz"
        report.add("warning", "mixed_rates", message, topic=topic)
    elif (spread := float(np.std(step))) > _JITTER * usual:
        message = f"{topic}: stamps jitter by {spread * 1e-3:.4g} us (std) at {1e9 / usual:.6g} Hz"
        report.add("note", "jitter", message, topic=topic)


def _check_drift(content: Content, report: Report) -> None:
    """Compare the clocks of the two sides: against the recorder's clock, and against each other's sample count."""
    both = [content.series[topic] for topic in _STATES if topic in content.series]
    if len(both) < 2 or any(series.type_name != TYPES[series.topic] or series.count < 100 for series in both):
        return
    rates = [_clock_rate(series.log_ns, series.stamp_ns) for series in both]
    steps = [_step(series.stamp_ns) for series in both]
    drift = rates[1] - rates[0]
    if abs(drift) <= _DRIFT and abs(steps[1] / steps[0] - 1) < _SAME_RATE:
        drift = steps[1] / steps[0] - 1
    duration = (both[0].stamp_ns[-1] - both[0].stamp_ns[0]) * 1e-9
    if abs(drift) > _DRIFT and abs(drift) * duration * 1e9 > 0.5 * steps[0]:
        message = (
            f"the clocks of {both[0].topic} and {both[1].topic} drift apart by {drift * 1e6:.4g} us a second, "
            f"{abs(drift) * duration * 1e3:.4g} ms over the recording"
        )
        report.add("warning", "drift", message, topic=both[1].topic)


def _clock_rate(log_ns: Stamps, stamp_ns: Stamps) -> float:
    """Slope of the stamps against the recorder's clock, less 1; from medians, as arrivals are late now and then."""
    log, ahead = (log_ns - log_ns[0]) * 1e-9, (stamp_ns - log_ns) * 1e-9
    third = len(log) // 3
    span = float(np.median(log[-third:]) - np.median(log[:third]))
    return float(np.median(ahead[-third:]) - np.median(ahead[:third])) / span if span > 0 else 0.0


def _step(stamp_ns: Stamps) -> float:
    """Mean sample interval without the gaps, ns; where a single sample is missing there are two."""
    step = np.diff(stamp_ns)
    forward = step[step > 0]
    if not len(forward):
        return float("nan")
    usual = np.median(forward)
    even = forward[forward <= _GAP * usual]
    return float(np.sum(even) / np.sum(np.maximum(np.rint(even / usual), 1.0)))
