"""The sealed truth: written once, its hash shown, opened only to score, and to know what to withhold.

While a challenge is made, the truth of each arm lies in a piece of its own, so that making can go on where it stopped.
"""

from __future__ import annotations

import base64
import hashlib
import json
import shutil
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from elastic_arm.errors import DiagnosisError

NAME = "truth.sealed"
PIECES = "truth"


def seal_piece(folder: Path, name: str, truth: dict[str, Any]) -> None:
    """Write the truth of one arm so that nobody reads it by accident."""
    path = folder / PIECES / f"{name}.sealed"
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_bytes(_closed(truth))
    part.replace(path)


def pieces(folder: Path) -> set[str]:
    """Return the names of the arms whose truth is there."""
    return {path.stem for path in (folder / PIECES).glob("*.sealed")}


def seal(folder: Path, names: Sequence[str]) -> str:
    """Put the pieces of these arms together, and return the SHA-256 of the whole."""
    paths = [folder / PIECES / f"{name}.sealed" for name in names]
    data = _closed([_opened(path.read_bytes()) for path in paths])
    (folder / NAME).write_bytes(data)
    return hashlib.sha256(data).hexdigest()


def drop_pieces(folder: Path) -> None:
    """Remove the pieces, once the whole is sealed and its hash is written down."""
    shutil.rmtree(folder / PIECES, ignore_errors=True)


def open_sealed(folder: Path, digest: str) -> list[dict[str, Any]]:
    """Return the truth."""
    path = folder / NAME
    if not path.is_file():
        raise DiagnosisError(f"{path} is missing", "Score the folder that `challenge create` made")
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != digest:
        raise DiagnosisError(f"{path} is not what was sealed at creation", "Create the challenge again")
    truth: list[dict[str, Any]] = _opened(data)
    return truth


def _closed(truth: Any) -> bytes:
    return base64.b64encode(zlib.compress(json.dumps(truth, sort_keys=True).encode()))


def _opened(data: bytes) -> Any:
    return json.loads(zlib.decompress(base64.b64decode(data)))
