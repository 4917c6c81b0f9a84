"""Bags against their peers: reading to arrays and writing of arrays, as ratios measured in one run.

    python benchmarks/bench_mcap.py [--messages 1000000] [--peer-messages 50000] [--repeats 5]
    [--json]

The peers are rosbags' AnyReader with deserialisation and rosbags' Writer with serialisation (timed
on fewer messages: their cost is linear), the plain reading and unpacking of the file's bytes, and
the least that a reader does: unpack, take checksums, fill new memory with as many numbers. All are
timed in turn, so that whatever else the machine does falls on all alike; figures are medians of
wall time, and in brackets of processor time (threads add up), which a busy machine disturbs less.
"""

import argparse
import json
import shutil
import tempfile
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import zstandard
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

from elastic_arm.recording import Recording, Side, message_types, read_recording, write_recording
from elastic_arm.recording.storage.mcap import open_mcap
from elastic_arm.recording.storage.stream_writer import COMPRESSIONS
from elastic_arm.recording.storage.unpacking import unpack_chunk

JOINT_STATE = "sensor_msgs/msg/JointState"


def make(count: int, n: int, rng: np.random.Generator) -> Recording:
    """One side of an arm in smooth motion with noise: compresses like a real one."""
    t = np.arange(count) * 1e-3
    phase = rng.uniform(0, 2 * np.pi, n)
    q = np.sin(2 * np.pi * 0.3 * t[:, None] + phase)
    dq = 2 * np.pi * 0.3 * np.cos(2 * np.pi * 0.3 * t[:, None] + phase)
    side = Side(
        10**18 + (10**6 * np.arange(count)),
        q,
        dq,
        100 * q + rng.normal(scale=0.26, size=(count, n)),
    )
    return Recording(tuple(f"joint_{i + 1}" for i in range(n)), motor=side)


def write_rosbags(folder: Path, recording: Recording) -> None:
    """Write by rosbags, message by message."""
    store = message_types.typestore()
    side = recording.motor
    types = store.types
    assert (
        side is not None
        and side.position is not None
        and side.velocity is not None
        and side.effort is not None
    )
    names = list(recording.joints)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/motor_states", JOINT_STATE, typestore=store)
        for stamp, q, dq, tau in zip(
            side.stamp_ns.tolist(), side.position, side.velocity, side.effort, strict=True
        ):
            time_ = types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
            message = types[JOINT_STATE](types["std_msgs/msg/Header"](time_, ""), names, q, dq, tau)
            writer.write(connection, stamp, store.serialize_cdr(message, JOINT_STATE))


def read_rosbags(folder: Path) -> None:
    """Read by rosbags, deserialise, make arrays."""
    stamps = []
    rows = []
    with AnyReader([folder]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
            rows.append((message.position, message.velocity, message.effort))
    np.array(stamps), np.array(rows)


def unpack(folder: Path) -> None:
    """Read the file's bytes and unpack its chunks one after the other, and nothing else."""
    file = next(folder.glob("*.mcap"))
    content = file.read_bytes()
    for chunk in open_mcap(file).chunks:
        if chunk.compression == "zstd":
            zstandard.ZstdDecompressor().decompress(
                content[chunk.begin : chunk.end], max_output_size=chunk.size
            )
        elif chunk.compression == "lz4":
            lz4.frame.decompress(content[chunk.begin : chunk.end])


def least(folder: Path, numbers: int) -> None:
    """Unpack all chunks, take their checksums, and fill new memory with as many numbers as the
    messages hold."""
    file = open_mcap(next(folder.glob("*.mcap")))
    for chunk in file.chunks:
        zlib.crc32(
            unpack_chunk(file.buffer[chunk.begin : chunk.end], chunk.compression, chunk.size).data
        )
    np.empty(numbers).fill(0.0)


def timed(job: Callable[[], Any]) -> np.ndarray:
    """Wall time and processor time of one call."""
    begin = time.perf_counter(), time.process_time()
    job()
    return np.array([time.perf_counter() - begin[0], time.process_time() - begin[1]])


def compare(
    root: Path, count: int, peers: int, repeats: int, n: int, compression: Any
) -> dict[str, Any]:
    """Time everything `repeats` times in turn; rates in messages a second."""
    rng = np.random.default_rng(0)
    recording = make(count, n, rng)
    small = make(peers, n, rng)
    names = ("write", "read", "unpack", "least", "peer write", "peer read")
    times: dict[str, list[np.ndarray]] = {name: [] for name in names}
    for _ in range(repeats):
        for folder in ("big", "small", "peer"):
            shutil.rmtree(root / folder, ignore_errors=True)
        write_recording(root / "small", small, compression)
        times["write"].append(
            timed(lambda: write_recording(root / "big", recording, compression)) / count
        )
        times["peer write"].append(timed(lambda: write_rosbags(root / "peer", small)) / peers)
        times["read"].append(timed(lambda: read_recording(root / "big")) / count)
        times["peer read"].append(timed(lambda: read_rosbags(root / "small")) / peers)
        times["unpack"].append(timed(lambda: unpack(root / "big")) / count)
        times["least"].append(timed(lambda: least(root / "big", count * (3 * n + 1))) / count)
    wall = {name: float(np.median(values, axis=0)[0]) for name, values in times.items()}
    cpu = {name: float(np.median(values, axis=0)[1]) for name, values in times.items()}
    size = next((root / "big").glob("*.mcap")).stat().st_size / count
    return {
        "joints": n,
        "messages": count,
        "packing": compression,
        "bytes": round(size, 1),
        "read/s": 1 / wall["read"],
        "write/s": 1 / wall["write"],
        "AnyReader / read": wall["peer read"] / wall["read"],
        "(cpu)": cpu["peer read"] / cpu["read"],
        "read / unpack": wall["read"] / wall["unpack"],
        "(cpu)  ": cpu["read"] / cpu["unpack"],
        "read / least": wall["read"] / wall["least"],
        "(cpu)   ": cpu["read"] / cpu["least"],
        "Writer / write": wall["peer write"] / wall["write"],
        "(cpu) ": cpu["peer write"] / cpu["write"],
    }


def main() -> None:
    """Print the table: every compression, then growth with N and n."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--messages", type=int, default=1_000_000)
    parser.add_argument("--peer-messages", type=int, default=50_000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    cases = [(options.messages, 3, compression) for compression in COMPRESSIONS]
    cases += [
        *((options.messages // 10, 3, compression) for compression in ("lz4", "zstd")),
        *((options.messages // 4, n, "zstd") for n in (6, 7, 12)),
    ]
    rows = []
    with tempfile.TemporaryDirectory() as root:
        for count, n, compression in cases:
            rows.append(
                compare(Path(root), count, options.peer_messages, options.repeats, n, compression)
            )
            if not options.json:
                if len(rows) == 1:
                    print("  ".join(rows[0]))
                print(
                    "  ".join(
                        f"{v:{len(k)}.4g}" if isinstance(v, float) else f"{v!s:>{len(k)}}"
                        for k, v in rows[-1].items()
                    )
                )
    if options.json:
        print(json.dumps(rows, indent=2))


if __name__ == "__main__":
    main()
