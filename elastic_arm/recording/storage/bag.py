"""The files of a bag: a rosbag2 folder, or a bare file, of any storage format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from elastic_arm.errors import RecordingError
from elastic_arm.recording.storage.interface import BagFile
from elastic_arm.recording.storage.mcap import open_mcap
from elastic_arm.recording.storage.metadata import METADATA_KEY
from elastic_arm.recording.storage.sqlite import open_sqlite

METADATA = "metadata.yaml"
# Written in C where the library has it: in Python, reading this file takes as long as a hundred thousand messages.
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_OPENERS: dict[str, Callable[[Path], BagFile]] = {".mcap": open_mcap, ".db3": open_sqlite}
_PACKED = ("", ".zstd", ".zst")
_REMEDY = "Give a rosbag2 folder, an .mcap or a .db3 file."


@dataclass
class Bag:
    """An opened bag.

    Parameters
    ----------
    path
        The folder or file.
    files
        Its files in time order.
    metadata
        The content of metadata.yaml; None for a bare file, or where it is missing.
    damage
        What is wrong with the bag as a whole, in words.
    """

    path: Path
    files: list[BagFile]
    metadata: dict[str, Any] | None = None
    damage: list[str] = field(default_factory=list)

    def all_damage(self) -> list[str]:
        """Return what is wrong with the bag and its files, as far as it is known so far."""
        return self.damage + [words for file in self.files for words in file.damage]


def open_bag(path: str | Path) -> Bag:
    """Open a bag.

    Raises
    ------
    RecordingError
        If there is nothing there that can be read.
    """
    path = Path(path)
    try:
        return _opened(path)
    except OSError as error:
        where = error.filename or path
        raise RecordingError(f"{where} cannot be read: {error.strerror}", "Check its permissions.") from None


def _opened(path: Path) -> Bag:
    if not path.exists():
        raise RecordingError(f"{path} does not exist", _REMEDY)
    if path.is_file():
        if path.name == METADATA:
            return open_bag(path.parent)
        return Bag(path, [_open_file(path)])
    present = sorted((entry for entry in path.iterdir() if _storage(entry)), key=_number)
    metadata, damage = _read_metadata(path)
    if not present:
        raise RecordingError(f"{path} holds no .mcap or .db3 file", _REMEDY)
    if metadata is None:
        if len({_storage(file) for file in present}) > 1:
            raise RecordingError(f"{path} holds .mcap and .db3 files", "Name the one to be read.")
        return Bag(path, [_open_file(file) for file in present], None, damage)
    if str(metadata.get("compression_mode")).lower() == "message":
        raise RecordingError(
            f"{path} compresses each message by itself", "Convert it with ros2 bag convert to storage compression."
        )
    listed = [path / str(name) for name in metadata.get("relative_file_paths") or []]
    damage += [f"{file} is named in {METADATA} and missing" for file in listed if not file.exists()]
    damage += [f"{file} is not named in {METADATA}" for file in present if file not in listed]
    files = [file for file in listed if file.exists()] + [file for file in present if file not in listed]
    return Bag(path, [_open_file(file) for file in files], metadata, damage)


def _read_metadata(folder: Path) -> tuple[dict[str, Any] | None, list[str]]:
    file = folder / METADATA
    if not file.exists():
        return None, [f"{file} is missing"]
    try:
        content = yaml.load(file.read_text(encoding="utf-8"), Loader=_LOADER)
        information = content[METADATA_KEY]
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError) as error:
        return None, [f"{file} cannot be read ({type(error).__name__})"]
    if not isinstance(information, dict):
        return None, [f"{file} cannot be read (no fields under {METADATA_KEY})"]
    return information, []


def _number(file: Path) -> tuple[str, int]:
    # rosbag2 numbers the files of a bag: run_2.mcap comes before run_10.mcap.
    stem, _, number = bag_stem(file).rpartition("_")
    return (stem, int(number)) if number.isdigit() else (file.name, 0)


def bag_stem(path: Path) -> str:
    """Return the name of a bag or of a file of one, without what names its format."""
    storage = _storage(path)
    return path.name.split(storage)[0] if storage else path.name


def _storage(path: Path) -> str:
    """Return the suffix that names the storage format of a file; empty where it is no file of a bag."""
    return next((kind for kind in _OPENERS for packed in _PACKED if path.name.endswith(kind + packed)), "")


def _open_file(path: Path) -> BagFile:
    return _OPENERS.get(_storage(path), open_mcap)(path)
