"""Work shared out among threads: as by one alone, in order, and never waiting for a pool that is busy."""

from __future__ import annotations

import multiprocessing
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from elastic_arm.codegen import parallel
from elastic_arm.codegen.parallel import ahead, in_chunks, share_out


@pytest.fixture(params=[1, 2, 3])
def cores(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """So many cores are there."""
    monkeypatch.setattr(parallel.os, "sched_getaffinity", lambda _: range(request.param), raising=False)
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
def test_an_error_reaches_the_caller_and_leaves_the_pool_usable(way: Callable[..., Iterator[int]]) -> None:
    def fails(number: int) -> int:
        if number == 4:
            raise ValueError("the fourth")
        return number

    with pytest.raises(ValueError, match="the fourth"):
        list(way(fails, range(9)))
    assert list(way(square, range(5))) == [0, 1, 4, 9, 16]


def test_of_several_errors_the_first_item_s_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second item fails first, but `ahead` raises the error of the first, as on one thread."""
    monkeypatch.setattr(parallel.os, "sched_getaffinity", lambda _: range(3), raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    failed = threading.Event()

    def work(number: int) -> None:
        if number == 0:
            assert failed.wait(10.0)
        failed.set()
        raise ValueError(f"item {number}")

    with pytest.raises(ValueError, match="item 0"):
        list(ahead(work, range(9)))


@pytest.mark.skipif(np.lib.NumpyVersion(np.__version__) < "2.0.0", reason="NumPy keeps them by thread before 2.0")
def test_an_item_sees_the_numerical_settings_of_its_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is wrong in one is as wrong there as without threads."""
    monkeypatch.setattr(parallel.os, "sched_getaffinity", lambda _: range(2), raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    met = threading.Barrier(2, timeout=10.0)

    def divided(x: np.ndarray) -> np.ndarray:
        met.wait()
        if threading.current_thread() is threading.main_thread():
            return x
        return x / np.zeros(1000)

    with np.errstate(divide="raise"), pytest.raises(FloatingPointError):
        share_out(divided, [np.ones(1000), np.ones(1000)])


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


def test_the_variable_means_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """With OMP_NUM_THREADS=1 all is done by the thread that asks, item after item."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    here = threading.get_ident()
    assert {*share_out(lambda _: threading.get_ident(), range(8))} == {here}
    assert {*ahead(lambda _: threading.get_ident(), range(8))} == {here}


def test_shared_work_shares_nothing_out_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """Within a thread of the pool there is one thread, and work shared out there ends all the same."""
    monkeypatch.setattr(parallel.os, "sched_getaffinity", lambda _: range(2), raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    met = threading.Barrier(2, timeout=10.0)

    def inner(_: int) -> tuple[bool, int, list[int]]:
        met.wait()  # so that both threads take one
        own = threading.current_thread() is threading.main_thread()
        return own, parallel.threads(), share_out(square, range(4))

    found = sorted(share_out(inner, range(2)))
    assert found == [(False, 1, [0, 1, 4, 9]), (True, 2, [0, 1, 4, 9])]


def test_nobody_waits_for_a_busy_pool(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel.os, "sched_getaffinity", lambda _: range(2), raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    released = threading.Event()
    busy = parallel._pool(1).submit(released.wait, 30.0)
    try:
        assert share_out(square, range(5)) == [0, 1, 4, 9, 16]
        assert list(ahead(square, range(5))) == [0, 1, 4, 9, 16]
        assert not busy.done()
    finally:
        released.set()


def test_what_is_not_wanted_any_more_is_not_begun_and_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of an iteration that ends early, nothing further is made, and a busy pool holds none of its arguments."""
    monkeypatch.setattr(parallel.os, "sched_getaffinity", lambda _: range(2), raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    released, made = threading.Event(), []
    parallel._pool(1).submit(released.wait, 30.0)
    try:
        arrays = [np.zeros(3) for _ in range(9)]
        held = [weakref.ref(array) for array in arrays]
        for number, _ in enumerate(ahead(lambda array: made.append(len(array)), iter(arrays))):
            if number == 1:
                break
        assert len(made) == 2
        del arrays
        assert not [one for one in held if one() is not None]
    finally:
        released.set()


def test_no_more_than_a_few_items_are_begun_ahead(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a machine of 64 cores a recording is not in memory as a whole either."""
    monkeypatch.setattr(parallel.os, "sched_getaffinity", lambda _: range(64), raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    given: list[int] = []

    def numbers() -> Iterator[int]:
        for k in range(50):
            given.append(k)
            yield k

    for used, found in enumerate(ahead(square, numbers()), 1):
        assert found == (used - 1) ** 2
        assert len(given) <= used + parallel._MOST_AHEAD


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
