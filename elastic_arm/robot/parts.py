"""The parts of an arm: inertias, solids of revolution, bearings, transmissions, limits,
Denavit-Hartenberg rows.

Every object checks its own physics when it is created. Units are SI units and radians.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.errors import RobotError

# A moment or a sum of moments may miss its bound by this share of the trace: rounding of a
# description on its edge.
_INERTIA_TOLERANCE = 1e-9
# Sizes of an arm's numbers, SI units, zero apart; products of several beyond leave the range of
# floating-point numbers.
_SMALLEST = 1e-30
_LARGEST = 1e30
# A stage of a transmission. Two that are larger leave no trace of the stiffness beside the motor's
# inertia.
_RATIO = 1e4
# Of the largest second moment: as flat as a plate.
_THIN = 1e-4
# Direction cosines below this are rounding of a right angle; kept, they would create false base
# parameters.
_SNAP = 1e-12


def checked_array(values: Any, shape: tuple[int, ...], what: str) -> np.ndarray:
    """Return `values` as a read-only float array of `shape`.

    Other shapes and numbers that no arm has are refused.
    """
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise RobotError(
            f"{what} is not an array of numbers: {values!r}", f"Give {shape} numbers"
        ) from error
    if array.shape != shape:
        raise RobotError(f"{what} has shape {array.shape}", f"Give an array of shape {shape}")
    if not np.isfinite(array).all():
        raise RobotError(
            f"{what} contains a number that is not finite: {values!r}", "Give finite numbers"
        )
    largest = float(np.abs(array).max(initial=0.0))
    require(
        largest <= _LARGEST, f"{what} contains {largest:g}, which is implausible", "Check its unit"
    )
    array.setflags(write=False)
    return array


@contextlib.contextmanager
def located(where: str) -> Iterator[None]:
    """Put where they were met in front of the problem of errors raised inside."""
    try:
        yield
    except RobotError as error:
        raise RobotError(f"{where}{error.problem}", error.remedy) from error


def require(condition: bool, problem: str, remedy: str) -> None:
    """Raise a RobotError unless a condition holds."""
    if not condition:
        raise RobotError(problem, remedy)


def check_number(value: float, what: str, *, positive: bool = False) -> None:
    """Refuse a number that is not finite, negative, or of no arm."""
    require(np.isfinite(value), f"{what} is {value}", "Give a finite number")
    if positive:
        require(
            value > 0.0, f"{what} is {value:g}, but must be positive", "Give a number above zero"
        )
    else:
        require(
            value >= 0.0,
            f"{what} is {value:g}, but must not be negative",
            "Give zero or a positive number",
        )
    sized = value == 0.0 or _SMALLEST <= value <= _LARGEST
    require(sized, f"{what} is {value:g}, which is implausible", "Check its unit")


def snap(matrix: np.ndarray) -> np.ndarray:
    """Return `matrix` with direction cosines like 6e-17 replaced by 0, 1 or -1.

    They are cos(pi/2) and the like.
    """
    snapped = np.array(matrix, dtype=float)
    for exact in (-1.0, 0.0, 1.0):
        snapped[np.abs(snapped - exact) < _SNAP] = exact
    return snapped


def placed(rotation: Any = None, position: Any = 0.0) -> np.ndarray:
    """Return the placement (4, 4) of a frame turned by a rotation (3, 3) and moved.

    Not turned by default.
    """
    placement = np.eye(4)
    placement[:3, :3] = (
        np.eye(3) if rotation is None else np.asarray(rotation, dtype=float).reshape(3, 3)
    )
    placement[:3, 3] = position
    return placement


def moved_joint(by: float, prismatic: bool) -> np.ndarray:
    """Return the placement (4, 4) after a joint that turned about z, rad, or slid, m."""
    c = np.cos(by)
    s = np.sin(by)
    return (
        placed(position=[0.0, 0.0, by])
        if prismatic
        else placed([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    )


def tensor_of(six: Any) -> np.ndarray:
    """(6,) in the order xx xy xz yy yz zz -> symmetric (3, 3)."""
    xx, xy, xz, yy, yz, zz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@dataclass(frozen=True, eq=False)
class Inertia:
    """Inertial parameters of a rigid body.

    A RobotError if no body of positive density has these numbers.
    """

    mass: float  # kg, not negative
    # (3,) centre of mass in the body's frame, m
    com: np.ndarray = field(default_factory=lambda: np.zeros(3))
    # (3, 3) about the centre of mass, in the axes of the body's frame, kg m^2
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))

    def __post_init__(self) -> None:
        object.__setattr__(self, "com", checked_array(self.com, (3,), "com"))
        object.__setattr__(self, "inertia", checked_array(self.inertia, (3, 3), "inertia"))
        check_number(self.mass, "mass")
        require(
            bool(np.array_equal(self.inertia, self.inertia.T)),
            "inertia is not symmetric",
            "Give xy only once, not also as yx",
        )
        moments = np.linalg.eigvalsh(self.inertia)
        tolerance = _INERTIA_TOLERANCE * max(float(np.trace(self.inertia)), 0.0)
        text = ", ".join(f"{m:.6g}" for m in moments)
        require(
            moments[0] >= -tolerance,
            f"inertia is not positive definite: its principal moments are {text} kg m^2",
            "Check its signs and the size of its products xy, xz, yz",
        )
        require(
            moments[0] + moments[1] >= moments[2] - tolerance,
            f"inertia violates the triangle inequality: its principal moments are {text} kg m^2",
            "No moment may exceed the sum of the other two; check that it refers to the"
            " centre of mass",
        )
        require(
            self.mass > 0.0 or not (self.inertia.any() or self.com.any()),
            "mass is zero, but inertia or com is not",
            "Give the body a mass, or no inertia",
        )


def nearest_tensor(inertia: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the nearest inertia (3, 3) that a body can have, and how far it is off.

    It is about the centre of mass.

    The distance is a share of the largest moment. A body's second moments about its centre of mass
    are nowhere negative; those that are count as a thin body's.
    """
    second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    values, axes = np.linalg.eigh(second)
    largest = float(np.linalg.norm(inertia, 2))
    if values[0] >= -_INERTIA_TOLERANCE * largest:
        return inertia, 0.0
    second = (axes * np.maximum(values, _THIN * values[-1])) @ axes.T
    second = 0.5 * (second + second.T)
    return np.trace(second) * np.eye(3) - second, float(-values[0] / largest)


