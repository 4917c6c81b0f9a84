"""Dry friction that turns over within a distance and bends by some percent, as that of real
drives."""

from pathlib import Path

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.recording import Recording, Side
from elastic_arm.robot import load_robot

MASS, LENGTH, INERTIA, GRAVITY = 2.0, 0.15, 0.02, 9.81
DRY, VISCOUS, DISTANCE = 0.5, 0.2, 0.02  # Nm, Nm s/rad, rad
STRIBECK_SPEED, WARM_AFTER = 0.2, 12.0  # rad/s, s
ORDINARY = {"coulomb_friction", "viscous_friction", "rotor_inertia_mismatch"}
URDF = f"""<robot name="pendulum"><link name="base"/><joint name="joint_1" type="revolute">
<parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="10" velocity="5"/></joint>
<link name="arm"><inertial><origin xyz="0 0 -{LENGTH}"/><mass value="{MASS}"/>
<inertia ixx="{INERTIA}" iyy="{INERTIA}" izz="{INERTIA}" ixy="0" ixz="0" iyz="0"/>
</inertial></link></robot>"""


def recording(
    seed: int, stribeck: float = 0.0, warmth: float = 0.0, *, has_joint_torque: bool = False
) -> Recording:
    """A pendulum swung for 20 s, its torque by the equations of motion and Dahl's equation.

    stribeck, warmth: shares of the dry friction that are there at rest only, and that are lost
    while the joint warms up; has_joint_torque: whether a sensor behind the drive reads the torque
    of the joint.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(4000) / 200.0
    rates = 2.0 * np.pi * 0.15 * np.arange(1, 5)
    phases = rng.uniform(0.0, 2.0 * np.pi, 4)
    sizes = 0.6 * rng.uniform(0.5, 1.0, 4) / np.arange(1, 5)
    waves = rates * t[:, None] + phases
    q = np.sin(waves) @ sizes
    dq = np.cos(waves) @ (sizes * rates)
    ddq = -np.sin(waves) @ (sizes * rates**2)
    z = np.zeros_like(q)
    for k in range(1, len(q)):
        step = dq[k] / 200.0
        z[k] = np.sign(step) + (z[k - 1] - np.sign(step)) * np.exp(-abs(step) / DISTANCE)
    inertia = INERTIA + MASS * LENGTH**2
    dry = DRY * (1.0 + stribeck * np.exp(-((dq / STRIBECK_SPEED) ** 2)))
    dry *= 1.0 - warmth * (1.0 - np.exp(-t / WARM_AFTER))
    load = inertia * ddq + MASS * GRAVITY * LENGTH * np.sin(q)
    tau = load + dry * z + VISCOUS * dq
    seen = q + 1e-5 * rng.normal(size=len(q))
    read = tau + 0.05 * rng.normal(size=len(q))
    stamps = (t * 1e9).astype(np.int64)
    if has_joint_torque:
        sensed = load + 0.01 * rng.normal(size=len(q))
        link = Side(stamps, seen[:, None], None, sensed[:, None])
        return Recording(("joint_1",), link, Side(stamps, None, None, read[:, None]))
    return Recording(("joint_1",), None, Side(stamps, seen[:, None], None, read[:, None]))


@pytest.mark.parametrize("has_joint_torque", [False, True])
def test_friction_that_turns_over_late_is_no_delay_of_the_torque(
    has_joint_torque: bool, tmp_path: Path
) -> None:
    """The friction is found with its size; no delay, low pass or other law stands for how it
    turns over, with and without a sensor of the joint's torque behind the drive."""
    (tmp_path / "pendulum.urdf").write_text(URDF)
    robot = load_robot(tmp_path / "pendulum.urdf")
    fitted, other = (recording(seed, has_joint_torque=has_joint_torque) for seed in (1, 2))
    found = diagnose([fitted], Question(robot), [other])
    sizes = {cause.effect: cause.parameters for cause in found.causes}
    assert found.verdict == "explained"
    assert set(sizes) <= ORDINARY
    assert abs(sizes["coulomb_friction"]["torque"].value - DRY) < 0.02
    assert abs(sizes["viscous_friction"]["coefficient"].value - VISCOUS) < 0.02


def test_friction_that_bends_by_some_percent_has_no_cause_for_each_bend(tmp_path: Path) -> None:
    """A tenth more at rest and a tenth less when warm is ordinary: only friction is named."""
    (tmp_path / "pendulum.urdf").write_text(URDF)
    robot = load_robot(tmp_path / "pendulum.urdf")
    fitted, other = (recording(seed, stribeck=0.1, warmth=0.1) for seed in (13, 14))
    found = diagnose([fitted], Question(robot), [other])
    assert found.verdict == "explained"
    assert {cause.effect for cause in found.causes} <= ORDINARY


def test_friction_twice_as_large_at_rest_is_named(tmp_path: Path) -> None:
    """What goes far beyond the ordinary bend is a cause, with its size."""
    (tmp_path / "pendulum.urdf").write_text(URDF)
    robot = load_robot(tmp_path / "pendulum.urdf")
    fitted, other = (recording(seed, stribeck=1.0) for seed in (5, 6))
    found = diagnose([fitted], Question(robot), [other])
    sizes = {cause.effect: cause.parameters for cause in found.causes}
    assert set(sizes) <= {"stribeck_friction", *ORDINARY}
    assert abs(sizes["stribeck_friction"]["speed"].value - STRIBECK_SPEED) < 0.02
