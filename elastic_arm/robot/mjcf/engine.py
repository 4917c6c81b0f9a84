"""MuJoCo, and the models that it compiled."""

import html
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

from elastic_arm.errors import RobotError, require_libraries
from elastic_arm.input_files import read_bytes

# Of compiling a model: beside what MuJoCo takes itself, of processor time, and of the clock for
# each second of that, as a busy machine gives a process a tenth of a core. MuJoCo's own checks take
# time that grows with the square of the number of copies, keyframes or attributes; an arm with ten
# hulls of 100,000 triangles each takes four seconds at most.
MEMORY = 2_000_000_000  # bytes
SECONDS = 4
PATIENCE = 10
MOST_BODIES = 2000
MOST_FILES = 2000
SMALLER = "Give only the arm: its description needs no meshes, images, height fields or copies"
_PROCESS = Path(__file__).with_name("compiling_process.py")
# One thread, and no library to draw with, which takes longer to load than most models to compile.
_ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MUJOCO_GL": "disable"}
_FOLDER = re.compile(rb"\b(meshdir|texturedir|assetdir)\s*=\s*[\"']([^\"']*)")
_FILE = re.compile(rb"\b(file\w{0,10})\s*=\s*[\"']([^\"'<>]*)")
# Files that name no others.
_LEAVES = (".stl", ".obj", ".msh", ".ply", ".dae", ".png", ".hdr", ".ktx", ".skn", ".bin")


def engine(what: str = "MJCF files need") -> ModuleType:
    """Return MuJoCo, or refuse where it is missing; `what` is subject and verb of the error."""
    require_libraries(what, "mujoco")
    import mujoco

    # Its own habit is to append warnings to a file MUJOCO_LOG.TXT wherever the user works.
    mujoco.set_mju_user_warning(lambda words: None)
    return mujoco


def compiled(path: Path) -> tuple[Any, list[str], bool]:
    """Compile an MJCF file, in a process of its own with limits of memory and time.

    Meshes and pictures whose files are not there are left out where every body states its inertia:
    then they are for the eye alone.
    """
    mj = engine()
    notes, content = _processed(path, "model")
    model = mj.MjModel.from_binary_path("model.mjb", {"model.mjb": content})
    if model.nbody > MOST_BODIES:
        raise RobotError(
            f"it has {model.nbody} bodies; the limit is {MOST_BODIES}", "Give only the arm"
        )
    return model, notes, any(b"armature" in content for content in _sources(path))


def saved(path: Path) -> str:
    """Return an MJCF file as MuJoCo saves it.

    Without includes, and with a line for each body, whatever made it.
    """
    engine()
    return _processed(path, "xml")[1].decode()


def _processed(path: Path, what: str) -> tuple[list[str], bytes]:
    """Return what was left out, and the compiled model or the saved file."""
    for _ in _sources(path):
        pass
    command = [sys.executable, "-P", str(_PROCESS), str(path), str(MEMORY), str(SECONDS), what]
    try:
        run = subprocess.run(
            command, capture_output=True, timeout=PATIENCE * SECONDS, env=os.environ | _ENVIRONMENT
        )
    except subprocess.TimeoutExpired:
        raise RobotError(
            f"MuJoCo takes longer than {PATIENCE * SECONDS} s to compile it", SMALLER
        ) from None
    if run.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        raise RobotError(
            f"MuJoCo needs more than {SECONDS} s of processor time to compile it", SMALLER
        )
    if run.returncode < 0:
        raise RobotError(
            f"MuJoCo ends with {signal.Signals(-run.returncode).name} while it compiles it", SMALLER
        )
    line, _, content = run.stdout.partition(b"\n")
    if run.returncode or not line:
        words = " ".join(run.stderr.decode("utf-8", "replace").strip().splitlines()[-1:])[:200]
        raise RobotError(
            f"MuJoCo cannot compile it: {words or 'it ended without a message'}", SMALLER
        )
    said = json.loads(line)
    if "refused" in said:
        raise RobotError(*said["refused"])
    if "mujoco" in said:
        raise RobotError(
            f"MuJoCo rejects it: {said['mujoco']}",
            "Correct the MJCF; MuJoCo's viewer shows the same error",
        )
    return said["notes"], content


def _sources(path: Path) -> Iterator[bytes]:
    """Yield the content of the file and of those that it names, but for meshes and pictures."""
    left = [path]
    seen = {path}
    while left:
        content = read_bytes(left.pop(), RobotError, "Give the path of an MJCF file.")
        yield content
        folders = {
            path.parent,
            *(path.parent / _value(match) for match in _FOLDER.finditer(content)),
        }
        for match in _FILE.finditer(content):
            name = _value(match)
            for file in (folder / name for folder in folders):
                if not os.path.exists(file) or os.path.isdir(file) or file in seen:
                    continue
                if not os.path.isfile(file):
                    raise RobotError(
                        f"it refers to {name[:60]!r}, which is a pipe or a device",
                        "Save its content as a file first",
                    )
                seen.add(file)
                if len(seen) > MOST_FILES:
                    raise RobotError(f"it refers to more than {MOST_FILES} files", SMALLER)
                if file.suffix.lower() not in _LEAVES:
                    left.append(file)


def _value(match: re.Match[bytes]) -> str:
    """Return the value of an attribute."""
    return html.unescape(match[2].decode(errors="replace"))
