"""Progress of long commands on a terminal or in a log, and their early end by time or Ctrl-C."""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType

from rich.markup import escape
from rich.status import Status

from elastic_arm.cli.console import err
from elastic_arm.cli.diagnosis_printing import print_first_look
from elastic_arm.evidence.watch import Stage, Watch

# Typical start of each stage as a share of the time of a command, measured on recordings of six
# axes, with torques and with commands only.
WITH_TORQUES = {
    Stage.CHECKED: 0.09,
    Stage.ORDINARY: 0.1,
    Stage.CAUSES: 0.17,
    Stage.CONFIRMED: 0.8,
    Stage.FOLLOWED: 0.83,
    Stage.CLOSED_LOOP: 0.87,
}
WITH_COMMANDS = {
    Stage.CHECKED: 0.05,
    Stage.ORDINARY: 0.06,
    Stage.CAUSES: 0.1,
    Stage.CONFIRMED: 0.35,
    Stage.FOLLOWED: 0.37,
    Stage.CLOSED_LOOP: 0.39,
}


@dataclass
class Progress:
    """The time of a diagnosis, and the typical share of its work that is done.

    seconds: time after which the search must end; None for no limit.
    """

    seconds: float | None = None
    begin: float = field(default_factory=time.monotonic)
    share: float = 0.0  # of the work that is done

    @property
    def spent(self) -> float:
        """Time since the start, s."""
        return time.monotonic() - self.begin

    def line(self, words: str, begins: dict[Stage, float], stage: Stage, done: float) -> str:
        """Return a line of a log: time spent, typical share of the work, time left, and words.

        begins: start of each stage as a share of the whole; done: share of this stage.
        """
        start = begins[stage]
        end = min((one for one in begins.values() if one > start), default=1.0)
        # The share never decreases, even if a search starts again without some events.
        self.share = max(self.share, start + done * (end - start))
        left = self.spent * (1.0 - self.share) / self.share
        if self.seconds is not None:
            left = min(left, max(self.seconds - self.spent, 0.0))
        return f"{self.spent:.0f} s, about {self.share:.0%}, {left:.0f} s left: {words}"


@contextmanager
def watched(progress: Progress, status: Status, *, commanded: bool, quiet: bool) -> Iterator[Watch]:
    """Watch a search: one line per stage in a log, a status on a terminal, and the first look.

    The first Ctrl-C ends the search with the best answer so far, and a second one the command.

    commanded: whether only commands and positions were recorded.
    """
    asked = threading.Event()
    begins = WITH_COMMANDS if commanded else WITH_TORQUES

    def show(text: str) -> None:
        if err.is_terminal:
            status.update(escape(text))
        elif not quiet:
            err.print(escape(text))

    def say(words: str, stage: Stage, done: float = 0.0) -> None:
        show(progress.line(words, begins, stage, done))

    def is_over() -> bool:
        late = progress.seconds is not None and progress.spent > progress.seconds
        return asked.is_set() or late

    before = signal.getsignal(signal.SIGINT)

    def interrupt(number: int, frame: FrameType | None) -> None:
        asked.set()
        signal.signal(signal.SIGINT, before)
        show("ending with the best answer so far; press Ctrl-C again to end at once")

    heeds = callable(before) and threading.current_thread() is threading.main_thread()
    if heeds:
        signal.signal(signal.SIGINT, interrupt)
    try:
        yield Watch(say, is_over) if quiet else Watch(say, is_over, print_first_look)
    finally:
        if heeds:
            signal.signal(signal.SIGINT, before)
