"""A replay as a moving picture: the recorded arm as a ghost, and each model's arm on it, rendered
by MuJoCo.

    python examples/replay_video.py BAG MODEL.xml [MODEL.xml …]

It writes replay.webp, which browsers show: the first 10 s. MuJoCo renders through EGL, which needs
no display ($MUJOCO_GL chooses otherwise); links without a shape are drawn as capsules between the
joints. Needs Pillow.
"""

import io
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_arm.errors import OutputError
from elastic_arm.mujoco.replaying import Replay, labels, replay
from elastic_arm.output_files import write_result
from elastic_arm.recording import read_recording
from elastic_arm.robot.mjcf import MjcfArm, engine, open_mjcf

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

WIDTH, HEIGHT = 480, 400  # pixels a model
FRAMES_A_SECOND = 20
LONGEST = 10.0  # s of the recording
GHOST = (0.25, 0.45, 0.95, 0.35)  # the recorded arm
SIMULATED = (0.95, 0.55, 0.15, 1.0)
MOST_GEOMS = 2000
# Links without a shape of their own are drawn as capsules between joints, this thick for the size
# of the model.
STICK = 0.02
GLOW = 0.4  # of moving shapes: a model need not have lights
AZIMUTH, ELEVATION = 130.0, -20.0  # of the camera, degrees
DISTANCE = 2.6  # of the camera, in radii of what the arm reaches


def write_video(path: Path, arms: Sequence[MjcfArm], found: Sequence[Replay]) -> None:
    """Write an animated WebP of all models side by side.

    Parameters
    ----------
    path
        Of the file.
    arms, found
        The models, and what :func:`.replaying.replay` found of each.

    Raises
    ------
    OutputError
        If no OpenGL is there to render with, or the file cannot be written.
    """
    # Matplotlib, which brings it, is slow to import.
    from PIL import Image, ImageDraw

    sequences = [_pictures(arm, one) for arm, one in zip(arms, found, strict=True)]
    pictures = []
    for frames in zip(*sequences, strict=False):
        image = Image.fromarray(np.hstack([picture for _, picture in frames]))
        draw = ImageDraw.Draw(image)
        for k, name in enumerate(labels(found)):
            draw.text((k * WIDTH + 10, 8), f"{name}   {frames[k][0]:.2f} s", fill="white")
            draw.text((k * WIDTH + 10, 22), "recorded", fill=_web(GHOST))
            draw.text((k * WIDTH + 80, 22), "simulated", fill=_web(SIMULATED))
        pictures.append(image)
    film, duration = io.BytesIO(), round(1000 / FRAMES_A_SECOND)
    pictures[0].save(
        film,
        "WEBP",
        save_all=True,
        append_images=pictures[1:],
        duration=duration,
        loop=0,
        quality=80,
    )
    write_result(path, film.getvalue())


def _web(color: tuple[float, ...]) -> tuple[int, ...]:
    return tuple(round(255 * part) for part in color[:3])


def _pictures(arm: MjcfArm, replay: Replay) -> Iterator[tuple[float, Picture]]:
    """Yield times from the start, s, and pictures (HEIGHT, WIDTH, 3) of a replay's course."""
    course = replay.course
    period = float(np.median(np.diff(course.t)))
    every = max(1, round(1.0 / (FRAMES_A_SECOND * period)))
    kept = np.flatnonzero(course.t - course.t[0] <= LONGEST)[::every]
    stage = _Stage(arm)
    stage.look_at(course.recorded[kept])
    for k in kept.tolist():
        replayed = np.where(np.isfinite(course.replayed[k]), course.replayed[k], course.recorded[k])
        yield float(course.t[k] - course.t[0]), stage.picture(course.recorded[k], replayed)


