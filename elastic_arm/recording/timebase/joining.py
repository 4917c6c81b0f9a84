"""Bring both sides of the joints to one time base."""

import numpy as np
import scipy
from numpy.typing import NDArray

from elastic_arm.errors import RecordingError
from elastic_arm.recording.inspection.report import Finding, note
from elastic_arm.recording.sides import (
    SAMPLED,
    Array,
    ClockMode,
    Lacking,
    Samples,
    Side,
    Stamps,
    joints_with,
)
from elastic_arm.recording.timebase.clocks import ENOUGH, Evidence, evidence, is_even, numbered

# Two topics stamped by one clock tick share nearly all their stamps, apart from lost messages;
# below this share they are stamped apart and have to be interpolated.
COMMON_SHARE = 0.9
# A spline over a longer hole than this many sample intervals would invent motion.
LONGEST_GAP = 4.0
# Of fewer samples nothing is known of their clock.
SHORTEST = 12


def join(link: Side | None, motor: Side | None, clock: ClockMode | None = None) -> Samples:
    """Bring both sides to one time base, see :func:`pair`."""
    if link is not None and motor is not None and (len(link) or len(motor)):
        found: list[Finding] = []
        link, motor = pair(link, motor, "the motor side", "the link side", found, clock)
        return _samples(link.stamp_ns, link, motor, tuple(finding.message for finding in found))
    only = motor if link is None else link
    if only is None or not len(only):
        raise RecordingError(
            "no samples of the arm", "Record /joint_states or /motor_states, or both."
        )
    return _samples(only.stamp_ns, link, motor, ())


def pair(
    base: Side,
    other: Side,
    other_name: str,
    base_name: str,
    found: list[Finding],
    clock: ClockMode | None = None,
) -> tuple[Side, Side]:
    """Bring `other` to the stamps of `base`; `found` receives the corrections.

    Samples with equal stamps are paired exactly. Otherwise a cubic spline interpolates `other`,
    never beyond its ends or across its gaps, between the times at which the samples were taken; if
    these were regular, the jitter of the stamps is not part of the motion. A cubic spline preserves
    frequencies well below half the sample rate and attenuates those close to it.
    """
    if np.array_equal(base.stamp_ns, other.stamp_ns):
        return base, other
    common, of_base, of_other = np.intersect1d(
        base.stamp_ns, other.stamp_ns, assume_unique=True, return_indices=True
    )
    if len(common) and len(common) >= COMMON_SHARE * min(len(base), len(other)):
        lost = len(base) + len(other) - 2 * len(common)
        found.append(
            note(f"{lost} samples present on only one of {base_name} and {other_name} were skipped")
        )
        return base.at(of_base), other.at(of_other)
    inside = _covered(base.stamp_ns, other.stamp_ns)
    if not inside.any():
        raise RecordingError(
            f"{base_name} and {other_name} do not overlap in time",
            "Stamp all topics with one clock.",
        )
    origin = int(base.stamp_ns[0])
    wanted, given = _times((base, other), origin, clock)
    at = base.at(inside)
    words = f"interpolated to the stamps of {base_name} by a cubic spline: {other_name}"
    left_out = (
        f"; {(~inside).sum()} samples outside of its time range are skipped"
        if not inside.all()
        else ""
    )
    found.append(note(f"{words}{left_out}"))
    return at, _interpolate(other, given, at.stamp_ns, wanted[inside])


def _times(sides: tuple[Side, Side], origin: int, clock: ClockMode | None) -> tuple[Array, Array]:
    """Return when the samples (N,) and (M,) of two sides were taken, in s from an origin in ns.

    If one side does not show the meaning of its stamps, that of the other side applies.
    """
    stamped = [np.asarray((side.stamp_ns - origin) * 1e-9, dtype=np.float64) for side in sides]
    regular = list(stamped)
    found = []
    for k, (side, t) in enumerate(zip(sides, stamped, strict=True)):
        if len(t) < SHORTEST:
            return stamped[0], stamped[1]
        number, rate, _, jitter = numbered(t)
        regular[k] = t - jitter
        found.append(
            None if is_even(jitter, rate) or clock is not None else _evidence(side, number, rate)
        )
    other = found[::-1]
    for k, own in enumerate(found):
        known = own or other[k]
        if clock == "stamps" or (clock is None and (known is None or known.stamps)):
            regular[k] = stamped[k]
    return regular[0], regular[1]


