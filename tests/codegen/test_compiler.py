"""The cache of compiled libraries: whole or made again, and nobody else's."""

import contextlib
import logging
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from elastic_arm.codegen import compiler, kernels
from elastic_arm.codegen.cache import CACHE_VARIABLE, LARGEST_FILE, cache_folder, is_own_file
from elastic_arm.codegen.derivations import cached_functions, cached_program
from elastic_arm.effects import parse
from elastic_arm.errors import KernelError
from elastic_arm.robot import load_robot
from elastic_arm.simulation import SimulationSettings, Simulator
from tests.helpers.small_disk import fill, make_read_only, mounted

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
    return subprocess.run(
        [sys.executable, "-c", USE], capture_output=True, text=True, check=True
    ).stdout.strip()


def test_the_cache_is_the_users_alone(cache: Path) -> None:
    """The folder is made for its owner only, and the library in it ends with its digest."""
    assert compiler.build(SOURCE).answer() == 42
    assert cache.stat().st_mode & 0o777 == 0o700
    (library,) = cache.iterdir()
    assert compiler._is_whole(library)


@pytest.mark.parametrize("damage", ["cut in half", "a bit turned", "empty", "another's library"])
def test_a_library_that_is_not_what_was_compiled_is_compiled_again(
    cache: Path, damage: str
) -> None:
    """Neither a torn nor an exchanged file is loaded."""
    assert used() == "42"
    (library,) = cache.iterdir()
    content = library.read_bytes()
    turned = bytearray(content)
    turned[len(turned) // 2] ^= 1
    damaged = {
        "cut in half": content[: len(content) // 2],
        "a bit turned": bytes(turned),
        "empty": b"",
    }
    library.write_bytes(damaged.get(damage, Path(sys.executable).resolve().read_bytes()[:100_000]))
    assert used() == "42"
    assert library.read_bytes() == content


def test_a_folder_that_others_may_write_to_is_not_used(
    cache: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """What lies in it is not loaded; a private folder serves, and the warning names the remedy."""
    cache.mkdir()
    cache.chmod(0o777)
    with caplog.at_level(logging.WARNING):
        assert compiler.build(SOURCE).answer() == 42
    assert not list(cache.iterdir())
    taken = cache_folder()
    assert taken != cache and taken.stat().st_mode & 0o777 == 0o700
    assert f"{cache} belongs to another user, or is writable by others" in caplog.text
    assert "Remove it, or set" in caplog.text and "chmod" not in caplog.text


def hand_over(cache: Path, what: Path) -> None:
    """Give a file or folder to another user, as only root may."""
    if os.getuid():
        pytest.skip("only root may give files away")
    os.lchown(what, 12345, 12345)


@pytest.mark.parametrize("how", ["another's", "writable by all", "a link"])
def test_a_file_that_others_put_into_the_cache_is_not_loaded(cache: Path, how: str) -> None:
    """A digest is no secret: whoever could write here once may have left a library that matches its
    own."""
    assert used() == "42"
    (library,) = cache.iterdir()
    planted = compiler._compiled(
        "int answer(void) { return 666; }", compiler.find_compiler() or ("cc",)
    )
    library.write_bytes(planted + compiler._digest(planted))
    assert used() == "666"  # in a file of one's own it would run
    if how == "another's":
        hand_over(cache, library)
    elif how == "writable by all":
        library.chmod(0o666)
    else:
        library.rename(cache / "elsewhere")
        library.symlink_to(cache / "elsewhere")
    assert used() == "42"
    assert is_own_file(library)


@pytest.mark.parametrize("way", ["a writable folder", "another's link", "another's folder"])
def test_a_cache_that_others_could_exchange_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, way: str
) -> None:
    """A private folder within one that others write to may be another by the next run; so may the
    end of a link."""
    between = tmp_path / "between"
    between.mkdir()
    folder = between / "cache"
    if way == "another's link":
        (tmp_path / "real").mkdir(mode=0o700)
        folder.symlink_to(tmp_path / "real")
        hand_over(tmp_path, folder)
    else:
        folder.mkdir(mode=0o700)
        hand_over(tmp_path, between) if way == "another's folder" else between.chmod(0o777)
    monkeypatch.setenv(CACHE_VARIABLE, str(folder))
    with caplog.at_level(logging.WARNING):
        assert compiler.build(SOURCE).answer() == 42
    assert not list(folder.iterdir())
    assert f"{folder} is reached through {folder if 'link' in way else between}" in caplog.text


def test_a_folder_with_the_sticky_bit_may_hold_the_cache(cache: Path) -> None:
    """In /tmp others cannot take away what is not theirs."""
    cache.parent.chmod(0o1777)
    assert compiler.build(SOURCE).answer() == 42
    assert list(cache.iterdir())


@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "huge"])
@pytest.mark.parametrize("ending", ["so", "npz", "casadi"])
def test_an_entry_that_is_no_file_is_made_again(cache: Path, kind: str, ending: str) -> None:
    """A pipe would never end, a device never run out."""

    def run() -> float:
        if ending == "so":
            return float(compiler.build(SOURCE).answer())
        x = ca.SX.sym("x")
        double = ca.Function("double", [x], [2 * x])
        if ending == "npz":
            return float(
                kernels.make(cached_program("double", lambda: double, []), "numpy")(
                    np.array([[21.0]])
                ).item()
            )
        return float(cached_functions("double", lambda: [double], [])[0](21.0))

    assert run() == 42.0
    (entry,) = cache.iterdir()
    entry.unlink()
    if kind == "pipe":
        os.mkfifo(entry)
    elif kind == "device":
        entry.symlink_to("/dev/zero")
    elif kind == "folder":
        entry.mkdir()
    else:
        with entry.open("wb") as file:
            file.truncate(LARGEST_FILE + 1)
    assert run() == 42.0


