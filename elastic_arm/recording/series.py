"""The messages of one topic as arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from elastic_arm.errors import RecordingError
from elastic_arm.recording.sides import Array, Stamps


@dataclass(frozen=True)
class Piece:
    """The messages of one layout.

    Parameters
    ----------
    rows
        (m,) their places among the topic's messages, in file order.
    log_ns
        (m,) arrival times.
    stamp_ns
        (m,) header stamps; None where the type has no header.
    names
        What the message calls its columns; empty where it names none.
    values
        By field path: (m, columns).
    """

    rows: Stamps
    log_ns: Stamps
    stamp_ns: Stamps | None
    names: tuple[str, ...]
    values: dict[str, Array]

    def whole(self) -> bool:
        """Whether these are all messages from the first to the last."""
        return len(self.rows) > 0 and self.rows[-1] - self.rows[0] == len(self.rows) - 1

    def has(self, path: str) -> bool:
        """Whether these messages carry numbers in field `path`."""
        return path in self.values and self.values[path].shape[1] > 0


@dataclass
class Series:
    """All messages of one topic.

    Parameters
    ----------
    topic, type_name
        Of the messages.
    pieces
        Their numbers, one piece per layout; nearly always there is one alone.
    count
        Number of messages.
    """

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
        rows = np.sort(np.concatenate([piece.rows for piece in kept])) if kept else np.empty(0, np.int64)
        again = [
            Piece(np.searchsorted(rows, piece.rows), piece.log_ns, piece.stamp_ns, piece.names, piece.values)
            for piece in kept
        ]
        return Series(self.topic, self.type_name, again, len(rows))

    @cached_property
    def order(self) -> NDArray[np.intp] | slice:
        """The messages in the order of their arrival."""
        log_ns = self._gather(np.int64, lambda piece: piece.log_ns)
        return slice(None) if np.all(log_ns[1:] >= log_ns[:-1]) else np.argsort(log_ns, kind="stable")

    @cached_property
    def log_ns(self) -> Stamps:
        """(N,) arrival times."""
        return self._gather(np.int64, lambda piece: piece.log_ns)[self.order]

    @cached_property
    def stamp_ns(self) -> Stamps:
        """(N,) header stamps.

        Raises
        ------
        RecordingError
            If the messages have none.
        """
        for piece in self.pieces:
            if piece.stamp_ns is None:
                raise RecordingError(
                    f"{self.topic} ({self.type_name}) has no header stamp",
                    "Set 'time: arrival' in a channel map to use the arrival times.",
                )
        return self._gather(np.int64, lambda piece: piece.stamp_ns)[self.order]

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
        """Return field `path` for the columns named, (N, len(names)); None if no message carries it.

        Raises
        ------
        RecordingError
            If some messages carry it and others do not, or one of the names is missing.
        """
        if not self.has(path):
            return None
        wanted = tuple(names)
        return self._gather(np.float64, lambda piece: self._named(piece, path, wanted), len(wanted))[self.order]

    def column(self, path: str, index: int) -> Array:
        """Return one column of field `path` by its place, (N,).

        Raises
        ------
        RecordingError
            If a message has no such column.
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

    def all_columns(self) -> Iterator[tuple[str, str, Array]]:
        """Yield field path, column name and (N,) values of everything recorded; NaN where messages lack it."""
        for path in dict.fromkeys(path for piece in self.pieces for path in piece.values if piece.has(path)):
            holding = [piece for piece in self.pieces if piece.has(path)]
            width = max(piece.values[path].shape[1] for piece in holding)
            # A field such as a duration belongs to the message, not to its joints.
            of_joints = all(piece.values[path].shape[1] == len(piece.names) for piece in holding)
            names = self.names() if of_joints else [f"number {index}" for index in range(width)]
            spread = partial(_spread, path=path, names=names, of_joints=of_joints)
            table = self._gather(np.float64, spread, len(names))[self.order]
            yield from ((path, name, table[:, index]) for index, name in enumerate(names))

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
        places = _places(piece.names)
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


def _spread(piece: Piece, path: str, names: Sequence[str], of_joints: bool) -> Array:
    """Lay the columns of a piece under `names`, which are those of joints or places; NaN where it has none."""
    table = np.full((len(piece.rows), len(names)), np.nan)
    if piece.has(path):
        values = piece.values[path]
        own = piece.names if of_joints else names[: values.shape[1]]
        places = _places(names)
        table[:, [places[name] for name in own]] = values
    return table


def _places(names: Sequence[str]) -> dict[str, int]:
    """Return where each name stands; the first place where it stands several times."""
    return {name: place for place, name in reversed(list(enumerate(names)))}


def _at(piece: Piece) -> str:
    stamps = piece.stamp_ns if piece.stamp_ns is not None else piece.log_ns
    return f" at {stamps[0] * 1e-9:.6f} s" if len(stamps) else ""
