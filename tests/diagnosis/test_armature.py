"""Motor inertia without elasticity: a rigid arm with armatures, simulated, identified and
diagnosed."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS
from elastic_arm.excitation import MotionLimits, random_trajectories
from elastic_arm.identification import identify
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot, load_robot, parse_urdf, to_urdf
from elastic_arm.simulation import SimulationSettings, simulate

ARMATURES = (0.5, 1.5, 2.5)
HEAVIER = 1.4


def rigid(factor: float = 1.0) -> Robot:
    """Return the nominal arm without elasticity, with armatures."""
    robot = parse_urdf(to_urdf(load_robot()))
    joints = zip(robot.joints, ARMATURES, strict=True)
    return robot.with_(
        joints=tuple(replace(joint, armature=factor * value) for joint, value in joints)
    )


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    """Two motions of an arm whose armatures are larger than described."""
    rng = np.random.default_rng(0)
    motions = random_trajectories(build_model(rigid()), MotionLimits.of(rigid()), 2, rng=rng)
    return [
        simulate(rigid(HEAVIER), motion, SimulationSettings(nominal=rigid()), rng=rng)
        for motion in motions
    ]


def test_an_armature_is_felt_by_its_own_joint_alone() -> None:
    """Inverse dynamics with and without armatures differ by armature times acceleration."""
    x, dx, ddx = np.random.default_rng(1).standard_normal((3, 5, 3))
    apart = build_model(rigid()).inverse_dynamics(x, dx, ddx) - build_model(
        bare()
    ).inverse_dynamics(x, dx, ddx)
    np.testing.assert_allclose(apart, np.array(ARMATURES) * ddx, atol=1e-12)


def test_identification_finds_armatures_that_the_motion_determines(
    recordings: list[Recording],
) -> None:
    """The armature of the last joint, which its link's inertia does not hide, comes out; the arm
    predicts torques."""
    result = identify(recordings[0], rigid())
    assert result.identified is not None
    named = {estimate.name: estimate for estimate in result.estimates}
    (third,) = [e for name, e in named.items() if name == "joint_3.armature"]
    assert abs(third.value - HEAVIER * ARMATURES[2]) < 4 * third.std + 0.01 * ARMATURES[2]
    assert all(
        joint.armature is not None and joint.armature >= 0.0 for joint in result.identified.joints
    )


def bare() -> Robot:
    """Return the arm as a URDF describes it: without the inertia of its motors."""
    return rigid().with_(joints=tuple(replace(joint, armature=None) for joint in rigid().joints))


def test_motor_inertia_that_no_description_states_is_identified(
    recordings: list[Recording],
) -> None:
    """From a URDF and motor torques the motors' inertia comes out, and no link gets it: masses stay
    as described."""
    result = identify(recordings[0], bare())
    assert result.identified is not None
    third = result.identified.joints[2].armature
    assert third is not None and abs(third - HEAVIER * ARMATURES[2]) < 0.02 * ARMATURES[2]
    for found, described in zip(result.identified.joints, bare().joints, strict=True):
        assert 0.5 < found.link.mass / described.link.mass < 2.0
    assert any("states no motor inertia" in note for note in result.notes)


def test_a_link_described_as_a_point_gets_an_inertia(recordings: list[Recording]) -> None:
    """A vendor's last link without moments of inertia, and too heavy, comes out as a body, and the
    arm is written."""
    last = bare().joints[2]
    point = replace(last.link, mass=1.5 * last.link.mass, inertia=np.zeros((3, 3)))
    described = bare().with_joint(last.name, link=point)
    result = identify(recordings[0], described)
    assert result.identified is not None
    moments = np.linalg.eigvalsh(result.identified.joints[2].link.inertia)
    assert moments[0] > 0.0 and moments[2] < moments[0] + moments[1]


def test_motor_inertia_that_no_description_states_is_no_gain(recordings: list[Recording]) -> None:
    """With --refit, motors' inertia that a URDF leaves out is a number of the arm, no gain and no
    link."""
    effects = tuple(
        EFFECTS[name] for name in ("coulomb_friction", "motor_torque_gain", "link_inertia_mismatch")
    )
    found = diagnose(recordings[:1], Question(bare(), effects=effects, refit=True), recordings[1:])
    assert not found.causes
    assert found.context is not None
    third = found.context.model.robot.joints[2].armature
    assert third is not None and abs(third - HEAVIER * ARMATURES[2]) < 0.05 * ARMATURES[2]
