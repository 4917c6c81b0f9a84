"""What is fuzzed: readers of bags and files, each with whole files that mutants are made of."""

import io
import shutil
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import scipy
import zstandard
from mcap.opcode import Opcode

from elastic_arm.errors import ElasticArmError
from elastic_arm.excitation import load_trajectory
from elastic_arm.recording import load_channels, read_recording, write_recording
from elastic_arm.recording.foreign.array_files import load_arrays
from elastic_arm.recording.foreign.arrays import import_arrays
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.inspection.info import bag_info
from elastic_arm.recording.inspection.repair import repair_bag
from elastic_arm.recording.storage.bag import METADATA
from elastic_arm.recording.storage.messages import read_messages
from elastic_arm.robot import load_robot, to_urdf
from elastic_arm.robot.loading import NOMINAL_ARM
from elastic_arm.robot.urdf import parse_urdf
from tests.helpers.bags import stamps, states, two_sided, write_sqlite
from tests.helpers.motions import trajectory

MAP = (
    "times: {key: t}\njoints: [a, b]\nlink:\n  position: {key: q, unit: deg, columns: [0,"
    " 1]}\nignore: [x*, s.*]\n"
)
TABLE_MAP = "times: {key: t}\njoints: [a, b]\nlink:\n  position: {key: [q, r], unit: deg}\n"
CHANNELS = """
defaults: {link: {position: {topic: /joint_states}}, motor: {effort: {topic: /joint_states, unit: A,
  torque_constant: 0.1, ratio: 100}}}
joints: {a: {name: joint_1}, b: {name: joint_2}}
time: arrival
"""
URDF_OVERLAY = "urdf: arm.urdf\nlimits: {joint_1: {velocity: 2.0}}\n"


@dataclass(frozen=True)
class Target:
    """Something that reads files."""

    group: str  # "bags" or "files"
    suffix: str  # of the file that a mutant is written to
    seeds: Sequence[bytes]  # whole files
    work: Callable[[Path], object]  # reads the file; may raise an ElasticArmError and nothing else


def targets(folder: Path) -> dict[str, Target]:
    """Return all targets; `folder` gets the files that their seeds are made from."""
    rng = np.random.default_rng(0)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.urdf").write_text(to_urdf(load_robot()))
    trajectory(n=2, period=2.0, ramp=0.2, periods=1).save(folder / "trajectory.yaml")
    bag, sqlite, packed = _bags(folder, rng)
    metadata = (folder / "none" / METADATA).read_bytes()
    return {
        "mcap": Target("bags", ".mcap", [*bag, *map(_without_checksums, bag)], _read_bag),
        "db3": Target("bags", ".db3", [sqlite], _read_bag),
        "db3.zstd": Target("bags", ".db3.zstd", [packed], _read_bag),
        "metadata": Target("bags", ".yaml", [metadata], _in_bag(folder / "none")),
        "arm": Target(
            "files",
            ".yaml",
            [NOMINAL_ARM.read_bytes(), URDF_OVERLAY.encode()],
            _in(folder, load_robot),
        ),
        "urdf": Target("files", ".urdf", [(folder / "arm.urdf").read_bytes()], _read_urdf),
        "channels": Target("files", ".yaml", [CHANNELS.encode()], load_channels),
        "mapping": Target("files", ".yaml", [MAP.encode()], _mapping(folder)),
        "trajectory": Target(
            "files", ".yaml", [(folder / "trajectory.yaml").read_bytes()], load_trajectory
        ),
        **_array_targets(folder, rng),
    }


def _bags(folder: Path, rng: np.random.Generator) -> tuple[list[bytes], bytes, bytes]:
    recording = two_sided(rng, 120)
    whole = []
    for kind in ("none", "lz4", "zstd"):
        shutil.rmtree(folder / kind, ignore_errors=True)
        write_recording(folder / kind, recording, kind)  # type: ignore[arg-type]
        whole.append((folder / kind / f"{kind}_0.mcap").read_bytes())
    database = next(
        write_sqlite(folder / "sqlite", states("/joint_states", stamps(60))).glob("*.db3")
    ).read_bytes()
    return whole, database, zstandard.ZstdCompressor().compress(database)


