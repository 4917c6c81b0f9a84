"""The interchange type: a recording of an arm, real or simulated."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy

from elastic_arm.errors import RecordingError, require_kind
from elastic_arm.recording.sides import (
    Array,
    ClockMode,
    Samples,
    Side,
    Stamps,
    joined_sides,
    joints_with,
    listed,
    matched_names,
)
from elastic_arm.recording.timebase.joining import join
from elastic_arm.recording.topics import OF_MOTOR
from elastic_arm.robot import JointController


@dataclass(frozen=True, repr=False)
class Recording:
    """A recording of an arm, real or simulated.

    Parameters
    ----------
    joints
        Names, in robot-description order: the columns of every channel.
    link, motor
        The two sides of the joints: (q, dq, tau_J) and (theta, dtheta, tau_m); None where not
        recorded.
    reference
        The commanded motion, with acceleration; None where not recorded.
    robot_description
        URDF text, None where not recorded.
    source
        The source: a file or folder, or "simulation".
    notes
        Assumptions and corrections of the reader.
    clock
        Meaning of the stamps if the user knows it, "regular" or "stamps"; None if inferred from
        the motion.
    currents
        The torque channels, of "joint_torque" and "motor_torque", that are motor currents times a
        torque constant.
    made_by
        Joint -> controller from which its motor torque was computed; the reference is then the
        input of the drives: the command, or in the mode "duty" the share of full duty. Empty if
        torques were measured.
    firmware_gains
        Joint -> number in its servo's register of the position gain during the recording. Empty
        where it is the one that the description states.
    read_ns
        (M,) stamps at which torques were read if they are recorded more often; None otherwise.
    """

    joints: tuple[str, ...]
    link: Side | None = None
    motor: Side | None = None
    reference: Side | None = None
    robot_description: str | None = None
    source: str = ""
    notes: tuple[str, ...] = ()
    clock: ClockMode | None = None
    currents: tuple[str, ...] = ()
    made_by: Mapping[str, JointController] = field(default_factory=dict)
    firmware_gains: Mapping[str, float] = field(default_factory=dict)
    read_ns: Stamps | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", tuple(self.joints))
        object.__setattr__(self, "notes", tuple(self.notes))
        for side_name, side in self.sides().items():
            for channel, values in side.channels().items():
                if values.shape[1] != self.n:
                    raise RecordingError(
                        f"{side_name} {channel} has {values.shape[1]} columns for {self.n} joints",
                        "Give one column per joint.",
                    )
            for channel in sorted(OF_MOTOR.keys() & side.channels()):
                if side_name != "motor":
                    raise RecordingError(
                        f"{side_name} has a {channel}",
                        "It is of motors: give it to the motor side.",
                    )
        self._check_duty()

    def _check_duty(self) -> None:
        """Raise a RecordingError if a motor has both a torque and a duty."""
        motor = self.motor
        if motor is None or motor.effort is None or motor.pwm is None:
            return
        both = joints_with(motor.effort) & joints_with(motor.pwm)
        if both.any():
            raise RecordingError(
                f"{listed(self.joints, both)}: both effort and pwm of the motor",
                "Give the effort if it is a measured torque, otherwise pwm.",
            )

    def __repr__(self) -> str:
        sides = self.sides().items()
        channels = ", ".join(
            f"{name}.{channel}" for name, side in sides for channel in side.channels()
        )
        samples = (
            f"{max((len(side) for _, side in sides), default=0)} samples of {channels or 'nothing'}"
        )
        return f"<Recording {self.source}: {', '.join(self.joints)}; {samples}>"

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    def sides(self) -> dict[str, Side]:
        """Return the sides that were recorded, by name."""
        named = {"link": self.link, "motor": self.motor, "reference": self.reference}
        return {name: side for name, side in named.items() if side is not None}

    def measured(self) -> dict[str, Side]:
        """Return the measured sides by name, without the reference."""
        return {name: side for name, side in self.sides().items() if name != "reference"}

    @property
    def start_ns(self) -> int:
        """First stamp of the link and motor sides."""
        return min(int(side.stamp_ns[0]) for side in self._measured())

    @property
    def duration(self) -> float:
        """Seconds between the first and the last stamp of the link and motor sides."""
        return (max(int(side.stamp_ns[-1]) for side in self._measured()) - self.start_ns) * 1e-9

    def samples(self) -> Samples:
        """Bring both sides to one time base.

        See :func:`elastic_arm.recording.timebase.joining.join`.
        """
        try:
            for side_name, side in self.measured().items():
                if not (side.stamp_ns[1:] > side.stamp_ns[:-1]).all():
                    problem = f"the stamps of {side_name} do not increase"
                    raise RecordingError(problem, "Give every stamp once, in order.")
            self._require_positions()
            samples = replace(join(self.link, self.motor, self.clock), clock=self.clock)
            if self.read_ns is not None:
                samples = replace(
                    samples, read=np.asarray((self.read_ns - samples.stamp_ns[0]) * 1e-9)
                )
            return self._with_followed(samples) if self.made_by else samples
        except RecordingError as error:
            raise RecordingError(
                f"{self.source or 'the recording'}: {error.problem}", error.remedy
            ) from None

    def _require_positions(self) -> None:
        """Refuse joints without positions beside joints that have them."""
        positions = [one.position for one in self.measured().values() if one.position is not None]
        if not positions or not all(map(len, positions)):
            return
        there = np.any([joints_with(values) for values in positions], axis=0)
        if not there.all():
            raise RecordingError(
                f"no positions of {listed(self.joints, ~there)} were recorded on either side",
                "Record them, or give a description of only the recorded joints: --robot.",
            )

    def moved(self, by_ns: int) -> Recording:
        """Return the recording shifted in time."""
        sides: dict[str, Any] = {
            k: replace(side, stamp_ns=side.stamp_ns + by_ns) for k, side in self.sides().items()
        }
        words = (
            f"{self.source}: the clock was set back: later stamps are shifted by"
            f" {by_ns * 1e-9:.4g} s"
        )
        return replace(self, **sides, notes=(*self.notes, words))

    def between(self, begin: float, end: float) -> Recording:
        """Return the part from `begin` to before `end`, in seconds from :attr:`start_ns`."""
        first = self.start_ns + round(begin * 1e9)
        last = self.start_ns + round(end * 1e9)
        cut: dict[str, Any] = {
            name: side.at(slice(*np.searchsorted(side.stamp_ns, (first, last))))
            for name, side in self.sides().items()
        }
        return replace(self, **cut)

    @staticmethod
    def joined(parts: Sequence[Recording]) -> Recording:
        """Return consecutive parts of one recording as one, with their common channels."""
        if len(parts) == 1:
            return parts[0]
        together: dict[str, Any] = {}
        for name in parts[0].sides():
            # A side that is empty in some part is left out.
            sides = [side for part in parts if (side := part.sides().get(name))]
            together[name] = joined_sides(sides) if len(sides) == len(parts) else None
        notes = tuple(dict.fromkeys(note for part in parts for note in part.notes))
        return replace(parts[-1], **together, notes=notes)

    def select(self, joints: Sequence[str]) -> Recording:
        """Return the recording with the columns of `joints`, in that order."""
        called = matched_names(joints, self.joints)
        if called is None:
            unknown = [name for name in joints if name not in self.joints]
            raise RecordingError(
                f"{self.source or 'the recording'} has no joint {', '.join(unknown)}; it has"
                f" {', '.join(self.joints)}",
                "Use a robot description with these joint names, or give the names in a channel map"
                " (--channels).",
            )
        if tuple(joints) == self.joints:
            return self
        other = (
            f"{', '.join(called)} match {', '.join(joints)} after removing the common part"
            " of the names"
        )
        notes = self.notes if called == list(joints) else (*self.notes, other)
        columns = [self.joints.index(name) for name in called]
        cut: dict[str, Any] = {}
        for name, side in self.sides().items():
            channels = {channel: values[:, columns] for channel, values in side.channels().items()}
            cut[name] = Side(side.stamp_ns, **channels)
        gains = {
            name: self.firmware_gains[own]
            for name, own in zip(joints, called, strict=True)
            if own in self.firmware_gains
        }
        return replace(self, joints=tuple(joints), notes=notes, firmware_gains=gains, **cut)

    def _with_followed(self, samples: Samples) -> Samples:
        """Return samples with what the drives follow; joints whose torque was measured lack it."""
        r = self._followed(samples.stamp_ns)
        others = {("r", j) for j, name in enumerate(self.joints) if name not in self.made_by}
        return replace(samples, r=np.nan_to_num(r), lacking=samples.lacking | others)

    def _followed(self, stamp_ns: Stamps) -> Array:
        """Return the command (N, n) at other stamps."""
        reference = self.reference
        assert reference is not None and reference.position is not None
        if np.array_equal(stamp_ns, reference.stamp_ns):
            return reference.position
        t = np.asarray(stamp_ns - reference.stamp_ns[0]) * 1e-9
        known = np.asarray(reference.stamp_ns - reference.stamp_ns[0]) * 1e-9
        return scipy.interpolate.CubicSpline(known, reference.position)(t)

    def _measured(self) -> list[Side]:
        measured = [side for side in self.measured().values() if len(side)]
        if not measured:
            raise RecordingError(
                f"{self.source or 'the recording'} contains no samples of the arm",
                "Record /joint_states or /motor_states, or both.",
            )
        return measured


def recordings_of(given: object, name: str = "recordings") -> list[Recording]:
    """Return what was given as recordings, one or several, as a list."""
    several: Iterable[Any] = (
        given if isinstance(given, Iterable) and not isinstance(given, str | bytes) else [given]
    )
    found = []
    for one in several:
        require_kind(
            one, Recording, name, RecordingError, "Give the result of read_recording or simulate."
        )
        found.append(one)
    return found
