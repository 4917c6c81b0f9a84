"""Descriptions of arms with six and seven joints, and arms with ordinary deviations from them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.robot import (
    DH,
    Bearing,
    Component,
    Inertia,
    Joint,
    Robot,
    Transmission,
    parse_urdf,
    to_urdf,
)
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from elastic_arm.studies.blind_challenge.hidden_arms.kinematic_tree import KinematicTree

RIGHT = np.pi / 2
# Denavit-Hartenberg rows (a, d, alpha, offset), m and rad, and masses of the links, kg, at scale 1.
GEOMETRIES: dict[int, tuple[tuple[tuple[float, float, float, float], ...], tuple[float, ...]]] = {
    6: (
        (
            (0.15, 0.45, -RIGHT, 0.0), (0.60, 0.0, 0.0, -RIGHT), (0.12, 0.0, -RIGHT, 0.0),
            (0.0, 0.62, RIGHT, 0.0), (0.0, 0.0, -RIGHT, 0.0), (0.0, 0.10, 0.0, 0.0),
        ),
        (30.0, 26.0, 18.0, 9.0, 4.0, 2.0),
    ),
    7: (
        (
            (0.0, 0.31, RIGHT, 0.0), (0.0, 0.0, -RIGHT, 0.0), (0.0, 0.40, -RIGHT, 0.0),
            (0.0, 0.0, RIGHT, 0.0), (0.0, 0.39, RIGHT, 0.0), (0.0, 0.0, -RIGHT, 0.0),
            (0.0, 0.08, 0.0, 0.0),
        ),
        (9.0, 9.0, 7.0, 7.0, 5.0, 4.0, 2.0),
    ),
}  # fmt: skip
RATED_DEFLECTION = 4e-3  # rad, of a drive under its rated torque
# Nm of rated torque from which on a joint's friction and offsets are those of a large arm
FULL_SIZE = 300.0
LEAST_REFLECTED = 0.03  # kg m², of a small motor (3e-6 kg m²) behind a gear of 100
SMALLEST = 0.08  # of a large joint's friction and noise that the smallest joint has
ENCODER_ZERO = 1.5e-5  # rad, by which the zeros of a joint's two encoders differ at most
STRAIN = (
    0.02  # by which a link's shape differs from its description in each direction, shear included
)


def mounted(robot: Robot, rng: np.random.Generator) -> Robot:
    """Return an arm on the floor, the wall or the ceiling, as its description states."""
    tilt = rng.choice([0.0, RIGHT, np.pi], p=[0.6, 0.2, 0.2])
    about = rng.uniform(-np.pi, np.pi)
    side = np.array([np.cos(about), np.sin(about), 0.0])
    return robot.with_(
        gravity=-9.81 * (np.cos(tilt) * np.array([0.0, 0.0, 1.0]) + np.sin(tilt) * side)
    )


def industrial_arm(n: int, rng: np.random.Generator, *, lift: bool = False) -> Robot:
    """Draw the description of an arm of six or seven joints, base to wrist.

    Its geometry is always the same.

    With `lift` its first axis is a column that slides along z instead of turning about it.
    """
    rows, masses = GEOMETRIES[n]
    scale = rng.uniform(0.7, 1.4)
    joints = []
    for i, (row, mass) in enumerate(zip(rows, masses, strict=True)):
        dh = DH(*row)
        link = _link(dh, scale * mass * rng.uniform(0.8, 1.2), rng)
        carrier = "base" if i == 0 else f"link_{i}"
        drive = _small_drive(carrier)
        slides = lift and i == 0
        name = f"joint_{i + 1}"
        moved = f"link_{i + 1}"
        joints.append(Joint.from_dh(name, moved, link, dh, transmission=drive, prismatic=slides))
    robot = Robot(f"industrial_{n}", tuple(joints))
    loads = _link_inertias(robot, rng)
    drives = [
        _drive(load, f"link_{i}" if i else "base", i / (n - 1), rng) for i, load in enumerate(loads)
    ]
    return robot.with_(
        joints=tuple(replace(j, transmission=d) for j, d in zip(robot.joints, drives, strict=True))
    )


def without_drives(robot: Robot) -> Robot:
    """Return an arm of its links alone."""
    return robot.with_(joints=tuple(replace(joint, transmission=None) for joint in robot.joints))


def as_urdf(robot: Robot) -> Robot:
    """Return an arm as its URDF has it: links in the frames of the URDF, the drives beside them."""
    read = parse_urdf(to_urdf(without_drives(robot)))
    joints = [
        replace(j, transmission=own.transmission)
        for j, own in zip(read.joints, robot.joints, strict=True)
    ]
    return read.with_(joints=tuple(joints), gravity=robot.gravity, notes=())


def joint_sizes(robot: Robot) -> Array:
    """Return how large each joint (n,) is: 1 for those of a large arm, less for a wrist."""
    rated = np.array(
        [
            RATED_DEFLECTION * joint.transmission.stiffness
            for joint in robot.joints
            if joint.transmission
        ]
    )
    return np.clip(rated / FULL_SIZE, SMALLEST, 1.0)


def imprecise(robot: Robot, rng: np.random.Generator) -> Robot:
    """Return an arm of this description as real arms are.

    Masses and inertias differ by up to 8 %, centres of mass by 1 cm, rotors by 5 %, stiffness by 10
    %, damping by 20 %, all uniformly. A link's moments of inertia differ by up to 4 % in common;
    the rest is its shape, stretched and sheared, so that no product of inertia is known exactly
    either.
    """
    joints = []
    shapes = rng.spawn(1)[0]  # so that all other numbers of a seed stay as they were
    for joint in robot.joints:
        mass = 1 + rng.uniform(-0.08, 0.08)
        link = joint.link
        gear = joint.transmission
        assert gear is not None
        inertia = np.asarray(link.inertia) * mass * (1 + rng.uniform(-0.04, 0.04))
        inertia = strained(inertia, shapes.uniform(-STRAIN, STRAIN, (3, 3)))
        com = np.asarray(link.com) + rng.uniform(-0.01, 0.01, 3)
        rotor = 1 + rng.uniform(-0.05, 0.05)
        gear = replace(
            gear.with_inertias(rotor),
            stiffness=gear.stiffness * (1 + rng.uniform(-0.1, 0.1)),
            damping=gear.damping * (1 + rng.uniform(-0.2, 0.2)),
        )
        joints.append(
            replace(
                joint,
                link=replace(link, mass=link.mass * mass, com=com, inertia=inertia),
                transmission=gear,
            )
        )
    return robot.with_(joints=tuple(joints))


def strained(inertia: Array, strain: Array) -> Array:
    """Return the inertia (3, 3) of a body after a homogeneous deformation 1 + strain.

    About its centre of mass.
    """
    deformation = np.eye(3) + strain
    second = 0.5 * np.trace(inertia) * np.eye(3) - inertia  # the integral of x x' over the mass
    second = deformation @ second @ deformation.T
    changed = np.trace(second) * np.eye(3) - second
    return 0.5 * (changed + changed.T)  # symmetric to the last digit


def ordinary_faults(
    sizes: Sequence[float], rng: np.random.Generator, *, torque_constant: float = 0.0
) -> list[Fault]:
    """Draw what every joint has: dry and viscous friction, torque sensors off by 1 % and 0.5 Nm."""
    found = []
    for i, size in enumerate(sizes):
        found.append(Fault("coulomb_friction", i, {"torque": float(size * rng.uniform(4, 14))}))
        found.append(
            Fault("viscous_friction", i, {"coefficient": float(size * rng.uniform(3, 20))})
        )
        for sensor in ("motor_torque", "joint_torque"):
            gain = max(torque_constant, 0.01) if sensor == "motor_torque" else 0.01
            found.append(Fault(f"{sensor}_gain", i, {"gain": float(1 + rng.uniform(-gain, gain))}))
            found.append(
                Fault(f"{sensor}_offset", i, {"offset": float(size * rng.uniform(-0.5, 0.5))})
            )
    return found


def encoder_zeros(n: int, rng: np.random.Generator) -> list[Fault]:
    """Draw by how much each joint's deflection is read wrong, where both of its encoders are."""
    offsets = rng.spawn(1)[0].uniform(-ENCODER_ZERO, ENCODER_ZERO, n)
    return [
        Fault("encoder_offset", i, {"offset": float(offset)}) for i, offset in enumerate(offsets)
    ]