def _without_checksums(content: bytes) -> bytes:
    """Return an MCAP file whose chunks have no checksum, so that damage reaches what reads them."""
    changed = bytearray(content)
    at = 8
    while at + 9 < len(content):
        opcode, size = struct.unpack_from("<BQ", content, at)
        if opcode == Opcode.CHUNK:
            changed[at + 33 : at + 37] = bytes(4)
        at += 9 + size
    return bytes(changed)


def _array_targets(folder: Path, rng: np.random.Generator) -> dict[str, Target]:
    arrays = {"t": np.arange(50) * 0.01, "q": rng.normal(size=(50, 2))}
    files = {kind: io.BytesIO() for kind in ("npz", "deflated", "npy", "mat", "packed")}
    np.savez(files["npz"], **arrays)  # type: ignore[arg-type]
    np.savez_compressed(files["deflated"], **arrays)  # type: ignore[arg-type]
    np.save(files["npy"], arrays["q"])
    scipy.io.savemat(files["mat"], {**arrays, "s": {"x": {"y": arrays["q"]}}})
    scipy.io.savemat(files["packed"], arrays, do_compression=True)
    whole = {kind: file.getvalue() for kind, file in files.items()}
    table = np.column_stack([arrays["t"], arrays["q"]])
    text = "t,q,r\n" + "\n".join(",".join(f"{value:.6g}" for value in row) for row in table)

    alone = folder / "arrays"  # each .npy is one array, so that a recording is a folder of them
    alone.mkdir(exist_ok=True)
    np.save(alone / "t.npy", arrays["t"])

    def read_array(path: Path) -> None:
        shutil.copyfile(path, alone / "q.npy")
        _import(alone, folder / "map.yaml")

    (folder / "map.yaml").write_text(MAP)
    (folder / "table.yaml").write_text(TABLE_MAP)
    read = partial(_import, mapping=folder / "map.yaml")
    return {
        "npz": Target("files", ".npz", [whole["npz"], whole["deflated"]], read),
        "npy": Target("files", ".npy", [whole["npy"]], read_array),
        "mat": Target("files", ".mat", [whole["mat"], whole["packed"]], read),
        "csv": Target(
            "files",
            ".csv",
            [text.encode(), text.replace(",", " ").encode()],
            partial(_import, mapping=folder / "table.yaml"),
        ),
    }


def _import(path: Path, mapping: Path) -> None:
    load_arrays(path)
    import_arrays(path, mapping)


def _read_bag(path: Path) -> None:
    """Do with a bag all that the commands do; a refusal by one does not keep the next from
    trying."""
    copy = path.with_name("copy")
    shutil.rmtree(copy, ignore_errors=True)
    steps: tuple[Callable[[], object], ...] = (
        lambda: read_recording(path).samples(),
        lambda: check_bag(path).to_json(),
        lambda: bag_info(path).to_json(),
        lambda: sum(1 for _ in read_messages(path)),
        lambda: repair_bag(path, copy),
    )
    refusals = []
    for step in steps:
        try:
            step()
        except ElasticArmError as error:
            refusals.append(error)
    if refusals:
        raise refusals[0]


def _in_bag(bag: Path) -> Callable[[Path], object]:
    def work(path: Path) -> None:
        shutil.copyfile(path, bag / METADATA)
        _read_bag(bag)

    return work


def _in(folder: Path, load: Callable[[Path], object]) -> Callable[[Path], object]:
    """Read a file from a folder in which others lie that it names."""

    def work(path: Path) -> object:
        return load(Path(shutil.copyfile(path, folder / "mutant.yaml")))

    return work


def _read_urdf(path: Path) -> None:
    load_robot(path)
    parse_urdf(path.read_bytes())


def _mapping(folder: Path) -> Callable[[Path], object]:
    np.savez(folder / "arrays.npz", t=np.arange(50) * 0.01, q=np.zeros((50, 2)))

    def work(path: Path) -> object:
        return import_arrays(folder / "arrays.npz", path)

    return work
