"""Derived functions on disk: a new process finds what an earlier one derived."""

import contextlib
import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

import casadi as ca

from elastic_arm.codegen.cache import cache_folder, is_own_file, source_digest, whole


def stored(key: str, derive: Callable[[], list[ca.Function]], sources: Sequence[Path]) -> list[ca.Function]:
    """Return the functions known under `key`, derived and stored where they are not known yet.

    key: everything that `derive` depends on besides source; derive: called where the functions are not in the
    cache; sources: Python files, or folders of them, that shape the functions: a changed law must not find what the
    old one gave.

    Notes
    -----
    A cache that cannot be read or written costs time, never a result.
    """
    digest = source_digest(*sources)
    name = hashlib.sha256(f"{key}:{ca.CasadiMeta.version()}:{digest}".encode()).hexdigest()[:32]
    try:
        path = cache_folder() / f"{name}.casadi"
    except OSError:
        return derive()
    if is_own_file(path):
        # CasADi's word for a file that it cannot read is a RuntimeError; what is stored below takes its place.
        with contextlib.suppress(RuntimeError):
            return list(_read(path))
    functions = derive()
    with contextlib.suppress(OSError, RuntimeError), whole(path) as passing:
        _write(passing, functions)
    return functions


def _read(path: Path) -> list[ca.Function]:
    return list(ca.FileDeserializer(str(path)).unpack())


def _write(path: Path, functions: list[ca.Function]) -> None:
    serializer = ca.FileSerializer(str(path))
    serializer.pack(functions)  # on disk when the serializer goes
