"""The files of a bag: a rosbag2 folder, or a bare file, of any storage format."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from elastic_arm.errors import RecordingError
from elastic_arm.input_files import read_fields
from elastic_arm.recording import limits
from elastic_arm.recording.storage.mcap import McapFile, open_mcap
from elastic_arm.recording.storage.metadata import METADATA_KEY, stated_currents, stated_gains
from elastic_arm.recording.storage.sqlite import SqliteFile, open_sqlite

# A storage format is a module with a kind of stored file and a function that opens one.
BagFile = McapFile | SqliteFile
METADATA = "metadata.yaml"
_OPENERS: dict[str, Callable[[Path], BagFile]] = {".mcap": open_mcap, ".db3": open_sqlite}
_PACKED = ("", ".zstd", ".zst")
# Files that `bag import` makes bags of.
TEXT_TABLES = (".csv", ".tsv", ".txt", ".dat")
ARRAY_FILES = (*TEXT_TABLES, ".npy", ".npz", ".mat", ".parquet", ".h5", ".hdf5")
RECORD_FILES = (".json", ".jsonl", ".ndjson")  # which a folder may hold for other reasons
_IMPORT = "Convert it to a bag: elastic-arm bag import {} --guess --robot ARM --out import.yaml"
WHAT_IS_A_BAG = "Give a rosbag2 folder, an .mcap or a .db3 file."


@dataclass(frozen=True)
class BagMetadata:
    """The contents of metadata.yaml beyond those of the storage files."""

    message_count: int | None  # messages in all files; None where it is not stated
    compression_mode: str  # "none", "file" or "message"; may be empty
    files: tuple[str, ...]  # names in the folder, in time order
    # the torque channels that are motor currents times a torque constant, as its writer stated
    currents: tuple[str, ...] = ()
    # joint -> number in its servo's register of the position gain, as its writer stated
    firmware_gains: Mapping[str, float] = field(default_factory=dict)


@dataclass
class Bag:
    """An opened bag."""

    path: Path  # the folder or file
    files: list[BagFile]  # its files in time order
    metadata: BagMetadata | None = (
        None  # from metadata.yaml; None for a bare file, or where it is missing
    )
    # what is wrong with the bag as a whole, in words
    damage: list[str] = field(default_factory=list)

    def currents(self) -> list[str]:
        """Return the torque channels that are motor currents times a torque constant."""
        if self.metadata is not None:
            return list(self.metadata.currents)
        return list(dict.fromkeys(name for file in self.files for name in file.currents()))

    def firmware_gains(self) -> Mapping[str, float]:
        """Return numbers of the servos' registers of the position gain, by joint."""
        if self.metadata is not None:
            return self.metadata.firmware_gains
        return {k: gain for file in self.files for k, gain in file.firmware_gains().items()}

    def all_damage(self) -> list[str]:
        """Return the faults of the bag and its files that are known so far."""
        return self.damage + [words for file in self.files for words in file.damage]


def open_bag(path: str | Path) -> Bag:
    """Open a bag."""
    path = Path(path)
    if "\0" in str(path):
        raise RecordingError(
            f"{str(path)!r} is not a valid file name: it contains a NUL character", WHAT_IS_A_BAG
        )
    try:
        return _opened(path)
    except OSError as error:
        where = error.filename or path
        raise RecordingError(
            f"{where} cannot be read: {error.strerror}", "Check its permissions."
        ) from None


