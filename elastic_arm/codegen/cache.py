"""The cache on disk: what was derived or compiled once is found again by any process of this machine."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import platformdirs

CACHE_VARIABLE = "ELASTIC_ARM_CACHE"


def cache_folder() -> Path:
    """Folder of compiled kernels and saved derivations: $ELASTIC_ARM_CACHE, or the user's cache."""
    chosen = os.environ.get(CACHE_VARIABLE)
    return Path(chosen) if chosen else Path(platformdirs.user_cache_dir("elastic_arm"))


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
