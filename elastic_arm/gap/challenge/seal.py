"""The sealed truth: written once, its hash shown, opened only to score."""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from pathlib import Path
from typing import Any

from elastic_arm.errors import DiagnosisError

NAME = "truth.sealed"


def seal(folder: Path, truth: list[dict[str, Any]]) -> str:
    """Write the truth so that nobody reads it by accident, and return its SHA-256."""
    data = base64.b64encode(zlib.compress(json.dumps(truth, sort_keys=True).encode()))
    (folder / NAME).write_bytes(data)
    return hashlib.sha256(data).hexdigest()


def open_sealed(folder: Path, digest: str) -> list[dict[str, Any]]:
    """Return the truth.

    Raises
    ------
    DiagnosisError
        If it is missing, or not what was sealed.
    """
    path = folder / NAME
    if not path.is_file():
        raise DiagnosisError(f"{path} is missing", "Score the folder that `challenge create` made")
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != digest:
        raise DiagnosisError(f"{path} is not what was sealed at creation", "Create the challenge again")
    truth: list[dict[str, Any]] = json.loads(zlib.decompress(base64.b64decode(data)))
    return truth
