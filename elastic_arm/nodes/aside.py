"""Work that takes seconds, in a process of low priority: the node's own thread goes on taking samples meanwhile."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from elastic_arm.errors import ElasticArmError, GraphError

# How much lower the priority is: what a busy machine lacks is taken from here first.
NICE = 5
# How long a process that is asked to end may take, seconds.
PATIENCE = 1.0


@dataclass(frozen=True)
class Answer:
    """What came of a question: a value, or what was wrong with the question, in words."""

    value: Any = None
    problem: str = ""


class Aside:
    """A process that answers one question after another.

    Parameters
    ----------
    make
        Called in the process with `args`; returns what answers questions. Both are importable by name.
    args
        What the process needs to know; questions and answers go through a pipe, so all are plain data.
    """

    def __init__(self, make: Callable[..., Callable[[Any], Any]], *args: Any) -> None:
        # A fork would take the threads' locks of the middleware along.
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, make, args), daemon=True)
        self._process.start()
        theirs.close()
        self._asked = 0

    @property
    def busy(self) -> bool:
        """Whether an answer is still to come."""
        return self._asked > 0

    def ask(self, question: Any) -> None:
        """Put a question; the answer is there later.

        Raises
        ------
        GraphError
            If the process has died.
        """
        try:
            self._pipe.send(question)
        except OSError:
            raise self._death() from None
        self._asked += 1

    def answer(self) -> Answer | None:
        """Return the answer if it is there; None if it is not.

        Raises
        ------
        GraphError
            If the process has died.
        """
        if not self._asked or not self._pipe.poll():
            return None
        try:
            answer: Answer = self._pipe.recv()
        except (EOFError, OSError):
            raise self._death() from None
        self._asked -= 1
        return answer

    def close(self) -> None:
        """End the process, whatever it is at."""
        self._pipe.close()
        self._process.terminate()
        self._process.join(PATIENCE)

    def _death(self) -> GraphError:
        self._process.join(PATIENCE)
        return GraphError(
            f"the process beside the node ended with code {self._process.exitcode}",
            "Start the node again; what the process wrote stands above.",
        )


def _serve(pipe: Connection, make: Callable[..., Callable[[Any], Any]], args: tuple[Any, ...]) -> None:
    """Answer questions until the node closes its end, or dies."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the node ends this process
    os.nice(NICE)
    answering = make(*args)
    while True:
        try:
            pipe.send(_answered(answering, pipe.recv()))
        except (EOFError, OSError):
            return


def _answered(answering: Callable[[Any], Any], question: Any) -> Answer:
    try:
        return Answer(answering(question))
    except ElasticArmError as error:
        return Answer(problem=str(error))
