"""The compiled checksum of chunks is zlib's, and flipped bits are found by it in chunks packed in any way."""

from __future__ import annotations

import os
import threading
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.codegen.compiler import find_compiler
from elastic_arm.errors import KernelError, RecordingError
from elastic_arm.recording import read_recording, write_recording
from elastic_arm.recording.storage import checksum
from elastic_arm.recording.storage.mcap import open_mcap
from tests.helpers.bags import assert_equal, two_sided

LARGE = 1 << 30


@pytest.fixture(autouse=True)
def forgotten() -> Iterator[None]:
    """Each test finds out for itself what this machine can do, and leaves that to the next one too."""
    checksum._folding_crc32.cache_clear()
    yield
    checksum._folding_crc32.cache_clear()


@pytest.mark.parametrize("compiler", ["usual", "none", "no command"])
def test_it_is_the_checksum_of_zlib(monkeypatch: pytest.MonkeyPatch, compiler: str) -> None:
    """Any length about the block of 64 bytes, any alignment, few bytes and a megabyte; compiled where that can be."""
    if compiler != "usual":
        monkeypatch.setenv("CC", {"none": "", "no command": "'"}[compiler])
    can = compiler == "usual" and find_compiler() and "pclmulqdq" in Path("/proc/cpuinfo").read_text(encoding="utf-8")
    crc32 = checksum.crc32_for(LARGE)
    assert (crc32 is not checksum._crc32_by_zlib) == bool(can)
    rng = np.random.default_rng(0)
    for size in (0, 1, 15, 16, 17, 63, 64, 65, 127, 128, 129, 191, 192, 1000, 4096, 1_048_577):
        for skip in (0, 1, 3):
            data = rng.integers(0, 256, size + skip, dtype=np.uint8)[skip:]
            assert crc32(data) == zlib.crc32(data.tobytes()) == checksum.crc32_for(size)(data)


def test_nothing_is_compiled_for_other_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    """On ARM the source could only be refused: the compiler is not called, and zlib serves."""
    built: list[str] = []
    monkeypatch.setattr(checksum, "processor", lambda: "aarch64Features : fp asimd aes pmull crc32")
    monkeypatch.setattr(checksum, "build", built.append)
    assert checksum.crc32_for(LARGE) is checksum._crc32_by_zlib
    assert not built


def test_a_failed_build_is_not_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many threads unpack, and however many bags are read, one thread asks the compiler once."""
    asked: list[threading.Thread] = []

    def refuse(_: str) -> None:
        asked.append(threading.current_thread())
        raise KernelError("no")

    given = two_sided(np.random.default_rng(1), 3_000)
    bag = write_recording(tmp_path / "bag", given, "lz4")
    monkeypatch.setattr(checksum, "_WORTH_LOADING", 0)
    monkeypatch.setattr(checksum, "build", refuse)
    monkeypatch.setattr(checksum, "processor", lambda: "x86_64flags : pclmulqdq")
    monkeypatch.setattr(os, "cpu_count", lambda: 5)
    for _ in range(2):
        assert_equal(read_recording(bag), given)
    assert asked == [threading.current_thread()]


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
