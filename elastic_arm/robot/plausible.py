"""Plausible ranges of the numbers of an arm; a number beyond its range indicates a wrong unit.

The ranges are wide: from a servo of a finger to the largest commercial arm (2300 kg with a reach of
4 m).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from elastic_arm.robot.description import Joint, Robot

DENSEST = 22_600.0  # kg/m³, osmium: no body of a mass is smaller than a ball of it
PLACEHOLDER = (
    1e-4  # of the least inertia: numbers above it stand for none in simplified descriptions
)


@dataclass(frozen=True)
class Range:
    """The plausible range of one quantity; beyond it lies what `hints` name."""

    what: str
    unit: str
    least: float
    most: float
    too_small: str
    too_large: str

    def doubts(self, whose: str, value: float) -> str | None:
        """Return in words why a value cannot be meant, or None.

        Zero states nothing.
        """
        size = abs(value)
        if size == 0.0 or not np.isfinite(size) or self.least <= size <= self.most:
            return None
        beyond, hint = ("less", self.too_small) if size < self.least else ("more", self.too_large)
        bound = self.least if size < self.least else self.most
        words = (
            f"{whose}: {self.what} of {value:.4g} {self.unit} is {beyond} than any arm has"
            f" ({bound:g} {self.unit})"
        )
        return f"{words}: {hint}"


POSITION = Range("position limit", "rad", 0.0, 4 * np.pi, "", "degrees taken as radians?")
TRAVEL = Range("position limit", "m", 0.0, 30.0, "", "millimetres taken as metres?")
SPAN = Range(
    "range",
    "rad",
    0.01,
    8 * np.pi,
    "degrees times pi/180 twice, or turns?",
    "degrees taken as radians?",
)
WAY = Range("range", "m", 1e-3, 60.0, "kilometres taken as metres?", "millimetres taken as metres?")
SPEED = Range(
    "velocity limit", "rad/s", 0.01, 50.0, "another unit?", "deg/s or rpm taken as rad/s?"
)
PACE = Range("velocity limit", "m/s", 1e-4, 20.0, "another unit?", "mm/s taken as m/s?")
TORQUE = Range("torque limit", "Nm", 1e-3, 1e5, "kNm taken as Nm?", "Nmm taken as Nm?")
FORCE = Range("force limit", "N", 1e-2, 1e6, "kN taken as N?", "another unit?")
MASS = Range("mass", "kg", 1e-5, 1500.0, "tonnes taken as kg?", "grams taken as kg?")
LENGTH = Range("distance to the previous joint", "m", 0.0, 10.0, "", "millimetres taken as metres?")
CENTRE = Range("centre of mass", "m", 0.0, 10.0, "", "millimetres taken as metres?")
ARMATURE = Range(
    "armature",
    "kg m²",
    1e-9,
    5e3,
    "a rotor's, without the square of its ratio?",
    "a ratio counted twice?",
)
REACH = Range(
    "length of all links",
    "m",
    0.02,
    30.0,
    "kilometres taken as metres?",
    "millimetres taken as metres?",
)
WEIGHT = Range("mass of all links", "kg", 0.005, 5e3, "tonnes taken as kg?", "grams taken as kg?")
GRAVITY = Range("gravity", "m/s²", 0.5, 30.0, "in units of 9.81 m/s²?", "mm/s² taken as m/s²?")


def doubtful(robot: Robot) -> list[str]:
    """Return in words which numbers of a description are of no arm.

    Each with its number and a hint.
    """
    found = [words for joint in robot.joints for words in _of_joint(joint, robot)]
    length = sum(
        float(np.linalg.norm(joint.before[:3, 3] + joint.after[:3, 3]))
        for joint in robot.joints[1:]
    )
    whole = [
        (WEIGHT, "the arm", robot.mass),
        (REACH, "the arm", length if robot.n > 2 else 0.0),
        (GRAVITY, "the arm", float(np.linalg.norm(robot.gravity))),
    ]
    return found + [
        words for each, whose, value in whole if (words := each.doubts(whose, value)) is not None
    ]


def _of_joint(joint: Joint, robot: Robot) -> Iterator[str]:
    limits = joint.limits
    slides = joint.prismatic
    ends = [end for end in (limits.position_min, limits.position_max) if end is not None]
    furthest = max(ends, key=abs, default=0.0)
    # Some state no limit by a number beyond all.
    endless = abs(furthest) > 1e3
    stated: list[tuple[Range, float]] = [
        (TRAVEL if slides else POSITION, 0.0 if endless and not slides else furthest),
        (
            WAY if slides else SPAN,
            max(ends) - min(ends) if len(ends) == 2 and abs(furthest) <= _bound(slides) else 0.0,
        ),
        (PACE if slides else SPEED, limits.velocity or 0.0),
        (FORCE if slides else TORQUE, limits.torque or 0.0),
        (ARMATURE, 0.0 if slides else joint.armature or 0.0),
    ]
    for each, value in stated:
        if (words := each.doubts(f"joint {joint.name!r}", value)) is not None:
            yield words
    body = joint.link
    first = joint is robot.joints[0]
    whose = f"link {joint.link_name!r}"
    lengths = [float(np.linalg.norm(part[:3, 3])) for part in (joint.before, joint.after)]
    numbers = [(MASS, body.mass), (CENTRE, float(np.linalg.norm(body.com)) if body.mass else 0.0)]
    numbers += [] if first else [(LENGTH, max(lengths))]
    for each, value in numbers:
        if (words := each.doubts(whose, value)) is not None:
            yield words
    if (
        body.mass > 0.0
        and (words := _inertia(whose, body.mass, np.linalg.eigvalsh(body.inertia), robot))
        is not None
    ):
        yield words


def _bound(slides: bool) -> float:
    return TRAVEL.most if slides else POSITION.most


def _inertia(whose: str, mass: float, moments: np.ndarray, robot: Robot) -> str | None:
    """Return in words why no body of a mass, kg, has principal moments of inertia (3,), kg m²."""
    largest = float(moments.max())
    if largest <= 0.0:  # a point of mass: a simplification
        return None
    radius = float(np.sqrt(largest / mass))
    ball = (3.0 * mass / (4.0 * np.pi * DENSEST)) ** (1.0 / 3.0)
    least = 0.4 * mass * ball**2
    distances = [
        float(np.linalg.norm(part[:3, 3]))
        for joint in robot.joints
        for part in (joint.before, joint.after)
    ]
    centres = [float(np.linalg.norm(joint.link.com)) for joint in robot.joints]
    # 0.5 m beyond the longest link: a cover, a counterweight
    longest = max(*distances, *centres) + 0.5
    said = f"{whose}: inertia of {largest:.4g} kg m² at {mass:.4g} kg"
    if radius > 2.0 * longest:
        return (
            f"{said} implies a width of {2.0 * radius:.3g} m, but no link is longer than"
            f" {longest - 0.5:.3g} m: g m² or kg mm² taken as kg m²?"
        )
    if largest < PLACEHOLDER * least:
        return (
            f"{said} is implausibly small: a sphere of osmium has {least:.3g} kg m²: another unit?"
        )
    return None
