"""The hidden arms of the challenge: their engine, laws, motions and sensors, and that they share
nothing else."""

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge.effect_sampling import sample_foreign, sized_foreign
from elastic_arm.studies.blind_challenge.hidden_arms.base_arms import (
    as_urdf,
    industrial_arm,
    mounted,
    strained,
)
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import KNOWN, Fault
from elastic_arm.studies.blind_challenge.hidden_arms.further_laws import FOREIGN
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import HiddenArm
from elastic_arm.studies.blind_challenge.hidden_arms.kinematic_tree import KinematicTree
from elastic_arm.studies.blind_challenge.hidden_arms.motion import random_motion, random_points
from elastic_arm.studies.blind_challenge.hidden_arms.realistic_sensors import (
    MOTOR,
    RealisticSensors,
    _noise,
    measure_realistically,
)
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel, measure
from elastic_arm.studies.blind_challenge.levels import FLOORS, FOREIGN_FLOORS
from tests.test_architecture import PACKAGE, imports_of

ROBOT = load_robot(None)
STUDY = "elastic_arm.studies.blind_challenge"
# What an arm is described by, what a recording is, and what compiles C: no physics.
NEUTRAL = (
    "elastic_arm.arrays.",
    "elastic_arm.errors.",
    "elastic_arm.robot.",
    "elastic_arm.recording.",
    "elastic_arm.codegen.loop",
)
HIDDEN = sorted((PACKAGE / "studies" / "blind_challenge" / "hidden_arms").glob("*.py"))
ENTRANCES = ("studies", "app.py")
ANSWERING = sorted(
    p for p in PACKAGE.rglob("*.py") if p.relative_to(PACKAGE).parts[0] not in ENTRANCES
)


def test_hidden_arms_and_the_diagnosis_share_no_code() -> None:
    """No law, dynamics or part of the diagnosis stands behind a hidden recording, and no truth
    behind answers."""
    assert len(HIDDEN) >= 7 and len(ANSWERING) > 40

    def imported(path: Path) -> list[str]:
        return [full for _, full in imports_of(path) if full.startswith("elastic_arm.")]

    own = (*NEUTRAL, f"{STUDY}.hidden_arms.")
    assert not [
        (path, full) for path in HIDDEN for full in imported(path) if not full.startswith(own)
    ]
    assert not [
        (path, full) for path in ANSWERING for full in imported(path) if full.startswith(STUDY)
    ]


@pytest.mark.parametrize("bearings", [False, True])
def test_hidden_tree_agrees_with_the_projects_own_derivation(bearings: bool) -> None:
    """Two engines that share no code give the same torques for the same motion, to rounding."""
    rng = np.random.default_rng(0)
    tree = KinematicTree(ROBOT, bearings=bearings)
    model = build_model(ROBOT, bearings=bearings)
    x, dx, ddx = (0.3 * rng.standard_normal((3, tree.dof)) for _ in range(3))
    still = np.zeros_like(x)
    # What hangs on stiffness and damping is not the tree's.
    springs, expected = (
        model.inverse_dynamics(x, dx, a)
        - np.array([tree.torque(*row) for row in zip(x, dx, a, strict=True)])
        for a in (ddx, still)
    )
    np.testing.assert_allclose(springs, expected, atol=1e-8)


def test_hidden_tree_has_the_papers_coupling() -> None:
    """S_11 and S_23 are the constants of (8), and the mass matrix is that of inverse dynamics."""
    tree = KinematicTree(ROBOT)
    x = np.array([0.3, -0.5, 0.7, 0.3, -0.5, 0.7])
    M, _ = tree.terms(x, np.zeros(6))
    columns = [
        tree.torque(x, np.zeros(6), e) - tree.torque(x, np.zeros(6), np.zeros(6)) for e in np.eye(6)
    ]
    np.testing.assert_allclose(M, np.array(columns), atol=1e-9)
    assert M[0, 3] == pytest.approx(0.4356, rel=1e-6)
    assert M[1, 5] == pytest.approx(0.185, rel=0.01)


