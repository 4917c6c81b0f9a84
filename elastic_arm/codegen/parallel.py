"""Samples, or other independent parts of a job, shared out among the cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from contextvars import copy_context
from functools import cache
from threading import local
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

# Below this many samples a second thread costs more than it saves.
_WORTH_A_THREAD = 2048
# Parts this long are worth sharing out more finely, for threads that the rest of the machine delays.
_WORTH_A_PART = 16384
_PARTS_A_THREAD = 4
# Parts begin on multiples of this many samples, so that outputs of theirs begin on cache lines.
_BLOCK = 64
_THREAD = local()  # has `shares` in a thread that works on a part: what that would share out, it does alone


def threads() -> int:
    """Return how many threads may share a job: the process's cores, or fewer by OMP_NUM_THREADS; one within a part."""
    if hasattr(_THREAD, "shares"):
        return 1
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return max(1, min(available, int(asked))) if asked.isdigit() else available


def in_chunks(samples: int, work: Callable[[int, int], None]) -> None:
    """Call `work(start, stop)` for parts of the samples on all threads, this one included; each takes the next part."""
    count = min(threads(), max(1, samples // _WORTH_A_THREAD))
    if count == 1:
        work(0, samples)
        return
    parts = max(count, min(_PARTS_A_THREAD * count, samples // _WORTH_A_PART))
    step = -(-samples // (parts * _BLOCK)) * _BLOCK
    todo = iter(range(0, samples, step))

    def take() -> None:
        for start in todo:
            work(start, min(start + step, samples))

    others = [_pool(count - 1).submit(take) for _ in range(count - 1)]
    try:
        take()
    finally:
        wait(others)
    for other in others:
        other.result()


def share_out(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Return `work(item)` of all items, in their order, on all threads; each takes the next item.

    It pays where NumPy, BLAS, transforms and kernels let go of the interpreter for most of the time. Results do not
    depend on the threads; of several items that fail, the first one's error is raised, as without them.

    Parameters
    ----------
    work
        Of one item. What it reads must not be changed by another's.
    items
        All parts of the job.
    """
    todo = list(items)
    count = threads()
    if min(count, len(todo)) <= 1:
        return [work(item) for item in todo]
    parts = [_pool(count).submit(copy_context().run, work, item) for item in todo]
    try:
        return [part.result() for part in parts]
    finally:
        # After an error or Ctrl-C no other part is begun, and none still runs when the caller goes on.
        for part in parts:
            part.cancel()
        wait(parts)


@cache
def _pool(size: int) -> ThreadPoolExecutor:
    """Return so many threads that work on parts of a job; made once."""
    return ThreadPoolExecutor(size, "elastic-arm", lambda: setattr(_THREAD, "shares", True))


# A forked child has the pools but not their threads.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)
