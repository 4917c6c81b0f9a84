"""Samples shared out among the cores."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache

# Below this many samples a second thread costs more than it saves.
_WORTH_A_THREAD = 2048
# Parts this long are worth sharing out more finely, for threads that the rest of the machine delays.
_WORTH_A_PART = 16384
_PARTS_A_THREAD = 4
# Parts begin on multiples of this many samples, so that outputs of theirs begin on cache lines.
_BLOCK = 64


def threads() -> int:
    """Cores this process may use; OMP_NUM_THREADS bounds them."""
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


@cache
def _pool(size: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(size, thread_name_prefix="elastic-arm-kernel")


# A forked child has the pool but not its threads.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)
