"""The bench of known changes: what a change does to a recording, and what counts as named."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.injections import against, is_named
from benchmarks.judge import ANY, Arm, row
from benchmarks.known_changes import CHANGES, STILL, Bench, ServoBench, with_mass
from elastic_arm.dynamics import build_model
from elastic_arm.recording import Recording, Side
from elastic_arm.robot import JointController
from elastic_arm.studies.blind_challenge.hidden_arms.motion import random_motion
from tests.helpers.random_arms import random_arm

JOINT = 1
ARM = Arm("a", "gen3", "1 times", ["fit"], ["held"])


def cause(effect: str, joint: str | None, *alternatives: dict[str, Any]) -> dict[str, Any]:
    """Return a cause as diagnosis.json has it."""
    return {
        "effect": effect,
        "joint": joint,
        "confidence": 0.95,
        "parameters": {},
        "alternatives": list(alternatives),
    }


@pytest.fixture(scope="module")
def bench() -> Bench:
    """Two recordings of a rigid arm of three joints at 200 Hz, without noise or friction."""
    rng = np.random.default_rng(3)
    robot = random_arm(3, rng, elastic=False)
    t = np.arange(0.0, 8.0, 0.005)
    recordings = []
    for _ in range(2):
        q, dq, ddq = random_motion(rng, 3, 8.0).evaluate(t)
        torque = build_model(robot, "mod3").inverse_dynamics(q, dq, ddq)
        recordings.append(
            Recording(robot.joint_names, motor=Side((t * 1e9).astype(np.int64), q, dq, torque))
        )
    return Bench(robot, recordings)


def changes_of(bench: Bench, name: str, times: float) -> tuple[list[np.ndarray], dict[str, Any]]:
    """Return what a change adds to the torques of each recording, and its truth."""
    recordings, truth = bench.changed(name, times, JOINT)
    pairs = zip(recordings, bench.motions, strict=True)
    return [getattr(r, m.name).effort - m.torque for r, m in pairs], truth


def test_friction_is_added_exactly(bench: Bench) -> None:
    """Dry friction adds its torque with the sign of the speed, viscous friction its coefficient
    times the speed, and neither adds anything at other joints."""
    dry, of_dry = changes_of(bench, "dry", 2.0)
    viscous, of_viscous = changes_of(bench, "viscous", 2.0)
    torque = 2.0 * CHANGES["dry"].size * bench.peak[JOINT]
    assert of_dry["parameters"] == {"torque": pytest.approx(torque)}
    (coefficient,) = of_viscous["parameters"].values()
    for motion, with_dry, with_viscous in zip(bench.motions, dry, viscous, strict=True):
        speed = motion.recording.motor.velocity[:, JOINT]  # type: ignore[union-attr, index]
        fast = np.abs(speed) > 5 * STILL * bench.fastest[JOINT]
        np.testing.assert_allclose(with_dry[fast, JOINT], torque * np.sign(speed[fast]), rtol=1e-3)
        inside = slice(50, -50)  # where the smoothing of the angles has no end
        expected = coefficient * speed[inside]
        np.testing.assert_allclose(
            with_viscous[inside, JOINT], expected, atol=1e-3 * np.abs(expected).max()
        )
        others = np.arange(bench.robot.n) != JOINT
        assert not with_dry[:, others].any() and not with_viscous[:, others].any()


@pytest.mark.parametrize("name", sorted(set(CHANGES) - {"ripple", "lighter", "clipped"}))
def test_a_change_goes_with_its_size(bench: Bench, name: str) -> None:
    """Twice a change does about twice what one does, in every recording."""
    sizes = []
    for times in (1.0, 2.0):
        changes, truth = changes_of(bench, name, times)
        assert all(np.abs(change).max() > 0.0 for change in changes)
        sizes.append(float(np.sqrt(np.mean(np.square(changes)))))
        assert all(np.isfinite(value) for value in truth["parameters"].values())
    assert sizes[1] / sizes[0] == pytest.approx(2.0, rel=0.15)


def test_ripple_turns_with_the_rotor() -> None:
    """Of an elastic arm the motor gives a sine of the rotor's angle more than its torque says."""
    rng = np.random.default_rng(3)
    robot = random_arm(2, rng, elastic=True)
    t = np.arange(0.0, 4.0, 0.002)
    q, dq, _ = random_motion(rng, 2, 4.0).evaluate(t)
    side = Side((t * 1e9).astype(np.int64), q, dq, np.ones_like(q))
    bench = Bench(robot, [Recording(robot.joint_names, motor=side)])
    (change,), truth = changes_of(bench, "ripple", 1.0)
    gear = robot.joints[JOINT].transmission
    assert gear is not None
    amplitude = truth["parameters"]["amplitude"]
    expected = -amplitude * np.sin(gear.r_tot * bench.motions[0].q[:, JOINT])
    np.testing.assert_allclose(change[:, JOINT], expected, atol=1e-12)


