"""Work shared out among the cores by threads: it is done in NumPy, SciPy and compiled code, which let threads run.

There is one pool, whose threads share nothing out themselves. Work that none of them has begun by the time the calling
thread has nothing else to do is done by that one: nobody waits for a pool that is busy with something else.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import cache
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
# Whether this is a thread of the pool.
_OF_POOL = threading.local()


def threads() -> int:
    """Cores this thread may share work out to: OMP_NUM_THREADS bounds them, and there is one within shared work."""
    if getattr(_OF_POOL, "value", False):
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
    each(lambda start: work(start, min(start + step, samples)), range(0, samples, step))


def each(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Return `work(item)` of all items, in their order, by all threads, this one included; each takes the next item."""
    count = min(threads(), len(items))
    if count <= 1:
        return [work(item) for item in items]
    done: dict[int, Result] = {}
    todo = iter(range(len(items)))

    def take() -> None:
        for index in todo:
            done[index] = work(items[index])

    others = [_pool(count - 1).submit(take) for _ in range(count - 1)]
    try:
        take()
    finally:
        begun = [other for other in others if not other.cancel()]
        wait(begun)
    for other in begun:
        other.result()
    return [done[index] for index in range(len(items))]


def ahead(work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yield `work(item)` of all items, in their order; the other threads work on the next ones meanwhile."""
    count = threads()
    if count == 1:
        yield from map(work, items)
        return
    todo = iter(items)
    begun: deque[tuple[Item, Future[Result]]] = deque()
    try:
        for item in todo:
            begun.append((item, _pool(count - 1).submit(work, item)))
            if len(begun) > count:
                yield _result(work, *begun.popleft())
        while begun:
            yield _result(work, *begun.popleft())
    finally:
        for _, future in begun:
            future.cancel()


def _result(work: Callable[[Item], Result], item: Item, future: Future[Result]) -> Result:
    return work(item) if future.cancel() else future.result()


@cache
def _pool(size: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(size, thread_name_prefix="elastic-arm", initializer=_join_pool)


def _join_pool() -> None:
    _OF_POOL.value = True


# A forked child has the pool but not its threads.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)
