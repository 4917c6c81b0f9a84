"""The files of a bag: a rosbag2 folder, or a bare MCAP file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from elastic_arm.errors import RecordingError
from elastic_arm.recording.storage.mcap import McapFile, open_mcap
from elastic_arm.recording.storage.metadata import METADATA_KEY

METADATA = "metadata.yaml"
# Written in C where the library has it: in Python, reading this file takes as long as a hundred thousand messages.
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_SUFFIXES = (".mcap", ".mcap.zstd", ".mcap.zst")


@dataclass
class Bag:
    """An opened bag.

    Parameters
    ----------
    path
        The folder or file.
    files
        Its MCAP files in time order.
    metadata
        What metadata.yaml says; None for a bare file, or where it is missing.
    damage
        What is wrong with the bag as a whole, in words.
    """

    path: Path
    files: list[McapFile]
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
        raise RecordingError(f"{path} does not exist", "Give a rosbag2 folder or an .mcap file.")
    if path.is_file():
        if path.name == METADATA:
            return open_bag(path.parent)
        if path.suffix == ".db3":
            raise _sqlite(path)
        return Bag(path, [open_mcap(path)])
    present = sorted((entry for entry in path.iterdir() if entry.name.endswith(_SUFFIXES)), key=_number)
    metadata, damage = _read_metadata(path)
    if not present:
        if any(entry.suffix == ".db3" for entry in path.iterdir()):
            raise _sqlite(path)
        raise RecordingError(f"{path} holds no .mcap file", "Give a rosbag2 folder or an .mcap file.")
    if metadata is None:
        return Bag(path, [open_mcap(file) for file in present], None, damage)
    if str(metadata.get("compression_mode")).lower() == "message":
        raise RecordingError(
            f"{path} compresses each message by itself", "Convert it with ros2 bag convert to storage compression."
        )
    listed = [path / str(name) for name in metadata.get("relative_file_paths") or []]
    damage += [f"{file} is named in {METADATA} and missing" for file in listed if not file.exists()]
    damage += [f"{file} is not named in {METADATA}" for file in present if file not in listed]
    files = [file for file in listed if file.exists()] + [file for file in present if file not in listed]
    return Bag(path, [open_mcap(file) for file in files], metadata, damage)


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
    stem, _, number = file.name.split(".mcap")[0].rpartition("_")
    return (stem, int(number)) if number.isdigit() else (file.name, 0)


def _sqlite(path: Path) -> RecordingError:
    return RecordingError(
        f"{path} is stored as SQLite, not MCAP",
        "Convert it: ros2 bag convert, with storage_id mcap.",
    )
