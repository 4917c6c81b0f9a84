"""Work distributed over the cores by threads, for NumPy, SciPy and compiled code, which release the
interpreter lock.

There is one pool, and its threads do not distribute work themselves. The calling thread does the
work that no thread has started when it becomes idle, so that nobody waits for a busy pool.
"""

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextvars import copy_context
from functools import cache, partial
from typing import Generic, TypeVar, cast

Item = TypeVar("Item")
Result = TypeVar("Result")

# Below this many samples a second thread costs more than it saves.
_WORTH_A_THREAD = 2048
# Parts this long are worth sharing out more finely, for threads that the rest of the machine
# delays.
_WORTH_A_PART = 16384
_PARTS_A_THREAD = 4
# Parts begin on multiples of this many samples, so that outputs of theirs begin on cache lines.
_BLOCK = 64
# So many further items are begun on machines of many cores: their results wait in memory.
_MOST_AHEAD = 4
# Whether this is a thread of the pool.
_OF_POOL = threading.local()


def threads() -> int:
    """Cores this thread may share work out to.

    OMP_NUM_THREADS bounds them; within shared work there is one.
    """
    if getattr(_OF_POOL, "value", False):
        return 1
    available = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return max(1, min(available, int(asked))) if asked.isdigit() else available


def in_chunks(samples: int, work: Callable[[int, int], None]) -> None:
    """Call `work(start, stop)` for parts of the samples on all threads.

    This thread takes part; each takes the next part.
    """
    count = min(threads(), max(1, samples // _WORTH_A_THREAD))
    if count == 1:
        work(0, samples)
        return
    parts = max(count, min(_PARTS_A_THREAD * count, samples // _WORTH_A_PART))
    step = -(-samples // (parts * _BLOCK)) * _BLOCK
    share_out(lambda start: work(start, min(start + step, samples)), range(0, samples, step))


def share_out(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Return `work(item)` of all items, in order, by all threads.

    This thread takes part; each takes the next item.

    It pays where NumPy, BLAS, transforms and kernels let go of the interpreter for most of the
    time. Results do not depend on the threads. After an error nothing further is begun; of several
    that fail, any one's is raised.

    work: of one item. What it reads must not be changed by another's.
    """
    parts = list(items)
    cores = threads()
    count = min(cores, len(parts))
    if count <= 1:
        return [work(part) for part in parts]
    done: dict[int, Result] = {}
    todo = iter(range(len(parts)))

    def take() -> None:
        for index in todo:
            done[index] = work(parts[index])

    others = [_pool(cores - 1).submit(copy_context().run, take) for _ in range(count - 1)]
    try:
        take()
    finally:
        deque(todo, 0)  # after an error, or Ctrl-C, nothing further is begun
        begun = [other for other in others if not other.cancel()]
        wait(begun)
    for other in begun:
        other.result()
    return [done[index] for index in range(len(parts))]


def ahead(work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yield `work(item)` of all items, in order; other threads work on the next ones.

    The error of an item comes in its turn, as without threads.
    """
    count = threads()
    if count == 1:
        yield from map(work, items)
        return
    begun: deque[_Task[Result]] = deque()
    try:
        for item in items:
            begun.append(_Task(partial(work, item), count - 1))
            if len(begun) > min(count, _MOST_AHEAD):
                yield begun.popleft().result()
        while begun:
            yield begun.popleft().result()
    finally:
        for task in begun:
            task.drop()


class _Task(Generic[Result]):
    """A call that the pool of so many threads makes, or whoever wants its result before the pool
    has come to it.

    The pool, which may be busy, holds on to the list of calls alone: a call that is done or dropped
    lets go of its arguments at once.
    """

    def __init__(self, call: Callable[[], Result], pool: int) -> None:
        # What is wrong in it is as wrong there as in the caller's thread: NumPy keeps that in the
        # context.
        self._calls: list[Callable[[], Result]] = [partial(copy_context().run, call)]
        self._future: Future[Result | None] = _pool(pool).submit(_made, self._calls)

    def result(self) -> Result:
        """Return what the call returns, or raise what it raises."""
        try:
            call = self._calls.pop()
        except IndexError:  # the pool has taken it
            return cast("Result", self._future.result())
        return call()

    def drop(self) -> None:
        """Leave the call out, unless the pool has begun it."""
        self._calls.clear()


def _made(calls: list[Callable[[], Result]]) -> Result | None:
    try:
        call = calls.pop()
    except IndexError:  # whoever wanted the result has made the call
        return None
    return call()


@cache
def _pool(size: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(size, thread_name_prefix="elastic-arm", initializer=_join_pool)


def _join_pool() -> None:
    _OF_POOL.value = True


# A forked child has the pool but not its threads.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)
