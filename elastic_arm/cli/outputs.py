"""Output paths, checked before the work starts, so that neither time nor earlier results are lost.

Results are overwritten only with --force, and recordings never, because they cannot be repeated.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from elastic_arm.errors import OutputError

SHOWN = 60  # characters of a name that is too long
# A file system takes 255 bytes; the files of a bag add a number and an ending to its name.
LONGEST_NAME = 240
Force = Annotated[bool, typer.Option("--force", help="Overwrite the results of an earlier run.")]

Csv = Annotated[bool, typer.Option("--csv", help="Also write tables of the results as CSV files.")]


def claim_folder(folder: Path, names: Sequence[str], *, force: bool, option: str = "--out") -> None:
    """Check that the files `names` may be written into `folder`, which need not exist.

    Raises an OutputError if one of them exists and `force` is not given, or the folder cannot be
    written.
    """
    _check_name(folder, option)
    left = [name for name in names if (folder / name).exists()]
    if left and not force:
        raise OutputError(
            f"{folder} contains results of an earlier run: {', '.join(left)}",
            f"Choose another folder with {option}, or overwrite the results with --force.",
        )
    _check_folder(folder, option)


def claim_file(path: Path, *, force: bool, option: str = "--out") -> None:
    """Check that `path` may be written; its folder need not exist.

    Raises an OutputError if it exists and `force` is not given, is a folder, or cannot be written.
    """
    _check_name(path, option)
    if path.is_dir():
        raise OutputError(f"{path} is a folder", f"Name a file with {option}.")
    if path.exists():
        if not force:
            raise OutputError(
                f"{path} already exists",
                f"Choose another file with {option}, or overwrite it with --force.",
            )
        if not os.access(path, os.W_OK):
            raise OutputError(f"{path} is not writable", f"Choose another file with {option}.")
    _check_folder(path.parent, option)


def claim_bag(path: Path, option: str = "--out") -> None:
    """Check that a bag may be made at `path`.

    Raises an OutputError if something is there, or its folder cannot be written.
    """
    _check_name(path, option)
    if path.exists():
        raise OutputError(
            f"{path} already exists",
            f"Choose another name with {option}; recordings are never overwritten.",
        )
    _check_folder(path.parent, option)


def _check_name(path: Path, option: str) -> None:
    """Refuse a name that the file system, or a report that holds it, cannot take."""
    shown = str(path) if len(str(path)) <= SHOWN else f"{str(path)[:SHOWN]}…"
    problem = ""
    try:
        if any(len(part.encode()) > LONGEST_NAME for part in path.parts):
            problem = f"the name {shown} is too long"
        os.lstat(path)
    except UnicodeEncodeError:
        problem = f"the name {shown!r} is not valid UTF-8"
    except ValueError:
        problem = f"the name {shown!r} contains a NUL character"
    except (FileNotFoundError, NotADirectoryError):
        pass  # what is in the way is looked for by the checks that follow
    except OSError as error:
        problem = problem or f"{shown} cannot be created ({(error.strerror or 'unusable').lower()})"
    if problem:
        raise OutputError(problem, f"Choose another path for {option}.")


def _check_folder(folder: Path, option: str) -> None:
    """Refuse a folder that cannot be made or written, by its nearest part that exists."""
    try:
        whole = folder.absolute()
    except FileNotFoundError:
        raise OutputError(
            "the current working directory was removed",
            f"Change to another directory, or give an absolute path with {option}.",
        ) from None
    present = next(path for path in (whole, *whole.parents) if path.exists())
    if not present.is_dir():
        raise OutputError(
            f"{present} is a file, not a folder", f"Choose another path for {option}."
        )
    if not os.access(present, os.W_OK | os.X_OK):
        raise OutputError(
            f"the folder {present} is not writable", f"Choose another path for {option}."
        )
