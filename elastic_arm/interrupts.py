"""Ctrl-C reaches all processes of a terminal, including those that are just starting, and libraries
that handle it themselves.

A Python process that is interrupted while it loads prints a traceback. Processes that are spawned
within :func:`interrupts_held` start with SIGINT blocked, and accept it from :func:`take_interrupts`
on.
"""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Hold SIGINT back in this thread and in the processes that it spawns meanwhile."""
    # It starts with the first process that is spawned, and takes SIGINT again for the thread that
    # starts it.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def take_interrupts(handler: Callable[..., Any] | signal.Handlers) -> None:
    """Take SIGINT from now on in a process that was spawned so, one that came meanwhile too."""
    signal.signal(signal.SIGINT, handler)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


@contextmanager
def interrupts_kept() -> Iterator[None]:
    """Keep SIGINT from a library that takes it for good, as NOMAD does at every step.

    It is held back in this thread and does behind it what it did before. A library that calls
    Python swallows what is raised there; it has to end by itself where :func:`interrupt_waits`.
    Whatever other threads take, it gets.
    """
    before = signal.getsignal(signal.SIGINT)
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread() and before is not None:
            signal.signal(signal.SIGINT, before)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def interrupts_count() -> bool:
    """Return whether SIGINT does anything, and is not ignored as in the background of a shell."""
    return signal.getsignal(signal.SIGINT) is not signal.SIG_IGN


def interrupt_waits() -> bool:
    """Return whether a SIGINT that counts has come and is held back."""
    return interrupts_count() and signal.SIGINT in signal.sigpending()
