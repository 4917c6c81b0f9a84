"""Jobs on several processes: Dask on this machine, or a Dask cluster."""

from __future__ import annotations

import logging
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from elastic_arm.errors import MissingExtraError
from elastic_arm.interrupts import interrupts_held

# Each worker is one core's work; the libraries under it must not take more.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@dataclass(frozen=True)
class Failure:
    """A job that ended in an error of the program."""

    job: Any
    problem: str


def mapped(
    function: Callable[[Any], Any], jobs: Sequence[Any], workers: int = 0, scheduler: str | None = None
) -> Iterator[Any]:
    """Apply a function to jobs and yield what it returns, in any order.

    Where a worker meets an error, a :class:`Failure` stands in its place and the others go on; without workers, the
    error is raised.
    """
    if not jobs:
        return
    if not workers and scheduler is None:
        yield from map(function, jobs)
        return
    with _client(min(workers, len(jobs)), scheduler) as (client, as_completed):
        waiting = dict(zip(client.map(function, jobs, pure=False), jobs, strict=True))
        for future in as_completed(list(waiting)):
            job = waiting.pop(future)
            yield future.result() if future.status == "finished" else Failure(job, repr(future.exception()))


@contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[Any]:
    try:
        from distributed import Client, LocalCluster, as_completed
    except ImportError as error:
        raise MissingExtraError(
            "campaigns run in parallel on Dask, which is not installed",
            "Install it: pip install 'elastic-arm[challenge]', or run with --workers 0",
        ) from error
    if scheduler is not None:
        with Client(scheduler) as client:
            yield client, as_completed
        return
    with interrupts_held():  # for good in its threads and workers, which are ended below
        # A worker that an interrupt ended is reported as restarted, a warning, while the cluster closes.
        cluster = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address="127.0.0.1:0",
            env=ONE_THREAD,
            silence_logs=logging.ERROR,
        )
    with cluster, Client(cluster) as client:
        try:
            yield client, as_completed
        except (KeyboardInterrupt, GeneratorExit):  # nobody waits for what they are at
            own = {nanny.pid for nanny in cluster.workers.values()}
            for process in multiprocessing.active_children():
                if process.pid in own:
                    process.terminate()
            raise
