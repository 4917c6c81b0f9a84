"""A six-axis arm with a tool that its URDF lacks, and tables of what it did: angles and currents.

Masses and lengths are those that a maker of such an arm publishes; Pinocchio moves it, so that no
line of the suite has part in what is recorded.
"""

import numpy as np
import pinocchio
from numpy.typing import NDArray

Array = NDArray[np.float64]
JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
LINKS = (
    "shoulder_link",
    "upper_arm_link",
    "forearm_link",
    "wrist_1_link",
    "wrist_2_link",
    "wrist_3_link",
)
# Of each link: mass, centre, moments xx yy zz; of its joint: place and angles in the link before.
MASSES = (3.761, 8.058, 2.846, 1.37, 1.3, 0.365)
CENTRES = (
    (0.0, -0.00193, -0.02561),
    (-0.2125, 0.0, 0.11336),
    (-0.24225, 0.0, 0.0265),
    (0.0, -0.01634, -0.0018),
    (0.0, 0.01634, -0.0018),
    (0.0, 0.0, -0.001159),
)
MOMENTS = (
    (0.010267, 0.010267, 0.00666),
    (0.015107, 0.133886, 0.133886),
    (0.004095, 0.031207, 0.031207),
    (0.002559, 0.002559, 0.002194),
    (0.002559, 0.002559, 0.002194),
    (0.000099, 0.000099, 0.000132),
)
PLACES = (
    ((0.0, 0.0, 0.1625), (0.0, 0.0, 0.0)),
    ((0.0, 0.0, 0.0), (np.pi / 2, 0.0, 0.0)),
    ((-0.425, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ((-0.3922, 0.0, 0.1333), (0.0, 0.0, 0.0)),
    ((0.0, -0.0997, 0.0), (np.pi / 2, 0.0, 0.0)),
    ((0.0, 0.0996, 0.0), (np.pi / 2, np.pi, np.pi)),
)
ARMATURES = np.array([3.2, 3.2, 1.2, 0.31, 0.31, 0.31])  # kg m²
DRY = np.array([9.0, 11.0, 6.0, 1.6, 1.5, 1.2])  # Nm
VISCOUS = np.array([10.0, 12.0, 7.0, 1.8, 1.6, 1.3])  # Nm s/rad
TORQUE_CONSTANTS = np.array([0.13, 0.13, 0.1, 0.09, 0.09, 0.09])  # Nm/A
RATIO = 101.0
TOOL, TOOL_CENTRE = 1.2, (0.01, 0.0, 0.07)  # kg, m
RATE, SECONDS = 125.0, 25.0


def urdf() -> str:
    """Return the arm as its maker describes it, without tool, friction and motors."""
    text = '<robot name="six_axes"><link name="base_link"/>'
    parent = "base_link"
    for k, name in enumerate(JOINTS):
        place, angles = (" ".join(f"{x:.10g}" for x in one) for one in PLACES[k])
        centre = " ".join(f"{x:g}" for x in CENTRES[k])
        xx, yy, zz = MOMENTS[k]
        text += (
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{LINKS[k]}"/><origin xyz="{place}" rpy="{angles}"/><axis xyz="0 0 1"/>'
            '<limit lower="-6.28" upper="6.28" effort="150" velocity="3.14"/></joint>'
            f'<link name="{LINKS[k]}"><inertial><origin xyz="{centre}"/><mass value="{MASSES[k]}"/>'
            f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        parent = LINKS[k]
    return f"{text}</robot>"


def motion(
    seed: int, *, rate: float = RATE, seconds: float = SECONDS
) -> tuple[Array, Array, Array, Array]:
    """Return time, angles, rates and accelerations of five harmonics of each joint."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / rate)
    w = 2 * np.pi * 0.08 * np.arange(1, 6)[:, None, None]
    a, b = 0.5 * rng.normal(size=(2, 5, 1, len(JOINTS))) / np.arange(1, 6)[:, None, None]
    sine, cosine = np.sin(w * t[:, None]), np.cos(w * t[:, None])
    q = (a * sine + b * cosine).sum(axis=0)
    dq = (w * (a * cosine - b * sine)).sum(axis=0)
    ddq = (-(w**2) * (a * sine + b * cosine)).sum(axis=0)
    return t, q, dq, ddq


def torques(q: Array, dq: Array, ddq: Array, *, link: int = 5, mass: float = TOOL) -> Array:
    """Return what the motors give, Nm at the joints, while a link carries a body of that mass."""
    model = pinocchio.buildModelFromXML(urdf())
    model.armature = ARMATURES
    joint = model.getJointId(JOINTS[link])
    if mass:
        # A body as large as a fist.
        body = pinocchio.Inertia(mass, np.array(TOOL_CENTRE), mass * 0.03**2 * np.eye(3))
        model.appendBodyToJoint(joint, body, pinocchio.SE3.Identity())
    data = model.createData()
    rigid = [pinocchio.rnea(model, data, *sample).copy() for sample in zip(q, dq, ddq, strict=True)]
    return np.array(rigid) + DRY * np.tanh(dq / 0.005) + VISCOUS * dq


def table(seed: int, *, rate: float = RATE, seconds: float = SECONDS, **carried: float) -> Array:
    """Return rows of time, angles, rates and motor currents, with the noise of such an arm."""
    rng = np.random.default_rng(seed)
    t, q, dq, ddq = motion(seed, rate=rate, seconds=seconds)
    tau = torques(q, dq, ddq, **carried)
    tau += rng.normal(size=tau.shape) * 0.01 * np.abs(tau).max(axis=0)
    current = tau / (TORQUE_CONSTANTS * RATIO)
    read = q + 2e-5 * rng.normal(size=q.shape)
    return np.column_stack([t, read, dq + 2e-3 * rng.normal(size=q.shape), current])
