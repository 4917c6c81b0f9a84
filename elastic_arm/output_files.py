"""Result files are written under a temporary name and renamed, so that a full disk or an interrupt
leaves the earlier file.
"""

import csv
import io
import math
import os
import secrets
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from elastic_arm.errors import ElasticArmError, OutputError
from elastic_arm.input_files import WHOLE_FROM, WHOLE_TO


def write_result(
    path: str | Path,
    content: str | bytes,
    kind: type[ElasticArmError] = OutputError,
    remedy: str = "Choose another path with --out.",
) -> Path:
    """Write a file, and its folder, wholly or not at all.

    An error of `kind` where it cannot be.
    """
    path = Path(path)
    # Of names of files that are no text the bytes are written out.
    data = content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # as /dev/stdout, and a folder, which cannot be opened
        if path.exists() and not path.is_file():
            path.write_bytes(data)
            return path
        _replace(Path(os.path.realpath(path)), data)
    except OSError as error:
        raise kind(f"{path} cannot be written: {error.strerror}", remedy) from error
    return path


def _replace(path: Path, data: bytes) -> None:
    if path.exists() and not os.access(path, os.W_OK):
        raise PermissionError(0, "it must not be overwritten")
    part = path.parent / f".{secrets.token_hex(8)}.part"
    try:
        with open(part, "xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if path.exists():
            shutil.copymode(path, part)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def plain(value: Any, digits: int = 17) -> Any:
    """Return records, arrays, tuples and numbers as JSON has them.

    Numbers have so many significant digits; what is not finite becomes None.
    """
    if is_dataclass(value):
        return {f.name: plain(getattr(value, f.name), digits) for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item, digits) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist(), digits)
    if isinstance(value, list | tuple):
        return [plain(item, digits) for item in value]
    if not isinstance(value, float):
        return value
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def csv_text(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """Return rows by the names of their columns as CSV, with a line of these names."""
    text = io.StringIO()
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue()


def yaml_text(content: Any, **options: Any) -> str:
    """Return YAML that :mod:`elastic_arm.input_files` refuses where its end is missing."""
    text = yaml.safe_dump(content, sort_keys=False, width=120, **options)
    return f"{WHOLE_FROM}\n{text}{WHOLE_TO}\n"
