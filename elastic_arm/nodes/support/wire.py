"""Messages at 1 kHz: bytes in, bytes out, with numpy views in between.

Building a Python message takes longer than sending it. The messages of a topic differ only in their
numbers, so one of them is serialised once and serves as a form. Incoming messages are stored as
bytes and decoded in batches.
"""

import struct
from collections import deque
from collections.abc import Iterator
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from numpy.typing import NDArray
from rclpy.serialization import serialize_message

from elastic_arm.errors import RecordingError
from elastic_arm.recording import cdr, limits

NANOSECONDS = 1_000_000_000


def nanoseconds(time: Time | Duration) -> int:
    """Return a stamp, or a span, of a message in ns."""
    return int(time.sec * NANOSECONDS + time.nanosec)


def stamp_of(stamp_ns: int) -> Time:
    """Return a stamp of a message."""
    sec, nanosec = divmod(stamp_ns, NANOSECONDS)
    return Time(sec=sec, nanosec=nanosec)


def span_of(span_ns: int) -> Duration:
    """Return a span of time of a message."""
    sec, nanosec = divmod(span_ns, NANOSECONDS)
    return Duration(sec=sec, nanosec=nanosec)


# Names of the joints, stamps (N,) in ns, numbers by field (N, count).
Decoded = tuple[tuple[str, ...], NDArray[np.int64], dict[str, NDArray]]


class Form:
    """A message to be filled in and published again and again.

    type_name: of the message, such as `sensor_msgs/msg/JointState`; message: an example whose
    strings and array lengths are those of every message to come.
    """

    def __init__(self, type_name: str, message: Any) -> None:
        self._buffer = bytearray(serialize_message(message))
        layout = cdr.layout_of(memoryview(self._buffer), type_name)
        self._stamp = next(
            layout.numbers[path].at
            for path in ("header.stamp.sec", "clock.sec")
            if path in layout.numbers
        )
        self.fields: dict[str, NDArray] = {
            path: np.frombuffer(self._buffer, numbers.dtype, numbers.count, numbers.at)
            for path, numbers in layout.numbers.items()
            if numbers.count
        }

    def filled(self, stamp_ns: int, **values: NDArray[np.float64]) -> bytes:
        """Return the message with this stamp and these fields, ready for `publish`."""
        struct.pack_into("<iI", self._buffer, self._stamp, *divmod(stamp_ns, NANOSECONDS))
        for name, value in values.items():
            self.fields[name][:] = value
        return bytes(self._buffer)


class Inbox:
    """Messages of one topic, to be decoded in batches.

    When it is full, the oldest messages are dropped. It counts messages that arrived, were dropped,
    or do not match their type (or have too many layouts).
    """

    def __init__(self, type_name: str, capacity: int = 20_000) -> None:
        self.type_name = type_name
        self.received = self.overflowed = self.unreadable = 0
        self._messages: deque[bytes] = deque(maxlen=capacity)

    def put(self, message: bytes) -> None:
        """Store a message; this is the callback of a raw subscription."""
        self.received += 1
        self.overflowed += len(self._messages) == self._messages.maxlen
        self._messages.append(message)

    def clear(self) -> None:
        """Discard all messages."""
        self._messages.clear()

    def __len__(self) -> int:
        return len(self._messages)

    def take(self) -> Iterator[Decoded]:
        """Empty the box: yield names, stamps (N,) ns and numbers by field (N, count), one layout at
        a time.

        Within a layout the order is that of arrival.
        """
        sizes: dict[int, list[bytes]] = {}
        for message in self._messages:
            sizes.setdefault(len(message), []).append(message)
        self._messages.clear()
        layouts = 0
        for size, messages in sizes.items():
            block = np.frombuffer(b"".join(messages), np.uint8).reshape(len(messages), size)
            while len(block) and layouts < limits.LAYOUTS:
                layouts += 1
                try:
                    layout = cdr.layout_of(block[0].data, self.type_name)
                except RecordingError:
                    self.unreadable += 1
                    block = block[1:]
                    continue
                alike = np.all(
                    [np.all(block[:, a:b] == block[0, a:b], axis=1) for a, b in layout.fixed],
                    axis=0,
                )
                yield _decoded(layout, block[alike])
                block = block[~alike]
            self.unreadable += len(block)


def _decoded(layout: cdr.Layout, block: NDArray[np.uint8]) -> Decoded:
    """Decode messages of one layout, (N, size) bytes."""
    numbers = {
        path: block[:, field.at : field.at + field.count * field.dtype.itemsize]
        .copy()
        .view(field.dtype)
        for path, field in layout.numbers.items()
    }
    seconds, rest = (
        numbers.pop(f"header.stamp.{part}")[:, 0].astype(np.int64) for part in ("sec", "nanosec")
    )
    return tuple(layout.strings.get("name", ())), seconds * NANOSECONDS + rest, numbers