def _evidence(side: Side, number: NDArray[np.int64], rate: float) -> Evidence | None:
    """Return the evidence of one side about its clock, from the joints that it contains."""
    few = side.at(slice(0, ENOUGH))
    if few.position is None:
        return None
    there = joints_with(few.position)
    velocity = None if few.velocity is None else few.velocity[:, there]
    if velocity is not None and not joints_with(velocity).all():
        velocity = None
    t: Array = (few.stamp_ns - few.stamp_ns[0]) * 1e-9
    samples = Samples(t, few.position[:, there], velocity, None, None, None, None, few.stamp_ns)
    return evidence(samples, number[: len(t)], rate)


def _samples(
    stamp_ns: Stamps, link: Side | None, motor: Side | None, notes: tuple[str, ...]
) -> Samples:
    link = link or Side(stamp_ns)
    motor = motor or Side(stamp_ns)
    t: Array = (stamp_ns - stamp_ns[0]) * 1e-9
    link, motor, lacking = _filled(t, link, motor)
    sides = {"link": link, "motor": motor}
    channels = {name: getattr(sides[side], channel) for name, (side, channel) in SAMPLED.items()}
    return Samples(t=t, **channels, stamp_ns=stamp_ns, notes=notes, lacking=lacking)


def _filled(t: Array, link: Side, motor: Side) -> tuple[Side, Side, Lacking]:
    """Return both sides with substitutes for missing channels of joints, and the list of
    substitutes.

    An angle is replaced by that of the other side of the joint, a velocity by the derivative of the
    angle, a torque by zero.
    """
    if not any(np.isnan(v[:1]).any() for side in (link, motor) for v in side.channels().values()):
        return link, motor, frozenset()
    channels = {
        "q": link.position,
        "tau_J": link.effort,
        "theta": motor.position,
        "tau_m": motor.effort,
    }
    lacking = {
        (name, int(j))
        for name, values in channels.items()
        if values is not None
        for j in np.flatnonzero(~joints_with(values))
    }
    return _filled_side(t, link, motor), _filled_side(t, motor, link), frozenset(lacking)


def _filled_side(t: Array, side: Side, other: Side) -> Side:
    found = side.channels()
    angle = side.position if side.position is not None else other.position
    if angle is not None and other.position is not None:
        angle = np.where(joints_with(angle), angle, other.position)
    if side.position is not None and angle is not None:
        found["position"] = angle
    if side.velocity is not None and angle is not None:
        found["velocity"] = np.where(
            joints_with(side.velocity), side.velocity, np.gradient(angle, t, axis=0)
        )
    if side.effort is not None:
        found["effort"] = np.where(joints_with(side.effort), side.effort, 0.0)
    return Side(side.stamp_ns, **found)


def _covered(wanted: Stamps, given: Stamps) -> np.ndarray:
    """(N,) True for the stamps `wanted` that lie between two of `given` that are not too far
    apart."""
    if len(given) < 4:
        return np.zeros(len(wanted), dtype=bool)
    step = np.diff(given)
    after = np.clip(np.searchsorted(given, wanted), 1, len(given) - 1)
    inside = (wanted >= given[0]) & (wanted <= given[-1])
    return inside & (step[after - 1] <= LONGEST_GAP * np.median(step))


def _interpolate(side: Side, given: Array, stamp_ns: Stamps, wanted: Array) -> Side:
    """Return the samples of a side, taken at times (M,) s, at other ones (N,) with these stamps."""

    def at_stamps(values: Array) -> Array:
        there = joints_with(values)
        found = np.full((len(wanted), values.shape[1]), np.nan)
        found[:, there] = scipy.interpolate.CubicSpline(given, values[:, there])(wanted)
        return found

    return Side(stamp_ns, **{name: at_stamps(x) for name, x in side.channels().items()})