@pytest.mark.parametrize(
    "fault",
    [
        Fault(
            "payload",
            None,
            {"mass": 4.0, "position_x": 0.1, "position_y": -0.05, "position_z": 0.12},
        ),
        Fault("load", 1, {"mass": 4.0, "position_x": 0.1, "position_y": -0.05, "position_z": 0.12}),
        Fault("base_tilt", None, {"x": 0.05, "y": -0.08}),
        Fault("bearing_compliance", None, {"stiffness_scale": 0.5}),
        Fault("rotor_inertia_mismatch", 1, {"inertia": 1.3, "coupled": 0.0}),
        Fault("hysteresis", 2, {"torque": 5.0, "width": 1e-4}),
    ],
    ids=lambda fault: fault.effect,
)
def test_compiled_hidden_arm_moves_as_pinocchio_says(fault: Fault) -> None:
    """Joint and motor torques of a run are those that Pinocchio finds for its motion, to what
    sampling leaves."""
    arm = HiddenArm(ROBOT, [fault])
    # raises where the engines differ
    course = arm.run(random_motion(np.random.default_rng(8), 3, 2.0))
    assert np.isfinite(course.tau_J).all()
    wrong = HiddenArm(ROBOT, [fault])
    wrong.tree = KinematicTree(
        ROBOT.with_(gravity=(0.0, 0.0, -9.0)), bearings=fault.effect == "bearing_compliance"
    )
    with pytest.raises(Exception, match="differ from Pinocchio's"):
        wrong.run(random_motion(np.random.default_rng(8), 3, 2.0))


def test_an_arm_on_a_lifting_column_moves_as_pinocchio_says_and_the_project_derives() -> None:
    """A first axis that slides: three engines give one motion, and the column carries the arm's
    whole weight."""
    arm = industrial_arm(6, np.random.default_rng(4), lift=True)
    course = HiddenArm(arm).run(
        random_points(np.random.default_rng(5), 6, 3.0)
    )  # raises where the engines differ
    tree = KinematicTree(arm)
    model = build_model(arm)
    x = np.tile(course.q[1000], 2)
    still = np.zeros(12)
    parts = sum(
        c.mass
        for j in arm.joints
        if j.transmission
        for c, _ in j.transmission.components.values()
        if c
    )
    own = arm.joints[0].transmission
    carried = (
        sum(j.link.mass for j in arm.joints)
        + parts
        - sum(c.mass for c, _ in own.components.values())
    )
    assert tree.gravity(x)[0] == pytest.approx(9.81 * carried)
    np.testing.assert_allclose(
        model.inverse_dynamics(x[None], still[None], still[None])[0], tree.gravity(x), atol=1e-8
    )


