"""Pair the samples of both sides of the joints by stamp as they arrive."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elastic_arm.arrays import Array

Stamps = NDArray[np.int64]
# Stamps this far behind are no stragglers: the clock was set back.
RESTART_NS = 1_000_000_000


class Pairs(NamedTuple):
    """Samples of both sides: stamps (N,) increasing, and the rows (N, …) of each side."""

    stamp_ns: Stamps
    link: Array
    motor: Array

    def __len__(self) -> int:
        return len(self.stamp_ns)


@dataclass
class Losses:
    """The samples that did not become a pair, by reason."""

    repeated: int = 0  # A stamp that was there already
    reordered: int = 0  # arrived behind a younger stamp, and was put in its place
    late: int = 0  # older than what was handed out already
    early: int = 0  # came before the first sample of the other side: its topic was found later
    unmatched: int = 0  # the other side's sample never came
    restarts: int = 0  # the clock of the stamps went back: another run began


class Pairing:
    """Pairs the samples of two topics by equal stamps, within a window of bounded length.

    A sample waits `window` for its partner and for older samples that were overtaken; then it is
    returned, or counted as unmatched. Returned samples are never followed by older ones.

    window_ns: how long a sample waits, in the time of the stamps; capacity: largest number of
    samples kept per side, whatever their stamps are.
    """

    def __init__(self, window_ns: int = 200_000_000, capacity: int = 20_000) -> None:
        self.window_ns = window_ns
        self.capacity = capacity
        self.losses = Losses()
        self._sides: list[tuple[Stamps, Array] | None] = [None, None]
        self._newest: list[int | None] = [None, None]
        self._first: list[int | None] = [None, None]
        self._handed: int | None = None

    def add_link(self, stamps: Stamps, rows: Array) -> None:
        """Add samples of the link side, in order of arrival."""
        self._add(0, stamps, rows)

    def add_motor(self, stamps: Stamps, rows: Array) -> None:
        """Add samples of the motor side, in order of arrival."""
        self._add(1, stamps, rows)

    def take(self, everything: bool = False) -> Pairs | None:
        """Return the pairs that are old enough (or all of them), None if there are none."""
        link, motor = self._sides
        if link is None or motor is None:
            return None
        newest = max(stamp for stamp in self._newest if stamp is not None)
        limit = newest if everything else newest - self.window_ns
        common, of_link, of_motor = np.intersect1d(
            link[0], motor[0], assume_unique=True, return_indices=True
        )
        ready = common <= limit
        pairs = Pairs(common[ready], link[1][of_link[ready]], motor[1][of_motor[ready]])
        self._drop_until(limit, len(pairs))
        return pairs if len(pairs) else None

    def _add(self, side: int, stamps: Stamps, rows: Array) -> None:
        if not len(stamps):
            return
        if (newest := self._newest[side]) is not None and stamps.max() < newest - RESTART_NS:
            self._restart()
        arrived = np.maximum.accumulate(stamps)
        newest = self._newest[side]
        before = np.concatenate(([stamps[0] - 1 if newest is None else newest], arrived[:-1]))
        self.losses.reordered += int(np.sum(stamps < before))
        self._newest[side] = int(max(arrived[-1], before[0]))
        earliest = self._first[side]
        self._first[side] = int(stamps.min() if earliest is None else min(earliest, stamps.min()))
        if self._handed is not None:
            in_time = stamps > self._handed
            self.losses.late += int(np.sum(~in_time))
            stamps = stamps[in_time]
            rows = rows[in_time]
        held = self._sides[side]
        if held is not None:
            stamps = np.concatenate((held[0], stamps))
            rows = np.concatenate((held[1], rows))
        unique, first = np.unique(stamps, return_index=True)
        self.losses.repeated += len(stamps) - len(unique)
        over = max(len(unique) - self.capacity, 0)
        self.losses.unmatched += over
        self._sides[side] = (unique[over:], rows[first[over:]])

    def _restart(self) -> None:
        self.losses.restarts += 1
        self.losses.unmatched += sum(len(held[0]) for held in self._sides if held is not None)
        self._sides = [None, None]
        self._newest = [None, None]
        self._first = [None, None]
        self._handed = None

    def _drop_until(self, limit: int, handed_out: int) -> None:
        """Discard the samples up to `limit`, and count those without a partner."""
        for side, held in enumerate(self._sides):
            if held is not None:
                keep = int(np.searchsorted(held[0], limit, side="right"))
                others = self._first[1 - side]
                early = 0 if others is None else int(np.searchsorted(held[0][:keep], others))
                self.losses.early += early
                self.losses.unmatched += keep - handed_out - early
                self._sides[side] = (held[0][keep:], held[1][keep:])
        self._handed = limit if self._handed is None else max(self._handed, limit)