@dataclass(frozen=True, eq=False)
class Component:
    """A solid of revolution of a transmission: rotor, wave generator or spline."""

    mass: float  # kg
    # ixx, izz: moments about the centre of mass, across and along the axis of revolution z, kg m^2
    ixx: float
    izz: float
    carrier: str  # body that holds the component: ``"base"`` or a link's name
    # (3,) centre in ``O_{i-1}`` of its own joint, m. Where the carrier is the link the joint
    # drives, in the frame that turns with it there
    position: np.ndarray = field(default_factory=lambda: np.zeros(3))
    kind: str | None = None  # of a spline: ``"circular"`` or ``"flex"``

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", checked_array(self.position, (3,), "position"))
        check_number(self.mass, "mass", positive=True)
        check_number(self.ixx, "ixx", positive=True)
        check_number(self.izz, "izz", positive=True)
        require(
            self.izz <= 2.0 * self.ixx * (1.0 + _INERTIA_TOLERANCE),
            f"inertia violates the triangle inequality: izz = {self.izz:g} exceeds 2 ixx ="
            f" {2 * self.ixx:g} kg m^2",
            "A solid of revolution has izz <= ixx + iyy = 2 ixx; check both",
        )


@dataclass(frozen=True)
class Bearing:
    """Tilting compliance of a joint about x and y: stiffness in Nm/rad, damping in Nm s/rad."""

    stiffness: float
    damping: float

    def __post_init__(self) -> None:
        check_number(self.stiffness, "stiffness", positive=True)
        check_number(self.damping, "damping")


@dataclass(frozen=True)
class Transmission:
    """Rotor, belt and harmonic drive between motor and link."""

    # rotor, wave_generator, spline: turn by ``r_b r_hd theta``, ``r_hd theta`` and ``theta``
    # relative to their carriers
    rotor: Component
    wave_generator: Component
    spline: Component
    # stiffness, damping: of the drive about z, belt and harmonic drive combined, Nm/rad and Nm
    # s/rad
    stiffness: float
    damping: float
    # belt_ratio, harmonic_drive_ratio: r_b and r_hd
    belt_ratio: float
    harmonic_drive_ratio: float
    bearing: Bearing | None = None  # None where the joint is rigid about x and y

    def __post_init__(self) -> None:
        check_number(self.stiffness, "stiffness", positive=True)
        check_number(self.damping, "damping")
        for what in ("belt_ratio", "harmonic_drive_ratio"):
            ratio = getattr(self, what)
            require(
                bool(np.isfinite(ratio)) and ratio != 0.0,
                f"{what} is {ratio:g}, but a transmission ratio cannot be zero or infinite",
                "Give input turns per output turn; 1 without such a stage",
            )
            sized = 1.0 / _RATIO <= abs(ratio) <= _RATIO
            require(
                sized,
                f"{what} is {ratio:g}, which is implausible for a transmission",
                "Give the ratio of one stage",
            )

    @property
    def r_tot(self) -> float:
        """Total transmission ratio r_b r_hd."""
        return self.belt_ratio * self.harmonic_drive_ratio

    @property
    def components(self) -> dict[str, tuple[Component, float]]:
        """Name -> component and its turns for one turn of theta, rotor first.

        Turns are relative to its carrier.
        """
        return {
            "rotor": (self.rotor, self.r_tot),
            "wave_generator": (self.wave_generator, self.harmonic_drive_ratio),
            "spline": (self.spline, 1.0),
        }

    def with_inertias(self, ratio: float) -> Self:
        """Return it with the moments of inertia of all components times a ratio."""
        scaled: dict[str, Any] = {
            name: replace(part, ixx=part.ixx * ratio, izz=part.izz * ratio)
            for name, (part, _) in self.components.items()
        }
        return replace(self, **scaled)


