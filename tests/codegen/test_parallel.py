"""Parts of a job shared out among the cores."""

from __future__ import annotations

import os
import threading
import time

import numpy as np
import pytest

from elastic_arm.codegen.parallel import share_out, threads
from tests.helpers.interrupted import interrupted

INTERRUPTED = """
import os, sys, time
os.sched_getaffinity = lambda process: {0, 1}
from elastic_arm.codegen.parallel import share_out

def work(k):
    print(k, file=sys.stderr, flush=True)
    time.sleep(0.5)

print("begun", flush=True)
share_out(work, range(1000))
"""


@pytest.fixture
def two_threads(monkeypatch):
    """Have the process use two cores, whatever the machine has."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1}, raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "2")


def test_results_come_in_the_order_of_the_parts_whatever_thread_made_them(two_threads):
    """Two threads work at the same time: each waits for the other; a part that is slow does not move its result."""
    together, first_two = threading.Barrier(2, timeout=10.0), {0, 1}

    def work(k: int) -> int:
        if k in first_two:
            together.wait()
        return k * k

    assert share_out(work, iter(range(50))) == [k * k for k in range(50)]


def test_one_thread_is_asked_for_by_the_environment(two_threads, monkeypatch):
    """With OMP_NUM_THREADS=1 the calling thread does all."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert share_out(lambda k: threading.current_thread(), range(4)) == [threading.current_thread()] * 4


def test_what_a_part_shares_out_it_does_alone(two_threads):
    """A thread that waited for others of a pool that is busy with its own kind would wait for ever."""

    def work(k: int) -> tuple[int, bool]:
        own = threading.current_thread()
        return threads(), all(one is own for one in share_out(lambda _: threading.current_thread(), range(5)))

    assert share_out(work, range(4)) == [(1, True)] * 4
    assert threads() == 2


def test_of_several_errors_the_first_part_s_is_raised_and_no_further_part_is_begun(two_threads):
    """The second part fails first, but the error is that of the first, as on one thread."""
    failed, begun = threading.Event(), []

    def work(k: int) -> None:
        begun.append(k)
        if k == 0:
            assert failed.wait(10.0)
        if k == 1:
            failed.set()
        if k > 1:
            time.sleep(0.01)
        raise ValueError(f"part {k}")

    with pytest.raises(ValueError, match="part 0"):
        share_out(work, range(1000))
    count = len(begun)
    assert count < 1000
    assert share_out(abs, [-1, -2]) == [1, 2]
    assert len(begun) == count


def test_a_part_sees_the_numerical_settings_of_its_caller(two_threads):
    """What is wrong in a part is as wrong there as without threads."""
    with np.errstate(divide="raise"), pytest.raises(FloatingPointError):
        share_out(lambda x: x / np.zeros(1000), [np.ones(1000), np.ones(1000)])


def test_ctrl_c_ends_a_job_after_the_parts_that_run():
    """The parts that run are ended, none is begun after them, and the process ends as interrupted."""
    status, complaints = interrupted(["-c", INTERRUPTED], 0.7, 10.0)
    assert "KeyboardInterrupt" in complaints
    assert status != 0
    assert len([line for line in complaints.splitlines() if line.isdigit()]) <= 6


def test_a_forked_process_shares_out_with_threads_of_its_own(two_threads):
    """The parent's threads are not there after a fork."""
    assert share_out(abs, [-1, -2, -3]) == [1, 2, 3]
    child = os.fork()
    if child == 0:
        os._exit(0 if share_out(abs, [-4, -5, -6]) == [4, 5, 6] else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
