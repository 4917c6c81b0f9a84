"""Independent tasks over the machine's cores, with progress."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Any, TypeVar

from elastic_arm.interrupts import interrupts_held, take_interrupts

Result = TypeVar("Result")
Task = Callable[[], Any]
Advance = Callable[[], None]
Results = Callable[[], list[Result]]
"""Waits for tasks that were begun, and returns their results in order."""


class ProcessPool:
    """Processes that run tasks; a context."""

    def __init__(self, workers: int) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._own: set[BaseProcess] = set()
        if workers > 1:
            # Spawned, not forked: this process may hold threads of the kernels' engine.
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin)

    def __enter__(self) -> ProcessPool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            if kind is KeyboardInterrupt:  # nobody waits for what they are at
                for process in self._own:
                    process.terminate()
            self._pool.shutdown(cancel_futures=True)

    def start(self, tasks: Sequence[Task], advance: Advance) -> Results[Any]:
        """Begin tasks (functions of a module, bound to their arguments); what is begun first is done first.

        Returns a function that waits for the tasks and returns their results in order. A task's error
        is raised there, or here where there is one process.
        """
        if self._pool is None:
            results = []
            for task in tasks:
                results.append(task())
                advance()
            return lambda: results
        with interrupts_held():
            others = set(multiprocessing.active_children())
            futures = [self._pool.submit(task) for task in tasks]
            self._own |= set(multiprocessing.active_children()) - others
        for future in futures:
            future.add_done_callback(lambda _: advance())
        return lambda: [future.result() for future in futures]

    def run(self, tasks: Sequence[Task], advance: Advance) -> list[Any]:
        """Run tasks and return their results in order: :meth:`start` and the wait for all of them."""
        return self.start(tasks, advance)()


def _begin() -> None:
    """Take one thread, and end quietly on a Ctrl-C, which reaches all processes of a terminal, and with the parent."""
    take_interrupts(signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"


def _end_with_parent() -> None:
    """End this process once its parent has gone, be it killed: nobody would hand it another task."""
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)
