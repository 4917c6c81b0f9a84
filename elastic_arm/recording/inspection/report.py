"""Findings about a recording, and faults that make it unusable: times that do not increase,
non-finite numbers."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from elastic_arm.arrays import Mask
from elastic_arm.errors import RecordingError, one_line
from elastic_arm.recording.sides import Side, Stamps, joints_with, listed

FEWEST = 200  # samples; of fewer nothing is concluded
REPAIR = "Write a usable copy with: elastic-arm bag check --repair BAG"
# Samples a second. A fifth of them is the band in which an arm is looked at, and the motion of none
# ends below 1 Hz; no drive is read out faster than the other. Beyond either the times have another
# unit than they are taken for.
SLOWEST = 5.0
FASTEST = 50_000.0
UNIT = (
    "Are the times in another unit? Give it (s, ms, us, ns) in the map, and"
    " import the recording again."
)
ARRIVAL = (
    "Use the arrival times: --clock arrival in `identify` and `diagnose`, 'time:"
    " arrival' in a channel map."
)
DOUBLE = (
    "Write them as 64-bit numbers (float64), or as seconds since the first"
    " sample; or give {rate: Hz} as times in the map."
)
Severity = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class Finding:
    """Something found in a bag or a recording."""

    # "error": it cannot be used as it is; "warning": it can, with less accuracy; "note": good to
    # know
    severity: Severity
    code: str  # A word for scripts
    message: str  # For people
    topic: str | None = None  # Where, as far as it is of one place; seconds from the first sample
    joint: str | None = None
    time: float | None = None

    def __post_init__(self) -> None:
        # Names come out of bags.
        object.__setattr__(self, "message", one_line(self.message))


class WrongMotion(Finding):
    """A finding that recorded angles are no motion of the arm: their unit, or that of the times, is
    wrong. What torques at such angles show is only a consequence."""


def note(message: str, code: str = "reading") -> Finding:
    """Return a note about an assumption."""
    return Finding("note", code, message)


def warning(code: str, message: str, remedy: str = "") -> Finding:
    """Return a warning with its remedy."""
    return Finding("warning", code, f"{message}: {remedy}" if remedy else message)


def about(
    joints: Sequence[str],
    chosen: Mask,
    code: str,
    what: str,
    words: str,
    remedy: str = "",
    severity: Severity = "warning",
    kind: type[Finding] = Finding,
) -> list[Finding]:
    """Return a finding about a channel of the chosen joints (n,), if there are any."""
    if not chosen.any():
        return []
    message = f"{what} of {listed(joints, chosen)} {words}"
    return [kind(severity, code, f"{message}: {remedy}" if remedy else message)]


@dataclass
class Report:
    """All findings about a bag."""

    path: str
    findings: list[Finding] = field(default_factory=list)
    begin_ns: int | None = None  # of what was looked at

    @property
    def ok(self) -> bool:
        """Whether no finding is worse than a note."""
        return all(finding.severity == "note" for finding in self.findings)

    @property
    def usable(self) -> bool:
        """Whether the bag can be read and used, possibly with less accuracy."""
        return all(finding.severity != "error" for finding in self.findings)

    def add(self, severity: Severity, code: str, message: str, **where: Any) -> None:
        """Add a finding with its topic, joint and time."""
        self.findings.append(Finding(severity, code, message, **where))

    def to_json(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "path": self.path,
            "ok": self.ok,
            "findings": [asdict(finding) for finding in self.findings],
        }


def checked(side: Side, topic: str, joints: Sequence[str]) -> Side:
    """Return `side` if its times increase and its numbers are finite.

    Joints without a channel contain NaN throughout.
    """
    check_times(side.stamp_ns, topic)
    faults = []
    for name, values in side.channels().items():
        # One sum finds any NaN or infinity in a pass; only then is it worth looking where.
        with np.errstate(over="ignore"):
            total = values.sum()
        if np.isfinite(total) or np.isfinite(values).all():
            continue
        bad = ~np.isfinite(values)
        bad = bad & joints_with(values) if joints_with(values).any() else bad
        for j in np.flatnonzero(bad.any(axis=0)).tolist():
            row = int(np.argmax(bad[:, j]))
            many = f" and in {bad[:, j].sum() - 1} other samples" if bad[:, j].sum() > 1 else ""
            faults.append(
                f"{name} of {joints[j]} is {values[row, j]} at {moment(side.stamp_ns, row)}{many}"
            )
    if faults:
        raise RecordingError(f"{topic}: {'; '.join(faults)}", REPAIR)
    return side


def check_times(stamp_ns: Stamps, topic: str) -> None:
    """Raise an error if there are no stamps, or they are repeated or decrease."""
    if not len(stamp_ns):
        raise RecordingError(
            f"{topic} has no messages", "Record again, with the publisher running."
        )
    if (stamp_ns[1:] > stamp_ns[:-1]).all():
        return
    check_stamped(stamp_ns, topic)
    step = np.diff(stamp_ns)
    at = int(np.argmax(step <= 0))
    if step[at] == 0:
        raise RecordingError(f"{topic} repeats the stamp of {moment(stamp_ns, at)}", REPAIR)
    problem = f"{topic} jumps back in time by {-step[at] * 1e-9:.6g} s after {moment(stamp_ns, at)}"
    raise RecordingError(problem, REPAIR)


def check_stamped(stamp_ns: Stamps, topic: str) -> None:
    """Raise an error if all stamps are equal."""
    if (step := single_precision(stamp_ns)) is not None:
        problem = (
            f"{topic}: times since 1970 in single precision (float32), or with too few digits,"
            f" have a resolution of {step:.3g} s or more"
        )
        raise RecordingError(problem, DOUBLE)
    if len(stamp_ns) > 1 and (stamp_ns == stamp_ns[0]).all():
        raise RecordingError(
            f"{topic}: all {len(stamp_ns)} header stamps are equal ({stamp_ns[0]} ns)", ARRIVAL
        )


def single_precision(stamp_ns: Stamps) -> float | None:
    """Return the step, s, of stamps that were rounded to 32 bits; None for others.

    Seconds since 1970 then have steps of 128 s, milliseconds of 131 s, and seconds since the start
    of a computer of some ms.
    """
    different = np.unique(stamp_ns)
    # Times of day and of a run are small; a log whose every sample has a time of its own lost
    # nothing.
    if len(stamp_ns) < 3 or different[-1] < 1e17 or 2 * len(different) > len(stamp_ns):
        return None
    for unit in (10**9, 10**6, 10**3, 1):
        rounded = (different / unit).astype(np.float32)
        if np.array_equal(different, np.round(rounded.astype(np.float64) * unit)):
            return float(np.spacing(rounded[-1])) * unit * 1e-9
    return None


def wrong_rate(rate: float) -> str | None:
    """Return in words the fault of a sample rate, Hz; None if it is plausible."""
    if SLOWEST <= rate <= FASTEST:
        return None
    much = "few to show" if rate < SLOWEST else "many for"
    return (
        f"{rate:.3g} samples per second, according to the stamps, are too {much} the"
        " motion of an arm"
    )


def moment(stamp_ns: Stamps, row: int) -> str:
    """Return the time of a sample: from the beginning, and as a stamp."""
    seconds, nanoseconds = divmod(int(stamp_ns[row]), 1_000_000_000)
    return f"{(stamp_ns[row] - stamp_ns[0]) * 1e-9:.6f} s (stamp {seconds}.{nanoseconds:09d})"
