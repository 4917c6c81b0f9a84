"""Jobs on a cluster of processes: where it listens, and how it ends."""

from __future__ import annotations

import multiprocessing
import time
from multiprocessing.process import BaseProcess
from pathlib import Path

import psutil
import pytest

from elastic_arm.studies.blind_challenge.parallel_jobs import _client
from tests.helpers.interrupted import interrupted


def test_a_cluster_of_this_machine_listens_on_loopback_alone() -> None:
    """Neither scheduler, worker nor dashboard can be reached from another machine."""
    with _client(1, None) as (client, _):
        client.wait_for_workers(1)
        here = psutil.Process()
        found = [c for p in (here, *here.children(recursive=True)) for c in p.net_connections("inet")]
        listening = {c.laddr.ip for c in found if c.status == psutil.CONN_LISTEN}
    assert listening
    assert listening <= {"127.0.0.1", "::1"}


SCRIPT = """
import sys, time
from elastic_arm.studies.blind_challenge.parallel_jobs import mapped
if __name__ == "__main__":
    print(flush=True)
    try:
        list(mapped(time.sleep, [60.0] * 4, workers=2))
    except KeyboardInterrupt:
        sys.exit(130)
"""


@pytest.mark.parametrize("delay", [2.0, 6.0])
def test_a_cluster_ends_quietly_on_an_interrupt(tmp_path: Path, delay: float) -> None:
    """Workers that are starting print nothing, and those that work are not waited for."""
    (tmp_path / "script.py").write_text(SCRIPT)
    status, complaints = interrupted([str(tmp_path / "script.py")], delay, patience=60.0)
    assert complaints == ""
    assert status == 130


def test_an_interrupt_ends_the_clusters_own_processes_alone(bystander: BaseProcess) -> None:
    """What else the process has started, as a user of the library may, goes on."""
    with pytest.raises(KeyboardInterrupt), _client(1, None) as (client, _):
        client.wait_for_workers(1)
        client.submit(time.sleep, 60.0)
        assert len(multiprocessing.active_children()) == 2
        raise KeyboardInterrupt
    bystander.join(0.5)  # it has been asked to end by now, if it has been at all
    assert multiprocessing.active_children() == [bystander]
