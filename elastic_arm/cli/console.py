"""Common parts of all subcommands: the console, JSON output, and errors as exit codes.

Exit codes: 0 done; 1 the work was done and its answer is "no" (a bag that fails its check); 2
unusable input.
"""

import contextlib
import functools
import io
import json
import math
import os
import re
import sys
from collections.abc import Callable, Collection, Iterator
from typing import Any, ParamSpec, TypeVar

from rich.console import Console, JustifyMethod
from rich.errors import MarkupError
from rich.markup import escape
from rich.progress import Progress, ProgressColumn
from rich.status import Status
from rich.table import Table
from rich.text import Text

from elastic_arm.errors import ElasticArmError, OutputError

P = ParamSpec("P")
R = TypeVar("R")

UNLIMITED = 10_000  # columns where no screen ends the line
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f]")


class SafeConsole(Console):
    """A console that prints names of files as they are, even if they look like markup."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Return text with its markup rendered, or as it stands where the markup does not close.

        Codes that control a terminal, which a name in a file may hold, are left out.
        """
        text = _CONTROL.sub("", text)
        try:
            return super().render_str(text, **options)
        except MarkupError:
            return super().render_str(text, **{**options, "markup": False})

    def on_broken_pipe(self) -> None:
        """Leave it to the application, as for what is written without a console."""
        raise BrokenPipeError


class PipeConsole(SafeConsole):
    """A console for pipes and files: every line stays whole, and ends where its text ends."""

    def print(self, *objects: Any, **options: Any) -> None:
        """Print, without the blanks that fill up the last column of a table."""
        with self.capture() as captured:
            super().print(*objects, **options)
        self.file.write(re.sub(r" +$", "", captured.get(), flags=re.MULTILINE))


def _console(*, stderr: bool) -> Console:
    """Return a console that wraps and shortens for a screen alone."""
    console = SafeConsole(stderr=stderr, highlight=False)
    return (
        console
        if console.is_terminal
        else PipeConsole(stderr=stderr, highlight=False, width=UNLIMITED)
    )


class _GuardedOutput(io.TextIOWrapper):
    """The standard output, whose errors are the user's to mend."""

    def write(self, text: str) -> int:
        """Write text; see :meth:`flush`."""
        with _worded():
            return super().write(text)

    def flush(self) -> None:
        """Hand on what was written.

        Raises an OutputError if whatever stdout leads to does not take it. A pipe that is closed at
        its other end is no error of ours.
        """
        with _worded():
            super().flush()


@contextlib.contextmanager
def _worded() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        # What Python writes at its end must not fail for that again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        raise OutputError(
            f"stdout cannot be written ({error.strerror})",
            "Results written to files are not affected",
        ) from None


def guard_output() -> None:
    """Let the process go on when an output is closed or cannot encode a letter.

    Closed outputs go nowhere, and such letters are printed as their codes.
    """
    for name, number in (("stdout", 1), ("stderr", 2)):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            if nowhere != number:  # a file opened later must not take the number of an output
                os.dup2(nowhere, number)
                os.close(nowhere)
            setattr(
                sys,
                name,
                io.TextIOWrapper(
                    io.FileIO(number, "w", closefd=False), "utf-8", write_through=True
                ),
            )
        elif number == 1 and isinstance(sys.stdout, io.TextIOWrapper):
            before = sys.stdout
            sys.stdout = _GuardedOutput(
                before.buffer,
                before.encoding,
                errors="backslashreplace",
                line_buffering=before.line_buffering,
            )


out = _console(stderr=False)
err = _console(stderr=True)


def new_table(
    *headings: str, right: Collection[str] = (), whole: Collection[str] = (), **options: Any
) -> Table:
    """Return a table without lines.

    Columns under the headings `right` hold numbers, those of `whole` never wrap.
    """
    table = Table(box=None, header_style="bold", pad_edge=False, **options)
    for heading in headings:
        justify: JustifyMethod = "right" if heading in right else "left"
        table.add_column(escape(heading), justify=justify, no_wrap=heading in whole)
    return table


def print_error(error: ElasticArmError) -> None:
    """Write an error as one line on stderr."""
    err.print(f"[bold red]error:[/] {escape(str(error))}", soft_wrap=True, markup=True)


def progress_bar(*columns: ProgressColumn, transient: bool = True) -> Progress:
    """Return a progress display for a terminal.

    Nothing is printed into a pipe, not even the empty line that it would leave.
    """
    return Progress(*columns, console=err, transient=transient, disable=not err.is_terminal)


def shares_of(status: Status) -> Callable[[str, float], None]:
    """Return what shows in a status line what is being done, and the share of it that is."""
    return lambda what, share: status.update(f"{what}, {share:.0%}")


def reports_errors(command: Callable[P, R]) -> Callable[P, R]:
    """Turn an :class:`ElasticArmError` into one clear line on stderr and exit code 2.

    So is memory that is used up.
    """

    @functools.wraps(command)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except ElasticArmError as error:
            print_error(error)
        except MemoryError as error:
            problem = f"out of memory ({str(error).rstrip('.') or 'size unknown'})"
            print_error(ElasticArmError(problem, "Use less motion, or raise the memory limit"))
        raise SystemExit(2) from None

    return wrapper


def print_json(data: dict[str, Any]) -> None:
    """Write `data` as JSON to stdout, for scripts.

    JSON has no numbers that are not finite: they become null, and `not_finite` lists where they
    were.
    """
    found: list[str] = []
    plain = finite(data, found)
    text = json.dumps({**plain, "not_finite": found} if found else plain, indent=2, allow_nan=False)
    sys.stdout.write(f"{text}\n")


def finite(data: Any, found: list[str], place: str = "") -> Any:
    """Return data with null for every number that is not finite."""
    match data:
        case float() if not math.isfinite(data):
            found.append(f"{place}: {data}")
            return None
        case dict():
            return {
                key: finite(value, found, f"{place}.{key}".lstrip("."))
                for key, value in data.items()
            }
        case list() | tuple():
            return [finite(value, found, f"{place}[{index}]") for index, value in enumerate(data)]
    return data
