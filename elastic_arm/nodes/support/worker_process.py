"""Work that takes seconds, in a process of low priority, while the node continues to receive
samples."""

import multiprocessing
import os
import signal
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from elastic_arm.errors import ElasticArmError
from elastic_arm.interrupts import interrupts_held, take_interrupts

# How much lower the priority is: what a busy machine lacks is taken from here first.
NICE = 5
# How long a process that is asked to end may take, seconds.
PATIENCE = 1.0


@dataclass(frozen=True)
class Answer:
    """The answer to a question: a value, or the problem of the question in words."""

    value: Any = None
    problem: str = ""


class WorkerProcess:
    """A process that answers one question after another.

    make: called in the process with `args`; returns what answers questions. Both are importable by
    name; args: what the process needs to know; questions and answers go through a pipe, so all are
    plain data. `restarts` is how often the process died, and was started again.
    """

    def __init__(self, make: Callable[..., Callable[[Any], Any]], *args: Any) -> None:
        self._make = make
        self._args = args
        self._start()
        # A process of low priority takes its time to fetch a question, too.
        self._courier = ThreadPoolExecutor(1)
        self._answer: Future[Answer] | None = None
        self.restarts = 0

    def _start(self) -> None:
        # A fork would take the threads' locks of the middleware along.
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(theirs, self._make, self._args), daemon=True
        )
        with interrupts_held():
            self._process.start()
        theirs.close()

    @property
    def busy(self) -> bool:
        """Whether an answer is still to come."""
        return self._answer is not None

    def ask(self, question: Any) -> None:
        """Put a question if none is open; the answer is available later."""
        assert not self.busy, "only one question at a time"
        self._answer = self._courier.submit(self._exchange, question)

    def answer(self) -> Answer | None:
        """Return the answer if it is available, otherwise None.

        If the process died over the question, the answer is that problem, and a new process serves
        the next question.
        """
        if self._answer is None or not self._answer.done():
            return None
        answered = self._answer
        self._answer = None
        try:
            return answered.result()
        except (EOFError, OSError):
            self._process.join(PATIENCE)
            problem = (
                f"the diagnosis process ended with code {self._process.exitcode} and was restarted"
            )
            self._end()
            self._start()
            self.restarts += 1
            return Answer(problem=problem)

    def close(self) -> None:
        """End the process, whatever it is doing."""
        self._end()
        self._courier.shutdown(wait=False, cancel_futures=True)

    def _end(self) -> None:
        self._process.terminate()
        self._process.join(PATIENCE)
        self._pipe.close()

    def _exchange(self, question: Any) -> Answer:
        self._pipe.send(question)
        return self._pipe.recv()


def _serve(
    pipe: Connection, make: Callable[..., Callable[[Any], Any]], args: tuple[Any, ...]
) -> None:
    """Answer questions until the node closes its end, or dies."""
    take_interrupts(signal.SIG_IGN)  # Ctrl-C reaches the whole group; the node ends this process
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
