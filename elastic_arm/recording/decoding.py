"""Decode the messages of a topic, block by block, straight into the arrays they end in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from elastic_arm.errors import RecordingError
from elastic_arm.recording import cdr, limits, message_types
from elastic_arm.recording.series import Piece, Series
from elastic_arm.recording.sides import Stamps
from elastic_arm.recording.spans import Spans
from elastic_arm.recording.storage.bag import BagFile
from elastic_arm.recording.storage.mcap_scan import McapBlock
from elastic_arm.recording.storage.metadata import Topic

_SECONDS, _NANOSECONDS = "header.stamp.sec", "header.stamp.nanosec"
_FIRST = 1024  # messages that a table holds at first, when nothing is known


class Decoder:
    """Decodes the messages of one topic."""

    def __init__(self, topic: str, type_name: str) -> None:
        self.topic, self.type_name = topic, type_name
        self._count = 0
        self._layouts: dict[str, cdr.Layouts] = {}
        self._tables: dict[int, _DecodedColumns] = {}

    def add(self, file: BagFile, channel: int, block: McapBlock) -> None:
        """Decode the messages of one channel in a block."""
        spans, log_ns = block.spans(channel).in_a_row(), block.log_ns(channel)
        rows = np.arange(self._count, self._count + len(log_ns))
        expected = file.expected(channel)
        try:
            for layout, index in self._types(file.topic(channel)).groups(spans):
                if id(layout) not in self._tables:
                    # What a file promises is believed up to a size; beyond it the table grows as it fills.
                    # 2_000_000_000 bytes taken for messages that are promised; touched only as they come
                    promised = min(max(expected, _FIRST) if index is None else _FIRST, 2_000_000_000 // layout.size)
                    self._tables[id(layout)] = _DecodedColumns(layout, max(promised, 1))
                table = self._tables[id(layout)]
                if index is None:
                    table.append(spans, rows, log_ns)
                else:
                    table.append(spans.at(index), rows[index], log_ns[index])
        except RecordingError as error:
            raise RecordingError(f"{file.path}, {self.topic}: {error.problem}", error.remedy) from None
        except MemoryError:
            message = f"{file.path}, {self.topic}: its messages do not fit into the memory"
            raise RecordingError(
                message, "Record fewer topics or shorter runs, or read it on a larger machine."
            ) from None
        self._count += len(rows)

    def series(self) -> Series:
        """Return all messages decoded so far."""
        return Series(self.topic, self.type_name, [table.piece() for table in self._tables.values()], self._count)

    def _types(self, topic: Topic) -> cdr.Layouts:
        if not topic.type_name:
            raise RecordingError("the file does not name the type of its messages", "Record with message definitions.")
        if topic.definition not in self._layouts:
            self._layouts[topic.definition] = cdr.Layouts(topic.type_name, message_types.types_of(topic))
        return self._layouts[topic.definition]


def _is_whole(part: cdr.Numbers | None) -> bool:
    """Whether a part of a stamp is one whole number of at most 32 bits, as in ROS; a bag may define it otherwise."""
    return part is not None and part.count == 1 and part.dtype.kind in "iu" and part.dtype.itemsize <= 4


class _DecodedColumns:
    """The numbers of all messages of one layout; grows as they come."""

    def __init__(self, layout: cdr.Layout, capacity: int) -> None:
        self.layout, self.count = layout, 0
        self.columns: dict[str, NDArray] = {name: np.empty(capacity, np.int64) for name in ("rows", "log_ns")}
        if all(_is_whole(layout.numbers.get(path)) for path in (_SECONDS, _NANOSECONDS)):
            self.columns["stamp_ns"] = np.empty(capacity, np.int64)
        self.values: dict[str, NDArray] = {}
        for path, numbers in layout.numbers.items():
            if numbers.dtype.kind != "f" and "time_from_start" not in path:
                continue
            if numbers.count > limits.COLUMNS:
                raise RecordingError(
                    f"field {path} holds {numbers.count} numbers, {limits.COLUMNS} are the limit",
                    "Record a topic with one number a joint.",
                )
            self.values[path] = np.empty((capacity, numbers.count), numbers.dtype)

    def append(self, spans: Spans, rows: Stamps, log_ns: Stamps) -> None:
        """Decode messages; `rows` are their places among the topic's messages."""
        spot = slice(self.count, self.count + len(rows))
        self._reserve(spot.stop)
        self.columns["rows"][spot], self.columns["log_ns"][spot] = rows, log_ns
        if "stamp_ns" in self.columns:
            stamps = self.columns["stamp_ns"][spot]
            np.multiply(self.layout.values(spans, _SECONDS)[:, 0], 1_000_000_000, out=stamps, dtype=np.int64)
            stamps += self.layout.values(spans, _NANOSECONDS)[:, 0]
        for path, target in self.values.items():
            self.layout.values_into(spans, path, target[spot])
        self.count = spot.stop

    def piece(self) -> Piece:
        """Return the messages as arrays, without a copy where they have the machine's own byte order."""
        rows, log_ns = self.columns["rows"][: self.count], self.columns["log_ns"][: self.count]
        stamp_ns = self.columns["stamp_ns"][: self.count] if "stamp_ns" in self.columns else None
        names = tuple(next(iter(self.layout.strings.values()), []))
        values = {path: np.asarray(target[: self.count], np.float64) for path, target in self.values.items()}
        return Piece(rows, log_ns, stamp_ns, names, values)

    def _reserve(self, count: int) -> None:
        for arrays in (self.columns, self.values):
            for name, array in arrays.items():
                if len(array) < count:
                    grown = np.empty((max(count, 2 * len(array)), *array.shape[1:]), array.dtype)
                    grown[: self.count] = array[: self.count]
                    arrays[name] = grown
