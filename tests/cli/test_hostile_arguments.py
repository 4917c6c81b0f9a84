"""Arguments and names that nobody expects: a line each, and no result is lost."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner, Result

from elastic_arm.app import app
from elastic_arm.cli import bag as bag_commands
from elastic_arm.cli.console import finite, out, print_json
from tests.helpers.motions import trajectory

NAMES = ["xd[/red]", "[bold]", "123", "a: b", "ü²", "a  b"]


def run(*arguments: object) -> Result:
    """Run `elastic-arm …`."""
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture
def motion(tmp_path: Path) -> Path:
    trajectory(n=3, period=0.5, ramp=0.1, periods=1).scaled(0.01).save(tmp_path / "motion.yaml")
    return tmp_path / "motion.yaml"


@pytest.mark.parametrize("command", [["simulate"], ["identify", "."], ["diagnose", "."], ["excite"], ["paper"]])
@pytest.mark.parametrize("name", ["x" * 300, "missing/" + "x" * 300, "x\udcff"])
def test_a_name_that_cannot_be_made_is_refused_before_the_work(command: list[str], name: str) -> None:
    """A name of 300 characters, or of bytes that are no text, ends every command with one line."""
    result = run(*command, "--out", name)
    assert result.exit_code == 2, result.output
    (line,) = result.stderr.splitlines()
    assert "too long" in line or "no UTF-8 text" in line
    assert len(line) < 200


@pytest.mark.parametrize(
    "command",
    [
        ["identify"],
        ["identify", "--validate"],
        ["diagnose"],
        ["bag", "info"],
        ["bag", "check"],
        ["bag", "import"],
        ["describe", "--robot"],
        ["replay"],
    ],
)
@pytest.mark.parametrize("name", ["x" * 300, "x" * 300 + ".xml", "x" * 300 + ".csv", "x" * 5000])
def test_a_name_that_no_file_can_have_is_refused(tmp_path: Path, command: list[str], name: str) -> None:
    """Whether it is that of a recording, a file of arrays or an arm."""
    given = [*command, str(tmp_path / name)]
    if command[-1] == "--validate":
        given.insert(1, str(tmp_path))
    result = run(*given)
    assert result.exit_code == 2, result.output
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: ")


@pytest.mark.parametrize("name", NAMES)
def test_results_are_there_whatever_the_folder_is_called(tmp_path: Path, motion: Path, name: str) -> None:
    """Names that look like markup, numbers or YAML are written and printed as they stand."""
    result = run("simulate", "--trajectory", motion, "--out", tmp_path / name, "--rate", 100)
    assert result.exit_code == 0, result.output
    assert str(tmp_path / name) in result.stdout
    checked = run("bag", "info", tmp_path / name)
    assert checked.exit_code == 0
    assert str(tmp_path / name) in checked.stdout


@pytest.mark.parametrize("name", NAMES)
def test_a_bag_is_replayed_whatever_it_is_called(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """The node gets the name of the bag as a text, also where YAML takes it for a number or a mapping."""
    called: list[list[str]] = []
    monkeypatch.setattr(bag_commands, "require_ros", lambda: None)
    monkeypatch.setattr(os, "execv", lambda _, arguments: called.append(arguments))
    assert run("bag", "replay", name).exit_code == 0
    (given,) = [word.removeprefix("bag:=") for word in called[0] if word.startswith("bag:=")]
    assert yaml.safe_load(given) == name


def test_text_that_is_no_markup_is_printed_as_it_stands(capsys: pytest.CaptureFixture[str]) -> None:
    """A closing tag that nothing opened does not end a command."""
    out.print("written: xd[/red]")
    assert capsys.readouterr().out == "written: xd[/red]\n"


def test_numbers_that_json_lacks_are_null_and_named(capsys: pytest.CaptureFixture[str]) -> None:
    """NaN and infinity become null; `not_finite` gives place and value."""
    print_json({"a": [1.0, float("nan")], "b": {"c": float("inf")}})
    told = json.loads(capsys.readouterr().out)
    assert told == {"a": [1.0, None], "b": {"c": None}, "not_finite": ["a[1]: nan", "b.c: inf"]}
    assert finite({"a": (1, "x", None)}, []) == {"a": [1, "x", None]}


def test_a_reader_that_goes_away_is_no_error() -> None:
    """`elastic-arm … | head` ends without a traceback."""
    command = "import os, sys; from elastic_arm.app import main; os.close(0); main()"
    process = subprocess.Popen(
        [sys.executable, "-c", command, "describe", "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None and process.stderr is not None
    process.stdout.close()
    assert process.stderr.read() == b""
    process.wait(60)
