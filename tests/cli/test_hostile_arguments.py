"""Arguments and names that nobody expects: a line each, and no result is lost."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml

from elastic_arm.cli import bag as bag_commands
from elastic_arm.cli.console import finite, out, print_json
from tests.helpers.command_line import refusal, run
from tests.helpers.motions import trajectory
from tests.helpers.nightly import nightly

NAMES = ["xd[/red]", "[bold]", "123", "a: b", "ü²", "a  b"]


@pytest.fixture
def motion(tmp_path: Path) -> Path:
    trajectory(n=3, period=0.5, ramp=0.1, periods=1).scaled(0.01).save(tmp_path / "motion.yaml")
    return tmp_path / "motion.yaml"


@pytest.mark.parametrize(
    "command", [["simulate"], ["identify", "."], ["diagnose", "."], ["excite"], ["paper"]]
)
@pytest.mark.parametrize("name", ["x" * 300, "missing/" + "x" * 300, "x\udcff"])
def test_a_name_that_cannot_be_made_is_refused_before_the_work(
    command: list[str], name: str
) -> None:
    """A name of 300 characters, or of bytes that are no text, ends every command with one line."""
    line = refusal(*command, "--out", name)
    assert "too long" in line or "not valid UTF-8" in line
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
        ["history"],
        ["describe", "--robot"],
        ["replay"],
        ["challenge", "diagnose"],
        ["challenge", "score"],
    ],
)
@pytest.mark.parametrize("name", ["x" * 300, "x" * 300 + ".xml", "x" * 300 + ".csv", "x" * 5000])
def test_a_name_that_no_file_can_have_is_refused(
    tmp_path: Path, command: list[str], name: str
) -> None:
    """Whether it is that of a recording, a file of arrays or an arm."""
    given = [*command, str(tmp_path / name)]
    if command[-1] == "--validate":
        given.insert(1, str(tmp_path))
    refusal(*given)


@pytest.mark.parametrize("command", ["simulate", "excite", "paper"])
def test_a_folder_that_was_removed_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """Whoever works in it may have removed it in another terminal."""
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert "was removed" in refusal(command, "--out", "out")


@pytest.mark.parametrize("command", [["simulate", "--effect"], ["identify", ".", "--with"]])
def test_an_effect_that_cannot_be_is_not_repeated_at_length(
    tmp_path: Path, command: list[str]
) -> None:
    """The line has room for the effects that there are."""
    line = refusal(*command, "n" * 5000, "--out", tmp_path / "out")
    assert "coulomb_friction" in line
    assert "n" * 100 not in line


@pytest.mark.parametrize(
    "content", ["", "{", "[]", "{}", "[" * 100_000, '{"settings": 5}', "\0", None]
)
@pytest.mark.parametrize("command", ["create", "diagnose", "score"])
def test_a_damaged_manifest_of_a_challenge_is_refused(
    tmp_path: Path, command: str, content: str | None
) -> None:
    """Whatever stands in it; a pipe is not waited for."""
    manifest = tmp_path / "challenge.json"
    os.mkfifo(manifest) if content is None else manifest.write_text(content)
    workers = () if command == "score" else ("--workers", 1)
    assert str(manifest) in refusal("challenge", command, tmp_path, *workers)


@pytest.mark.parametrize("name", NAMES)
def test_results_are_there_whatever_the_folder_is_called(
    tmp_path: Path, motion: Path, name: str
) -> None:
    """Names that look like markup, numbers or YAML are written and printed as they stand."""
    result = run("simulate", "--trajectory", motion, "--out", tmp_path / name, "--rate", 100)
    assert result.exit_code == 0, result.output
    assert str(tmp_path / name) in result.stdout
    checked = run("bag", "info", tmp_path / name)
    assert checked.exit_code == 0
    assert str(tmp_path / name) in checked.stdout


@pytest.mark.parametrize("name", NAMES)
def test_a_bag_is_replayed_whatever_it_is_called(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """The node gets the name of the bag as a text, also where YAML takes it for a number or a
    mapping."""
    called: list[list[str]] = []
    monkeypatch.setattr(bag_commands, "require_ros", lambda what: None)
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


MAIN = "from elastic_arm.app import main; main()"
HEED = (
    "import signal; [signal.signal(number, signal.SIG_DFL) for number in (signal.SIGINT,"
    " signal.SIGTERM)]"
)
BAG = str(Path(__file__).parents[2] / "bags" / "validation")
SPEAKING = {"describe": ("describe",), "bag info": ("bag", "info", BAG, "--json")}


def in_a_process(
    arguments: Sequence[str], before: str = "", **options: Any
) -> subprocess.CompletedProcess[str]:
    """Run a command in a process of its own, after some Python; it heeds signals, also where the
    tests ignore them."""
    command = [sys.executable, "-c", f"{HEED}\n{before}\n{MAIN}", *arguments]
    return subprocess.run(command, text=True, timeout=60, **options)


@pytest.mark.parametrize("command", SPEAKING)
def test_an_output_that_takes_nothing_is_an_error_in_one_line(command: str) -> None:
    """A full disk behind `> file` is the user's to mend, and no traceback."""
    with Path("/dev/full").open("w") as full:
        done = in_a_process(SPEAKING[command], stdout=full, stderr=subprocess.PIPE)
    (line,) = done.stderr.splitlines()
    assert "stdout cannot be written (No space left on device)" in line
    assert done.returncode == 2


