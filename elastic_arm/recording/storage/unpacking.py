"""Unpack what is compressed in a bag, up to the limits of :mod:`elastic_arm.recording.limits`,
whatever it claims."""

from pathlib import Path

import lz4.frame
import numpy as np
import zstandard

from elastic_arm.errors import RecordingError
from elastic_arm.recording import limits
from elastic_arm.recording.spans import Bytes

PACKED_FILES = (".zstd", ".zst")
_PIECE = 4 * limits.MEGABYTE


def unpack_chunk(packed: Bytes, compression: str, size: int, *, torn: bool = False) -> Bytes:
    """Return the plain bytes of a chunk; of a torn one what is there."""
    if compression and size > limits.chunk_bytes():
        limit = f"{limits.chunk_bytes()} ($ELASTIC_ARM_MAX_CHUNK_MB)"
        raise ValueError(f"its stated unpacked size is {size} bytes, above the limit of {limit}")
    plain: bytes | memoryview
    match compression:
        case "":
            return packed
        case "zstd":
            # The library allocates what a frame claims, not what it is allowed to.
            # -1 is what zstandard returns for a frame that does not state its length
            if zstandard.frame_content_size(packed.data) not in (-1, size):
                raise ValueError("chunk and zstd frame state different lengths")
            unpacker = zstandard.ZstdDecompressor()
            if torn:
                plain = unpacker.stream_reader(packed.data).read(size)
            else:
                plain = unpacker.decompress(packed.data, max_output_size=size)
        case "lz4":
            context = lz4.frame.create_decompression_context()
            plain, _, _ = lz4.frame.decompress_chunk(context, packed.data, max_length=max(size, 1))
        case other:
            raise ValueError(f"unknown compression {other[:20]!r}")
    return np.frombuffer(plain, np.uint8)


def unpack_file(path: Path, limit: int) -> bytearray:
    """Return the plain bytes of a zstd file; of a torn one what is there."""
    plain = bytearray()
    try:
        with open(path, "rb") as file, zstandard.ZstdDecompressor().stream_reader(file) as reader:
            while piece := reader.read(_PIECE):
                plain += piece
                if len(plain) > limit:
                    problem = f"{path} unpacks to more than {limit // limits.MEGABYTE} MB"
                    raise RecordingError(
                        problem,
                        "If you trust it, raise the limit: set ELASTIC_ARM_MAX_UNPACKED_MB.",
                    )
    except zstandard.ZstdError as error:
        raise RecordingError(
            f"{path} cannot be read: {error}", "Copy it again: it is incomplete."
        ) from None
    return plain
