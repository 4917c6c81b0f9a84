"""Where in a bag a replay is, and when its next message is due."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from elastic_arm.nodes.support.wire import NANOSECONDS
from elastic_arm.recording.storage.messages import Message


class Playback:
    """The messages of a bag on a clock that may stand still, run faster and be set.

    read: returns the messages in the order they were logged, from the first on. `next` is the message that comes next,
    None at the end; `first_ns` when the first was logged, None of a bag without messages.
    """

    def __init__(self, read: Callable[[], Iterator[Message]]) -> None:
        self._read = read
        self.paused = False
        self._messages = read()
        self.next = next(self._messages, None)
        self.first_ns = None if self.next is None else self.next.log_ns
        self._place_ns = float(self.first_ns or 0)
        self._since: float | None = None

    def seek(self, to_ns: int) -> list[Message]:
        """Set the clock: the next message is the first logged at `to_ns` or later; return those passed over."""
        self._messages = self._read()
        self._since = None
        self._place_ns = float(max(to_ns, self.first_ns or 0))
        passed = []
        self.next = next(self._messages, None)
        while self.next is not None and self.next.log_ns < to_ns:
            passed.append(self.next)
            self.next = next(self._messages, None)
        return passed

    def wait(self, now: float, rate: float) -> float:
        """Return the seconds until the next message is due, zero or less when it is."""
        assert self.next is not None, "there is no next message"
        if self._since is not None and not self.paused:
            self._place_ns += (now - self._since) * rate * NANOSECONDS
        self._since = now
        return (self.next.log_ns - self._place_ns) / NANOSECONDS / rate

    def take(self) -> Message:
        """Return the next message and go on to the one behind it; a clock that stands still is set to it."""
        assert self.next is not None, "there is no next message"
        taken, self.next = self.next, next(self._messages, None)
        if self.paused:
            self._place_ns = max(self._place_ns, float(taken.log_ns))
        return taken
