"""Derived functions on disk: a new process finds what an earlier one derived."""

from __future__ import annotations

import contextlib
import functools
import hashlib
from collections.abc import Callable
from pathlib import Path

import casadi as ca

from elastic_arm.codegen.cache import cache_folder, whole

# Whose text shapes the functions: a changed law or recursion must not find what the old one derived.
_SOURCES = ("codegen", "dynamics", "effects", "simulation")


def stored(key: str, derive: Callable[[], list[ca.Function]]) -> list[ca.Function]:
    """Return the functions known under `key`, derived and stored where they are not known yet.

    A cache that cannot be read or written costs time, nothing else.
    """
    name = hashlib.sha256(f"{key}:{ca.CasadiMeta.version()}:{_digest()}".encode()).hexdigest()[:32]
    path = cache_folder() / f"{name}.casadi"
    if path.exists():
        try:
            return list(_read(path))
        except RuntimeError:  # CasADi's word for a file it cannot read
            path.unlink(missing_ok=True)
    functions = derive()
    with contextlib.suppress(OSError, RuntimeError), whole(path) as passing:
        _write(passing, functions)
    return functions


def _read(path: Path) -> list[ca.Function]:
    return list(ca.FileDeserializer(str(path)).unpack())


def _write(path: Path, functions: list[ca.Function]) -> None:
    serializer = ca.FileSerializer(str(path))
    serializer.pack(functions)  # on disk when the serializer goes


@functools.cache
def _digest() -> str:
    package = Path(__file__).parent.parent
    files = sorted(path for folder in _SOURCES for path in (package / folder).rglob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()
