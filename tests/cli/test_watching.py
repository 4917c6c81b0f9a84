"""Progress of a long command, and Ctrl-C."""

import os
import re
import signal

import pytest
from rich.console import Console

from elastic_arm.cli.watching import WITH_COMMANDS, WITH_TORQUES, Progress, watched
from elastic_arm.evidence.watch import Stage


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
