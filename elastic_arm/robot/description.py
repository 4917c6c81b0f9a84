"""The arm as data: its joints in a row.

Frames (paper, (2) and (3)): ``O_G`` is the ground and ``O_0 = T_0^G``; link i's frame is that of
link i-1 followed by ``before . Ry(q_iy) . Rx(q_ix) . Rz(q_i) . after``, with ``Tz(q_i)`` at a
prismatic joint. Links are described in their own frames, and all inertias about the body's own
centre of mass. Units are SI units and radians.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from elastic_arm.errors import RobotError, require_kind
from elastic_arm.formatting import JointUnits, linear_unit
from elastic_arm.robot.parts import (
    DH,
    Bearing,
    Component,
    Inertia,
    JointController,
    Limits,
    Transmission,
    check_number,
    checked_array,
    checked_placement,
    require,
)

__all__ = [
    "DH",
    "Bearing",
    "Component",
    "Inertia",
    "Joint",
    "JointController",
    "Limits",
    "Robot",
    "Transmission",
]


# The equations of motion grow with the cube of the joints: of 60 they take a minute to compile.
MOST_JOINTS = 64


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint, the link it moves and what drives it.

    All numbers of a prismatic joint are linear ones: travel in m for an angle, force in N for a
    torque, kg for an armature, rad of the rotor per m for a ratio.
    """

    name: str  # of the joint, as in recordings
    link_name: str  # of the link it moves
    link: Inertia  # inertia of that link, in its frame ``O_i``
    # before, after: (4, 4) Link i-1's frame -> the joint's frame ``O_{i-1}`` (z is the axis), and
    # the turned joint frame -> ``O_i``
    before: np.ndarray = field(default_factory=lambda: np.eye(4))
    after: np.ndarray = field(default_factory=lambda: np.eye(4))
    limits: Limits = field(default_factory=Limits)
    transmission: Transmission | None = None  # None for a joint driven at the link (a plain URDF)
    dh: DH | None = (
        None  # the row that `after` comes from, where there is one; only kept to be written again
    )
    # inertia of the motor and its gears, as the joint feels it, of a joint without transmission, kg
    # m^2: it counts for the joint's own acceleration alone. None where nothing is known of it, and
    # no model then holds it
    armature: float | None = None
    prismatic: bool = False  # whether it slides along z instead of turning about it
    controller: JointController | None = None  # of its drive; None where nothing is known of it

    def __post_init__(self) -> None:
        if self.armature is not None:
            check_number(self.armature, "armature")
            require(
                self.transmission is None,
                "both an armature and a transmission are given",
                "The rotor of the transmission already contains this inertia: omit armature",
            )
        object.__setattr__(self, "before", checked_placement(self.before, "before"))
        object.__setattr__(self, "after", checked_placement(self.after, "after"))

    @property
    def most_torque(self) -> float | None:
        """The lower of the limits of torque of the joint and of its controller, Nm; None without
        either, and where a duty was recorded, which the firmware has limited."""
        if self.follows_duty:
            return None
        own = None if self.controller is None else self.controller.torque
        limits = [one for one in (own, self.limits.torque) if one is not None]
        return min(limits, default=None)

    @property
    def follows_duty(self) -> bool:
        """Whether a recorded duty makes its torque."""
        return self.controller is not None and self.controller.mode == "duty"

    def unit(self, unit: str) -> str:
        """Return the unit here of what has `unit` at a revolute joint: N for Nm, m for rad."""
        return linear_unit(unit) if self.prismatic else unit

    @classmethod
    def from_dh(cls, name: str, link_name: str, link: Inertia, dh: DH, **rest: Any) -> Self:
        """Make a joint from its Denavit-Hartenberg row (paper, (3))."""
        return cls(name, link_name, link, after=dh.placement, dh=dh, **rest)


