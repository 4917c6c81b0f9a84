"""What all subcommands share: the console, JSON output, and errors turned into exit codes.

Exit codes: 0 done; 1 the work was done and its answer is "no" (a bag that fails its check); 2 unusable input.
"""

from __future__ import annotations

import functools
import json
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from rich.console import Console
from rich.markup import escape

from elastic_arm.errors import ElasticArmError, RecordingError

P = ParamSpec("P")
R = TypeVar("R")

UNLIMITED = 10_000  # columns where no screen ends the line
LEAST = 12  # columns of a name that is cut


class PipeConsole(Console):
    """A console for pipes and files: every line stays whole, and ends where its text ends."""

    def print(self, *objects: Any, **options: Any) -> None:
        """Print, without the blanks that fill up the last column of a table."""
        with self.capture() as captured:
            super().print(*objects, **options)
        self.file.write(re.sub(r" +$", "", captured.get(), flags=re.MULTILINE))


def _console(*, stderr: bool) -> Console:
    """Return a console that wraps and shortens for a screen alone."""
    console = Console(stderr=stderr, highlight=False)
    return console if console.is_terminal else PipeConsole(stderr=stderr, highlight=False, width=UNLIMITED)


out = _console(stderr=False)
err = _console(stderr=True)


def print_error(error: ElasticArmError) -> None:
    """Write an error as one line on stderr."""
    err.print(f"[bold red]error:[/] {escape(str(error))}", soft_wrap=True, markup=True)


def columns_left(rows: Sequence[Sequence[str]]) -> int:
    """Return how many columns of the screen a table of these cells leaves to one more; a few in any case."""
    taken = sum(2 + max(len(cell) for cell in column) for column in zip(*rows, strict=True))
    return max(out.width - taken, LEAST)


def reports_errors(command: Callable[P, R]) -> Callable[P, R]:
    """Turn an :class:`ElasticArmError` into one clear line on stderr and exit code 2."""

    @functools.wraps(command)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except ElasticArmError as error:
            print_error(error)
            raise SystemExit(2) from None

    return wrapper


def refuse_repeated(bags: Sequence[Path]) -> None:
    """Raise if a recording is given twice: it would count double, or judge a fit that has seen it.

    Raises
    ------
    RecordingError
        Naming the recording.
    """
    seen: set[Path] = set()
    for bag in bags:
        if bag.resolve() in seen:
            raise RecordingError(f"{bag} is given twice", "Give every recording once, and validate on another.")
        seen.add(bag.resolve())


def print_json(data: Any) -> None:
    """Write `data` as JSON to stdout, for scripts."""
    json.dump(data, sys.stdout, indent=2, allow_nan=False)
    sys.stdout.write("\n")
