"""Long work seen from a terminal or a log file, and ended early: by time, or by Ctrl-C."""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from rich.markup import escape
from rich.status import Status

from elastic_arm.cli.console import err
from elastic_arm.evidence.watch import Watch


@contextmanager
def ended_early(seconds: float | None, status: Status, *, quiet: bool) -> Iterator[Watch]:
    """Watch a search: a line a stage in a log, a status on a screen.

    The first Ctrl-C ends the search with the best answer so far, a second one ends the command.

    seconds: after which the search ends, too; None for no bound.
    """
    begin = time.monotonic()
    asked = threading.Event()

    def say(stage: str) -> None:
        spent = time.monotonic() - begin
        left = "" if seconds is None else f", {max(seconds - spent, 0.0):.0f} s left"
        text = f"{spent:.0f} s{left}: {stage}"
        if err.is_terminal:
            status.update(escape(text))
        elif not quiet:
            err.print(escape(text))

    def is_over() -> bool:
        return asked.is_set() or (seconds is not None and time.monotonic() - begin > seconds)

    before = signal.getsignal(signal.SIGINT)

    def interrupt(number: int, frame: FrameType | None) -> None:
        asked.set()
        signal.signal(signal.SIGINT, before)
        say("ending with the best answer so far; press Ctrl-C again to end at once")

    heeds = callable(before) and threading.current_thread() is threading.main_thread()
    if heeds:
        signal.signal(signal.SIGINT, interrupt)
    try:
        yield Watch(say, is_over)
    finally:
        if heeds:
            signal.signal(signal.SIGINT, before)