def _link(dh: DH, mass: float, rng: np.random.Generator) -> Inertia:
    """Inertia of a hollow beam between two joints, in the frame of the second."""
    back = -dh.placement[:3, :3].T @ dh.placement[:3, 3]
    along = np.abs(back) + rng.uniform(0.12, 0.18, 3)
    square = along**2
    inertia = mass / 8.0 * (square.sum() * np.eye(3) - np.diag(square))
    turn, _ = np.linalg.qr(np.eye(3) + 0.05 * rng.standard_normal((3, 3)))
    inertia = turn @ inertia @ turn.T
    return Inertia(mass, 0.45 * back + rng.uniform(-0.02, 0.02, 3), 0.5 * (inertia + inertia.T))


def _small_drive(carrier: str) -> Transmission:
    part = Component(1e-3, 1e-9, 1e-9, carrier)
    return Transmission(part, part, part, 1.0, 0.0, 1.0, 1.0)


def _link_inertias(robot: Robot, rng: np.random.Generator) -> Array:
    """Mean inertia (n,) about each joint over some poses, kg m²."""
    tree = KinematicTree(robot)
    n = robot.n
    diagonals = []
    for _ in range(10):
        pose = np.tile(rng.uniform(-1.2, 1.2, n), 2)
        diagonals.append(np.diag(tree.terms(pose, np.zeros(2 * n))[0])[:n])
    return np.mean(diagonals, axis=0)


def _drive(load: float, carrier: str, outward: float, rng: np.random.Generator) -> Transmission:
    """A drive fit for a load: reflected inertia, stiffness and damping in proportion."""
    belt = float(rng.choice([1.0, 1.5, 2.0]))
    harmonic = float(rng.choice([50, 80, 100, 120, 160]))
    reflected = max(load * rng.uniform(0.3, 1.0), LEAST_REFLECTED)
    frequency = 2 * np.pi * rng.uniform(11, 18) * (1 + 1.5 * outward)
    stiffness = max(frequency**2 * load, 4000.0)
    damping = 2 * rng.uniform(0.01, 0.03) * np.sqrt(stiffness * load)
    size = load ** (1 / 3)
    parts = {
        name: _solid(share * reflected / ratio**2, mass * size, carrier)
        for name, share, ratio, mass in (
            ("rotor", 0.66, belt * harmonic, 1.0),
            ("wave_generator", 0.30, harmonic, 0.5),
            ("spline", 0.04, 1.0, 0.8),
        )
    }
    bearing = Bearing(20 * stiffness, damping * 20)
    return Transmission(
        **parts,
        stiffness=stiffness,
        damping=damping,
        belt_ratio=belt,
        harmonic_drive_ratio=harmonic,
        bearing=bearing,
    )


def _solid(izz: float, mass: float, carrier: str) -> Component:
    return Component(float(mass), 0.8 * float(izz), float(izz), carrier)