@dataclass(frozen=True)
class Limits:
    """What a joint may do, at the harmonic-drive output; None where unknown."""

    position_min: float | None = None
    position_max: float | None = None
    velocity: float | None = None
    acceleration: float | None = None
    torque: float | None = None

    def __post_init__(self) -> None:
        for what in ("velocity", "acceleration", "torque"):
            if getattr(self, what) is not None:
                check_number(getattr(self, what), what, positive=True)
        if self.position_min is not None and self.position_max is not None:
            require(
                self.position_min < self.position_max,
                f"position_min {self.position_min:g} is not below position_max"
                f" {self.position_max:g}",
                "Exchange them",
            )


# What to do where no torque was recorded.
CONTROLLED = (
    "or record commands and positions, and describe the controllers that compute"
    " torques from them: `controller: {joint_1: {kp: 30, kd: 0.5}}`, Nm/rad and Nm"
    " s/rad, or the duty (pwm) of servos, and describe their `motor` (docs/servo_arm.md)"
)


@dataclass(frozen=True)
class JointController:
    """A controller of a joint's drive.

    e = r(t - d) - theta
    tau_m = limit(kp e + kd de + ki int(r - theta) + feed-forward)

    The firmware of a servo commands a share u of its supply, the duty, and the back-EMF acts after
    the limit of the duty:

    u = limit((kp e + ki int(r - theta) + feed-forward) / stall, 1)
    tau_m = stall u (1 - sag |u|) - kd dtheta

    Where u was recorded, its mode is ``"duty"``: u takes the place of r, and nothing but stall, sag
    and kd makes the torque (:meth:`of_duty`).
    """

    # what is commanded: ``"position"`` r alone, dr is zero; ``"velocity"`` dr alone, ki integrates
    # its error and there is no kp; ``"both"``; ``"duty"`` u itself
    mode: str = "position"
    # kp, kd, ki: Nm/rad, Nm s/rad, and Nm/(rad s), of velocity Nm/rad; at the harmonic-drive output
    kp: float = 0.0
    kd: float = 0.0
    ki: float = 0.0
    delay: float = 0.0  # d by which commands come late, s
    torque: float | None = None  # limit, Nm, beside that of the joint; None where there is none
    feedforward: str = (
        "none"  # ``"none"``, ``"gravity"``, or ``"model"``: all torque of the nominal rigid arm
    )
    between: str = (
        "held"  # two commands: the last one is ``"held"``, or the motion is ``"interpolated"``
    )
    dead_band: float = 0.0  # rad; of the error of the angle, kp makes a torque of what exceeds it
    # Nm, torque of full duty at rest, kt / R times the supply; None where the duty has no limit
    stall: float | None = None
    sag: float = 0.0  # share of the supply that full duty takes away
    # V, of which stall and kd are made; only a file that states a motor's constants needs it
    supply: float | None = None
    # number in the servo's register for which kp and ki hold; None where it is not stated: they
    # then hold for that of the recordings
    firmware_gain: float | None = None

    def __post_init__(self) -> None:
        choices = {
            "mode": ("position", "velocity", "both", "duty"),
            "feedforward": ("none", "gravity", "model"),
            "between": ("held", "interpolated"),
        }
        for what, known in choices.items():
            given = getattr(self, what)
            require(
                given in known,
                f"{what} of the controller is {given!r}",
                f"Choose one of {', '.join(known)}",
            )
        for what in ("kp", "kd", "ki", "delay", "dead_band"):
            check_number(getattr(self, what), what)
        if self.torque is not None:
            check_number(self.torque, "torque", positive=True)
        for what in ("stall", "supply", "firmware_gain"):
            if getattr(self, what) is not None:
                check_number(getattr(self, what), what, positive=True)
        require(
            self.stall is None or self.mode in ("position", "duty"),
            f"stall is the limit of a position controller's duty, and its mode is {self.mode}",
            "Use the mode position, or give the limit as torque",
        )
        require(
            self.stall is not None or self.mode != "duty",
            "a duty makes no torque without a stall torque",
            "Give the torque of full duty at rest as stall",
        )
        require(
            0.0 <= self.sag < 1.0 and (self.sag == 0.0 or self.stall is not None),
            f"sag of the controller is {self.sag:g}"
            + (" without a stall torque" if self.stall is None else ""),
            "Give a share of 0 to 1 of the supply voltage, together with the stall torque",
        )
        require(
            self.mode != "velocity" or self.kp == 0.0,
            "a velocity controller has a kp",
            "Give its gains as kd and ki, or use the mode both",
        )

    @property
    def gains(self) -> tuple[float, float, float]:
        """Gains of the error of the angle, of its rate, and of its integral.

        An integral of speeds is an angle. A duty has its torque of full duty as the first gain.
        """
        if self.mode == "duty":
            return (self.stall or 0.0, self.kd, 0.0)
        return (self.ki, self.kd, 0.0) if self.mode == "velocity" else (self.kp, self.kd, self.ki)

    def scaled(self, kp: float = 1.0, kd: float = 1.0) -> Self:
        """Return it with gains of angle and rate times these ratios.

        The torque of full duty follows kp: both are made of the supply.
        """
        own = "ki" if self.mode == "velocity" else "kp"
        stall = None if self.stall is None else kp * self.stall
        return replace(self, **{own: kp * getattr(self, own), "kd": kd * self.kd, "stall": stall})

    def with_firmware_gain(self, gain: float | None) -> Self:
        """Return it with another number in the servo's register.

        As it is for None, and where it does not state the number for which its gains hold.
        """
        if gain is None or self.firmware_gain in (gain, None):
            return self
        ratio = gain / self.firmware_gain
        return replace(self, kp=ratio * self.kp, ki=ratio * self.ki, firmware_gain=gain)

    def supplied(self, asked: Array) -> Array:
        """Return the torque at rest (N,) Nm that the supply makes of what the firmware commands."""
        if self.stall is None:
            return asked
        # A recorded duty is within its limit; of a larger supply than stated it makes more.
        limited = asked if self.mode == "duty" else np.clip(asked, -self.stall, self.stall)
        return np.asarray(limited * (1.0 - self.sag * np.abs(limited) / self.stall))

    @property
    def follows_rate(self) -> float:
        """1 where the rate of the command is followed; 0 where kd damps the motor's own motion."""
        return float(self.mode not in ("position", "duty"))

    @property
    def follows_angle(self) -> float:
        """1 where the error of the angle is what the first gain multiplies; 0 where a duty is."""
        return float(self.mode != "duty")

    def of_duty(self) -> Self:
        """Return the electrics alone, which make the torque of a recorded duty.

        What the firmware did beside, its limit of torque too, is in the duty already. kp is kept,
        as it scales with the electrics.
        """
        return replace(
            self,
            mode="duty",
            ki=0.0,
            delay=0.0,
            dead_band=0.0,
            torque=None,
            feedforward="none",
            between="interpolated",
        )

    def with_electrics_of(self, other: Self) -> Self:
        """Return it with the electrics of another one, and the kp that goes with these."""
        return replace(self, kp=other.kp, kd=other.kd, stall=other.stall, sag=other.sag)