@dataclass(frozen=True, eq=False, repr=False)
class Robot:
    """A serial arm of n joints, revolute or prismatic."""

    # name, joints: from one to MOST_JOINTS; all joints have a transmission, or none has
    name: str
    joints: tuple[Joint, ...]
    # (3,) in the ground frame, m/s^2
    gravity: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    base_placement: np.ndarray = field(default_factory=lambda: np.eye(4))  # (4, 4) ``T_0^G`` of (2)
    base_mass: float = 0.0  # kg; rests on the ground and enters no equation
    base_dh: DH | None = None
    # r_tot -> (r_b, r_hd) (paper, section IV-C)
    total_ratios_studied: Mapping[float, tuple[float, float]] = field(default_factory=dict)
    # torque_noise_std, sample_rate: of the recordings this arm makes: Nm, Hz
    torque_noise_std: float = 0.26
    sample_rate: float = 1000.0
    # what this arm has beyond mod3, as plain data: ``{"effect": id, "joint": name or None,
    # "parameters": {...}}``
    effects: tuple[Mapping[str, Any], ...] = ()
    # what was read otherwise than written (like a URDF's fixed joints), one sentence each; not part
    # of an arm file
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", tuple(self.joints))
        object.__setattr__(self, "effects", tuple(dict(e) for e in self.effects))
        object.__setattr__(self, "gravity", checked_array(self.gravity, (3,), "gravity"))
        object.__setattr__(
            self, "base_placement", checked_placement(self.base_placement, "base placement")
        )
        check_number(self.base_mass, "base.mass")
        check_number(self.torque_noise_std, "torque_noise_std")
        check_number(self.sample_rate, "sample_rate", positive=True)
        for r_tot, (belt, harmonic) in self.total_ratios_studied.items():
            require(
                belt != 0 and harmonic != 0 and abs(belt * harmonic - r_tot) <= 1e-9 * abs(r_tot),
                f"total_ratios_studied[{r_tot:g}] is split into {belt:g} x {harmonic:g}",
                "Give [belt, harmonic drive], both nonzero, with this total ratio as their product",
            )
        require(len(self.joints) > 0, f"robot {self.name} has no joints", "Give it at least one")
        require(
            len(self.joints) <= MOST_JOINTS,
            f"robot {self.name} has {len(self.joints)} joints in a row; the limit is {MOST_JOINTS}",
            "Select the arm by its first and last link: --chain base:tip",
        )
        _check_unique(self.joint_names, "joint")
        _check_unique(("base", *self.link_names), "link")
        _check_transmissions(self.joints)
        for i, joint in enumerate(self.joints):
            _check_carriers(joint, self.carriers(i))

    def __repr__(self) -> str:
        return f"<Robot {self.name}: {', '.join(self.joint_names)}>"

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names in order from the base."""
        return tuple(j.name for j in self.joints)

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of the moving links in order from the base."""
        return tuple(j.link_name for j in self.joints)

    @property
    def units(self) -> JointUnits:
        """Units of quantities at the joints."""
        return JointUnits(
            self.joint_names, [joint.name for joint in self.joints if joint.prismatic]
        )

    @property
    def elastic(self) -> bool:
        """True when the joints have transmissions."""
        return self.joints[0].transmission is not None

    @property
    def mass(self) -> float:
        """Total mass, base included, kg."""
        parts = (
            c.mass
            for j in self.joints
            if j.transmission
            for c, _ in j.transmission.components.values()
        )
        return self.base_mass + sum(j.link.mass for j in self.joints) + sum(parts)

    def carriers(self, i: int) -> tuple[str, str]:
        """Return the two bodies that can carry transmission i (from 0): the one before its joint
        and its link."""
        return ("base", *self.link_names)[i], self.link_names[i]

    def with_(self, **changes: Any) -> Self:
        """Return a copy with these fields changed."""
        return replace(self, **changes)

    def with_joint(self, name: str, **changes: Any) -> Self:
        """Return a copy in which these fields of joint `name` are changed."""
        use = f"Use one of {', '.join(self.joint_names)}."
        require(name in self.joint_names, f"robot {self.name} has no joint {name!r}", use)
        joints = tuple(replace(j, **changes) if j.name == name else j for j in self.joints)
        return self.with_(joints=joints)

    def with_armatures(self) -> Self:
        """Return a copy whose models include motor inertia, initially zero, if the description
        states none.

        A description of only links, like a URDF, has no motor inertia. The inertia of geared
        motors at the joint is comparable to that of the links, as it is multiplied by the square
        of the ratio. An arm with a single joint gets none, because no motion separates it from
        the inertia of the link.
        """
        if self.n == 1 or self.elastic or all(joint.armature for joint in self.joints):
            return self
        return self.with_(
            joints=tuple(replace(joint, armature=joint.armature or 0.0) for joint in self.joints)
        )

    def with_ratio(self, r_tot: float) -> Self:
        """Return a copy whose joints all have total ratio `r_tot`, split as in the description."""
        require(
            self.elastic,
            f"robot {self.name} has no transmissions",
            "Use an arm file with transmissions",
        )
        known = ", ".join(f"{r:g}" for r in self.total_ratios_studied) or "none"
        require(
            r_tot in self.total_ratios_studied,
            f"robot {self.name} does not describe the total ratio {r_tot:g} ({known})",
            "Use one of these, or add it under total_ratios_studied",
        )
        belt, harmonic = self.total_ratios_studied[r_tot]
        gears = [(j, j.transmission) for j in self.joints if j.transmission is not None]
        changed = [
            replace(j, transmission=replace(gear, belt_ratio=belt, harmonic_drive_ratio=harmonic))
            for j, gear in gears
        ]
        return self.with_(joints=tuple(changed))


def _check_unique(names: Sequence[str], what: str) -> None:
    for name in names:
        require(
            names.count(name) == 1,
            f"two {what}s are named {name!r}",
            f"Give every {what} a unique name",
        )


def _check_transmissions(joints: Sequence[Joint]) -> None:
    without = [j.name for j in joints if j.transmission is None]
    require(
        len(without) in (0, len(joints)),
        f"joints {', '.join(without)} have no transmission, but others have one",
        "Describe the transmissions of all joints, or of none",
    )


def _check_carriers(joint: Joint, allowed: tuple[str, str]) -> None:
    if joint.transmission is None:
        return
    for what, (component, _) in joint.transmission.components.items():
        require(
            component.carrier in allowed,
            f"{joint.name}.{what}.carrier is {component.carrier!r}",
            f"A transmission component has to be on a body at its joint: {allowed[0]} or"
            f" {allowed[1]}",
        )


def require_robot(given: object) -> None:
    """Refuse, by a RobotError, what is no robot where a user's program hands it in."""
    require_kind(given, Robot, "robot", RobotError, "Give the result of load_robot.")
