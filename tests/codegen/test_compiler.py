"""The cache of compiled libraries: whole or made again, and nobody else's."""

from __future__ import annotations

import logging
import subprocess
import sys
from pathlib import Path

import pytest

from elastic_arm.codegen import compiler
from elastic_arm.codegen.cache import CACHE_VARIABLE, cache_folder
from elastic_arm.errors import KernelError

SOURCE = "int answer(void) { return 42; }"
USE = f"from elastic_arm.codegen.compiler import build; print(build({SOURCE!r}).answer())"


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache folder that is not there yet."""
    folder = tmp_path / "cache"
    monkeypatch.setenv(CACHE_VARIABLE, str(folder))
    return folder


def used() -> str:
    """What a process of its own prints: a damaged library would kill it."""
    return subprocess.run([sys.executable, "-c", USE], capture_output=True, text=True, check=True).stdout.strip()


def test_the_cache_is_the_users_alone(cache: Path) -> None:
    """The folder is made for its owner only, and the library in it ends with its digest."""
    assert compiler.build(SOURCE).answer() == 42
    assert cache.stat().st_mode & 0o777 == 0o700
    (library,) = cache.iterdir()
    assert compiler._is_whole(library)


@pytest.mark.parametrize("damage", ["cut in half", "a bit turned", "empty", "another's library"])
def test_a_library_that_is_not_what_was_compiled_is_compiled_again(cache: Path, damage: str) -> None:
    """Neither a torn nor an exchanged file is loaded."""
    assert used() == "42"
    (library,) = cache.iterdir()
    content = library.read_bytes()
    turned = bytearray(content)
    turned[len(turned) // 2] ^= 1
    damaged = {"cut in half": content[: len(content) // 2], "a bit turned": bytes(turned), "empty": b""}
    library.write_bytes(damaged.get(damage, Path(sys.executable).resolve().read_bytes()[:100_000]))
    assert used() == "42"
    assert library.read_bytes() == content


def test_a_folder_that_others_may_write_to_is_not_used(cache: Path, caplog: pytest.LogCaptureFixture) -> None:
    """What lies in it is not loaded; a private folder serves, and the warning names the remedy."""
    cache.mkdir()
    cache.chmod(0o777)
    with caplog.at_level(logging.WARNING):
        assert compiler.build(SOURCE).answer() == 42
    assert not list(cache.iterdir())
    taken = cache_folder()
    assert taken != cache and taken.stat().st_mode & 0o777 == 0o700
    assert "chmod 700" in caplog.text and str(cache) in caplog.text


@pytest.mark.parametrize("asked", ["'", "cc \\"])
def test_a_cc_that_no_shell_could_read_is_named(monkeypatch: pytest.MonkeyPatch, asked: str) -> None:
    """An open quotation or a last backslash is an error of the user's, with what to do about it."""
    monkeypatch.setenv("CC", asked)
    with pytest.raises(KernelError, match=r"CC=.* is no command .*Set CC to a working C compiler"):
        compiler.find_compiler()
