"""Independent tasks over processes, and over the workers of a Dask cluster."""

import importlib
import math
import multiprocessing
import subprocess
import sys
import time
from functools import partial
from multiprocessing.process import BaseProcess

import psutil
import pytest

from elastic_arm.errors import ElasticArmError
from elastic_arm.processes import ProcessPool
from tests.helpers.interrupted import interrupted


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_in_the_order_of_the_tasks_and_each_is_counted(workers: int) -> None:
    """Whichever ends first, in one process or in several; a second batch may begin before the first
    is waited for."""
    done: list[int] = []
    with ProcessPool(workers) as pool:
        first = pool.start(
            [partial(math.factorial, k) for k in (2000, 3, 4)], lambda: done.append(1)
        )
        second = pool.start([partial(math.sqrt, 4.0)], lambda: done.append(2))
        assert second() == [2.0]
        assert [value % 10**9 for value in first()][1:] == [6, 24]
    assert sorted(done) == [1, 1, 1, 2]


def test_workers_of_a_cluster_give_the_same() -> None:
    """Results in order, a task's error where it is waited for; an address where none answers is
    refused in one line."""
    distributed = pytest.importorskip("distributed")
    local = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**local, protocol="tcp://") as cluster:
        done: list[int] = []
        with ProcessPool(1, cluster.scheduler_address) as pool:
            found = pool.run(
                [partial(math.factorial, k) for k in (3, 4, 3)], lambda: done.append(1)
            )
            assert (found, len(done)) == ([6, 24, 6], 3)
            with pytest.raises(ValueError, match="domain"):
                pool.run([partial(math.sqrt, -1.0)], lambda: None)
    quickly = importlib.import_module("dask").config.set(
        {"distributed.comm.timeouts.connect": "0.2s"}
    )
    with quickly, pytest.raises(ElasticArmError, match="no Dask scheduler responds"):
        ProcessPool(1, "tcp://127.0.0.1:9")


def test_a_tasks_error_is_raised_where_its_result_is_waited_for() -> None:
    """Not before, so that other stages are not disturbed, and not lost."""
    with ProcessPool(2) as pool:
        broken = pool.start([partial(math.sqrt, -1.0)], lambda: None)
        assert pool.run([partial(math.sqrt, 9.0)], lambda: None) == [3.0]
        with pytest.raises(ValueError, match="domain"):
            broken()


SCRIPT = """
import functools, sys, time
from elastic_arm.processes import ProcessPool
try:
    with ProcessPool(2) as pool:
        results = pool.start([functools.partial(time.sleep, 60.0)] * 2, lambda: None)
        print(flush=True)
        results()
except KeyboardInterrupt:
    sys.exit(130)
"""


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.05, 0.1, 0.3])
def test_processes_that_are_starting_end_quietly_on_an_interrupt(delay: float) -> None:
    """A Ctrl-C reaches all processes of a terminal, also those that still load."""
    status, complaints = interrupted(["-c", SCRIPT], delay, patience=30.0)
    assert complaints == ""
    assert status == 130


def test_an_interrupt_ends_the_pools_own_processes_alone(bystander: BaseProcess) -> None:
    """What else the process has started, as a user of the library may, goes on."""
    with pytest.raises(KeyboardInterrupt), ProcessPool(2) as pool:
        pool.start([partial(time.sleep, 60.0)] * 2, lambda: None)
        raise KeyboardInterrupt
    bystander.join(0.5)  # it has been asked to end by now, if it has been at all
    assert multiprocessing.active_children() == [bystander]


ORPHANS = """
import functools, multiprocessing, time
from elastic_arm.processes import ProcessPool
with ProcessPool(2) as pool:
    print(pool.run([functools.partial(abs, -1)] * 2, lambda: None), flush=True)
    print(*(process.pid for process in multiprocessing.active_children()), flush=True)
    pool.run([functools.partial(time.sleep, 60.0)] * 2, lambda: None)
"""


def test_processes_end_with_the_parent_however_it_ends() -> None:
    """A parent that is killed tells nobody; its processes would wait for another task for ever."""
    parent = subprocess.Popen(
        [sys.executable, "-c", ORPHANS], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    assert parent.stdout is not None and parent.stdout.readline()
    orphans = [psutil.Process(int(pid)) for pid in parent.stdout.readline().split()]
    parent.kill()
    parent.wait()
    _, alive = psutil.wait_procs(orphans, timeout=30.0)
    assert len(orphans) == 2 and not alive
