"""The C compiler of the system behind a cache: every source is compiled once per machine, and found
again by its content.
"""

import ctypes
import functools
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

from elastic_arm.codegen.cache import (
    CACHE_VARIABLE,
    cache_folder,
    is_own_file,
    replace_folder,
    whole,
)
from elastic_arm.errors import KernelError

_TIMEOUT_S = 300.0
_FLAGS = (
    "-std=gnu11", "-shared", "-fPIC", "-w", "-O2", "-fno-math-errno", "-fno-trapping-math",
    "-ffp-contract=fast",
)  # fmt: skip
# Tried in turn: with the vector mathematics of the GNU C library, for this processor only, and
# plain.
_VARIANTS = (("-march=native", "-DVECTOR_MATH"), ("-march=native",), ())
_DIGEST_BYTES = hashlib.sha256().digest_size
_LIBRARIES = {"-DVECTOR_MATH": ("-lmvec",)}


def find_compiler() -> tuple[str, ...] | None:
    """Command of $CC, cc, gcc or clang, the first that is there, or None.

    An empty $CC means none.

    Raises a KernelError if $CC cannot be split into words, as a shell would.
    """
    asked = os.environ.get("CC")
    try:
        commands = [["cc"], ["gcc"], ["clang"]] if asked is None else [shlex.split(asked) or [""]]
    except ValueError as error:
        raise KernelError(
            f"CC={asked!r} is not a command ({error})",
            "Set CC to a working C compiler, or to an empty string to use none",
        ) from error
    for name, *options in commands:
        if path := shutil.which(name):
            return path, *options
    return None


def build(source: str) -> ctypes.CDLL:
    """Compile C `source` to a shared library, or find it in the cache, and load it.

    Safe among processes that build the same source at once: a library appears under its name only
    when complete.

    Raises a KernelError if there is no compiler, $CC is no command, it refuses the source, or there
    is no folder at all to write to.
    """
    return build_once(source, lambda: source)


def build_once(identity: str, source: Callable[[], str]) -> ctypes.CDLL:
    """As :func:`build`, but print the source only for an `identity` that is not cached.

    identity: what the source depends on; part of the library's name in the cache.

    Raises a KernelError as :func:`build`.
    """
    compiler = find_compiler()
    if compiler is None:
        raise KernelError("no C compiler was found", "Install gcc or clang, or set CC to one")
    name = f"{_key(identity, compiler)}.so"
    try:
        folder = cache_folder()
        try:
            return _found_or_made(folder / name, source, compiler)
        except OSError as error:  # a disk that is full, may not be written, or runs no programs
            reason = (error.strerror or str(error)).removeprefix(f"{folder / name}: ")
        return _found_or_made(
            replace_folder(folder, f"cannot be used ({reason})") / name, source, compiler
        )
    except OSError as error:
        raise KernelError(
            f"there is no folder for compiled code ({error})",
            f"Set {CACHE_VARIABLE} to a writable folder",
        ) from error


def _found_or_made(
    library: Path, source: Callable[[], str], compiler: tuple[str, ...]
) -> ctypes.CDLL:
    if not _is_whole(library):
        content = _compiled(source(), compiler)
        with whole(library) as passing:
            # loaders take no notice of what follows the last section
            passing.write_bytes(content + _digest(content))
    return ctypes.CDLL(str(library))


def _is_whole(library: Path) -> bool:
    """Whether a library of the user's is there, with its digest: loading half of one kills the
    process."""
    if not is_own_file(library):
        return False
    try:
        content = library.read_bytes()
    except OSError:
        return False
    return (
        len(content) > _DIGEST_BYTES
        and _digest(content[:-_DIGEST_BYTES]) == content[-_DIGEST_BYTES:]
    )


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).digest()


def _key(identity: str, compiler: tuple[str, ...]) -> str:
    content = "\0".join([identity, *compiler, *_compiler_stamp(compiler[0]), *_FLAGS, processor()])
    return hashlib.sha256(content.encode()).hexdigest()[:32]


def _compiler_stamp(compiler: str) -> tuple[str, str]:
    """Size and time of the compiler's file: changes with its version, and costs no process."""
    stat = Path(compiler).stat()
    return str(stat.st_size), str(stat.st_mtime_ns)


@functools.cache
def processor() -> str:
    """Return what ``-march=native`` depends on.

    The machine, and on Linux the abilities of its processor.
    """
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.machine() + platform.processor()
    chosen = (line for line in lines if line.startswith(("flags", "Features", "model name")))
    return platform.machine() + "".join(sorted(set(chosen)))


def _compiled(source: str, compiler: tuple[str, ...]) -> bytes:
    """Return the library that the compiler makes of a source.

    Raises a KernelError if it refuses the source, or does not end; an OSError if there is no room
    for it.
    """
    messages = []
    with tempfile.TemporaryDirectory(prefix="elastic_arm_") as folder:
        text = Path(folder) / "kernel.c"
        made = Path(folder) / "kernel.so"
        text.write_text(source, encoding="utf-8")
        for variant in _VARIANTS:
            libraries = [name for flag in variant for name in _LIBRARIES.get(flag, ())]
            command = [
                *compiler,
                *_FLAGS,
                *variant,
                str(text),
                "-o",
                str(made),
                *libraries,
                "-lm",
            ]
            try:
                done = subprocess.run(
                    command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False
                )
            except subprocess.TimeoutExpired as error:
                raise KernelError(
                    f"{compiler[0]} did not end within {_TIMEOUT_S:g} s", "Run with an empty CC"
                ) from error
            if done.returncode == 0:
                return made.read_bytes()
            messages.append(done.stderr.strip())
    first = messages[-1].splitlines()[0] if messages[-1] else "no message"
    raise KernelError(
        f"{compiler[0]} failed: {first}",
        "Set CC to a working C compiler, or to an empty string to use none",
    )
