"""Find faults of a bag: of its files, of what its readers correct or refuse, and of its numbers."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from elastic_arm.arrays import median_step
from elastic_arm.errors import RecordingError, RobotError
from elastic_arm.recording.foreign.channels import ChannelMap
from elastic_arm.recording.inspection.commands import followed
from elastic_arm.recording.inspection.described_gravity import contradicted, misread_channels
from elastic_arm.recording.inspection.magnitudes import beyond_limits, of_no_arm
from elastic_arm.recording.inspection.outliers import cleared, without_zeros
from elastic_arm.recording.inspection.percent import in_percent
from elastic_arm.recording.inspection.plausibility import implausible, in_degrees
from elastic_arm.recording.inspection.report import (
    REPAIR,
    Finding,
    Report,
    WrongMotion,
    moment,
    note,
    wrong_rate,
)
from elastic_arm.recording.inspection.side_motion import Motions, side_motions
from elastic_arm.recording.inspection.stuck_channels import channel_findings, frozen
from elastic_arm.recording.inspection.supply_voltage import other_supply
from elastic_arm.recording.inspection.two_encoders import disagreeing
from elastic_arm.recording.made_torque import is_commanded, joints_with_duty
from elastic_arm.recording.reading import Content, contents, recording_of, urdf_joints
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.series import Series
from elastic_arm.recording.sides import Stamps, matched_names
from elastic_arm.recording.storage.bag import open_bag
from elastic_arm.recording.timebase.clocks import RATE_CHANGE
from elastic_arm.recording.topics import (
    JOINT_STATES,
    JOINT_TORQUES,
    MOTOR_PWM,
    MOTOR_STATES,
    REFERENCE,
)
from elastic_arm.robot import Robot
from elastic_arm.robot.plausible import doubtful

CHECKED = 1_200_000  # messages of a part of a long bag: ten minutes of two topics at 1 kHz
_THROUGHOUT = ("short", "no_motion", "one_side")  # what nothing is wrong with in a part
# what is said of the first part that shows it, whichever joints move in the others
_ONCE = ("commands",)
_NUMBER = re.compile(r"(?<!\w)\d[\d.e+-]*")  # which findings of two parts may not share
_STATES = (JOINT_STATES, MOTOR_STATES)
_SIDES = {"link": JOINT_STATES, "motor": MOTOR_STATES, "reference": REFERENCE}
_GAP = 2.5  # sample intervals: more is a gap, not jitter
_LOST = 0.05  # share of the samples that nothing which follows misses: a convention
_JITTER = 0.05  # of the sample interval
_DRIFT = 20e-6  # two good crystals differ by less


def check_bag(
    path: str | Path,
    channels: ChannelMap | None = None,
    robot: Robot | None = None,
    namespace: str | None = None,
    report_share: Callable[[str, float], None] = lambda what, share: None,
) -> Report:
    """Find all faults of a bag: those that readers refuse or correct, and numbers that no arm
    produces.

    A long bag is checked in parts; a finding in a later part is reported with its time. The
    description is compared with the motions of all parts together.
    """
    report = Report(str(path))
    parts = list[Report]()
    motions = Motions()
    # What is no bag at all is no finding.
    open_bag(path)
    try:
        for content in contents(path, channels, namespace, strict=False, most=CHECKED):
            parts.append(_checked(content, channels, robot, motions))
            report_share(f"checking {path}", content.share)
        _check_content(content, report)
        for words in [] if robot is None else doubtful(robot):
            report.add("warning", "description", words)
    except RecordingError as error:
        report.add("error", "undecodable", str(error))
    report.findings += _together(parts)
    if robot is not None:
        report.findings += contradicted(motions, robot)
    return report


def _checked(
    content: Content, channels: ChannelMap | None, robot: Robot | None, motions: Motions
) -> Report:
    """Report what is wrong with a part of a bag, and add its motions."""
    report = Report(content.source)
    recording = _read(content, channels, robot, report)
    if recording is not None:
        if any(map(len, recording.measured().values())):
            report.begin_ns = recording.start_ns
        seen: set[bytes] = set()
        for name, side in without_zeros(recording, []).sides().items():
            if (stamps := side.stamp_ns.tobytes()) not in seen:
                seen.add(stamps)
                what = _SIDES[name] if channels is None else f"the {name} side"
                _check_stamps(what, side.stamp_ns, report)
        try:
            report.findings += looked_through(recording, robot, motions)
        except (RecordingError, RobotError) as error:
            report.add("error", "unusable", str(error))
    return report


def _together(parts: Sequence[Report]) -> Iterator[Finding]:
    """Yield what was found in parts of a bag, each in the first that has it; of the whole what all
    of them have."""
    seen = set[str]()
    codes = [{one.code for one in part.findings} for part in parts]
    every = set[str].intersection(*codes) if codes else set[str]()
    first = next((part.begin_ns for part in parts if part.begin_ns is not None), 0)
    for k, part in enumerate(parts):
        offset = ((part.begin_ns or first) - first) * 1e-9
        words = [
            one.code if one.code in _ONCE else _NUMBER.sub("", one.message) for one in part.findings
        ]
        for one, same in zip(part.findings, words, strict=True):
            if same not in seen and (one.code in every or one.code not in _THROUGHOUT):
                time = None if one.time is None else one.time + offset
                yield (
                    replace(one, message=f"from {offset:.0f} s: {one.message}", time=time)
                    if k
                    else one
                )
        seen.update(words)


def looked_through(
    recording: Recording, robot: Robot | None = None, motions: Motions | None = None
) -> list[Finding]:
    """Return what was done to use a recording, and what no sensor of an arm measures.

    What the description is to be compared with is added to `motions`.
    """
    whole, found = cleared(recording)
    found += [note(words) for words in whole.samples().notes if words not in recording.notes]
    seen = _seen(whole, recording, robot)
    if robot is not None and motions is not None and not _of_motion(seen):
        motions += side_motions(whole, robot)
    return found + seen


def doubts(recording: Recording, robot: Robot) -> list[str]:
    """Return in words what cannot be right of a recording to be fitted.

    Fits look for the mounting themselves.
    """
    whole = cleared(recording)[0]
    found = _seen(whole, recording, robot)
    if not _of_motion(found):
        found += contradicted([*side_motions(whole, robot)], robot)
    return [
        finding.message
        for finding in found
        if finding.severity == "warning" and finding.code != "mounting"
    ]


def misread(
    recordings: Sequence[Recording], robot: Robot, *, explained: bool = False
) -> str | None:
    """Return in words which channels are misread; None if there are none.

    The corrected arm is not written if there are any.

    explained: whether effects may explain missing gravity and encoders that disagree, as in a
    diagnosis.
    """
    for recording in recordings:
        whole = cleared(recording)[0]
        words = [] if explained else [finding.message for finding in disagreeing(whole)]
        words += in_degrees(whole)
        of_commands = len(joints_with_duty(whole)) < whole.n
        # Torques would be made of commands that no drive received.
        if of_commands and is_commanded(whole):
            words += [one.message for one in followed(whole) if one.code == "copied_command"]
        if not words and (read := misread_channels(whole, robot, weight=not explained)):
            words = [*_of_motion(_sizes(whole, recording, robot)), read]
        if words:
            return f"{recording.source}: {words[0]}"
    return None


def _seen(whole: Recording, recording: Recording, robot: Robot | None) -> list[Finding]:
    found = [
        *channel_findings(whole, robot),
        *frozen(recording),
        *implausible(whole),
        *disagreeing(whole),
        *followed(whole, robot),
    ]
    found += _sizes(whole, recording, robot)
    return found if robot is None else [*found, *other_supply(whole, robot)]


def _sizes(whole: Recording, recording: Recording, robot: Robot | None) -> list[Finding]:
    found = [*of_no_arm(whole), *in_percent(recording)]
    return found if robot is None else [*found, *beyond_limits(whole, robot)]


def _of_motion(findings: Sequence[Finding]) -> list[str]:
    """Return in words which findings make a comparison of the torques at these angles moot."""
    return [one.message for one in findings if isinstance(one, WrongMotion)]


def _read(
    content: Content, channels: ChannelMap | None, robot: Robot | None, report: Report
) -> Recording | None:
    """Return the recording as readers return it, None if they refuse it; their messages are added
    to the report."""
    joints = None if robot is None else robot.joint_names
    if channels is None:
        _check_names(content, report, joints)
    try:
        recording, found = recording_of(content, channels, joints)
    except RecordingError as error:
        report.add("error", "nan" if error.remedy == REPAIR else "unusable", str(error))
        return None
    report.findings += found
    if channels is None:
        _check_drift(content, report)
    return recording


def _check_content(content: Content, report: Report) -> None:
    for damage in content.damage:
        if damage.endswith("metadata.yaml is missing"):
            report.add("warning", "missing_metadata", damage)
        else:
            report.add("error", "damaged", damage)
    if content.promised is not None and content.promised != content.messages:
        message = (
            f"metadata.yaml lists {content.promised} messages, but the files contain"
            f" {content.messages}"
        )
        report.add("error", "count", message)
    if not content.topics:
        report.add("error", "empty", "the bag contains no messages")


def _check_names(content: Content, report: Report, joints: Sequence[str] | None) -> None:
    """Look at which topics there are, and which joints they name."""
    present = [topic for topic in _STATES if topic in content.series]
    if len(present) == 1:
        missing = next(topic for topic in _STATES if topic not in present)
        report.add("note", "one_side", f"{missing} was not recorded", topic=missing)
    known = list(joints) if joints is not None else urdf_joints(content.robot_description)
    for topic in present:
        series = content.series[topic]
        others = [name for name in series.names() if name not in set(known)]
        if known and others and matched_names(known, series.names()) != series.names():
            message = (
                f"{topic} contains joints that the robot description lacks: {', '.join(others)}"
            )
            report.add(
                "note" if joints is not None else "warning", "unknown_joint", message, topic=topic
            )
        orders = {piece.names for piece in series.pieces}
        if len(orders) > len(set(map(frozenset, orders))):
            message = f"{topic} lists its joints in several orders; they are matched by name"
            report.add("note", "joint_order", message, topic=topic)
        if not series.has("effort") and JOINT_TORQUES not in content.series:
            instead = [
                f"the torques of {other} are used"
                for other in present
                if content.series[other].has("effort")
            ]
            if MOTOR_PWM in content.series:
                instead.append(
                    f"the electrics of a `motor:` in the arm file make them of {MOTOR_PWM}"
                )
            if REFERENCE in content.series:
                instead.append("a `controller:` in the arm file computes them from the commands")
            message = ": ".join([f"{topic} has no torques (effort is empty)", *instead[:1]])
            report.add("note" if instead else "warning", "no_torque", message, topic=topic)


def _check_stamps(topic: str, stamp_ns: Stamps, report: Report) -> None:
    """Look at the stamps of a side for gaps, and rates that are odd, change or spread."""
    step = np.diff(stamp_ns)
    if len(step) < 10:
        report.add("warning", "short", f"{topic} has only {len(stamp_ns)} messages", topic=topic)
        return
    usual = float(np.median(step))
    # A reference may hold few points.
    wrong = wrong_rate(1e9 / usual) if topic != REFERENCE else None
    if wrong is not None:
        message = f"{topic}: {wrong}: are the times in another unit?"
        report.add("warning", "rate", message, topic=topic)
    gaps = np.flatnonzero(step > _GAP * usual)
    if len(gaps):
        longest = gaps[np.argmax(step[gaps])]
        count = len(gaps)
        lost = int(np.sum(np.round(step[gaps] / usual) - 1))
        message = (
            f"{topic} has {count} {'gap' if count == 1 else 'gaps'} (about {lost} samples lost), "
            f"the longest of {step[longest] * 1e-9:.4g} s after {moment(stamp_ns, int(longest))}"
        )
        # Readers bridge short gaps, and take what is before and after a long one as two parts.
        few = lost < _LOST * len(stamp_ns)
        at = float((stamp_ns[longest] - stamp_ns[0]) * 1e-9)
        report.add("note" if few else "warning", "gaps", message, topic=topic, time=at)
    even = step[step <= _GAP * usual]
    usual = float(np.median(even))
    parts = [float(np.median(part)) for part in np.array_split(even, min(10, len(even) // 5))]
    slow = max(parts)
    fast = min(parts)
    if slow > (1 + RATE_CHANGE) * fast:
        message = f"{topic} has mixed rates: between {1e9 / slow:.6g} Hz and {1e9 / fast:.6g} Hz"
        report.add("warning", "mixed_rates", message, topic=topic)
    elif (spread := float(np.std(even))) > _JITTER * usual:
        message = f"{topic}: stamps jitter by {spread * 1e-3:.4g} us (std) at {1e9 / usual:.6g} Hz"
        report.add("note", "jitter", message, topic=topic)


def _check_drift(content: Content, report: Report) -> None:
    """Compare the clocks of the two sides: against the recorder's clock, and against each other's
    sample count."""
    both = [content.series[topic] for topic in _STATES if topic in content.series]
    if len(both) < 2 or any(len(series.stamp_ns) < 100 for series in both):
        return
    drift = _clock_rate(both[1]) - _clock_rate(both[0])
    steps = [median_step(series.stamp_ns) for series in both]
    rates = [_counted_interval(series.stamp_ns) for series in both]
    # rates this close are meant to be equal
    if abs(drift) <= _DRIFT and abs(rates[1] / rates[0] - 1) < 0.01:
        drift = rates[1] / rates[0] - 1
    duration = (both[0].stamp_ns[-1] - both[0].stamp_ns[0]) * 1e-9
    if abs(drift) > _DRIFT and abs(drift) * duration * 1e9 > 0.5 * steps[0]:
        message = (
            f"the clocks of {both[0].topic} and {both[1].topic} drift apart by"
            f" {drift * 1e6:.4g} us per second, {abs(drift) * duration * 1e3:.4g}"
            " ms over the recording"
        )
        report.add("warning", "drift", message, topic=both[1].topic)


def _counted_interval(stamp_ns: Stamps) -> float:
    """Return the interval between samples, ns: the slope of the stamps over the sample numbers,
    which include lost samples."""
    step = np.diff(stamp_ns)
    number = np.concatenate([[0.0], np.cumsum(np.round(step / np.median(step)))])
    return float(np.polyfit(number - number.mean(), stamp_ns - stamp_ns.mean(), 1)[0])


def _clock_rate(series: Series) -> float:
    """Return the slope of the stamps over the clock of the recorder, minus 1; from medians, because
    messages sometimes arrive late."""
    log = (series.log_ns - series.log_ns[0]) * 1e-9
    ahead = (series.stamp_ns - series.log_ns) * 1e-9
    third = len(log) // 3
    span = float(np.median(log[-third:]) - np.median(log[:third]))
    return float(np.median(ahead[-third:]) - np.median(ahead[:third])) / span if span > 0 else 0.0
