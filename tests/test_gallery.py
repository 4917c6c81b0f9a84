"""The table over all examples, run in folders of its own."""

import runpy
import sys
from pathlib import Path

import pytest

GALLERY = Path(__file__).resolve().parents[1] / "examples" / "gallery.py"


def test_relative_folders_are_those_of_the_caller(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An example finds its data, and notes the time of its commands, where data and results have relative paths."""
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
