"""Sizes that no moving arm has: angles and speeds far beyond the limits of its description.

They tell a unit that was mistaken: degrees for radians, millimetres for metres.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from elastic_arm.recording.inspection.report import Finding
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, Side, joints_with, listed, span_of
from elastic_arm.robot import Robot
from elastic_arm.robot.parts import Limits

_FEWEST = 200  # samples; below, nothing is concluded
_BEYOND = 0.1  # of a joint's range: more than a zero, or a limit, that is set a little otherwise
_FAR = 5.0  # times the limit; less is no unit; convention
_TOO_FAST = 3.0  # times the limit of the velocity; controllers may pass that a little
_DEGREES = 180.0 / np.pi
_MILLIMETRES = 1000.0


def hardly_usable(recording: Recording) -> list[str]:
    """Return in words why a recording that is whole cannot be used: few samples, or joints without a position."""
    sides, words = recording.measured(), []
    count = min((len(side) for side in sides.values()), default=0)
    if count < _FEWEST:
        words.append(f"there are {count} samples only: nothing can be concluded of fewer than {_FEWEST}")
    have = np.zeros(len(recording.joints), np.bool_)
    for side in sides.values():
        have |= False if side.position is None else joints_with(side.position)
    if not have.all():
        which = "any joint" if not have.any() else listed(recording.joints, ~have)
        words.append(f"no position of {which}, of link or motor: without it no recording is identified or diagnosed")
    return words


def beyond_limits(recording: Recording, robot: Robot) -> list[Finding]:
    """Return which angles and speeds are far beyond the limits of the description."""
    findings = []
    for name, side in recording.select(robot.joint_names).measured().items():
        if len(side) >= _FEWEST:
            findings += _positions(name, side, robot) + _speeds(name, side, robot)
    return findings


def _positions(name: str, side: Side, robot: Robot) -> list[Finding]:
    if side.position is None:
        return []
    low, high = side.position.min(axis=0), side.position.max(axis=0)
    limits, slides = [joint.limits for joint in robot.joints], [joint.prismatic for joint in robot.joints]
    found = ~_within(low, high, limits, slides) & joints_with(side.position)
    if not found.any():
        return []
    j = int(np.argmax(np.where(found, high - low, -np.inf)))
    reached = f"{low[j]:.3g} to {high[j]:.3g} {robot.joints[j].unit('rad')}"
    least, most = limits[j].position_min or 0.0, limits[j].position_max or 0.0
    message = (
        f"{name} position of {listed(robot.joint_names, found)} is beyond the limits of the description: "
        f"{robot.joint_names[j]} goes from {reached}, its limits are {least:.3g} to {most:.3g}"
    )
    unit = np.where(slides, _MILLIMETRES, _DEGREES)
    far = np.maximum(np.abs(low), np.abs(high))[j] > _FAR * max(abs(least), abs(most))
    if far and _within(low / unit, high / unit, limits, slides)[found].all():
        what = _mistaken(np.asarray(slides)[found])
        remedy = f"divided by {span_of(unit[found])} all are within: check the unit ({what})"
    else:
        remedy = "check units, columns and zeros (offset)"
    return [Finding("warning", "beyond_limits", f"{message}: {remedy}")]


def _within(low: Array, high: Array, limits: Sequence[Limits], slides: Sequence[bool]) -> NDArray[np.bool_]:
    """Return whether each joint (n,) stays within its limits, or would if an angle were given by other whole turns."""
    inside = []
    for least, most, limit, slide in zip(low, high, limits, slides, strict=True):
        if limit.position_min is None or limit.position_max is None:
            inside.append(True)
            continue
        more = _BEYOND * (limit.position_max - limit.position_min)
        away = 0.5 * (limit.position_min + limit.position_max - least - most)
        turns = 0.0 if slide else 2 * np.pi * round(float(away) / (2 * np.pi))
        inside.append(limit.position_min - more <= least + turns and most + turns <= limit.position_max + more)
    return np.array(inside)


def _speeds(name: str, side: Side, robot: Robot) -> list[Finding]:
    """Look at the root mean square of the velocities: of a joint at its limit all the time it is the limit."""
    if side.velocity is None:
        return []
    limit = np.array([joint.limits.velocity or np.inf for joint in robot.joints])
    share = np.sqrt(np.mean(side.velocity**2, axis=0)) / limit
    found = share > _TOO_FAST
    if not found.any():
        return []
    slides = np.array([joint.prismatic for joint in robot.joints])[found]
    message = (
        f"{name} velocity of {listed(robot.joint_names, found)} is {span_of(share[found])} times the limit of the "
        "description (root mean square)"
    )
    near = share[found].max() < np.where(slides, _MILLIMETRES, _DEGREES).max()
    remedy = f"check the unit ({_mistaken(slides)})" if near else "check units and columns"
    return [Finding("warning", "beyond_limits", f"{message}: {remedy}")]


def _mistaken(slides: NDArray[np.bool_]) -> str:
    """Return which units were mistaken at joints of which some slide."""
    words = ["degrees taken as radians"] if not slides.all() else []
    return " and ".join([*words, *(["millimetres taken as metres"] if slides.any() else [])])