class _Stage:
    """What MuJoCo needs to render two poses of an arm into one picture."""

    def __init__(self, arm: MjcfArm) -> None:
        self._mj, self._arm, model = engine("a video needs"), arm, arm.model
        model.vis.global_.offwidth, model.vis.global_.offheight = WIDTH, HEIGHT
        model.vis.quality.offsamples = 2
        self._gl, self._context = _opengl(model)
        mj = self._mj
        self._scene, self._options = mj.MjvScene(model, MOST_GEOMS), mj.MjvOption()
        self._camera, self._hand = mj.MjvCamera(), mj.MjvPerturb()
        mj.mjv_defaultFreeCamera(model, self._camera)
        self._camera.azimuth, self._camera.elevation = AZIMUTH, ELEVATION
        self._view = mj.MjrRect(0, 0, WIDTH, HEIGHT)
        self._data = mj.MjData(model)
        shown = {
            arm.chain.link_of.get(int(model.geom_bodyid[k]))
            for k in range(model.ngeom)
            if model.geom_group[k] < 3
        }
        self._bare = [link for link in range(arm.robot.n) if link not in shown]

    def look_at(self, poses: Array) -> None:
        """Point the camera at what the arm reaches in poses (N, n)."""
        reached = []
        for pose in poses:
            self._pose(pose)
            reached += self._points()
        low, high = np.min(reached, axis=0), np.max(reached, axis=0)
        self._camera.lookat[:] = 0.5 * (low + high)
        self._camera.distance = DISTANCE * 0.5 * float(np.linalg.norm(high - low))

    def _points(self) -> list[Array]:
        """Return where the joints are, and the last link's centre of mass."""
        model, joints = self._arm.model, list(self._arm.chain.joints)
        last = int(model.jnt_bodyid[joints[-1]])
        return [*self._data.xanchor[joints].copy(), self._data.xipos[last].copy()]

    def picture(self, recorded: Array, replayed: Array) -> Picture:
        """Return the picture (HEIGHT, WIDTH, 3) of two poses (n,)."""
        mj, model, scene = self._mj, self._arm.model, self._scene
        self._gl.make_current()
        self._pose(replayed)
        everything = mj.mjtCatBit.mjCAT_ALL
        mj.mjv_updateScene(
            model, self._data, self._options, self._hand, self._camera, everything, scene
        )
        first = self._coloured(0, SIMULATED)
        self._pose(recorded)
        mj.mjv_addGeoms(
            model, self._data, self._options, self._hand, mj.mjtCatBit.mjCAT_DYNAMIC, scene
        )
        self._coloured(first, GHOST)
        mj.mjr_render(self._view, scene, self._context)
        found = np.empty((HEIGHT, WIDTH, 3), dtype=np.uint8)
        mj.mjr_readPixels(found, None, self._view, self._context)
        return found[::-1]

    def _pose(self, angles: Array) -> None:
        self._data.qpos[:] = self._arm.qpos
        self._data.qpos[self._arm.positions] = angles
        self._mj.mj_kinematics(self._arm.model, self._data)
        self._mj.mj_comPos(self._arm.model, self._data)

    def _coloured(self, first: int, color: tuple[float, ...]) -> int:
        """Colour the moving shapes of the scene from `first` on, links without any added; return
        how many there are."""
        self._add_sticks()
        scene = self._scene
        for k in range(first, scene.ngeom):
            if scene.geoms[k].category == self._mj.mjtCatBit.mjCAT_DYNAMIC:
                scene.geoms[k].rgba[:], scene.geoms[k].emission = color, GLOW
        return int(scene.ngeom)

    def _add_sticks(self) -> None:
        mj, model, ends = self._mj, self._arm.model, self._points()
        capsule, none = mj.mjtGeom.mjGEOM_CAPSULE, np.zeros(3)
        for link in self._bare:
            geom = self._scene.geoms[self._scene.ngeom]
            mj.mjv_initGeom(geom, capsule, none, none, np.zeros(9), np.ones(4, dtype=np.float32))
            mj.mjv_connector(geom, capsule, STICK * model.stat.extent, ends[link], ends[link + 1])
            geom.category = mj.mjtCatBit.mjCAT_DYNAMIC
            self._scene.ngeom += 1


def _opengl(model: Any) -> tuple[Any, Any]:
    """Return OpenGL for a model: by the user's choice ($MUJOCO_GL, a display), or EGL, which needs
    neither."""
    mj = engine()
    try:
        if os.environ.get("MUJOCO_GL") or os.environ.get("DISPLAY"):
            from mujoco.gl_context import GLContext
        else:
            from mujoco.egl import GLContext
        gl = GLContext(WIDTH, HEIGHT)
        gl.make_current()
        context = mj.MjrContext(model, mj.mjtFontScale.mjFONTSCALE_100)
    except (ImportError, AttributeError, RuntimeError, mj.FatalError) as error:
        raise OutputError(
            f"no video: there is no OpenGL to render with ({' '.join(str(error).split())})",
            "Install EGL (libegl1, libgl1-mesa-dri), or set MUJOCO_GL to egl, osmesa or glfw",
        ) from None
    mj.mjr_setBuffer(mj.mjtFramebuffer.mjFB_OFFSCREEN, context)
    return gl, context


if __name__ == "__main__":
    models = [open_mjcf(path) for path in sys.argv[2:]]
    recording = read_recording(Path(sys.argv[1]))
    names = zip(sys.argv[2:], models, strict=True)
    write_video(
        Path("replay.webp"), models, [replay(recording, arm, name=path) for path, arm in names]
    )
