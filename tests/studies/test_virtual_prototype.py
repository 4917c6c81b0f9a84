"""The virtual prototype: an engine that nobody here wrote, against mod3, against itself, and
against its limits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.errors import RobotError, SimulationError
from elastic_arm.robot import Robot, load_robot
from elastic_arm.studies.paper.torques import model_torques
from elastic_arm.studies.paper.virtual_prototype.mechanism import Bushing, build_spec
from elastic_arm.studies.paper.virtual_prototype.motions import QUINTIC, StepRamp
from elastic_arm.studies.paper.virtual_prototype.prototype import Prototype
from elastic_arm.studies.paper.virtual_prototype.rotations import chain, link_coordinates

POSE = np.array([0.4, -0.6, 0.9])


@pytest.fixture(scope="module")
def robot() -> Robot:
    """The nominal arm at the paper's highest ratio."""
    return load_robot(None).with_ratio(363)


def short_ramp(start: np.ndarray, **changes: object) -> StepRamp:
    """A ramp of a quarter of a second, to spare time."""
    return StepRamp(start, rise=0.25, hold=0.05, **changes)  # type: ignore[arg-type]


def test_every_component_is_a_body_and_the_masses_sum_to_the_papers(robot: Robot) -> None:
    """Three links, rotors, wave generators and splines weigh 139 kg with the base."""
    model = build_spec(robot, Bushing()).compile()
    assert model.nbody - 1 == 4 * robot.n
    assert model.body_mass.sum() + robot.base_mass == pytest.approx(139.0)


@pytest.mark.parametrize("joints", [2, 3])
def test_mod3_meets_the_prototype_when_the_bushing_is_locked(robot: Robot, joints: int) -> None:
    """With locked tilts and translations, engine and mod3 give one tau_m, and mod3's first row is
    in equilibrium."""
    arm = robot.with_(joints=robot.joints[:joints])
    run = Prototype(arm, Bushing(locked=True)).follow(short_ramp(POSE[:joints]), step=1e-3)
    torques = model_torques(build_model(arm, "mod3"), run)
    size = np.abs(run.tau_m).max()
    assert np.abs(torques.motor - run.tau_m).max() < 1e-9 * size
    assert np.abs(torques.link).max() < 1e-9 * size


def test_mod1_and_mod2_do_not_meet_it(robot: Robot) -> None:
    """The same comparison tells models that lack S from the engine: the test above could fail."""
    run = Prototype(robot, Bushing(locked=True)).follow(short_ramp(POSE), step=1e-3)
    for name in ("mod1", "mod2"):
        assert np.abs(model_torques(build_model(robot, name), run).motor - run.tau_m).max() > 0.1


def test_bearing_tilts_in_the_model_explain_what_the_bushing_does(robot: Robot) -> None:
    """mod3 with bearings, given the tilts, leaves a tenth or less of tau_l: the rest are the
    bushing's translations."""
    run = Prototype(robot).follow(short_ramp(POSE, shape=QUINTIC), step=2e-4)
    locked = model_torques(build_model(robot, "mod3"), run)
    tilting = model_torques(build_model(robot, "mod3", bearings=True), run)
    assert np.abs(tilting.link).max() < 0.1 * np.abs(locked.link).max()


def test_tau_l_of_mod3_falls_as_the_bushing_grows_stiff(robot: Robot) -> None:
    """Nine times the stiffness leaves less than a third of the link-side residual, on a ramp
    without jumps."""
    left = []
    for scale, step in ((1.0, 2e-4), (9.0, 6e-5)):
        run = Prototype(robot, Bushing(bearing_scale=scale)).follow(
            short_ramp(POSE, shape=QUINTIC), step=step
        )
        left.append(np.abs(model_torques(build_model(robot, "mod3"), run).link).max())
    assert left[1] < left[0] / 3.0


def test_halving_the_step_shrinks_the_error_as_a_fourth_order_method_does(robot: Robot) -> None:
    """By at least eight times, on a smooth motion."""
    prototype = Prototype(robot)
    motion = short_ramp(POSE, shape=QUINTIC)
    fine, half, whole = (prototype.follow(motion, step=step).tau_m for step in (5e-5, 1e-4, 2e-4))
    assert np.abs(whole - fine).max() > 8.0 * np.abs(half - fine).max()


def test_in_equilibrium_nothing_moves(robot: Robot) -> None:
    """With the holding torque applied to the motors the whole arm stays where it is."""
    prototype = Prototype(robot)
    still = np.zeros(robot.n)
    y = np.concatenate([POSE, prototype.equilibrium(POSE)])
    holding = prototype.reduced(y, np.zeros_like(y)).force[: robot.n]
    run = prototype.actuate(lambda half, theta, dtheta: holding, (POSE, still), 0.05, step=2e-4)
    assert np.abs(run.theta - POSE).max() < 1e-9
    assert np.abs(run.ddq).max() < 1e-6


def test_torques_read_under_an_imposed_motion_bring_that_motion_about(robot: Robot) -> None:
    """The inverse of the forward prototype: its own tau_m, applied, gives back theta."""
    prototype = Prototype(robot)
    motion = short_ramp(POSE, shape=QUINTIC)
    step = 2.5e-4
    imposed = prototype.follow(motion, step=step, rate=2.0 / step)  # a sample at every half step
    run = prototype.actuate(
        lambda half, theta, dtheta: imposed.tau_m[half], (POSE, np.zeros(3)), 0.25, step=step
    )
    at = np.rint(run.t * 2.0 / step).astype(int)
    assert np.abs(run.theta - imposed.theta[at]).max() < 1e-6


def test_link_angles_are_converted_exactly_with_their_rates() -> None:
    """The paper's tilts-first angles give the chain's rotation, angular velocity and
    acceleration."""
    rng = np.random.default_rng(3)
    theta = [rng.standard_normal(20) for _ in range(3)]
    bushing = [0.3 * rng.standard_normal((20, 3)) for _ in range(3)]
    y, x, z = np.eye(3)[[1, 0, 2]]
    hinges = [np.column_stack([turn, rest]) for turn, rest in zip(theta, bushing, strict=True)]
    expected = chain((z, y, x, z), *hinges)
    found = chain((y, x, z), *link_coordinates(theta, bushing))
    for ours, theirs in zip(found[:3], expected[:3], strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_too_large_a_step_is_refused_and_a_stable_one_is_known(
    robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A step beyond the bushing's reach is a clear error and leaves no file; the step that is
    proposed works."""
    monkeypatch.chdir(tmp_path)
    prototype = Prototype(robot)
    with pytest.raises(SimulationError, match="smaller step"), np.errstate(all="ignore"):
        prototype.follow(short_ramp(POSE), step=1e-3)
    assert not list(tmp_path.iterdir())
    run = prototype.follow(short_ramp(POSE), step=prototype.stable_step())
    assert np.isfinite(run.tau_m).all()


def test_an_arm_that_lacks_bearings_or_transmissions_is_refused_by_joint(robot: Robot) -> None:
    """The error names the joint and what to add; a plain arm has no rotors to drive."""
    arm = robot.with_joint(
        "joint_2", transmission=replace(robot.joints[1].transmission, bearing=None)
    )
    with pytest.raises(RobotError, match=r"joint_2 .*no bearing.*bearing: \{stiffness"):
        Prototype(arm)
    bare = robot.with_(joints=tuple(replace(joint, transmission=None) for joint in robot.joints))
    with pytest.raises(RobotError, match=r"joint_1 .* has no transmission"):
        Prototype(bare)
