"""mod1, mod2, mod3: which bodies an arm is made of (paper, sections IV-B and V).

========  ==========================================================================================
mod3      every rotor, wave generator and spline rides and spins on its carrier
mod2      they ride on their carriers, but their spins stand on the ground: S, c1, c2 are null
mod1      as mod2, and the spline is part of the link it drives: its inertia moves from B (6) to M
========  ==========================================================================================
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics.bodies import (
    GROUND,
    LINK_PARAMETERS,
    LINK_UNITS,
    SOLID_PARAMETERS,
    SOLID_UNITS,
    Bodies,
    Body,
    Frame,
    ModelParameter,
    Spin,
    Spring,
    inertial_parameters,
    moved,
)
from elastic_arm.errors import RobotError
from elastic_arm.robot.description import Bearing, Component, Inertia, Joint, Robot
from elastic_arm.robot.parts import placed, snap, tensor_of

X, Y, Z = range(3)
# Last part of the name of the parameter that holds a rigid joint's armature.
ARMATURE = "armature"


@dataclass
class _Assembly:
    """An arm being put together."""

    robot: Robot
    link_frames: list[int] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)
    bodies: list[Body] = field(default_factory=list)
    spins: list[Spin] = field(default_factory=list)
    springs: list[Spring] = field(default_factory=list)
    parameters: list[ModelParameter] = field(default_factory=list)

    def add_parameters(
        self, prefix: str, names: tuple[str, ...], units: tuple[str, ...], values: Array
    ) -> range:
        start = len(self.parameters)
        self.parameters += [
            ModelParameter(f"{prefix}.{name}", unit, float(value))
            for name, unit, value in zip(names, units, values, strict=True)
        ]
        return range(start, len(self.parameters))

    def add_link(self, i: int, tilting: bool) -> None:
        """Add joint i's frames: tilts about y and x where bearings give way, then the turn about
        z."""
        joint = self.robot.joints[i]
        n = self.robot.n
        parent = self.link_frames[-1] if self.link_frames else GROUND
        before = joint.before
        for axis, coordinate in ((Y, 3 * n + i), (X, 2 * n + i)) if tilting else ():
            self.frames.append(Frame(parent, before, axis, coordinate, np.eye(4)))
            parent = len(self.frames) - 1
            before = np.eye(4)
        self.frames.append(Frame(parent, before, Z, i, joint.after, joint.prismatic))
        self.link_frames.append(len(self.frames) - 1)

    def add_link_body(self, i: int, inertia: Inertia) -> None:
        joint = self.robot.joints[i]
        values = inertial_parameters(inertia)
        indices = self.add_parameters(joint.link_name, LINK_PARAMETERS, LINK_UNITS, values)
        self.bodies.append(Body(joint.link_name, self.link_frames[i], np.eye(4), tuple(indices)))

    def add_solid(
        self, i: int, what: str, component: Component, ratio: float, spin_on: Callable[[int], int]
    ) -> None:
        """Add a component of transmission i: a body on its carrier, and a spin on what `spin_on`
        makes of that."""
        joint = self.robot.joints[i]
        values = np.array([component.mass, 0.0, component.ixx, component.izz])
        indices = self.add_parameters(f"{joint.name}.{what}", SOLID_PARAMETERS, SOLID_UNITS, values)
        frame, placement = self.seat(i, component)
        self.bodies.append(Body(f"{joint.name}.{what}", frame, placement, tuple(indices)))
        self.spins.append(
            Spin(spin_on(frame), placement[:3, 2], ((self.robot.n + i, ratio),), indices[-1])
        )

    def seat(self, i: int, component: Component) -> tuple[int, Array]:
        """Carrier's frame of a component of transmission i, and the component's placement in it."""
        joint = self.robot.joints[i]
        if component.carrier == joint.link_name:
            return self.link_frames[i], on_link(joint, component)
        return (self.link_frames[i - 1] if i else GROUND), joint.before @ placed(
            position=component.position
        )

    def add_springs(self, bearings: bool) -> None:
        n = self.robot.n
        for i, joint in enumerate(self.robot.joints):
            t = joint.transmission
            if t is not None:
                units = joint.unit("Nm/rad"), joint.unit("Nm s/rad")
                K, D = self.add_parameters(
                    joint.name, ("K", "D"), units, np.array([t.stiffness, t.damping])
                )
                self.springs.append(Spring(K, D, i, n + i))
        for i, joint in enumerate(self.robot.joints if bearings else ()):
            bearing = _bearing(joint)
            values = np.array([bearing.stiffness, bearing.damping])
            K, D = self.add_parameters(joint.name, ("K_b", "D_b"), ("Nm/rad", "Nm s/rad"), values)
            self.springs += [Spring(K, D, 2 * n + i), Spring(K, D, 3 * n + i)]


def compose(robot: Robot, name: str, *, bearings: bool = False) -> Bodies:
    """Put `robot` together as model `name`: mod1, mod2 or mod3.

    A robot without transmissions is its links and armatures, whichever the name.

    bearings: whether bearings tilt, which adds two coordinates a joint.

    Raises a RobotError if there is no such model, or bearings are wanted of an arm that describes
    none.
    """
    if name not in COMPOSITIONS:
        raise RobotError(f"unknown model {name!r}", f"Choose one of {', '.join(COMPOSITIONS)}")
    if bearings:
        for joint in robot.joints:
            _bearing(joint)
    arm = _Assembly(robot)
    for i in range(robot.n):
        arm.add_link(i, bearings)
    (COMPOSITIONS[name] if robot.elastic else _rigid)(arm)
    arm.add_springs(bearings)
    n = robot.n
    kinds = ["q_{}"]
    if robot.elastic:
        kinds.append("theta_{}")
    if bearings:
        kinds += ["q_{}x", "q_{}y"]
    motor_side = range(n, 2 * n) if robot.elastic else range(0)
    return Bodies(
        gravity=snap(robot.base_placement[:3, :3].T @ robot.gravity),
        coordinates=tuple(pattern.format(i + 1) for pattern in kinds for i in range(n)),
        link_side=tuple(k for k in range(len(kinds) * n) if k not in motor_side),
        motor_side=tuple(motor_side),
        frames=tuple(arm.frames),
        bodies=tuple(arm.bodies),
        spins=tuple(arm.spins),
        springs=tuple(arm.springs),
        parameters=tuple(arm.parameters),
        base_height=float(robot.gravity @ robot.base_placement[:3, 3]),
    )


def _links(arm: _Assembly) -> None:
    for i, joint in enumerate(arm.robot.joints):
        arm.add_link_body(i, joint.link)


def _rigid(arm: _Assembly) -> None:
    """Links, and what spins with the motors of joints that are driven stiffly: felt by their own
    joints alone."""
    _links(arm)
    for i, joint in enumerate(arm.robot.joints):
        if joint.armature is not None:
            unit = "kg" if joint.prismatic else "kg m^2"
            (inertia,) = arm.add_parameters(
                joint.name, (ARMATURE,), (unit,), np.array([joint.armature])
            )
            arm.spins.append(Spin(GROUND, np.array([0.0, 0.0, 1.0]), ((i, 1.0),), inertia))


def _mod3(arm: _Assembly) -> None:
    _links(arm)
    for i, what, component, ratio in _components(arm.robot):
        arm.add_solid(i, what, component, ratio, spin_on=lambda carrier: carrier)


def _mod2(arm: _Assembly) -> None:
    _links(arm)
    for i, what, component, ratio in _components(arm.robot):
        arm.add_solid(i, what, component, ratio, spin_on=lambda carrier: GROUND)


def _mod1(arm: _Assembly) -> None:
    for i, joint in enumerate(arm.robot.joints):
        arm.add_link_body(i, with_spline(joint))
    for i, what, component, ratio in _components(arm.robot):
        if what != "spline":
            arm.add_solid(i, what, component, ratio, spin_on=lambda carrier: GROUND)


COMPOSITIONS: dict[str, Callable[[_Assembly], None]] = {"mod1": _mod1, "mod2": _mod2, "mod3": _mod3}


def _components(robot: Robot) -> Iterator[tuple[int, str, Component, float]]:
    for i, joint in enumerate(robot.joints):
        if joint.transmission is not None:
            for what, (component, ratio) in joint.transmission.components.items():
                yield i, what, component, ratio


def _bearing(joint: Joint) -> Bearing:
    if joint.transmission is None or joint.transmission.bearing is None:
        raise RobotError(
            f"{joint.name} has no bearing", "Describe its bearing, or lock the bearings"
        )
    return joint.transmission.bearing


def on_link(joint: Joint, component: Component) -> Array:
    """Placement of a component at ``O_{i-1}`` in the frame of the link that a joint moves."""
    return snap(np.linalg.inv(joint.after) @ placed(position=component.position))


def with_spline(joint: Joint) -> Inertia:
    """Inertia of a joint's link with the spline that drives it as a part of it."""
    if joint.transmission is None:
        return joint.link
    spline = joint.transmission.spline
    solid = np.array(
        [spline.mass, 0.0, 0.0, 0.0, spline.ixx, 0.0, 0.0, spline.ixx, 0.0, spline.izz]
    )
    return inertia_from(inertial_parameters(joint.link) + moved(solid, on_link(joint, spline)))


def exchanged(whole: Inertia, old: Inertia, new: Inertia) -> Inertia:
    """Return a body in which a part is exchanged for another; RobotError if no body is left."""
    ten = [inertial_parameters(body) for body in (whole, new, old)]
    return inertia_from(ten[0] + ten[1] - ten[2])


def inertia_from(ten: Array) -> Inertia:
    """Inertia of a body whose ten parameters about its frame's origin are given.

    Raises a RobotError if no body has them.
    """
    mass = float(ten[0])
    if mass <= 0.0:
        raise RobotError(
            f"mass is {mass:g} kg, but must be positive", "Identify with physical consistency"
        )
    com = ten[1:4] / mass
    tensor = tensor_of(ten[4:]) - mass * ((com @ com) * np.eye(3) - np.outer(com, com))
    return Inertia(mass, com, tensor)
