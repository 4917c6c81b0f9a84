"""Ctrl-C, which reaches all processes of a terminal: those that are just starting, too, and libraries that take it.

A Python that is interrupted while it loads prints a traceback. Processes that are spawned within
:func:`interrupts_held` begin with SIGINT held back, and take it from :func:`take_interrupts` on.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Hold SIGINT back in this thread and in the processes that it spawns meanwhile."""
    # It starts with the first process that is spawned, and takes SIGINT again for the thread that starts it.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def take_interrupts(handler: Callable[..., Any] | signal.Handlers) -> None:
    """Take SIGINT from now on in a process that was spawned so, one that came meanwhile too.

    Parameters
    ----------
    handler
        As for `signal.signal`.
    """
    signal.signal(signal.SIGINT, handler)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


class NotedInterrupts:
    """Calls a function on SIGINT while a library runs that takes it for itself, as NOMAD does at every step, for good.

    A context, in which nothing is raised: a library that calls Python swallows what is. Behind it SIGINT does what it
    did before. Where it was ignored, or ends the process, it is and does so within, too, without a call. In other
    threads than the main one nothing is done.

    Parameters
    ----------
    note
        Called on each SIGINT.
    """

    def __init__(self, note: Callable[[], None]) -> None:
        self._note = note
        self._before = signal.getsignal(signal.SIGINT)
        self._main = threading.current_thread() is threading.main_thread()

    def __enter__(self) -> NotedInterrupts:
        return self

    def __exit__(self, *_: object) -> None:
        if self._main and self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def take(self) -> None:
        """Take SIGINT back from the library, which has called Python."""
        before = self._before
        if self._main and before is not None:
            signal.signal(signal.SIGINT, (lambda number, frame: self._note()) if callable(before) else before)
