"""The split of the recordings into fitted and validation parts."""

from collections.abc import Sequence

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.errors import DiagnosisError
from elastic_arm.recording import Recording, Side

HELD_BACK = 1.0 / 3.0  # share of each recording for validation
SHORTEST = 2.5  # s, of either part
HOLE = 1.0  # s, distance of samples from which the recording has a hole
RATE = 50.0  # Hz, above the frequencies of motion, at which motions are compared
REPEATED = 0.02  # difference over spread below which a motion counts as a repetition
ROWS = 200  # runs of a validation recording that are sought in the fitted ones
RUN = 20  # rows of a run
SHARED = 0.2  # share of these runs that may be found; noise does not repeat


def split(
    recordings: Sequence[Recording], validate: Sequence[Recording]
) -> tuple[list[Recording], list[Recording]]:
    """Return fitted and validation recordings; without validation recordings, the last third of
    each recording is for validation.

    Holes, such as those of standstill, do not count as time.

    Raises a DiagnosisError if the parts would be too short, or a recording would validate itself.
    """
    if not recordings:
        raise DiagnosisError("no recording is given", "Name a bag")
    if validate:
        for judge in validate:
            if any(_contains(r, judge) for r in recordings):
                raise DiagnosisError(
                    f"{judge.source or 'the validation recording'} is also a fitted recording",
                    "Validate on another recording, or omit --validate to use the last third of"
                    " each",
                )
        return list(recordings), list(validate)
    least = SHORTEST / HELD_BACK
    ends = []
    for r in recordings:
        times, lasts = _course_of_time(r)
        if lasts[-1] * HELD_BACK < SHORTEST:
            raise DiagnosisError(
                f"{r.source or 'the recording'} lasts {lasts[-1]:.1f} s, too short to reserve a"
                " third"
                " for validation",
                f"Record at least {least:.0f} s, or give another recording with --validate",
            )
        ends.append(float(np.interp(lasts[-1] * (1.0 - HELD_BACK), lasts, times)))
    first = [r.between(0.0, end) for r, end in zip(recordings, ends, strict=True)]
    rest = [r.between(end, r.duration + 1.0) for r, end in zip(recordings, ends, strict=True)]
    return first, rest


def _course_of_time(recording: Recording) -> tuple[Array, Array]:
    """Return the stamps (N,) of a side from the first of the recording, s, and the recorded time
    until each, s."""
    stamps = next(
        side for side in (recording.motor, recording.link) if side is not None and len(side)
    ).stamp_ns
    times = np.asarray((stamps - recording.start_ns) * 1e-9)
    steps = np.diff(times, prepend=0.0)
    return times, np.cumsum(np.where(steps > HOLE, 0.0, steps))


def independent(identify: Sequence[Recording], validate: Sequence[Recording]) -> bool:
    """Whether the validation motion differs from the fitted ones and is not a repetition."""
    return not any(_repeats(_course(v), _course(r)) for v in validate for r in identify)


def _course(recording: Recording) -> Array:
    """Return the angles (N, n) of a recording at :data:`RATE`, without holes."""
    samples = recording.samples()
    position = samples.theta if samples.theta is not None else samples.q
    if position is None:
        raise DiagnosisError(
            f"{recording.source or 'the recording'} contains no positions", "Record positions"
        )
    steps = np.diff(samples.t, prepend=0.0)
    lasts = np.cumsum(np.where(steps > HOLE, 0.0, steps))
    t = np.arange(0.0, lasts[-1], 1.0 / RATE)
    return np.stack([np.interp(t, lasts, column) for column in position.T], axis=1)


def _repeats(part: Array, whole: Array) -> bool:
    """Whether `whole` contains `part`, by the least mean-square distance over all shifts."""
    part, whole = sorted((part, whole), key=len)
    middle = part.mean(axis=0)
    part = part - middle
    whole = whole - middle
    spread = float(np.mean(part**2))
    if spread == 0.0 or len(part) < 2:
        return True
    size = len(whole) + len(part)
    spectra = np.fft.rfft(whole, size, axis=0) * np.fft.rfft(part[::-1], size, axis=0)
    product = np.fft.irfft(spectra, size, axis=0)
    shifts = slice(len(part) - 1, len(whole))
    energy = np.cumsum(np.vstack([np.zeros(whole.shape[1]), whole**2]), axis=0)
    windows = energy[len(part) :] - energy[: len(energy) - len(part)]
    distance = (windows + np.sum(part**2, axis=0) - 2 * product[shifts]).sum(axis=1) / part.size
    return bool(distance.min() < REPEATED**2 * spread)


def _contains(recording: Recording, part: Recording) -> bool:
    """Whether much of `part` is also in `recording`, whatever its stamps: noise does not repeat."""
    sides = [
        (a, b) for a, b in ((recording.motor, part.motor), (recording.link, part.link)) if a and b
    ]
    # A coarse or resting channel repeats its steps; both sides together do not.
    return bool(sides) and all(_shares(_rows(whole), _rows(own)) for whole, own in sides)


def _shares(whole: Array, own: Array) -> bool:
    """Whether rows (N, k) contain runs of others (M, k).

    Single rows repeat if a channel is coarse or at a limit, but runs that change do not.
    """
    if whole.shape[1] != own.shape[1] or len(own) < RUN:
        return False
    # A joint that lacks the channel has no numbers.
    whole = np.nan_to_num(whole)
    own = np.nan_to_num(own)
    changed = np.any(own[1:] != own[:-1], axis=1)
    changes = np.convolve(changed, np.ones(RUN - 1), mode="valid")
    lively = np.flatnonzero(changes >= max(1.0, 0.5 * float(changes.max())))
    starts = lively[:: max(1, len(lively) // ROWS)]
    alike = np.flatnonzero(np.isin(whole[: 1 - RUN, 0], own[starts, 0]))
    known = {whole[i : i + RUN].tobytes() for i in alike}
    found = sum(own[i : i + RUN].tobytes() in known for i in starts)
    return found > SHARED * len(starts)


def _rows(side: Side) -> Array:
    """Return all channels (N, k) of a side."""
    channels = list(side.channels().values())
    return np.hstack(channels) if channels else np.zeros((0, 0))