@dataclass(frozen=True)
class DH:
    """Denavit-Hartenberg row: ``Rz(q + offset) Tz(d) Tx(a) Rx(alpha)``, m and rad.

    Paper, Table I.
    """

    a: float
    d: float
    alpha: float
    offset: float

    def __post_init__(self) -> None:
        checked_array([self.a, self.d, self.alpha, self.offset], (4,), "a, d, alpha, offset")

    @property
    def placement(self) -> np.ndarray:
        """4x4, the row's transform at q = 0, right angles exact."""
        c = np.cos(self.offset)
        s = np.sin(self.offset)
        ca = np.cos(self.alpha)
        sa = np.sin(self.alpha)
        rotation = snap(np.array([[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0.0, sa, ca]]))
        return placed(rotation, [self.a * rotation[0, 0], self.a * rotation[1, 0], self.d])


def checked_placement(values: Any, what: str) -> np.ndarray:
    """Return a (4, 4) placement with exact right angles; refuse what is no rigid one."""
    matrix = checked_array(values, (4, 4), what)
    rotation = matrix[:3, :3]
    proper = (
        np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) and np.linalg.det(rotation) > 0
    )
    require(
        bool(proper) and np.array_equal(matrix[3], [0, 0, 0, 1]),
        f"{what} is not a rigid placement",
        "Its upper left 3x3 must be a rotation and its last row 0 0 0 1",
    )
    snapped = np.array(matrix)
    snapped[:3, :3] = snap(rotation)
    snapped.setflags(write=False)
    return snapped
