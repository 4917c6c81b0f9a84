"""Progress of a long command, and Ctrl-C."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from rich.console import Console

from elastic_arm.cli.watching import WITH_COMMANDS, WITH_TORQUES, Progress, watched
from elastic_arm.evidence.watch import Stage
from elastic_arm.recording import write_recording
from tests.diagnosis.test_dry_friction import URDF, recording


@pytest.mark.parametrize("begins", [WITH_TORQUES, WITH_COMMANDS])
def test_lines_tell_a_growing_share(begins: dict[Stage, float]) -> None:
    """Every stage has a share; a stage half done lies between its begin and the next one's."""
    progress = Progress()
    shares = []
    for stage in Stage:
        for done in (0.0, 0.5):
            line = progress.line("words", begins, stage, done)
            shares.append(int(re.search(r"about (\d+)%", line).group(1)))
    assert shares == sorted(shares)
    assert shares[0] > 0
    assert shares[-1] < 100


def test_seconds_left_are_at_most_those_that_were_asked_for() -> None:
    """With --seconds, no line promises more time than that."""
    progress = Progress(seconds=5.0, begin=Progress().begin - 3.0)
    line = progress.line("words", WITH_TORQUES, Stage.CAUSES, 0.0)
    assert ", 2 s left:" in line


@pytest.fixture
def interrupts() -> Iterator[None]:
    """The usual answer to Ctrl-C: tests that run in the background ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interrupts")
def test_the_first_interrupt_asks_for_an_answer_and_the_second_ends() -> None:
    """After the first SIGINT the search is over; the second is a KeyboardInterrupt."""
    status = Console(quiet=True).status("")
    with watched(Progress(), status, commanded=False, quiet=True) as watch:
        assert not watch.is_over()
        os.kill(os.getpid(), signal.SIGINT)
        assert watch.is_over()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_search_that_begins_anew_does_not_step_back() -> None:
    progress = Progress()
    first = progress.line("words", WITH_TORQUES, Stage.CAUSES, 0.9)
    again = progress.line("words", WITH_TORQUES, Stage.ORDINARY, 0.0)
    assert first.split(",")[1] == again.split(",")[1]


def test_a_closed_pipe_costs_no_result(tmp_path: Path) -> None:
    """`diagnose … | head` has the files of the answer all the same."""
    (tmp_path / "pendulum.urdf").write_text(URDF)
    runs = (recording(k).between(0.0, 8.0) for k in (1, 2))
    bags = [write_recording(tmp_path / f"run_{k}", run) for k, run in enumerate(runs)]
    command = [sys.executable, "-m", "elastic_arm", "diagnose", bags[0], "--validate", bags[1]]
    options = ["--robot", tmp_path / "pendulum.urdf", "--out", tmp_path / "out"]
    reading, writing = os.pipe()
    os.close(reading)
    subprocess.run([*command, *options], stdout=writing, stderr=subprocess.DEVNULL, check=False)
    os.close(writing)
    assert (tmp_path / "out" / "diagnosis.json").exists()
    assert (tmp_path / "out" / "robot.yaml").exists()
