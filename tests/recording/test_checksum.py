"""The compiled checksum of chunks is zlib's, and flipped bits are found by it in chunks packed in any way."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from elastic_arm.recording import read_recording, write_recording
from elastic_arm.recording.storage import checksum
from elastic_arm.recording.storage.mcap import open_mcap
from tests.helpers.bags import assert_equal, two_sided

LARGE = 1 << 30


@pytest.mark.parametrize("compiler", ["usual", "none"])
def test_it_is_the_checksum_of_zlib(monkeypatch: pytest.MonkeyPatch, compiler: str) -> None:
    """Any length about the block of 64 bytes, any alignment, few bytes and a megabyte; with and without a compiler."""
    if compiler == "none":
        monkeypatch.setenv("CC", "")
        checksum._folding_crc32.cache_clear()
    crc32 = checksum.crc32_for(LARGE)
    rng = np.random.default_rng(0)
    for size in (0, 1, 15, 16, 17, 63, 64, 65, 127, 128, 129, 191, 192, 1000, 4096, 1_048_577):
        for skip in (0, 1, 3):
            data = rng.integers(0, 256, size + skip, dtype=np.uint8)[skip:]
            assert crc32(data) == zlib.crc32(data.tobytes()) == checksum.crc32_for(size)(data)
    checksum._folding_crc32.cache_clear()


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_flipped_bits_in_packed_chunks_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compression: str
) -> None:
    """Of forty single bits none changes what is read without an error; nearly all of them are errors."""
    monkeypatch.setattr(checksum, "_WORTH_LOADING", 0)
    given = two_sided(np.random.default_rng(1), 3_000)
    file = write_recording(tmp_path / "bag", given, compression) / "bag_0.mcap"  # type: ignore[arg-type]
    content = file.read_bytes()
    rng, found = np.random.default_rng(2), 0
    spans = [(chunk.begin, chunk.end) for chunk in open_mcap(file).chunks]
    for begin, end in rng.choice(spans, 40).tolist():
        changed = bytearray(content)
        changed[int(rng.integers(begin, end))] ^= 1 << int(rng.integers(8))
        file.write_bytes(changed)
        try:
            assert_equal(read_recording(file.parent), given)
        except RecordingError as error:
            assert "is damaged" in error.problem
            found += 1
    assert found >= 38
