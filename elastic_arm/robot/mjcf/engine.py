"""MuJoCo, which is an optional extra, and models compiled by it."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

from elastic_arm.errors import MissingExtraError, RobotError
from elastic_arm.input_files import read_bytes


def engine(what: str = "MJCF files need", extra: str = "mujoco") -> ModuleType:
    """Return MuJoCo.

    Parameters
    ----------
    what
        Subject and verb of the error: what needs it.
    extra
        The optional extra that installs it.

    Raises
    ------
    MissingExtraError
        When it is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise MissingExtraError(
            f"{what} the physics engine MuJoCo, which is not installed",
            f"Install it with: pip install 'elastic_arm[{extra}]'",
        ) from error
    # Its own habit is to append warnings to a file MUJOCO_LOG.TXT wherever the user works.
    mujoco.set_mju_user_warning(lambda words: None)
    return mujoco


def compiled(path: Path) -> tuple[Any, list[str]]:
    """Compile an MJCF file.

    Meshes and pictures whose files are not there are left out where every body states its inertia: then they are for
    the eye alone.

    Returns
    -------
    model, notes
        The compiled `MjModel`, and what was left out.

    Raises
    ------
    RobotError
        If MuJoCo refuses it; the message is MuJoCo's own.
    """
    _, model, notes = _opened(path)
    return model, notes


def saved(path: Path) -> str:
    """Return an MJCF file as MuJoCo saves it: without includes, and with a line for each body, whatever made it.

    Parameters
    ----------
    path
        Of the file; see :func:`compiled` for errors.
    """
    return str(_opened(path)[0].to_xml())


def _opened(path: Path) -> tuple[Any, Any, list[str]]:
    """Return specification, compiled model and notes."""
    mj = engine()
    read_bytes(path, RobotError, "Give the path of an MJCF file.")
    try:
        spec = mj.MjSpec.from_file(str(path))
        notes = _without_missing_files(spec, path.parent)
        return spec, spec.compile(), notes
    except RobotError:
        raise
    except (ValueError, mj.FatalError) as error:
        words = " ".join(str(error).split()).removeprefix("Error: ")
        raise RobotError(f"MuJoCo refuses it: {words}", "Mend the MJCF; MuJoCo's viewer shows the same error") from None


def _without_missing_files(spec: Any, folder: Path) -> list[str]:
    """Take meshes and textures without a file, and the geoms that show them, out of a specification."""
    meshes = folder / (spec.meshdir or "")
    missing = {mesh.name or Path(mesh.file).stem: mesh for mesh in spec.meshes if _absent(meshes, mesh.file)}
    shown = [geom for geom in spec.geoms if geom.meshname in missing]
    weighing = sorted({g.parent.name for g in shown if not g.parent.explicitinertial and _moves(g.parent)})
    if weighing:
        raise RobotError(
            f"mesh files are missing, and bodies {', '.join(weighing)} take their inertia from them",
            f"Put the meshes into {meshes}, or give these bodies an <inertial>",
        )
    for geom in shown:
        spec.delete(geom)
    for mesh in missing.values():
        spec.delete(mesh)
    textures = folder / (spec.texturedir or "")
    for texture in [t for t in spec.textures if _absent(textures, t.file)]:
        spec.delete(texture)
    return [f"{len(missing)} mesh files are missing: what they show is left out"] if missing else []


def _moves(body: Any) -> bool:
    """Return whether a body moves in the world: its inertia does not matter otherwise."""
    while body.name != "world":
        if body.joints:
            return True
        body = body.parent
    return False


def _absent(folder: Path, file: str) -> bool:
    return bool(file) and not (folder / file).is_file()