@pytest.mark.parametrize("kind", ["a file", "below a file", "full", "read-only", "runs nothing"])
def test_a_cache_that_cannot_be_used_costs_time_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, kind: str
) -> None:
    """Compiled code is kept for the life of the process then, and the reason is said once."""
    disk = tmp_path / "disk"
    with contextlib.ExitStack() as stack:
        if "file" in kind:
            disk.write_text("no folder")
        else:
            stack.enter_context(mounted(disk, 40))
            disk.chmod(0o700)
        if kind == "full":
            fill(disk)
        if kind == "read-only":
            make_read_only(disk)
        if kind == "runs nothing":
            subprocess.run(["mount", "-o", "remount,noexec", str(disk)], check=True)
        monkeypatch.setenv(CACHE_VARIABLE, str(disk / "cache" if kind == "below a file" else disk))
        with caplog.at_level(logging.WARNING):
            assert compiler.build(SOURCE).answer() == 42
            assert compiler.build(f"{SOURCE} int other;").answer() == 42
        assert caplog.text.count("kernels are compiled again") == 1


def test_without_any_folder_the_simulation_is_slow_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Neither a cache nor temporary files: CasADi and numpy serve."""
    nowhere = tmp_path / "file"
    nowhere.write_text("no folder")
    monkeypatch.setenv(CACHE_VARIABLE, str(nowhere))
    monkeypatch.setattr(tempfile, "tempdir", str(nowhere))
    robot = load_robot()
    # Of a structure that no other test has compiled in this process.
    effects = [parse(f"coulomb_friction:joint_{k}:torque=3,side=motor", robot) for k in (2, 3)]
    with caplog.at_level(logging.WARNING):
        assert Simulator(robot, SimulationSettings(effects=effects)).integrator.name == "casadi"
    assert "there is no folder for compiled code" in caplog.text


@pytest.mark.parametrize("asked", ["'", "cc \\"])
def test_a_cc_that_no_shell_could_read_is_named(
    monkeypatch: pytest.MonkeyPatch, asked: str
) -> None:
    """An open quotation or a last backslash is an error of the user's, with what to do about it."""
    monkeypatch.setenv("CC", asked)
    with pytest.raises(
        KernelError, match=r"CC=.* is not a command .*Set CC to a working C compiler"
    ):
        compiler.find_compiler()
