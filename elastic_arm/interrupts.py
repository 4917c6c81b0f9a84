"""Ctrl-C, which reaches all processes of a terminal, and processes that are just starting.

A Python that is interrupted while it loads prints a traceback. Processes that are spawned within
:func:`interrupts_held` begin with SIGINT held back, and take it from :func:`take_interrupts` on.
"""

from __future__ import annotations

import signal
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
