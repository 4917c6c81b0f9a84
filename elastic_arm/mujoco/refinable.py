"""Numbers of a corrected servo arm for refinement in closed loop, from a diagnosis and back."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.diagnosis.result import Cause, Diagnosis
from elastic_arm.equations.numbers import RATIO, SCALE
from elastic_arm.evidence.priors import STATED
from elastic_arm.robot import Robot

MOST_SAG = 0.99  # numerical; a supply of nothing drives nothing
MOST_LOST = 0.9  # share of a mass or gain that one step takes; numerical
TOLD = 0.98  # of the prior's deviation, beyond which a recording does not tell of a number
# Effects that are numbers of a joint, and the parameter that is one.
DELAY = "command_delay"
MASSES = ("payload", "load")  # numbers are "payload.mass", "payload.position_x", …
FRICTION = {
    "coulomb_friction": "torque",
    "viscous_friction": "coefficient",
    "load_dependent_friction": "coefficient",
    "stribeck_friction": "torque",
    "degressive_friction": "torque",
}
ZERO = "joint_zero"
# Effects of a controller, the field of it that each changes, and the parameter that is that.
CONTROLLERS = {
    DELAY: ("delay", "delay"),
    "torque_saturation": ("limit", "torque"),
    "position_dead_band": ("dead_band", "half_width"),
    "integral_gain": ("ki", "ki"),
    "supply_sag": ("sag", "share"),
}
POINT = ("mass", "position_x", "position_y", "position_z")
# Causes of one size, the number that each is, and the parameter that holds it. A delay stays as it
# was found: an integrator of MuJoCo may read it up to half a step ahead, and the refined one makes
# up for it.
SIZES = {
    **{effect: one for effect, one in CONTROLLERS.items() if effect != DELAY},
    **{effect: (effect, parameter) for effect, parameter in FRICTION.items()},
    "position_gain": ("scale", "gain"),
    "velocity_gain": ("kd", "gain"),
    "rotor_inertia_mismatch": ("armature", "inertia"),
}
SIZES_OF_DUTY = {"torque_constant": ("scale", "gain")}  # where the duty was recorded
# Numbers of a description that are ratios, and what they are of the arm.
RATIOS = {SCALE: "scale", RATIO: "kd", "rotor_inertia": "armature", "link_mass": "mass"}


@dataclass(frozen=True)
class Refinable:
    """A number of a corrected arm: a deviation from where it was found."""

    # "scale" of kp and kd, "kd", "armature", "mass" are logarithms of ratios: to scale all torques
    # and masses is a straight line, along which no motion changes; "delay" s, "limit" Nm, "com_x" …
    # m, and effects in their units
    what: str
    joint: str | None  # None of all joints
    std: float  # of the posterior
    least: float = -np.inf  # below which no simulator takes it
    stated: float = 0.0  # where the description has it
    prior: float = np.inf  # how far it is ordinarily from there
    is_cause: bool = False  # whether it is the size of a cause: then as far from there as was found

    @staticmethod
    def of_cause(
        what: str, joint: str | None, std: float, least: float, stated: float
    ) -> "Refinable":
        """Return the size of a cause: what the recordings do not tell of it returns to the
        description."""
        return Refinable(what, joint, std, least, stated, abs(stated) or np.inf, is_cause=True)

    @property
    def is_ratio(self) -> bool:
        """Whether it is the logarithm of a ratio."""
        return self.what in RATIOS.values()

    @property
    def factor(self) -> str | None:
        """The number whose product with this one the dynamics are linear in, if there is one: the
        mass of the body whose centre it moves, or the scale of kp and kd."""
        if self.what == "kd":
            return "scale"
        if self.what.startswith("com_"):
            return "mass"
        body, _, coordinate = self.what.partition(".")
        return f"{body}.mass" if coordinate.startswith("position_") else None

    def change(self, step: float) -> float:
        """Return by how much a step of the ratio, or of the number, changes the deviation."""
        return float(np.log1p(max(step, -MOST_LOST))) if self.is_ratio else step

    def size(self, by: float) -> float:
        """Return the number at a deviation: a ratio, or from its least value."""
        return float(np.exp(by)) if self.is_ratio else by - self.least

    def room(self, by: float) -> float:
        """Return how far below a deviation a step may end: a mass or a gain stays positive."""
        if self.is_ratio:
            return MOST_LOST
        if self.what.endswith(".mass"):
            return MOST_LOST * self.size(by)
        return by - self.least


@dataclass(frozen=True)
class Moved:
    """A number that was refined: by how much, and its deviation there."""

    number: Refinable
    by: float
    std: float

    def of(self, value: float) -> tuple[float, float]:
        """Return what a value becomes, and its deviation."""
        if self.number.is_ratio:
            value *= float(np.exp(self.by))
            return value, value * self.std
        return value + self.by, self.std


def refinable(found: Diagnosis, robot: Robot) -> tuple[Refinable, ...]:
    """Return the numbers of a diagnosed servo arm that its recordings determine.

    robot: as described.
    """
    return (
        *_of_description(found),
        *_of_friction(found, robot),
        *_of_masses(found),
        *_of_controllers(found, robot),
    )


def _of_description(found: Diagnosis) -> Iterator[Refinable]:
    for one in found.imperfections:
        # Gains count in any case: one may stand where another cause was tried, and nothing else
        # tell of it.
        told = one.std < TOLD * one.prior_std or one.what in (SCALE, RATIO) or not one.ordinary
        if not told or one.std <= 0.0:
            continue
        if one.what in RATIOS and one.unit == "1" and one.value > 0.0:
            what = RATIOS[one.what]
            std = one.std / one.value
            stated = float(np.log(one.neutral / one.value))
        elif one.what.startswith("link_com_"):
            what = one.what.removeprefix("link_")
            std = one.std
            stated = -one.value
        else:
            continue
        if one.ordinary:
            yield Refinable(what, one.joint, std, stated=stated, prior=one.prior_std)
        else:
            yield Refinable.of_cause(what, one.joint, std, -np.inf, stated)


def _of_friction(found: Diagnosis, robot: Robot) -> Iterator[Refinable]:
    described = {(one["effect"], one["joint"]): one["parameters"] for one in robot.effects}
    sizes: dict[tuple[str, Any], tuple[float, float | None]] = {}  # by effect and joint
    for one in found.known:
        effect = one["effect"]
        if effect in FRICTION:
            known = one["parameters"][FRICTION[effect]]
            sizes[effect, one["joint"]] = known["value"], known["std"]
    causes = set()
    for cause in found.causes:
        if cause.effect in FRICTION and cause.held_as == "effect":
            size = cause.parameters[FRICTION[cause.effect]]
            sizes[cause.effect, cause.joint] = size.value, size.std
            causes.add((cause.effect, cause.joint))
    for (effect, joint), (value, std) in sizes.items():
        if not std:
            continue
        before = float(described.get((effect, joint), {}).get(FRICTION[effect], 0.0))
        stated = before - float(value)
        least = -float(value)
        if before and (effect, joint) not in causes:
            yield Refinable(effect, joint, float(std), least, stated, STATED * before)
        else:
            yield Refinable.of_cause(effect, joint, float(std), least, stated)


def _of_masses(found: Diagnosis) -> Iterator[Refinable]:
    for cause in found.causes:
        if cause.effect in MASSES:
            mass = cause.parameters["mass"]
            position = cause.parameters["position"]
            joint = cause.joint or found.joints[-1]
            least = -float(mass.value)
            yield Refinable.of_cause(f"{cause.effect}.mass", joint, float(mass.std), least, least)
            for axis, std in zip("xyz", position.std, strict=True):
                name = f"{cause.effect}.position_{axis}"
                yield Refinable.of_cause(name, joint, float(std), -np.inf, 0.0)


def _of_controllers(found: Diagnosis, robot: Robot) -> Iterator[Refinable]:
    for cause in found.causes:
        if cause.effect not in CONTROLLERS:
            continue
        what, parameter = CONTROLLERS[cause.effect]
        size = cause.parameters[parameter]
        least = -float(size.value)
        stated = -float(size.value)
        if what == "limit":  # a size of none is the limit that is stated, if any is
            drive = robot.joints[robot.joint_names.index(cause.joint)].controller
            limit = None if drive is None else drive.torque
            stated = 0.0 if limit is None else limit - float(size.value)
        if size.std:
            yield Refinable.of_cause(what, cause.joint, float(size.std), least, stated)


def by_words(one: Moved) -> str:
    """Return by how much a number was refined, in words."""
    number = one.number
    by = one.by
    what = {"scale": "kp and kd", "limit": "limit of torque"}.get(
        number.what, number.what.replace("_", " ")
    )
    ratio = number.is_ratio
    size = f"{100.0 * np.expm1(by):+.2g} %" if ratio else f"{by:+.2g}"
    return f"{what} of {number.joint or 'all joints'} by {size}"


def with_refined(found: Diagnosis, moved: Sequence[Moved]) -> Diagnosis:
    """Return a diagnosis with numbers and sizes of causes as they were refined."""
    by = {(one.number.what, one.number.joint): one for one in moved}
    numbers = []
    for number in found.imperfections:
        what = RATIOS.get(number.what, number.what.removeprefix("link_"))
        one = by.get((what, number.joint)) if number.recording is None else None
        if one is not None:
            value, std = one.of(number.value)
            number = replace(number, value=value, std=std)
        numbers.append(number)
    causes = tuple(_with_sizes(cause, by, found) for cause in found.causes)
    return replace(found, imperfections=tuple(numbers), causes=causes)


def _with_sizes(
    cause: Cause, by: Mapping[tuple[str, str | None], Moved], found: Diagnosis
) -> Cause:
    """Return a cause with its parameters as they were refined."""
    last = found.joints[-1]
    sizes = dict(cause.parameters)
    known = SIZES | (SIZES_OF_DUTY if cause.joint in found.of_duty else {})
    if cause.effect in known:
        what, parameter = known[cause.effect]
        one = by.get((what, cause.joint))
        if one is not None:
            value, std = one.of(float(sizes[parameter].value))
            sizes[parameter] = replace(sizes[parameter], value=value, std=std)
    elif cause.effect in MASSES and (f"{cause.effect}.mass", cause.joint or last) in by:
        mass, *position = (by[f"{cause.effect}.{name}", cause.joint or last] for name in POINT)
        value, std = mass.of(float(sizes["mass"].value))
        sizes["mass"] = replace(sizes["mass"], value=value, std=std)
        pairs = zip(position, sizes["position"].value, strict=True)
        place, stds = zip(*(one.of(float(at)) for one, at in pairs), strict=True)
        sizes["position"] = replace(sizes["position"], value=list(place), std=list(stds))
    return replace(cause, parameters=sizes)


def robot_at(robot: Robot, numbers: Sequence[Refinable], x: Array) -> Robot:
    """Return an arm with numbers (k,) by x away from its own."""
    for number, by in zip(numbers, x, strict=True):
        for joint in robot.joints:
            if number.joint in (joint.name, None):
                robot = _changed(robot, joint.name, number.what, float(by))
    return robot


def _changed(robot: Robot, name: str, what: str, by: float) -> Robot:
    joint = robot.joints[robot.joint_names.index(name)]
    ratio = float(np.exp(by))
    drive = joint.controller
    link = joint.link
    if what == ZERO or what in FRICTION or what.partition(".")[0] in MASSES:
        effects = tuple(_moved(effect, name, what, by) for effect in robot.effects)
        return robot.with_(effects=effects)
    if what == "armature":
        return robot.with_joint(name, armature=(joint.armature or 0.0) * ratio)
    if what == "mass":
        heavier = replace(link, mass=link.mass * ratio, inertia=np.asarray(link.inertia) * ratio)
        return robot.with_joint(name, link=heavier)
    if what.startswith("com_"):
        com = np.asarray(link.com, dtype=float) + by * np.eye(3)["xyz".index(what[-1])]
        return robot.with_joint(name, link=replace(link, com=com))
    assert drive is not None
    if what == "delay":
        return robot.with_joint(name, controller=replace(drive, delay=max(0.0, drive.delay + by)))
    if what == "sag":
        share = min(MOST_SAG, max(0.0, drive.sag + by))
        return robot.with_joint(name, controller=replace(drive, sag=share))
    if what in ("dead_band", "ki"):
        value = max(0.0, getattr(drive, what) + by)
        return robot.with_joint(name, controller=replace(drive, **{what: value}))
    if what == "limit":
        limit = None if drive.torque is None else max(1e-6, drive.torque + by)
        return robot.with_joint(name, controller=replace(drive, torque=limit))
    kp = ratio if what == "scale" else 1.0
    return robot.with_joint(name, controller=drive.scaled(kp, ratio))


def _moved(effect: Mapping[str, Any], joint: str, what: str, by: float) -> Mapping[str, Any]:
    name, _, parameter = what.partition(".")
    if effect["effect"] != name or effect["joint"] not in (joint, None):
        return effect
    values = dict(effect["parameters"])
    if parameter.startswith("position"):
        values["position"] = [
            v + by * (axis == parameter[-1])
            for axis, v in zip("xyz", values["position"], strict=True)
        ]
    elif name == ZERO:
        values["offset"] += by
    else:
        key = parameter or FRICTION[name]
        values[key] = max(0.0, values[key] + by)
    return {**effect, "parameters": values}
