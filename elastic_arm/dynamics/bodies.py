"""The data of the recursion: frames in a tree, the bodies that they carry, spins and springs. It
contains numbers only, not a robot.

A solid of revolution that spins on its carrier is two things: a body at rest on the carrier,
whatever its angle, and a :class:`Spin`, the angular momentum about its axis. Spin angles therefore
do not appear.
"""

import hashlib
import json
from dataclasses import dataclass, field

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.robot.parts import Inertia, placed, snap, tensor_of

GROUND = -1
# Inertial parameters of a link, about its frame's origin; those of a solid of revolution lie on its
# axis z.
LINK_PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
LINK_UNITS = ("kg", *("kg m",) * 3, *("kg m^2",) * 6)
SOLID_PARAMETERS = ("m", "mz", "Ixx", "Izz")
SOLID_UNITS = ("kg", "kg m", "kg m^2", "kg m^2")
# Rows and columns of a symmetric tensor's six entries, in the order of the parameters.
TENSOR = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


@dataclass(frozen=True)
class ModelParameter:
    """One entry of Psi: name, unit and the value of the description."""

    name: str
    unit: str
    nominal: float


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame on one axis: parent . before . R or T(axis, coordinate) . after.

    It turns about the axis or slides along it.
    """

    parent: int  # index of the parent frame, :data:`GROUND` for the base
    # before, after: (4, 4), constant placements on either side of the turn or the slide
    before: Array
    axis: int  # 0, 1, 2 for x, y, z
    coordinate: int  # index into the generalized coordinates
    after: Array
    slides: bool = False  # whether it slides (a prismatic joint)


@dataclass(frozen=True, eq=False)
class Body:
    """A body at rest in a frame."""

    name: str
    frame: int  # index of the frame that carries it; :data:`GROUND` where it enters no equation
    placement: Array  # (4, 4), of the body's own frame in the carrier's
    parameters: tuple[int, ...]  # indices into Psi: ten of a link, or four of a solid of revolution

    @property
    def inertia_map(self) -> Array:
        """(10, k): the body's own parameters -> the ten about its frame's origin."""
        if len(self.parameters) == len(LINK_PARAMETERS):
            return moved(np.eye(10), self.placement)
        solid = np.zeros((10, 4))
        solid[0, 0] = solid[3, 1] = solid[4, 2] = solid[7, 2] = solid[9, 3] = 1.0
        return moved(solid, self.placement)


@dataclass(frozen=True, eq=False)
class Spin:
    """A row of the gear matrix G: a solid turns by sum(ratio x coordinate) about `axis`.

    Its turn is relative to its frame.

    Carried by :data:`GROUND` it does not feel the arm's motion: its inertia enters B alone.
    """

    frame: int
    axis: Array
    gears: tuple[tuple[int, float], ...]
    parameter: int


@dataclass(frozen=True)
class Spring:
    """Stiffness and damping (indices into Psi) between two coordinates, or from one to zero."""

    stiffness: int
    damping: int
    coordinate: int
    against: int | None = None


@dataclass(frozen=True, eq=False)
class Bodies:
    """A mechanism: everything the recursion needs."""

    gravity: Array  # (3,), in the base frame ``O_0``, m/s^2
    coordinates: tuple[str, ...]  # names of the generalized coordinates
    # link_side, motor_side: indices of the coordinates in the first and second row of (1)
    link_side: tuple[int, ...]
    motor_side: tuple[int, ...]
    frames: tuple[Frame, ...]
    bodies: tuple[Body, ...]
    spins: tuple[Spin, ...] = ()
    springs: tuple[Spring, ...] = ()
    parameters: tuple[ModelParameter, ...] = ()
    # g . p of the base frame's origin, for the potential energy's zero at the ground
    base_height: float = field(default=0.0)

    @property
    def dof(self) -> int:
        """Number of generalized coordinates."""
        return len(self.coordinates)

    def fingerprint(self) -> str:
        """Hash of all that shapes the equations; the nominal values of the parameters do not."""
        content = [
            self.gravity.tolist(),
            self.base_height,
            self.dof,
            [self.link_side, self.motor_side],
            [
                [
                    f.parent,
                    f.before.tolist(),
                    f.axis,
                    f.coordinate,
                    f.after.tolist(),
                    *(["slides"] if f.slides else []),
                ]
                for f in self.frames
            ],
            [[b.frame, b.placement.tolist(), b.parameters] for b in self.bodies],
            [[s.frame, s.axis.tolist(), s.gears, s.parameter] for s in self.spins],
            [[s.stiffness, s.damping, s.coordinate, s.against] for s in self.springs],
            len(self.parameters),
        ]
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def moved(parameters: Array, placement: Array) -> Array:
    """Express inertial parameters (10, ...) of a body about the origin of another frame.

    The body's own frame has `placement` there.
    """
    rotation = placement[:3, :3]
    p = placement[:3, 3]
    columns = parameters.reshape(10, -1)
    result = np.empty_like(columns, dtype=float)
    for k, column in enumerate(columns.T):
        mass = column[0]
        moment = rotation @ column[1:4]
        tensor = rotation @ tensor_of(column[4:]) @ rotation.T
        tensor = tensor + 2.0 * (p @ moment) * np.eye(3) - np.outer(p, moment) - np.outer(moment, p)
        tensor = tensor + mass * ((p @ p) * np.eye(3) - np.outer(p, p))
        result[:, k] = [mass, *(moment + mass * p), *(tensor[index] for index in TENSOR)]
    return (
        snap(result).reshape(parameters.shape)
        if parameters.ndim == 2
        else result.reshape(parameters.shape)
    )


def inertial_parameters(body: Inertia) -> Array:
    """(10,) about the frame's origin."""
    about_com = np.array([body.mass, 0.0, 0.0, 0.0, *(body.inertia[index] for index in TENSOR)])
    return moved(about_com, placed(position=body.com))


def pseudo_inertia(ten: Array) -> Array:
    """Return the pseudo-inertia (4, 4) of a body's ten parameters about its frame's origin."""
    m, mx, my, mz, xx, xy, xz, yy, yz, zz = ten
    half = 0.5 * (xx + yy + zz)
    return np.array(
        [
            [half - xx, -xy, -xz, mx],
            [-xy, half - yy, -yz, my],
            [-xz, -yz, half - zz, mz],
            [mx, my, mz, m],
        ]
    )