def _opened(path: Path) -> Bag:
    if not path.exists():
        raise RecordingError(f"{path} does not exist", WHAT_IS_A_BAG)
    if path.name == METADATA and path.is_file():
        return open_bag(path.parent)
    if not path.is_dir():
        return Bag(path, [_open_file(path)])
    present = sorted((entry for entry in path.iterdir() if _storage(entry)), key=_number)
    metadata, damage = _read_metadata(path)
    if not present:
        arrays = any(
            file.suffix.lower() in ARRAY_FILES
            for depth in ("*", "*/*", "*/*/*")
            for file in path.glob(depth)
        )
        raise RecordingError(
            f"{path} contains no .mcap or .db3 file",
            _IMPORT.format(path) if arrays else WHAT_IS_A_BAG,
        )
    if metadata is None:
        if len({_storage(file) for file in present}) > 1:
            raise RecordingError(f"{path} contains .mcap and .db3 files", "Give the file to read.")
        return Bag(path, [_open_file(file) for file in present], None, damage)
    if metadata.compression_mode == "message":
        problem = f"{path} contains individually compressed messages"
        raise RecordingError(problem, "Convert it with ros2 bag convert to storage compression.")
    # Of a name that is too long Path.exists raises.
    listed = {path / name: os.path.exists(path / name) for name in metadata.files}
    unlisted = [file for file in present if file not in listed]
    damage += [
        f"{file} is listed in {METADATA} but missing" for file, there in listed.items() if not there
    ]
    damage += [f"{file} is not listed in {METADATA}" for file in unlisted]
    files = [file for file, there in listed.items() if there] + unlisted
    return Bag(path, [_open_file(file) for file in files], metadata, damage)


def _read_metadata(folder: Path) -> tuple[BagMetadata | None, list[str]]:
    """Return the required contents of metadata.yaml, None if it cannot be read, and its faults."""
    file = folder / METADATA
    if not file.exists():
        return None, [f"{file} is missing"]
    try:
        content = read_fields(file, RecordingError, "", most=limits.METADATA_BYTES).get(
            METADATA_KEY
        )
    except RecordingError as error:
        return None, [f"{file} cannot be read ({error.problem.removeprefix(f'{file}: ')})"]
    if not isinstance(content, dict):
        return None, [f"{file} cannot be read (no fields under {METADATA_KEY})"]
    damage = []
    count = content.get("message_count")
    names = content.get("relative_file_paths")
    if count is not None and type(count) is not int:
        damage.append(f"{file}: message_count is not a whole number")
        count = None
    if names is not None and not (
        isinstance(names, list) and all(isinstance(name, str) for name in names)
    ):
        damage.append(f"{file}: relative_file_paths is not a list of names")
        names = None
    if names is not None and len(names) > limits.FILES:
        damage.append(f"{file} lists {len(names)} files; the limit is {limits.FILES}")
        names = None
    # A bag is its folder: names that lead out of it are not followed.
    outside = {
        n for n in names or () if "\0" in n or Path(n).is_absolute() or ".." in Path(n).parts
    }
    damage += [
        f"{file} lists {name[:60]!r}, which is not in the bag's folder" for name in sorted(outside)
    ]
    files = tuple(name for name in names or () if name not in outside)
    mode = str(content.get("compression_mode") or "").lower()
    currents = stated_currents(content)
    gains = stated_gains(content)
    return BagMetadata(count, mode, files, currents, gains), damage


def _number(file: Path) -> tuple[str, int]:
    # rosbag2 numbers the files of a bag: run_2.mcap comes before run_10.mcap.
    stem, _, number = bag_stem(file).rpartition("_")
    return (stem, int(number)) if number.isdecimal() else (file.name, 0)


def bag_stem(path: Path) -> str:
    """Return the name of a bag or storage file without the extension of its format."""
    storage = _storage(path)
    return path.name.split(storage)[0] if storage else path.name


def _storage(path: Path) -> str:
    """Return the extension that names the storage format of a file; empty if it is not a storage
    file."""
    return next(
        (kind for kind in _OPENERS for packed in _PACKED if path.name.endswith(kind + packed)), ""
    )


def _open_file(path: Path) -> BagFile:
    if not path.is_file():
        raise RecordingError(f"{path} is a pipe or a device, not a file", WHAT_IS_A_BAG)
    if path.suffix.lower() in (*ARRAY_FILES, *RECORD_FILES):
        raise RecordingError(f"{path} contains arrays and is not a bag", _IMPORT.format(path))
    if path.suffix.lower() == ".bag":
        raise RecordingError(
            f"{path} is a ROS 1 bag", f"Run: rosbags-convert --src {path} --dst {path.stem}"
        )
    return _OPENERS.get(_storage(path), open_mcap)(path)
