"""The nodes of the demo end with it."""

import subprocess
import sys
from pathlib import Path

import pytest

from examples import demo


def test_nodes_that_do_not_end_are_not_waited_for_by_an_interrupt(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a demo that is stopped nothing is left behind, and nobody waits for half a minute."""
    monkeypatch.setattr(demo, "ABANDONED", 0.3)
    deaf = "import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); print(flush=True); time.sleep(60)"
    started = [subprocess.Popen([sys.executable, "-c", deaf], stdout=subprocess.PIPE, text=True) for _ in range(3)]
    for node in started:
        assert node.stdout is not None and node.stdout.readline()
    nodes = demo.Nodes(tmp_path, 1)
    nodes.processes = {str(k): node for k, node in enumerate(started)}
    with pytest.raises(KeyboardInterrupt), demo.started(nodes):
        raise KeyboardInterrupt
    assert all(node.poll() for node in started)
