"""Fewer candidates for code that asks its own question: most of a diagnosis is the choice among the
catalogue, which tests of what follows do not need."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock

from elastic_arm.diagnosis import Question


@contextmanager
def candidates(module: Any, *names: str) -> Iterator[None]:
    """Let the questions that a module asks have these effects alone to choose from."""

    def question(*arguments: Any, **options: Any) -> Question:
        return Question(*arguments, **options | {"effects": names})

    with mock.patch.object(module, "Question", question):
        yield
