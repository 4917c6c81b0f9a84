"""Derived programs on disk: a model that was derived once is never derived again, and CasADi stays unloaded."""

from __future__ import annotations

import contextlib
import hashlib
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from elastic_arm.codegen.cache import cache_folder, is_own_file, source_digest, whole
from elastic_arm.codegen.program import Program, from_casadi

if TYPE_CHECKING:
    import casadi

# What reads a function shapes the program too.
_READER = Path(__file__).with_name("program.py")


def cached_program(key: str, derive: Callable[[], casadi.Function], sources: Sequence[Path]) -> Program:
    """Return the program of `derive()`, from the cache where it is there.

    key: everything that `derive` depends on besides source; sources: Python files, or folders of them, that shape
    what `derive` returns.

    Notes
    -----
    A cache that cannot be read or written costs time, never a result.
    """
    digest = source_digest(*sources, _READER)
    name = f"{hashlib.sha256(f'{key}:{digest}'.encode()).hexdigest()[:32]}.npz"
    try:
        path = cache_folder() / name
    except OSError:
        return from_casadi(derive())
    if is_own_file(path):
        with contextlib.suppress(OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return Program.load(path)
    program = from_casadi(derive())
    with contextlib.suppress(OSError), whole(path) as passing:
        program.save(passing)
    return program
