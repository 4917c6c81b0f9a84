"""The examples: the table over all of them, run in folders of its own, and the nodes of the demo,
which end with it."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from examples import demo

GALLERY = Path(__file__).resolve().parents[1] / "examples" / "gallery.py"


def test_relative_folders_are_those_of_the_caller(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An example finds its data, and notes the time of its commands, where data and results have
    relative paths."""
    examples = tmp_path / "examples"
    (examples / "one").mkdir(parents=True)
    (examples / "gallery.py").write_text(GALLERY.read_text())
    (examples / "one" / "run.sh").write_text('test -d "$1" && elastic-arm --version\n')
    (tmp_path / "data" / "one").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["gallery.py", "data", "--out", "results"])
    runpy.run_path(str(examples / "gallery.py"), run_name="__main__")
    ran = tmp_path / "results" / "one"
    assert (ran / "exit_status").read_text() == "0\n", (ran / "run.log").read_text()
    assert (ran / "times.tsv").read_text()


def test_nodes_that_do_not_end_are_not_waited_for_by_an_interrupt(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a demo that is stopped nothing is left behind, and nobody waits for half a minute."""
    monkeypatch.setattr(demo, "ABANDONED", 0.3)
    deaf = (
        "import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); print(flush=True);"
        " time.sleep(60)"
    )
    started = [
        subprocess.Popen([sys.executable, "-c", deaf], stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    for node in started:
        assert node.stdout is not None and node.stdout.readline()
    nodes = demo.Nodes(tmp_path, 1)
    nodes.processes = {str(k): node for k, node in enumerate(started)}
    with pytest.raises(KeyboardInterrupt), demo.started(nodes):
        raise KeyboardInterrupt
    assert all(node.poll() for node in started)
