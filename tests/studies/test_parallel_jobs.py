"""Jobs on a cluster of processes: where it listens."""

from __future__ import annotations

import psutil

from elastic_arm.studies.blind_challenge.parallel_jobs import _client


def test_a_cluster_of_this_machine_listens_on_loopback_alone() -> None:
    """Neither scheduler, worker nor dashboard can be reached from another machine."""
    with _client(1, None) as (client, _):
        client.wait_for_workers(1)
        here = psutil.Process()
        found = [c for p in (here, *here.children(recursive=True)) for c in p.net_connections("inet")]
        listening = {c.laddr.ip for c in found if c.status == psutil.CONN_LISTEN}
    assert listening
    assert listening <= {"127.0.0.1", "::1"}
