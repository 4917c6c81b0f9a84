"""The folder of an arm of a level: its description, its two bags, and how they are to be read."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from elastic_arm.effects import Catalogue
from elastic_arm.recording import write_recording
from elastic_arm.robot import Robot, load_robot, save_robot, to_urdf
from elastic_arm.robot.saving import robot_to_dict
from elastic_arm.studies.blind_challenge.arm_sampling import SamplingRequest
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import HiddenArm
from elastic_arm.studies.blind_challenge.hidden_arms.realistic_sensors import LINK, measure_realistically
from elastic_arm.studies.blind_challenge.levels.level import ChallengeLevel
from elastic_arm.studies.blind_challenge.levels.sampling import sample_realistic_arm

DESCRIPTIONS, CHANNELS = "robots", "channels"  # folders of a challenge


def record_realistic_arm(
    folder: Path, bags: tuple[Path, Path], request: SamplingRequest, level: ChallengeLevel, catalogue: Catalogue
) -> dict[str, Any]:
    """Draw an arm of a level and record it; return its truth."""
    rng = np.random.default_rng(request.seed)
    drawn = sample_realistic_arm(request, level, rng, catalogue)
    description, sensors = drawn.description, drawn.arm.sensors
    ratios = np.array([joint.transmission.r_tot for joint in description.joints if joint.transmission])
    hidden = HiddenArm(drawn.robot, drawn.arm.all_faults, geometry=description)
    for bag, motion in zip(bags, drawn.motions, strict=True):
        course = hidden.run(motion)
        recording = measure_realistically(course, description.joint_names, hidden.faults, sensors, ratios, rng)
        if not (bag / "metadata.yaml").is_file():
            shutil.rmtree(bag, ignore_errors=True)  # what a run that was broken off has left
            bag.parent.mkdir(parents=True, exist_ok=True)
            write_recording(bag, recording)
    _write_description(folder / DESCRIPTIONS, request.name, description, urdf=level.urdf)
    if sensors.sides == LINK:
        path = folder / CHANNELS / f"{request.name}.yaml"
        path.parent.mkdir(exist_ok=True)
        path.write_text(yaml.safe_dump(_link_channels(description.joint_names)), encoding="utf-8")
    return drawn.arm.truth()


def description_path(folder: Path, name: str) -> Path | None:
    """Return the file that describes an arm; None for the nominal one."""
    path = folder / DESCRIPTIONS / f"{name}.yaml"
    return path if path.is_file() else None


def channels_path(folder: Path, name: str) -> Path | None:
    """Return the channel map of an arm's bags; None where they need none."""
    path = folder / CHANNELS / f"{name}.yaml"
    return path if path.is_file() else None


def _write_description(folder: Path, name: str, robot: Robot, *, urdf: bool) -> None:
    """Write an arm as an arm file, or as a URDF with its drives in an overlay; the nominal arm needs none."""
    if robot.n == load_robot(None).n:
        return
    folder.mkdir(exist_ok=True)
    path = folder / f"{name}.yaml"
    if not urdf:
        save_robot(robot, path)
        return
    rigid = robot.with_(joints=tuple(replace(joint, transmission=None) for joint in robot.joints))
    path.with_suffix(".urdf").write_text(to_urdf(rigid), encoding="utf-8")
    fields = ("rotor", "wave_generator", "spline", "stiffness", "damping", "belt_ratio", "harmonic_drive_ratio")
    stated = robot_to_dict(robot)["joints"]
    overlay = {
        "urdf": f"{name}.urdf",
        "transmissions": {joint["name"]: {k: joint[k] for k in (*fields, "bearing")} for joint in stated},
    }
    path.write_text(yaml.safe_dump(overlay, sort_keys=False), encoding="utf-8")


def _link_channels(joints: Sequence[str]) -> dict[str, Any]:
    """Return a channel map: without one, the effort of a bag without motor states counts as the motors' torque."""
    channels = {name: {"topic": "/joint_states"} for name in ("position", "effort")}
    return {"defaults": {"link": channels}, "joints": {joint: {} for joint in joints}}
