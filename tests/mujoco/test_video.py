"""Replays as moving pictures, rendered by MuJoCo."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.errors import OutputError
from elastic_arm.mujoco.replaying import JointErrors, Replay, ReplayedCourse
from tests.helpers.mujoco_arms import MODELS

pytest.importorskip("mujoco")

from PIL import Image

from elastic_arm.mujoco.video import FRAMES_A_SECOND, WIDTH, write_video
from elastic_arm.robot.mjcf import open_mjcf

ARM = open_mjcf(MODELS / "arm.xml")
SECONDS = 0.4


def course_off_by(angle: float) -> Replay:
    """Return a replay in which joint 2 is off by an angle, rad."""
    t = np.arange(0.0, SECONDS, 0.002)
    recorded = np.tile([0.0, 0.5, 0.0, -1.5, 0.0, 1.5, 0.0], (len(t), 1))
    replayed = recorded + angle * (np.arange(7) == 1)
    replayed[0] = np.nan
    none = np.zeros(7)
    course = ReplayedCourse(t, recorded, replayed, recorded, recorded)
    return Replay("arm.xml", ARM.robot.joint_names, 0.2, 2, JointErrors(*[none] * 5), None, course)


def colours(path: Path) -> tuple[int, int]:
    """Return how many pixels of the last picture, below the words, are blue and how many orange."""
    image = Image.open(path)
    image.seek(image.n_frames - 1)
    picture = np.asarray(image.convert("RGB"), dtype=int)[60:, :WIDTH]
    red, _, blue = np.moveaxis(picture, -1, 0)
    return int(np.sum(blue > red + 40)), int(np.sum(red > blue + 40))


def test_a_video_shows_the_recorded_arm_apart_from_the_simulated_one(tmp_path: Path) -> None:
    """A frame for each 50 ms and a panel for each model; where the arms part, both colours are seen."""
    near, far = course_off_by(0.0), replace(course_off_by(0.4), name="other.xml")
    try:
        write_video(tmp_path / "both.webp", [ARM, ARM], [near, far])
    except OutputError as error:
        pytest.skip(str(error))
    video = Image.open(tmp_path / "both.webp")
    assert video.n_frames == round(SECONDS * FRAMES_A_SECOND)
    assert video.size[0] == 2 * WIDTH
    for one in (near, far):
        write_video(tmp_path / f"{one.name}.webp", [ARM], [one])
    (same, _), (ghost, simulated) = (colours(tmp_path / f"{one.name}.webp") for one in (near, far))
    assert ghost > 300 > 10 * same
    assert simulated > 300


def test_without_opengl_one_line_states_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nothing can render, the error names what to install or to set."""
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(OutputError, match=r"no video.*libegl1.*MUJOCO_GL"):
        write_video(tmp_path / "none.webp", [ARM], [course_off_by(0.0)])
