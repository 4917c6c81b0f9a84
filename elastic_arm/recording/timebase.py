"""Both sides of the joints on one time base."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from elastic_arm.errors import RecordingError
from elastic_arm.recording.sides import Array, Samples, Side, Stamps

# Two topics stamped by one clock tick share nearly all their stamps, apart from lost messages; below this share they
# are stamped apart and have to be interpolated.
COMMON_SHARE = 0.9
# A spline over a longer hole than this many sample intervals would invent motion.
LONGEST_GAP = 4.0


def join(link: Side | None, motor: Side | None) -> Samples:
    """Bring both sides to one time base.

    Samples with equal stamps are joined exactly; where the two topics are stamped apart, the motor side is
    interpolated to the link side's stamps by a cubic spline (never beyond its ends or across its gaps).

    Raises
    ------
    RecordingError
        If neither side was recorded, or the two do not overlap in time.
    """
    if link is None or motor is None:
        only = link if link is not None else motor
        if only is None or not len(only):
            raise RecordingError(
                "no samples of the arm",
                "Record /joint_states or /motor_states, or both.",
            )
        return _samples(only.stamp_ns, link, motor, ())
    common, of_link, of_motor = np.intersect1d(link.stamp_ns, motor.stamp_ns, assume_unique=True, return_indices=True)
    if len(common) >= COMMON_SHARE * min(len(link), len(motor)) and len(common):
        lost = len(link) + len(motor) - 2 * len(common)
        if not lost:
            return _samples(common, link, motor, ())
        notes = (f"{lost} samples that only one side has were left out",)
        return _samples(common, link.at(of_link), motor.at(of_motor), notes)
    inside = _covered(link.stamp_ns, motor.stamp_ns)
    if not inside.any():
        raise RecordingError(
            "/joint_states and /motor_states do not overlap in time",
            "Stamp both topics by one clock.",
        )
    at = link.at(inside)
    notes = ("the motor side was interpolated to the link side's stamps by a cubic spline",)
    return _samples(at.stamp_ns, at, _interpolate(motor, at.stamp_ns), notes)


def _samples(stamp_ns: Stamps, link: Side | None, motor: Side | None, notes: tuple[str, ...]) -> Samples:
    link, motor = link or Side(stamp_ns), motor or Side(stamp_ns)
    return Samples(
        t=(stamp_ns - stamp_ns[0]) * 1e-9,
        q=link.position,
        dq=link.velocity,
        tau_J=link.effort,
        theta=motor.position,
        dtheta=motor.velocity,
        tau_m=motor.effort,
        stamp_ns=stamp_ns,
        notes=notes,
    )


def _covered(wanted: Stamps, given: Stamps) -> np.ndarray:
    """Say which of the stamps `wanted` lie between two of `given` that are not too far apart."""
    if len(given) < 4:
        return np.zeros(len(wanted), dtype=bool)
    step = np.diff(given)
    after = np.clip(np.searchsorted(given, wanted), 1, len(given) - 1)
    inside = (wanted >= given[0]) & (wanted <= given[-1])
    return inside & (step[after - 1] <= LONGEST_GAP * np.median(step))


def _interpolate(side: Side, stamp_ns: Stamps) -> Side:
    origin = side.stamp_ns[0]
    given: Array = (side.stamp_ns - origin) * 1e-9
    wanted: Array = (stamp_ns - origin) * 1e-9
    return Side(stamp_ns, **{name: CubicSpline(given, x)(wanted) for name, x in side.channels().items()})
