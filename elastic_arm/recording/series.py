"""The messages of one topic as arrays, decoded block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from elastic_arm.arrays import Indices, Mask
from elastic_arm.errors import RecordingError
from elastic_arm.recording import cdr, limits, message_types
from elastic_arm.recording.inspection.report import Finding, moment
from elastic_arm.recording.sides import Array, Stamps
from elastic_arm.recording.spans import Spans
from elastic_arm.recording.storage.bag import BagFile
from elastic_arm.recording.storage.mcap_scan import McapBlock
from elastic_arm.recording.storage.metadata import Topic
from elastic_arm.recording.timebase.ordering import in_order

_SECONDS = "header.stamp.sec"
_NANOSECONDS = "header.stamp.nanosec"
_FIRST = 1024  # messages that a table holds at first, when nothing is known


@dataclass(frozen=True)
class Piece:
    """The messages of one layout."""

    rows: Stamps  # (m,) their places among the topic's messages, in file order
    log_ns: Stamps  # (m,) arrival times
    stamp_ns: Stamps | None  # (m,) header stamps; None where the type has no header
    names: tuple[str, ...]  # What the message calls its columns; empty where it names none
    values: dict[str, Array]  # By field path: (m, columns)

    def whole(self) -> bool:
        """Return whether these are all messages from the first to the last."""
        return len(self.rows) > 0 and self.rows[-1] - self.rows[0] == len(self.rows) - 1

    def has(self, path: str) -> bool:
        """Return whether these messages contain numbers in field `path`."""
        return path in self.values and self.values[path].shape[1] > 0

    def finite(self) -> Mask:
        """Return which messages (m,) contain only finite numbers, apart from columns that are
        mostly non-finite."""
        good = np.ones(len(self.rows), np.bool_)
        for values in self.values.values():
            each = np.isfinite(values)
            good &= (each | (each.mean(axis=0) < 0.5)).all(axis=1)
        return good


@dataclass
class Series:
    """All messages of one topic, as one piece per layout; usually there is only one."""

    topic: str
    type_name: str
    pieces: list[Piece] = field(default_factory=list)
    count: int = 0

    def by_arrival(self) -> Series:
        """Return the series with the times of recording as stamps."""
        return replace(
            self, pieces=[replace(piece, stamp_ns=piece.log_ns) for piece in self.pieces]
        )

    def keep(self, wanted: Callable[[Piece], bool]) -> Series:
        """Return the series of the messages whose piece is `wanted`."""
        kept = [piece for piece in self.pieces if wanted(piece)]
        if len(kept) == len(self.pieces):
            return self
        rows = (
            np.sort(np.concatenate([piece.rows for piece in kept]))
            if kept
            else np.empty(0, np.int64)
        )
        again = [replace(piece, rows=np.searchsorted(rows, piece.rows)) for piece in kept]
        return Series(self.topic, self.type_name, again, len(rows))

    def holding(self, joints: Sequence[str]) -> list[tuple[Series, list[str]]]:
        """Return the smallest number of kinds of messages that name all joints, with the joints of
        each."""
        counts: dict[frozenset[str], int] = {}
        for piece in self.pieces:
            own = frozenset(piece.names) & set(joints)
            counts[own] = counts.get(own, 0) + len(piece.rows)
        left = set(joints)
        found = []
        for own in sorted(counts, key=lambda own: (len(own), counts[own]), reverse=True):
            if taken := own & left:
                part = self.keep(lambda piece, own=own: own <= set(piece.names))  # type: ignore[misc]
                found.append((part, [joint for joint in joints if joint in taken]))
                left -= taken
        if left:
            missing = ", ".join(joint for joint in joints if joint in left)
            raise RecordingError(
                f"no message on {self.topic} contains {missing}; the joints are"
                f" {', '.join(self.names())}",
                "Give the joints of the arm by its robot description or a channel map"
                " (--channels).",
            )
        return found

    def fullest(self, paths: Iterable[str], found: list[Finding]) -> Series:
        """Return the series without messages that leave fields empty which others fill.

        `found` receives a finding about them.
        """
        partly = [path for path in paths if len({piece.has(path) for piece in self.pieces}) > 1]
        full = self.keep(lambda piece: all(piece.has(path) for path in partly))
        if not 0 < full.count < self.count:
            return self
        words = (
            f"{self.count - full.count} of {self.count} messages on {self.topic} leave"
            f" {', '.join(partly)} empty"
        )
        message = f"{words}, which others fill: a second publisher? They are skipped"
        found.append(Finding("warning", "second_publisher", message, topic=self.topic))
        return full

    @cached_property
    def _in_order(self) -> tuple[Stamps, Indices | slice, list[Finding]]:
        """The stamps in order, the positions of their messages, and the corrections."""
        for piece in self.pieces:
            if piece.stamp_ns is None:
                raise RecordingError(
                    f"{self.topic} ({self.type_name}) has no header stamp",
                    "Set 'time: arrival' in a channel map to use the arrival times.",
                )
        stamp_ns = self._gather(np.int64, lambda piece: piece.stamp_ns)
        if (stamp_ns[1:] > stamp_ns[:-1]).all():
            return stamp_ns, slice(None), []
        stamp_ns, rows, found = in_order(
            stamp_ns, self.topic, self._gather(np.int64, lambda piece: piece.log_ns)
        )
        again = np.diff(stamp_ns, prepend=stamp_ns[0] - 1) == 0
        if again.any():
            stamp_ns, rows, words = self._once(stamp_ns, rows)
            found.append(words)
        return stamp_ns, rows, found

    def _once(self, stamp_ns: Stamps, rows: Indices) -> tuple[Stamps, Indices, Finding]:
        """Select one message per stamp: the first that does not contain only zeros."""
        paths = dict.fromkeys(
            path for piece in self.pieces for path in piece.values if piece.has(path)
        )
        table = np.hstack([self._gather(np.float64, *_spread(self, path)) for path in paths])[rows]
        empty = ~np.nan_to_num(table).any(axis=1)
        order = np.lexsort((np.arange(len(rows)), empty, stamp_ns))
        first = np.diff(stamp_ns[order], prepend=stamp_ns[0] - 1) > 0
        other = np.flatnonzero(~first)
        one = table[order[other - 1]]
        two = table[order[other]]
        differ = ~((one == two) | (np.isnan(one) & np.isnan(two))).all(axis=1)
        at = moment(stamp_ns, int(order[other[0]]))
        words = f"{self.topic} repeats {len(other)} stamps, first that of {at}"
        if differ.any():
            message = (
                f"{words}, {differ.sum()} of them with different numbers (two publishers?):"
                " the first message of each is used"
            )
        else:
            message = f"{words}, with the same numbers: one message of each is used"
        kept = np.sort(order[first])
        severity = "warning" if differ.any() else "note"
        return stamp_ns[kept], rows[kept], Finding(severity, "duplicate", message, topic=self.topic)  # type: ignore[arg-type]

    @property
    def findings(self) -> list[Finding]:
        """The corrections that brought the messages into order."""
        return self._in_order[2]

    @cached_property
    def order(self) -> Indices | slice:
        """The positions of the used messages, in order of stamps, or otherwise of arrival."""
        if all(piece.stamp_ns is not None for piece in self.pieces):
            return self._in_order[1]
        log_ns = self._gather(np.int64, lambda piece: piece.log_ns)
        return (
            slice(None) if np.all(log_ns[1:] >= log_ns[:-1]) else np.argsort(log_ns, kind="stable")
        )

    @cached_property
    def log_ns(self) -> Stamps:
        """(N,) arrival times."""
        return self._gather(np.int64, lambda piece: piece.log_ns)[self.order]

    @property
    def stamp_ns(self) -> Stamps:
        """(N,) header stamps, in order.

        A RecordingError if there are none, or all are the same.
        """
        return self._in_order[0]

    def names(self) -> list[str]:
        """Return all column names that occur, in the order of their appearance."""
        return list(dict.fromkeys(name for piece in self.pieces for name in piece.names))

    def has(self, path: str) -> bool:
        """Return whether any message contains numbers in field `path`."""
        return any(piece.has(path) for piece in self.pieces)

    def width(self, path: str) -> int:
        """Return the largest number of columns that a message has in field `path`."""
        return max(
            (piece.values[path].shape[1] for piece in self.pieces if piece.has(path)), default=0
        )

    def columns(self, path: str, names: Sequence[str]) -> Array | None:
        """Return field `path` of the named joints, (N, len(names)); None if no message contains
        it."""
        if not self.has(path):
            return None
        wanted = tuple(names)
        return self._gather(
            np.float64, lambda piece: self._named(piece, path, wanted), len(wanted)
        )[self.order]

    def column(self, path: str, index: int) -> Array:
        """Return one column (N,) of field `path` by its index.

        A RecordingError if a message has no such column.
        """

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
                f"{self.topic}: field {path} is empty{_at(piece)}, but not elsewhere",
                "Two sources seem to publish on this topic; stop one and record again.",
            )
        values = piece.values[path]
        if values.shape[1] != len(piece.names):
            raise RecordingError(
                f"{self.topic}: field {path} has {values.shape[1]} values for {len(piece.names)}"
                f" joints{_at(piece)}",
                "The publisher has to fill a field for all joints or for none.",
            )
        if piece.names == wanted:
            return values
        # The first place of a name that stands several times.
        places = {name: place for place, name in reversed(list(enumerate(piece.names)))}
        missing = [name for name in wanted if name not in places]
        if missing:
            raise RecordingError(
                f"{self.topic}: joint {', '.join(missing)} is missing{_at(piece)}; the joints"
                f" are {', '.join(piece.names)}",
                "Give the required joints in a channel map (--channels), or record again with"
                " all joints.",
            )
        return values[:, [places[name] for name in wanted]]

    def _gather(
        self, dtype: type, part: Callable[[Piece], NDArray | None], width: int | None = None
    ) -> NDArray:
        if len(self.pieces) == 1 and self.pieces[0].whole():
            return np.asarray(part(self.pieces[0]), dtype)
        gathered: NDArray = np.empty((self.count,) if width is None else (self.count, width), dtype)
        for piece in self.pieces:
            gathered[piece.rows] = part(piece)
        return gathered


def _spread(series: Series, path: str) -> tuple[Callable[[Piece], Array], int]:
    """Return a function that puts the columns of a piece into a table, with NaN for missing ones,
    and the width of the table."""
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


class Decoder:
    """Decodes the messages of one topic."""

    def __init__(self, topic: str, type_name: str) -> None:
        self.topic = topic
        self.type_name = type_name
        self._count = 0
        self._layouts: dict[str, cdr.Layouts] = {}
        self._tables: dict[int, _DecodedColumns] = {}

    def add(self, file: BagFile, channel: int, block: McapBlock) -> None:
        """Decode the messages of one channel in a block."""
        spans = block.spans(channel).in_a_row()
        log_ns = block.log_ns(channel)
        rows = np.arange(self._count, self._count + len(log_ns))
        expected = file.expected(channel)
        try:
            for layout, index in self._types(file.topic(channel)).groups(spans):
                if id(layout) not in self._tables:
                    # What a file promises is believed up to a size; beyond it the table grows as it
                    # fills. 2_000_000_000 bytes taken for messages that are promised; touched only
                    # as they come
                    promised = min(
                        max(expected, _FIRST) if index is None else _FIRST,
                        2_000_000_000 // layout.size,
                    )
                    self._tables[id(layout)] = _DecodedColumns(layout, max(promised, 1))
                table = self._tables[id(layout)]
                if index is None:
                    table.append(spans, rows, log_ns)
                else:
                    table.append(spans.at(index), rows[index], log_ns[index])
        except RecordingError as error:
            raise RecordingError(
                f"{file.path}, {self.topic}: {error.problem}", error.remedy
            ) from None
        except MemoryError:
            message = f"{file.path}, {self.topic}: its messages do not fit into memory"
            raise RecordingError(
                message, "Record fewer topics or shorter runs, or use a machine with more memory."
            ) from None
        self._count += len(rows)

    def series(self) -> Series:
        """Return all messages decoded so far."""
        return Series(
            self.topic,
            self.type_name,
            [table.piece() for table in self._tables.values()],
            self._count,
        )

    def _types(self, topic: Topic) -> cdr.Layouts:
        if not topic.type_name:
            raise RecordingError(
                "the file does not name the type of its messages",
                "Record with message definitions.",
            )
        if topic.definition not in self._layouts:
            self._layouts[topic.definition] = cdr.Layouts(
                topic.type_name, message_types.types_of(topic)
            )
        return self._layouts[topic.definition]


def _is_whole(part: cdr.Numbers | None) -> bool:
    """Return whether a part of a stamp is a single integer of at most 32 bits, as in ROS; a bag may
    define it otherwise."""
    return (
        part is not None
        and part.count == 1
        and part.dtype.kind in "iu"
        and part.dtype.itemsize <= 4
    )


class _DecodedColumns:
    """The numbers of all messages of one layout; the arrays grow as messages arrive."""

    def __init__(self, layout: cdr.Layout, capacity: int) -> None:
        self.layout = layout
        self.count = 0
        self.columns: dict[str, NDArray] = {
            name: np.empty(capacity, np.int64) for name in ("rows", "log_ns")
        }
        if all(_is_whole(layout.numbers.get(path)) for path in (_SECONDS, _NANOSECONDS)):
            self.columns["stamp_ns"] = np.empty(capacity, np.int64)
        self.values: dict[str, NDArray] = {}
        for path, numbers in layout.numbers.items():
            if numbers.dtype.kind != "f" and "time_from_start" not in path:
                continue
            if numbers.count > limits.COLUMNS:
                raise RecordingError(
                    f"field {path} contains {numbers.count} numbers; the limit is {limits.COLUMNS}",
                    "Record a topic with one number per joint.",
                )
            self.values[path] = np.empty((capacity, numbers.count), numbers.dtype)

    def append(self, spans: Spans, rows: Stamps, log_ns: Stamps) -> None:
        """Decode messages; `rows` are their positions among the messages of the topic."""
        spot = slice(self.count, self.count + len(rows))
        self._reserve(spot.stop)
        self.columns["rows"][spot] = rows
        self.columns["log_ns"][spot] = log_ns
        if "stamp_ns" in self.columns:
            stamps = self.columns["stamp_ns"][spot]
            np.multiply(
                self.layout.values(spans, _SECONDS)[:, 0], 1_000_000_000, out=stamps, dtype=np.int64
            )
            stamps += self.layout.values(spans, _NANOSECONDS)[:, 0]
        for path, target in self.values.items():
            self.layout.values_into(spans, path, target[spot])
        self.count = spot.stop

    def piece(self) -> Piece:
        """Return the messages as arrays, without a copy if they have the byte order of the
        machine."""
        rows = self.columns["rows"][: self.count]
        log_ns = self.columns["log_ns"][: self.count]
        stamp_ns = self.columns["stamp_ns"][: self.count] if "stamp_ns" in self.columns else None
        names = tuple(next(iter(self.layout.strings.values()), []))
        values = {
            path: np.asarray(target[: self.count], np.float64)
            for path, target in self.values.items()
        }
        return Piece(rows, log_ns, stamp_ns, names, values)

    def _reserve(self, count: int) -> None:
        for arrays in (self.columns, self.values):
            for name, array in arrays.items():
                if len(array) < count:
                    grown = np.empty((max(count, 2 * len(array)), *array.shape[1:]), array.dtype)
                    grown[: self.count] = array[: self.count]
                    arrays[name] = grown
