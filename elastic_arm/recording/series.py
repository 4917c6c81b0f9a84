"""The messages of one topic as arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from elastic_arm.errors import RecordingError
from elastic_arm.recording.inspection.report import Finding, moment
from elastic_arm.recording.sides import Array, Stamps
from elastic_arm.recording.timebase.ordering import in_order

Rows = NDArray[np.intp]


@dataclass(frozen=True)
class Piece:
    """The messages of one layout."""

    rows: Stamps  # (m,) their places among the topic's messages, in file order
    log_ns: Stamps  # (m,) arrival times
    stamp_ns: Stamps | None  # (m,) header stamps; None where the type has no header
    names: tuple[str, ...]  # What the message calls its columns; empty where it names none
    values: dict[str, Array]  # By field path: (m, columns)

    def whole(self) -> bool:
        """Whether these are all messages from the first to the last."""
        return len(self.rows) > 0 and self.rows[-1] - self.rows[0] == len(self.rows) - 1

    def has(self, path: str) -> bool:
        """Whether these messages carry numbers in field `path`."""
        return path in self.values and self.values[path].shape[1] > 0

    def finite(self) -> NDArray[np.bool_]:
        """Return which messages (m,) hold no number that is none, but in columns that mostly do."""
        good = np.ones(len(self.rows), np.bool_)
        for values in self.values.values():
            each = np.isfinite(values)
            good &= (each | (each.mean(axis=0) < 0.5)).all(axis=1)
        return good


@dataclass
class Series:
    """All messages of one topic, as pieces of one layout each; nearly always there is one alone."""

    topic: str
    type_name: str
    pieces: list[Piece] = field(default_factory=list)
    count: int = 0

    def by_arrival(self) -> Series:
        """Return the series with the times of recording for stamps."""
        return replace(self, pieces=[replace(piece, stamp_ns=piece.log_ns) for piece in self.pieces])

    def keep(self, wanted: Callable[[Piece], bool]) -> Series:
        """Return the series of those messages alone whose piece is `wanted`."""
        kept = [piece for piece in self.pieces if wanted(piece)]
        if len(kept) == len(self.pieces):
            return self
        rows = np.sort(np.concatenate([piece.rows for piece in kept])) if kept else np.empty(0, np.int64)
        again = [replace(piece, rows=np.searchsorted(rows, piece.rows)) for piece in kept]
        return Series(self.topic, self.type_name, again, len(rows))

    def holding(self, joints: Sequence[str]) -> list[tuple[Series, list[str]]]:
        """Return as few kinds of messages as together name all joints, each with the joints to take from it."""
        counts: dict[frozenset[str], int] = {}
        for piece in self.pieces:
            own = frozenset(piece.names) & set(joints)
            counts[own] = counts.get(own, 0) + len(piece.rows)
        left, found = set(joints), []
        for own in sorted(counts, key=lambda own: (len(own), counts[own]), reverse=True):
            if taken := own & left:
                part = self.keep(lambda piece, own=own: own <= set(piece.names))  # type: ignore[misc]
                found.append((part, [joint for joint in joints if joint in taken]))
                left -= taken
        if left:
            missing = ", ".join(joint for joint in joints if joint in left)
            raise RecordingError(
                f"no message on {self.topic} names {missing}; there are {', '.join(self.names())}",
                "Name the joints of the arm: give its robot description, or a channel map (--channels).",
            )
        return found

    @cached_property
    def _in_order(self) -> tuple[Stamps, Rows | slice, list[Finding]]:
        """Stamps in order, where their messages stand, and what had to be done."""
        for piece in self.pieces:
            if piece.stamp_ns is None:
                raise RecordingError(
                    f"{self.topic} ({self.type_name}) has no header stamp",
                    "Set 'time: arrival' in a channel map to use the arrival times.",
                )
        stamp_ns = self._gather(np.int64, lambda piece: piece.stamp_ns)
        if (stamp_ns[1:] > stamp_ns[:-1]).all():
            return stamp_ns, slice(None), []
        stamp_ns, rows, found = in_order(stamp_ns, self.topic)
        again = np.diff(stamp_ns, prepend=stamp_ns[0] - 1) == 0
        if again.any():
            stamp_ns, rows, words = self._once(stamp_ns, rows)
            found.append(words)
        return stamp_ns, rows, found

    def _once(self, stamp_ns: Stamps, rows: Rows) -> tuple[Stamps, Rows, Finding]:
        """Take one message of each stamp: the first that does not hold zeros alone."""
        paths = dict.fromkeys(path for piece in self.pieces for path in piece.values if piece.has(path))
        table = np.hstack([self._gather(np.float64, *_spread(self, path)) for path in paths])[rows]
        empty = ~np.nan_to_num(table).any(axis=1)
        order = np.lexsort((np.arange(len(rows)), empty, stamp_ns))
        first = np.diff(stamp_ns[order], prepend=stamp_ns[0] - 1) > 0
        other = np.flatnonzero(~first)
        one, two = table[order[other - 1]], table[order[other]]
        differ = ~((one == two) | (np.isnan(one) & np.isnan(two))).all(axis=1)
        at = moment(stamp_ns, int(order[other[0]]))
        words = f"{self.topic} repeats a stamp {len(other)} times, first that of {at}"
        if differ.any():
            message = f"{words}, {differ.sum()} times with other numbers (two publishers?): the first of each is taken"
        else:
            message = f"{words}, with the same numbers: one of each is taken"
        kept = np.sort(order[first])
        severity = "warning" if differ.any() else "note"
        return stamp_ns[kept], rows[kept], Finding(severity, "duplicate", message, topic=self.topic)  # type: ignore[arg-type]

    @property
    def findings(self) -> list[Finding]:
        """What had to be done to bring the messages in order."""
        return self._in_order[2]

    @cached_property
    def order(self) -> Rows | slice:
        """Where the messages stand that are used, in the order of their stamps, or of their arrival without any."""
        if all(piece.stamp_ns is not None for piece in self.pieces):
            return self._in_order[1]
        log_ns = self._gather(np.int64, lambda piece: piece.log_ns)
        return slice(None) if np.all(log_ns[1:] >= log_ns[:-1]) else np.argsort(log_ns, kind="stable")

    @cached_property
    def log_ns(self) -> Stamps:
        """(N,) arrival times."""
        return self._gather(np.int64, lambda piece: piece.log_ns)[self.order]

    @property
    def stamp_ns(self) -> Stamps:
        """(N,) header stamps, in order; a RecordingError if the messages have none, or all the same."""
        return self._in_order[0]

    def names(self) -> list[str]:
        """Return all column names that occur, in the order of their appearance."""
        return list(dict.fromkeys(name for piece in self.pieces for name in piece.names))

    def has(self, path: str) -> bool:
        """Whether any message carries numbers in field `path`."""
        return any(piece.has(path) for piece in self.pieces)

    def width(self, path: str) -> int:
        """Return the largest number of columns that a message has in field `path`."""
        return max((piece.values[path].shape[1] for piece in self.pieces if piece.has(path)), default=0)

    def columns(self, path: str, names: Sequence[str]) -> Array | None:
        """Return field `path` for the columns named, (N, len(names)); None if no message carries it."""
        if not self.has(path):
            return None
        wanted = tuple(names)
        return self._gather(np.float64, lambda piece: self._named(piece, path, wanted), len(wanted))[self.order]

    def column(self, path: str, index: int) -> Array:
        """Return one column of field `path` by its place, (N,); a RecordingError if a message has no such column."""

        def one(piece: Piece) -> Array:
            if not piece.has(path) or piece.values[path].shape[1] <= index:
                known = sorted(path for path in piece.values if piece.has(path))
                raise RecordingError(
                    f"{self.topic} has no number {index} in field {path!r}{_at(piece)}",
                    f"Fields with numbers there: {', '.join(known) or 'none'}.",
                )
            return piece.values[path][:, index]

        return self._gather(np.float64, one)[self.order]

    def _named(self, piece: Piece, path: str, wanted: tuple[str, ...]) -> Array:
        if not piece.has(path):
            raise RecordingError(
                f"{self.topic}: field {path} is empty{_at(piece)}, and filled elsewhere",
                "Two sources seem to publish on this topic; stop one and record again.",
            )
        values = piece.values[path]
        if values.shape[1] != len(piece.names):
            raise RecordingError(
                f"{self.topic}: field {path} has {values.shape[1]} values for {len(piece.names)} joints{_at(piece)}",
                "The publisher must fill a field for all joints or for none.",
            )
        if piece.names == wanted:
            return values
        # The first place of a name that stands several times.
        places = {name: place for place, name in reversed(list(enumerate(piece.names)))}
        missing = [name for name in wanted if name not in places]
        if missing:
            raise RecordingError(
                f"{self.topic}: joint {', '.join(missing)} is missing{_at(piece)}; there are {', '.join(piece.names)}",
                "Name the joints wanted in a channel map (--channels), or record again with all joints.",
            )
        return values[:, [places[name] for name in wanted]]

    def _gather(self, dtype: type, part: Callable[[Piece], NDArray | None], width: int | None = None) -> NDArray:
        if len(self.pieces) == 1 and self.pieces[0].whole():
            return np.asarray(part(self.pieces[0]), dtype)
        gathered: NDArray = np.empty((self.count,) if width is None else (self.count, width), dtype)
        for piece in self.pieces:
            gathered[piece.rows] = part(piece)
        return gathered


def _spread(series: Series, path: str) -> tuple[Callable[[Piece], Array], int]:
    """Return what lays the columns of a piece in a table with NaN where it has none, and the width of that."""
    width = series.width(path)

    def part(piece: Piece) -> Array:
        table = np.full((len(piece.rows), width), np.nan)
        if piece.has(path):
            table[:, : piece.values[path].shape[1]] = piece.values[path]
        return table

    return part, width


def _at(piece: Piece) -> str:
    stamps = piece.stamp_ns if piece.stamp_ns is not None else piece.log_ns
    return f" at {stamps[0] * 1e-9:.6f} s" if len(stamps) else ""