@pytest.mark.parametrize("command", SPEAKING)
@pytest.mark.parametrize("closed", ["012", *nightly(["2"])])
def test_outputs_that_are_closed_are_done_without(command: str, closed: str) -> None:
    """As behind `>&-`: the command does its work, and says nothing."""
    shut = "import os; " + "; ".join(f"os.close({number})" for number in closed)
    code = (
        f"{shut}; os.execv({sys.executable!r}, [{sys.executable!r}, '-c', {MAIN!r},"
        f" *{SPEAKING[command]!r}])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0
    assert not done.stderr


def test_a_reader_that_has_gone_ends_a_command_quietly() -> None:
    """As `head -1` does."""
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = in_a_process(SPEAKING["describe"], stdout=writing, stderr=subprocess.PIPE)
    finally:
        os.close(writing)
    assert done.returncode == 128 + signal.SIGPIPE
    assert not done.stderr


@pytest.mark.parametrize(
    "how", [{"LANG": "C", "LC_ALL": "C", "PYTHONUTF8": "0"}, {"PYTHONIOENCODING": "ascii"}]
)
def test_letters_that_the_output_cannot_show_are_written_as_codes(how: dict[str, str]) -> None:
    """A terminal of the C locale has no ²; whoever reads it sees which letter it is."""
    done = in_a_process(SPEAKING["describe"], env={**os.environ, **how}, capture_output=True)
    assert done.returncode == 0, done.stderr
    assert "m/s\\xb2" in done.stdout


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("swallowed", [0, 1])
def test_a_command_ends_quietly_when_it_is_interrupted(
    number: signal.Signals, swallowed: int
) -> None:
    """Also where a library catches the interrupt, as it would any error: it is raised once more."""
    before = f"""
import contextlib, os, signal, sys, time, elastic_arm.app, elastic_arm.cli.options as module
elastic_arm.app.AGAIN = 0.2
def load_arm(*_):
    left = {swallowed}
    os.kill(os.getpid(), {number:d}) if not left else None
    with contextlib.suppress(KeyboardInterrupt):
        os.kill(os.getpid(), {number:d})
    time.sleep(30)
module.load_arm = load_arm
"""
    done = in_a_process(("describe",), before, capture_output=True)
    assert done.returncode == 128 + number
    assert not done.stderr


def test_an_interrupt_that_a_library_turns_into_another_error_is_no_traceback() -> None:
    """An extension module that is interrupted while it loads raises an ImportError."""
    before = """
import os, signal, elastic_arm.cli.options as module
def load_arm(*_):
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt:
        raise ImportError("initialization failed")
module.load_arm = load_arm
"""
    done = in_a_process(("describe",), before, capture_output=True)
    assert done.returncode == 130
    assert not done.stderr


@pytest.mark.parametrize("loading", ["elastic_arm.memory", "elastic_arm.cli.application"])
def test_an_interrupt_while_libraries_load_ends_the_process_quietly(loading: str) -> None:
    """The second that this takes is one in which one may think better of it."""
    before = f"""
import os, signal, sys
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == "{loading}":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupt())
"""
    done = in_a_process(("describe",), before, capture_output=True)
    assert done.returncode == -signal.SIGINT
    assert not done.stderr


def test_a_bag_whose_name_is_no_text_is_not_replayed(tmp_path: Path) -> None:
    """ROS would refuse it by a traceback of its own."""
    assert "is not valid UTF-8" in refusal("bag", "replay", tmp_path / "x\udcff")
