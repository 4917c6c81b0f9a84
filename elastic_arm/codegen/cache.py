"""The cache on disk: what was derived or compiled once is found again by any process of this machine."""

from __future__ import annotations

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
_LOG = logging.getLogger(__name__)


def cache_folder() -> Path:
    """Folder of compiled kernels and saved derivations: $ELASTIC_ARM_CACHE, or the user's cache.

    What lies there is loaded and run. A folder of another user, or one that others may write to, is not used: a
    private one for the life of this process takes its place, with a warning.
    """
    chosen = os.environ.get(CACHE_VARIABLE)
    folder = Path(chosen) if chosen else Path(platformdirs.user_cache_dir("elastic_arm"))
    with contextlib.suppress(OSError):  # whoever writes there next meets the same error, and words it
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    return folder if _is_private(folder) else _private_folder(folder)


def _is_private(folder: Path) -> bool:
    """Whether a folder belongs to this user, who alone may write to it; true as well of what cannot be looked at."""
    if not hasattr(os, "getuid"):
        return True
    try:
        found = folder.stat()
    except OSError:
        return True
    return found.st_uid == os.getuid() and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


@functools.cache
def _private_folder(instead_of: Path) -> Path:
    made = tempfile.TemporaryDirectory(prefix="elastic_arm_")
    atexit.register(made.cleanup)
    _LOG.warning(
        "%s belongs to another user, or others may write to it: kernels are compiled anew in %s. Run chmod 700 on it, "
        "or set %s to a folder of your own.",
        instead_of,
        made.name,
        CACHE_VARIABLE,
    )
    return Path(made.name)


@contextlib.contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Give a passing file to write, which then becomes `path`: another process must never read half a file.

    Raises
    ------
    OSError
        If the folder cannot be made or written.
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
    """Digest of Python files, and of all those below folders: what was derived by other source is derived again."""
    files = [path for source in sources for path in (sorted(source.rglob("*.py")) if source.is_dir() else [source])]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()
