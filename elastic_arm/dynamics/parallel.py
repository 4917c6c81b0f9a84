"""Samples shared out among the cores."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

# Below this many samples a second thread costs more than it saves.
_WORTH_A_THREAD = 2048
# Parts begin on multiples of this many samples, so that outputs of theirs begin on cache lines.
_BLOCK = 64


def threads() -> int:
    """Cores this process may use; OMP_NUM_THREADS bounds them."""
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return max(1, min(available, int(asked))) if asked.isdigit() else available


def in_chunks(samples: int, work: Callable[[int, int], None]) -> int:
    """Call `work(start, stop)` for as many parts of the samples as there are threads; return how many."""
    parts = max(1, min(threads(), samples // _WORTH_A_THREAD))
    if parts == 1:
        work(0, samples)
        return 1
    step = -(-samples // (parts * _BLOCK)) * _BLOCK
    starts = range(0, samples, step)
    for done in [_pool(parts).submit(work, start, min(start + step, samples)) for start in starts]:
        done.result()
    return len(starts)


@cache
def _pool(size: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(size, thread_name_prefix="elastic-arm-kernel")


# A forked child has the pool but not its threads.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)
