"""Independent pieces of work over the machine's cores, with word of each that is done."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any

Task = Callable[[], Any]
Advance = Callable[[], None]


def run_all(tasks: Sequence[Task], workers: int, advance: Advance) -> list[Any]:
    """Run tasks (functions of a module, bound to their arguments) and return their results in order.

    Parameters
    ----------
    workers
        Processes; 1 runs everything in this one.
    advance
        Called after each task.
    """
    if workers <= 1 or len(tasks) <= 1:
        results = []
        for task in tasks:
            results.append(task())
            advance()
        return results
    # Spawned, not forked: this process may hold threads of the kernels' engine.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(workers, len(tasks)), mp_context=context, initializer=_one_thread_each) as pool:
        futures = [pool.submit(task) for task in tasks]
        for _ in as_completed(futures):
            advance()
        return [future.result() for future in futures]


def _one_thread_each() -> None:
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