def test_another_arm_takes_other_torques(bench: Bench) -> None:
    """A mass weighs at rest, and a zero is read as true angle and offset."""
    motion = bench.motions[0]
    robot = bench.robot
    (change, _), truth = changes_of(bench, "load", 1.0)
    mass = truth["parameters"]["mass"]
    added = with_mass(robot, JOINT, mass, np.asarray(robot.joints[JOINT].link.com))
    assert sum(j.link.mass for j in added.joints) == pytest.approx(bench.mass + mass)
    np.testing.assert_allclose(change, motion.taken(added) - motion.taken(robot), atol=1e-9)
    (change, _), truth = changes_of(bench, "zero", 1.0)
    off = np.array([0.0, truth["parameters"]["offset"], 0.0])
    taken = build_model(robot, "mod3").inverse_dynamics(motion.q - off, motion.dq, motion.ddq)
    np.testing.assert_allclose(change, taken - motion.taken(robot), atol=1e-9)


def test_a_lighter_description_leaves_the_recordings_as_they_are(bench: Bench) -> None:
    """A link of 1.4 times its described mass is one that carries 0.4 times of it at its centre."""
    (change, _), _ = changes_of(bench, "lighter", 1.0)
    described = bench.description("lighter", 1.0, JOINT)
    np.testing.assert_allclose(change, 0.0, atol=1e-12)
    true = bench.robot.joints[JOINT].link
    assert true.mass == pytest.approx(1.4 * described.joints[JOINT].link.mass)


def test_a_servo_answers_later_and_is_stiffer_than_described() -> None:
    """Angles that are stamped later follow the commands later; a lower gain is described."""
    robot = random_arm(1, np.random.default_rng(3), elastic=False)
    name = robot.joint_names[0]
    robot = robot.with_joint(name, controller=JointController(kp=16.0))
    stamps = np.arange(100) * 10_000_000
    side = Side(stamps, np.zeros((100, 1)))
    bench = ServoBench(robot, [Recording((name,), link=side, reference=side)])
    (late,), truth = bench.changed("late", 2.0, 0)
    assert late.link is not None and late.reference is not None
    assert truth["parameters"] == {"delay": 0.02}
    assert set(late.link.stamp_ns - late.reference.stamp_ns) == {20_000_000}
    softer = bench.description("softer", 2.0, 0).joints[0].controller
    assert softer is not None and softer.kp == pytest.approx(10.0)


def test_the_base_is_no_false_cause_and_a_part_of_the_size() -> None:
    """What the unchanged recordings have is allowed, with its synonyms; gains multiply."""
    zero = {"effect": "joint_zero", "joint": "j2", "confidence": 0.2}
    faint = {"effect": "base_tilt", "joint": None, "confidence": 0.01}
    base = {
        "causes": [cause("payload", "j3", zero, faint)],
        "imperfections": [{"what": "motor_torque_gain", "joint": "j1", "value": 0.98}],
    }
    assert is_named(base, "joint_zero", "j2") and is_named(base, "payload", ANY)
    assert is_named(base, "link_inertia_mismatch", "j3")
    assert not is_named(base, "base_tilt", None) and not is_named(base, "payload", "j2")
    truth = {"effect": "motor_torque_gain", "joint": "j1", "phases": []}
    arm = against(replace(ARM, truth=[truth | {"parameters": {"gain": 1.1}}]), base)
    assert arm.truth[0]["parameters"]["gain"] == pytest.approx(1.078)
    found = {
        "verdict": "explained",
        "causes": [cause("link_inertia_mismatch", "j3"), cause("backlash", "j1")],
        "cpu_seconds": 1.0,
    }
    assert row(arm, found)["false_causes"] == "backlash:j1"
