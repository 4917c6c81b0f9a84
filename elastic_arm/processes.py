"""Independent tasks on all cores, or on the workers of a Dask cluster, with progress."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from functools import partial
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Any, Self, TypeVar

from elastic_arm.errors import ElasticArmError, one_line, require_libraries
from elastic_arm.interrupts import interrupts_held, take_interrupts

Result = TypeVar("Result")
Task = Callable[[], Any]
Advance = Callable[[], None]
Results = Callable[[], list[Result]]
"""Waits for tasks that were begun, and returns their results in order."""


class ProcessPool:
    """Processes that run tasks, as a context.

    They are those of a Dask cluster where its scheduler's address is given.
    """

    def __init__(self, workers: int, scheduler: str | None = None) -> None:
        self._pool: Executor | None = None
        self._own: set[BaseProcess] = set()
        if scheduler is not None:
            self._pool, self._end = _cluster(scheduler)
        elif workers > 1:
            # Spawned, not forked: this process may hold threads of the kernels' engine.
            context = multiprocessing.get_context("spawn")
            self._pool = pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin)
            self._end = partial(pool.shutdown, cancel_futures=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._pool is not None:
            if kind is KeyboardInterrupt:  # nobody waits for what they are at
                for process in self._own:
                    process.terminate()
            self._end()

    def start(self, tasks: Sequence[Task], advance: Advance) -> Results[Any]:
        """Begin tasks; what is begun first is done first.

        Tasks are functions of a module, bound to their arguments.

        Returns a function that waits for the tasks and returns their results in order. A task's
        error is raised there, or here where there is one process.
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
        """Run tasks and return their results in order.

        It is :meth:`start` and the wait for all of them.
        """
        return self.start(tasks, advance)()


def _cluster(scheduler: str) -> tuple[Executor, Callable[[], Any]]:
    """Return what hands tasks to a Dask cluster, and what leaves it, with the tasks that nobody
    waits for."""
    require_libraries("a cluster needs", "distributed")
    from distributed import Client

    try:
        client = Client(scheduler)
    except (OSError, ValueError) as error:
        problem = f"no Dask scheduler responds at {scheduler}: {one_line(str(error))}"
        raise ElasticArmError(
            problem,
            "Start `dask scheduler` and `dask worker`, and give the tcp:// address of the"
            " scheduler",
        ) from None
    return client.get_executor(pure=False), client.close


def _begin() -> None:
    """Take one thread, and end quietly on a Ctrl-C, which reaches all processes of a terminal, and
    with the parent."""
    take_interrupts(signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"


def _end_with_parent() -> None:
    """End this process once its parent has gone, be it killed: nobody would hand it another
    task."""
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)
