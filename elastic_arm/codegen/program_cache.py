"""Derived programs on disk: a model that was derived once is never derived again, and CasADi stays unloaded."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from elastic_arm.codegen.cache import cache_folder, whole
from elastic_arm.codegen.program import Program, from_casadi

if TYPE_CHECKING:
    import casadi

# What a derived program depends on besides its key.
_SOURCES = ("dynamics/bodies.py", "dynamics/recursion.py", "dynamics/derivation.py", "codegen/program.py")


def cached_program(key: str, derive: Callable[[], casadi.Function]) -> Program:
    """Return the program of `derive()`, from the cache where it is there.

    Parameters
    ----------
    key
        Says everything that `derive` depends on, but the project's own source.

    Notes
    -----
    A cache that cannot be read or written costs time, never a result.
    """
    path = cache_folder() / f"{hashlib.sha256(f'{key}:{_source_digest()}'.encode()).hexdigest()[:32]}.npz"
    with contextlib.suppress(OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return Program.load(path)
    program = from_casadi(derive())
    with contextlib.suppress(OSError), whole(path) as passing:
        program.save(passing)
    return program


@functools.cache
def _source_digest() -> str:
    folder = Path(__file__).parents[1]
    return hashlib.sha256(b"".join((folder / name).read_bytes() for name in _SOURCES)).hexdigest()
