"""Samples shared out among the cores."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import wait

from elastic_arm.parallel import pool, threads

# Below this many samples a second thread costs more than it saves.
_WORTH_A_THREAD = 2048
# Parts this long are worth sharing out more finely, for threads that the rest of the machine delays.
_WORTH_A_PART = 16384
_PARTS_A_THREAD = 4
# Parts begin on multiples of this many samples, so that outputs of theirs begin on cache lines.
_BLOCK = 64


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

    others = [pool(count - 1).submit(take) for _ in range(count - 1)]
    try:
        take()
    finally:
        wait(others)
    for other in others:
        other.result()
