"""Derived CasADi functions on disk: a model is derived once, and CasADi then stays unloaded."""

from __future__ import annotations

import contextlib
import hashlib
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from elastic_arm.codegen.cache import cache_folder, is_own_file, source_digest, whole
from elastic_arm.codegen.program import Program, from_casadi

if TYPE_CHECKING:
    import casadi

_T = TypeVar("_T")
# What reads a function shapes the program too.
_READER = Path(__file__).with_name("program.py")
# Of a file that is none of ours, or of another version; CasADi's word for one that it cannot read
# is a RuntimeError.
_UNREADABLE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, RuntimeError)


def cached_program(
    key: str, derive: Callable[[], casadi.Function], sources: Sequence[Path]
) -> Program:
    """Return the program of `derive()`, from the cache if possible.

    Arguments as of `_cached`.
    """
    return _cached(
        key, ".npz", [*sources, _READER], lambda: from_casadi(derive()), Program.load, Program.save
    )


def cached_functions(
    key: str, derive: Callable[[], list[casadi.Function]], sources: Sequence[Path]
) -> list[casadi.Function]:
    """Return the functions of `derive()`, from the cache if possible.

    Arguments as of `_cached`.
    """
    import casadi

    def read(path: Path) -> list[casadi.Function]:
        return list(casadi.FileDeserializer(str(path)).unpack())

    def write(functions: list[casadi.Function], path: Path) -> None:
        serializer = casadi.FileSerializer(str(path))
        serializer.pack(functions)  # on disk when the serializer goes

    return _cached(f"{key}:{casadi.CasadiMeta.version()}", ".casadi", sources, derive, read, write)


def _cached(
    key: str,
    suffix: str,
    sources: Sequence[Path],
    derive: Callable[[], _T],
    read: Callable[[Path], _T],
    write: Callable[[_T, Path], None],
) -> _T:
    """Return what `derive` gives; a cache that cannot be read or written costs time, never a
    result.

    key: everything that `derive` depends on besides source; sources: Python files, or folders of
    them, that shape the result: a changed law must not find what the old one gave.
    """
    digest = hashlib.sha256(f"{key}:{source_digest(*sources)}".encode()).hexdigest()[:32]
    try:
        path = cache_folder() / f"{digest}{suffix}"
    except OSError:
        return derive()
    if is_own_file(path):
        with contextlib.suppress(*_UNREADABLE):
            return read(path)
    made = derive()
    with contextlib.suppress(OSError, RuntimeError), whole(path) as passing:
        write(made, passing)
    return made
