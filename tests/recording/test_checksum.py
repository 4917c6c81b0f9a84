"""Flipped bits are found by the checksums of chunks packed in any way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from elastic_arm.recording import read_recording, write_recording
from elastic_arm.recording.storage.mcap import open_mcap
from tests.helpers.bags import assert_equal, two_sided


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_flipped_bits_in_packed_chunks_are_found(tmp_path: Path, compression: str) -> None:
    """Of forty single bits none changes what is read without an error; nearly all of them are errors."""
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