def test_hidden_motion_does_not_depend_on_the_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twice as many integration steps change angles by less than 1e-9 rad."""
    from elastic_arm.studies.blind_challenge.hidden_arms import hidden_arm

    motion = random_motion(np.random.default_rng(2), 3, 1.5)
    coarse = HiddenArm(ROBOT).run(motion)
    monkeypatch.setattr(hidden_arm, "SUBSTEPS", 2 * hidden_arm.SUBSTEPS)
    fine = HiddenArm(ROBOT).run(motion)
    assert np.abs(coarse.q - fine.q).max() < 1e-9


def test_the_larger_set_of_equations_without_its_effects_is_the_smaller_one() -> None:
    """An arm with a spring of no stiffness moves as the plain one does."""
    motion = random_motion(np.random.default_rng(3), 3, 2.0)
    none = Fault("joint_spring", 1, {"stiffness": 0.0, "rest": 0.0})
    first = HiddenArm(ROBOT).run(motion)
    second = HiddenArm(ROBOT, [none]).run(motion)
    assert np.abs(first.q - second.q).max() < 1e-12


@pytest.mark.parametrize("effect", sorted(FOREIGN))
def test_an_effect_of_no_catalogue_changes_what_is_recorded(effect: str) -> None:
    """Each of the ten moves the arm, or its readings, by more than rounding, and Pinocchio confirms
    every run."""
    rng = np.random.default_rng(2)
    motion = random_motion(rng, 3, 4.0)
    plain = HiddenArm(ROBOT).run(motion)
    fault = sample_foreign(effect, 3, 4.0, rng)
    sized = sized_foreign(
        fault, FOREIGN_FLOORS[effect].amount, lambda: np.abs(plain.tau_m).max(axis=0)
    )
    arm = HiddenArm(ROBOT, [sized])
    sensors = RealisticSensors((0.0,) * 3, link_bits=40, motor_bits=40, jitter=0.0)
    read = [
        measure_realistically(
            course, ROBOT.joint_names, faults, sensors, np.ones(3), np.random.default_rng(0)
        )
        for course, faults in ((plain, ()), (arm.run(motion), arm.faults))
    ]
    changes = [
        np.abs(getattr(read[1], s).effort - getattr(read[0], s).effort).max()
        for s in ("link", "motor")
    ]
    assert max(changes) > 1e-3
    assert set(FLOORS) <= KNOWN and not set(FOREIGN) & set(EFFECTS)


def test_friction_by_direction_is_larger_one_way() -> None:
    """Of 10 Nm with an asymmetry of 0.3 the motor bears 13 Nm one way and 7 Nm the other."""
    faults = [
        Fault("coulomb_friction", 1, {"torque": 10.0}),
        Fault("asymmetric_friction", 1, {"asymmetry": 0.3}),
    ]
    motion = random_motion(np.random.default_rng(3), 3, 4.0)
    plain, course = (HiddenArm(ROBOT, some).run(motion) for some in ((), faults))
    moving = np.abs(course.dtheta[:, 1]) > 0.3
    added = (course.tau_m - plain.tau_m)[moving, 1]
    sign = course.dtheta[moving, 1] > 0.0
    assert np.median(added[sign]) == pytest.approx(13.0, rel=0.02)
    assert np.median(added[~sign]) == pytest.approx(-7.0, rel=0.02)


def test_a_compensated_torque_lacks_gravity_and_a_zero_moves_both_encoders() -> None:
    """At rest nothing is left of the motor's torque; a zero of 0.05 rad is read on both sides."""
    faults = [
        Fault("gravity_compensation", None, {"share": 1.0}, channels=("motor_torque",)),
        Fault("joint_zero", 1, {"offset": 0.05}),
    ]
    course = HiddenArm(ROBOT, faults).run(random_points(np.random.default_rng(1), 3, 3.0))
    exact = SensorModel(torque_noise=0.0, velocity_noise=0.0)
    read = measure(course, ROBOT.joint_names, faults, exact, np.random.default_rng(0))
    for side, true in ((read.link, course.q), (read.motor, course.theta)):
        np.testing.assert_allclose(side.position - true, [[0.0, 0.05, 0.0]] * len(true), atol=1e-12)
    assert np.abs(course.tau_m[:500]).max() > 50.0 and np.abs(read.motor.effort[:500]).max() < 0.5


def test_motion_from_point_to_point_dwells_and_keeps_its_limits() -> None:
    """Velocities and accelerations are the derivatives of the angles, within 1 rad/s and 3 rad/s²,
    and rest between."""
    motion = random_points(np.random.default_rng(1), 3, 20.0)
    t = np.linspace(0.0, 20.0, 20_001)
    q, dq, ddq = motion.evaluate(t)
    np.testing.assert_allclose(np.gradient(q, t, axis=0), dq, atol=1e-4)
    np.testing.assert_allclose(np.gradient(dq, t, axis=0)[2:-2], ddq[2:-2], atol=1e-3)
    assert np.abs(dq).max() <= 1.0 and np.abs(ddq).max() <= 3.0 and np.abs(q).max() <= 1.2
    assert len(motion.begins) > 5 and (np.abs(dq).max(axis=1) == 0.0).mean() > 0.2


