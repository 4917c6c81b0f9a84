"""Work shared out among threads: as by one alone, in order, and never waiting for a pool that is
busy."""

import multiprocessing
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from elastic_arm.codegen import parallel
from elastic_arm.codegen.parallel import ahead, in_chunks, share_out


@pytest.fixture(params=[1, 2, 3])
def cores(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """So many cores are there."""
    monkeypatch.setattr(
        parallel.os, "sched_getaffinity", lambda _: range(request.param), raising=False
    )
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert parallel.threads() == request.param
    return int(request.param)


def every(work: Callable[[int], int], items: range) -> Iterator[int]:
    """Hand on what `share_out` returns, as `ahead` yields it."""
    yield from share_out(work, items)


def square(number: int) -> int:
    """Take longest for the first numbers, so that later ones are there before."""
    time.sleep(0.002 if number < 3 else 0.0)
    return number * number


@pytest.mark.usefixtures("cores")
@pytest.mark.parametrize("way", [every, ahead])
def test_results_come_in_the_order_of_the_items(way: Callable[..., Iterator[int]]) -> None:
    for count in (0, 1, 2, 20):
        assert list(way(square, range(count))) == [k * k for k in range(count)]


@pytest.mark.usefixtures("cores")
@pytest.mark.parametrize("samples", [0, 1, 2048, 5000, 100_001])
def test_chunks_cover_all_samples_once(samples: int) -> None:
    seen = np.zeros(samples, dtype=int)

    def count(start: int, stop: int) -> None:
        seen[start:stop] += 1

    in_chunks(samples, count)
    assert (seen == 1).all()


@pytest.mark.usefixtures("cores")
@pytest.mark.parametrize("way", [every, ahead])
def test_an_error_reaches_the_caller_and_leaves_the_pool_usable(
    way: Callable[..., Iterator[int]],
) -> None:
    def fails(number: int) -> int:
        if number == 4:
            raise ValueError("the fourth")
        return number

    with pytest.raises(ValueError, match="the fourth"):
        list(way(fails, range(9)))
    assert list(way(square, range(5))) == [0, 1, 4, 9, 16]


def test_after_an_interrupt_nothing_further_is_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C, which the thread that asks receives, ends shared work with what the others are at."""
    monkeypatch.setattr(parallel.os, "sched_getaffinity", lambda _: range(2), raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    begun: list[int] = []

    def work(number: int) -> None:
        begun.append(number)
        if threading.current_thread() is threading.main_thread():
            raise KeyboardInterrupt
        time.sleep(0.01)

    with pytest.raises(KeyboardInterrupt):
        share_out(work, range(1000))
    assert len(begun) < 500


def test_shared_work_shares_nothing_out_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """Within a thread of the pool there is one thread, and work shared out there ends all the
    same."""
    monkeypatch.setattr(parallel.os, "sched_getaffinity", lambda _: range(2), raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    met = threading.Barrier(2, timeout=10.0)

    def inner(_: int) -> tuple[bool, int, list[int]]:
        met.wait()  # so that both threads take one
        own = threading.current_thread() is threading.main_thread()
        return own, parallel.threads(), share_out(square, range(4))

    found = sorted(share_out(inner, range(2)))
    assert found == [(False, 1, [0, 1, 4, 9]), (True, 2, [0, 1, 4, 9])]


def squares() -> list[int]:
    """Return some, by all threads."""
    return share_out(square, range(5))


def test_a_forked_process_has_threads_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel.os, "sched_getaffinity", lambda _: range(2), raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert squares() == [0, 1, 4, 9, 16]
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert pool.apply_async(squares).get(timeout=30.0) == [0, 1, 4, 9, 16]


def test_a_process_ends_while_work_lies_ahead() -> None:
    """An exit in the middle of an iteration leaves no thread behind that anyone would wait for."""
    program = (
        "import time\n"
        "from elastic_arm.codegen import parallel\n"
        "parallel.threads = lambda: 2\n"
        "for k in parallel.ahead(lambda k: time.sleep(0.01) or k, range(10**6)):\n"
        "    if k == 3: raise SystemExit(7)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], timeout=60.0, check=False)
    assert done.returncode == 7
