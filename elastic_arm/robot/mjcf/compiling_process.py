"""A separate process that compiles one MJCF file.

Its command is ``python -P compiling_process.py FILE BYTES SECONDS WHAT``.

MuJoCo trusts the sizes and counts in a file: one line may request an image of ten gigabytes, or a
hundred thousand bodies. Here this costs at most this process, whose memory (bytes beyond those of
MuJoCo itself) and processor time are limited. It runs as a script and imports nothing of the
package, so it starts quickly. It writes a line of JSON with omissions or the error to standard
output, followed by the compiled model as saved by MuJoCo (WHAT is "model"), or the file as saved by
MuJoCo ("xml").
"""

import json
import resource
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np


class Refused(Exception):
    """What is wrong with a model, and what to do."""


def compiled(path: Path, what: str) -> tuple[list[str], bytes]:
    """Return what was left out, and the model or its file as bytes."""
    spec = mujoco.MjSpec.from_file(str(path))
    notes = _without_missing_files(spec, path.parent)
    model = spec.compile()
    if what == "xml":
        return notes, spec.to_xml().encode()
    packed = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, packed)
    return notes, packed.tobytes()


def _without_missing_files(spec: Any, folder: Path) -> list[str]:
    """Take meshes and textures without a file, and the geoms that show them, out of a
    specification."""
    meshes = folder / (spec.meshdir or "")
    missing = {
        mesh.name or Path(mesh.file).stem: mesh
        for mesh in spec.meshes
        if _absent(meshes, mesh.file)
    }
    shown = [geom for geom in spec.geoms if geom.meshname in missing]
    weighing = sorted(
        {g.parent.name for g in shown if not g.parent.explicitinertial and _moves(g.parent)}
    )
    if weighing:
        raise Refused(
            f"mesh files are missing, and bodies {', '.join(weighing)} need them for their inertia",
            f"Put the meshes into {meshes}, or give these bodies an <inertial>",
        )
    for geom in shown:
        spec.delete(geom)
    for mesh in missing.values():
        spec.delete(mesh)
    textures = folder / (spec.texturedir or "")
    for texture in [t for t in spec.textures if _absent(textures, t.file)]:
        spec.delete(texture)
    return [f"{len(missing)} mesh files are missing: their shapes are ignored"] if missing else []


def _moves(body: Any) -> bool:
    """Return whether a body moves in the world: its inertia does not matter otherwise."""
    while body.name != "world":
        if body.joints:
            return True
        body = body.parent
    return False


def _absent(folder: Path, file: str) -> bool:
    return bool(file) and not (folder / file).is_file()


def _limit(kind: int, limit: int) -> None:
    """Limit this process, at most to what it may have already: a limit of the user's shell cannot
    be raised."""
    _, most = resource.getrlimit(kind)
    limit = limit if most == resource.RLIM_INFINITY else min(limit, most)
    resource.setrlimit(kind, (limit, limit))


def main() -> None:
    """Compile the file and write what came of it to standard output."""
    path = sys.argv[1]
    memory = int(sys.argv[2])
    seconds = int(sys.argv[3])
    what = sys.argv[4]
    # Its own habit is to append warnings to a file MUJOCO_LOG.TXT wherever the user works.
    mujoco.set_mju_user_warning(lambda words: None)
    with open("/proc/self/statm", encoding="ascii") as status:
        own = int(status.read().split()[0]) * resource.getpagesize()
    _limit(resource.RLIMIT_AS, own + memory)
    _limit(resource.RLIMIT_CPU, seconds)
    _limit(resource.RLIMIT_CORE, 0)
    content = b""
    try:
        notes, content = compiled(Path(path), what)
        said: dict[str, Any] = {"notes": notes}
    except Refused as error:
        said = {"refused": error.args}
    except MemoryError:
        said = {"mujoco": "it needs too much memory"}
    # RuntimeError is what becomes of an exception of C++, such as the one for a lack of memory.
    except (ValueError, TypeError, RuntimeError, mujoco.FatalError) as error:
        said = {"mujoco": " ".join(str(error).split()).removeprefix("Error: ")}
    sys.stdout.buffer.write(json.dumps(said).encode() + b"\n" + content)


if __name__ == "__main__":
    main()