def test_an_arm_read_from_its_urdf_moves_as_the_arm_does() -> None:
    """Base arms of six joints, on a lifting column and upside down too, keep mass matrix and
    gravity through a URDF."""
    for lift in (False, True):
        arm = mounted(
            industrial_arm(6, np.random.default_rng(4), lift=lift), np.random.default_rng(0)
        )
        x, dx, ddx = (0.3 * np.random.default_rng(5).standard_normal((3, 12)) for _ in range(3))
        torques = [
            KinematicTree(robot).torque(x[0], dx[1], ddx[2]) for robot in (arm, as_urdf(arm))
        ]
        np.testing.assert_allclose(torques[1], torques[0], atol=1e-6)


def test_a_strained_body_stays_one_and_gains_products_of_inertia() -> None:
    """The moments of a rod stretched along itself grow across it by twice the strain; shear makes a
    product."""
    rod = np.diag([0.0, 1.0, 1.0])
    along = np.zeros((3, 3))
    sheared = np.zeros((3, 3))
    along[0, 0] = 0.01
    sheared[1, 0] = 0.01
    assert strained(rod, along) == pytest.approx(np.diag([0.0, 1.0201, 1.0201]))
    assert strained(rod, sheared)[0, 1] == pytest.approx(-0.01)
    principal = np.sort(np.linalg.eigvalsh(strained(rod, along + sheared)))
    assert principal[0] > -1e-15 and principal[2] <= principal[0] + principal[1] + 1e-12


def test_zeros_of_torques_wander_about_their_offsets() -> None:
    """The mean of a channel's noise over a recording is that of white noise, however far its zero
    walks."""
    sensors = RealisticSensors((0.26,) * 3, drift=1.0)
    noise = _noise(sensors, 20_000, np.random.default_rng(2))
    assert np.all(np.abs(noise.mean(axis=0)) < 4.0 * 0.26 / np.sqrt(20_000))
    assert np.ptp(noise[:, 0].reshape(20, 1000).mean(axis=1)) > 0.1


@pytest.mark.parametrize("lost", [0.0, 0.05])
def test_sides_that_jitter_apart_are_sampled_where_their_stamps_say(lost: float) -> None:
    """The stamps of the two sides differ by some 28 µs, each angle is that of its own stamp, and a
    share is lost."""
    rng = np.random.default_rng(7)
    course = HiddenArm(ROBOT).run(random_motion(rng, 3, 3.0))
    sensors = RealisticSensors((0.0,) * 3, link_bits=40, motor_bits=40, apart=True, lost=lost)
    read = measure_realistically(course, ROBOT.joint_names, (), sensors, np.ones(3), rng)
    for side, true in ((read.link, course.q), (read.motor, course.theta)):
        t = (side.stamp_ns - 1_700_000_000_000_000_000) * 1e-9
        np.testing.assert_allclose(side.position, CubicSpline(course.t, true)(t), atol=1e-9)
        assert 1.0 - len(t) / len(course.t) == pytest.approx(lost, abs=0.02)
    if not lost:
        apart = (read.motor.stamp_ns - read.link.stamp_ns) * 1e-9
        assert np.std(apart) == pytest.approx(np.sqrt(2) * 2e-5, rel=0.1)


def test_realistic_sensors_leave_out_a_side_and_thin_out_samples() -> None:
    """At 100 Hz with the motor side alone no link is there, angles stand on the encoder's steps,
    torques are means.

    A mean is over the interval that is centred on its stamp: of ten samples, with half of the
    eleventh at either end.
    """
    rng = np.random.default_rng(6)
    course = HiddenArm(ROBOT).run(random_motion(rng, 3, 3.0))
    sensors = RealisticSensors((1e-9,) * 3, rate=100.0, sides=MOTOR, jitter=0.0)
    read = measure_realistically(course, ROBOT.joint_names, (), sensors, np.full(3, 100.0), rng)
    assert read.link is None and read.motor is not None
    turns = read.motor.position / (2 * np.pi / 2**13 / 100.0)
    assert np.abs(turns - np.round(turns)).max() < 1e-6
    assert np.median(np.diff(read.motor.stamp_ns)) == 10_000_000
    inner = course.tau_m[36:45].sum(axis=0)
    ends = course.tau_m[[35, 45]].mean(axis=0)
    np.testing.assert_allclose(read.motor.effort[3], (inner + ends) / 10.0, atol=1e-6)
