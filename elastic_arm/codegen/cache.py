"""The cache on disk: results of one process serve all processes of the machine."""

import atexit
import contextlib
import functools
import hashlib
import logging
import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

import platformdirs

CACHE_VARIABLE = "ELASTIC_ARM_CACHE"
# Far above the largest that is stored: what is larger is none of it.
LARGEST_FILE = 1 << 28
_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
# Folders that cannot serve, and what this process has in their place.
_REPLACED: dict[Path, Path] = {}
_LOG = logging.getLogger(__name__)


def cache_folder() -> Path:
    """Folder of compiled kernels and saved derivations: $ELASTIC_ARM_CACHE, or the user's cache.

    What lies there is loaded and run. A folder that is not the user's alone, or that cannot be
    used, gives way to a private one for the life of this process, with a warning.

    Raises an OSError if no temporary folder can be made either.
    """
    chosen = os.environ.get(CACHE_VARIABLE)
    folder = (
        Path(chosen) if chosen else Path(platformdirs.user_cache_dir("elastic_arm"))
    ).absolute()
    if folder in _REPLACED:
        return _REPLACED[folder]
    try:
        for missing in reversed([part for part in (folder, *folder.parents) if not part.exists()]):
            missing.mkdir(mode=0o700, exist_ok=True)
        problem = _problem(folder)
    except OSError as error:
        problem = f"cannot be used ({error.strerror or error})"
    return replace_folder(folder, problem) if problem else folder


def replace_folder(folder: Path, problem: str) -> Path:
    """Return a private folder that :func:`cache_folder` gives in place of another one from now on.

    Raises an OSError if no temporary folder can be made, or `folder` is one that was made here.
    """
    if folder in _REPLACED.values():
        raise OSError(f"the folder for temporary files {problem}")
    made = tempfile.TemporaryDirectory(prefix="elastic_arm_")
    atexit.register(made.cleanup)
    _REPLACED[folder] = Path(made.name)
    _LOG.warning(
        "%s %s: kernels are compiled again in %s. Remove it, or set %s to a folder"
        " that only you can write to.",
        folder,
        problem,
        made.name,
        CACHE_VARIABLE,
    )
    return _REPLACED[folder]


def is_own_file(path: Path) -> bool:
    """Whether there is a file of this user's that nobody else may write to.

    No pipe, link or device.

    What others have put into a folder stays theirs when the folder is closed to them.
    """
    try:
        found = path.lstat()
    except OSError:
        return False
    if not stat.S_ISREG(found.st_mode) or found.st_size > LARGEST_FILE:
        return False
    return not hasattr(os, "getuid") or (
        found.st_uid == os.getuid() and not found.st_mode & _BY_OTHERS
    )


def _problem(folder: Path) -> str:
    """Return why a folder is not this user's alone, in words that follow its name; empty where it
    is.

    Raises an OSError if it cannot be looked at.
    """
    found = folder.stat()
    if not stat.S_ISDIR(found.st_mode):
        return "is not a folder"
    if not hasattr(os, "getuid"):
        return ""
    if found.st_uid != os.getuid() or found.st_mode & _BY_OTHERS:
        return "belongs to another user, or is writable by others"
    for part in _way(folder):
        if (mode := part.lstat()).st_uid not in (0, os.getuid()):
            return f"is reached through {part}, which belongs to another user"
        # Of a folder with the sticky bit, such as /tmp, others cannot take away what is not theirs.
        if (
            stat.S_ISDIR(mode.st_mode)
            and mode.st_mode & _BY_OTHERS
            and not mode.st_mode & stat.S_ISVTX
        ):
            return f"is reached through {part}, which is writable by others"
    return ""


def _way(path: Path) -> Iterator[Path]:
    """Return the folders and links through which a path leads."""
    for part in reversed([path, *path.parents]):
        yield part
        if part.is_symlink():
            yield from _way(part.parent / part.readlink())


@contextlib.contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Give a passing file to write, which then becomes `path`.

    Another process must never read half a file.

    Raises an OSError if the folder cannot be made or written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, suffix=".part")
    os.close(handle)
    passing = Path(name)
    try:
        yield passing
        passing.replace(path)
    finally:
        passing.unlink(missing_ok=True)


@functools.cache
def source_digest(*sources: Path) -> str:
    """Digest of Python files, and of all those below folders.

    What other source derived is derived again.
    """
    files = [
        path
        for source in sources
        for path in (sorted(source.rglob("*.py")) if source.is_dir() else [source])
    ]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()
