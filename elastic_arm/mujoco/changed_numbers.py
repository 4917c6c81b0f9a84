"""The table of changes by an export: element, number, before and after."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from elastic_arm.dynamics.bodies import inertial_parameters
from elastic_arm.dynamics.composition import exchanged
from elastic_arm.errors import RobotError
from elastic_arm.mujoco.stated_arm import StatedArm
from elastic_arm.robot import Inertia, Robot

# Numbers closer than this, relative to their size, are the same: what is written has nine digits.
SAME = 1e-9
# What each number of a joint is called in a file, its unit, and the effect and parameter by which
# it changes.
JOINT_NUMBERS = {
    "armature": ("armature", "kg m²", "rotor_inertia_mismatch", "inertia"),
    "damping": ("damping", "Nm s/rad", "viscous_friction", "coefficient"),
    "friction_loss": ("frictionloss", "Nm", "coulomb_friction", "torque"),
    "stiffness": ("stiffness", "Nm/rad", "joint_spring", "stiffness"),
    "rest": ("springref", "rad", "joint_spring", "rest"),
    "zero": ("ref", "rad", "joint_zero", "offset"),
    "delay": ("delay of its torque sensor", "s", "time_delay", "delay"),
}
# Deviations of estimates, by effect, joint and parameter.
Deviations = Mapping[tuple[str, str | None, str], float]


@dataclass(frozen=True)
class Change:
    """A number of a file that changes."""

    element: str  # joint or body, by name
    # number, unit: what it is
    number: str
    unit: str
    # before, after: its values
    before: tuple[float, ...]
    after: tuple[float, ...]
    std: float | None = None  # standard deviation of the new value, where it was estimated


def joint_changes(
    robot: Robot, before: StatedArm, after: StatedArm, deviations: Deviations | None = None
) -> dict[tuple[int, str], Change]:
    """Return the numbers of joints that change, by joint index and field of
    :class:`.StatedJoint`."""
    found = {}
    for i, (joint, old, new) in enumerate(
        zip(robot.joints, before.joints, after.joints, strict=True)
    ):
        for field, (number, unit, effect, parameter) in JOINT_NUMBERS.items():
            unit = joint.unit(unit).replace("kg m²", "kg") if joint.prismatic else unit
            values = getattr(old, field), getattr(new, field)
            if abs(values[1] - values[0]) > SAME * max(abs(values[0]), abs(values[1])):
                std = (deviations or {}).get((effect, joint.name, parameter))
                if std is not None and field == "armature":
                    std *= values[0]
                found[i, field] = Change(joint.name, number, unit, (values[0],), (values[1],), std)
                if values[1] < 0.0 and field not in ("rest", "zero"):
                    raise RobotError(
                        f"{number} of {joint.name} would be {values[1]:.4g} {unit}",
                        "No simulator accepts it: record a richer motion, or state prior knowledge"
                        " (--with)",
                    )
    return found


def differs(old: Inertia, new: Inertia) -> bool:
    """Return whether two inertias are different numbers."""
    a = inertial_parameters(old)
    b = inertial_parameters(new)
    return bool(np.abs(a - b).max() > SAME * max(np.abs(a).max(), np.abs(b).max()))


def body_after(own: Inertia, old_link: Inertia, new_link: Inertia, name: str) -> Inertia:
    """Return the body that makes a link of several bodies the new one, the others unchanged."""
    try:
        return exchanged(own, old_link, new_link)
    except RobotError as error:
        raise RobotError(
            f"the estimates leave body {name!r} without a physically possible inertia"
            f" ({error.problem})",
            "Identify with physical consistency on a richer motion, or merge the bodies"
            " of the link in the file",
        ) from None


def inertial_change(name: str, before: Inertia, after: Inertia) -> list[Change]:
    """Return the changes of a body's inertial."""
    found = [
        ("mass", "kg", (before.mass,), (after.mass,)),
        ("centre of mass", "m", tuple(before.com), tuple(after.com)),
        ("moments xx yy zz xy xz yz", "kg m²", six(before), six(after)),
    ]
    return [
        Change(name, number, unit, _without_rounding(old), _without_rounding(new))
        for number, unit, old, new in found
        if np.abs(np.subtract(old, new)).max()
        > SAME * max(np.abs(old).max(), np.abs(new).max(), 1e-12)
    ]


def _without_rounding(values: Sequence[float]) -> tuple[float, ...]:
    """Return the values with zero for what is nothing but a solver's rounding beside the
    largest."""
    largest = max(map(abs, values))
    # 1e-6 of the largest component of a vector, up to which another one is a solver's rounding;
    # numerical
    return tuple(float(v) if abs(v) > 1e-6 * largest else 0.0 for v in values)


def six(body: Inertia) -> tuple[float, ...]:
    """Return the moments xx yy zz xy xz yz about the centre of mass."""
    order = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    return tuple(float(body.inertia[index]) for index in order)


def text_of(*values: float) -> str:
    """Return numbers as files hold them: ten digits, none needless."""
    return " ".join(f"{value + 0.0:.10g}" for value in values)  # + 0.0: no "-0"
