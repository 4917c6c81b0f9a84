"""Recorded commands played by MuJoCo's own servos: a true model moves as recorded from wherever a
recording begins."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.mujoco.closed_loop import play
from elastic_arm.robot.mjcf import MjcfArm
from tests.helpers.servo_arms import recorded, servo_arm

FORMS = [f'joint="{name}" forcerange="-4 4"' for name in ("pan", "lift", "elbow")]
LATE = {form: f'{form} delay="0.0213" nsample="24"' for form in FORMS}
WHOLE = {form: f'{form} delay="0.02" nsample="22"' for form in FORMS}
# an integral beside a limit would rest
TENDER = {form: form.replace("4 4", "30 30") for form in FORMS}


def integrating(arm: MjcfArm) -> MjcfArm:
    """Return an arm whose lift has an integral beside its actuator."""
    drive = arm.robot.joints[1].controller
    assert drive is not None
    return replace(arm, robot=arm.robot.with_joint("lift", controller=replace(drive, ki=20.0)))


def error(arm: MjcfArm, true: MjcfArm, rate: float, begin: float) -> float:
    """Return the largest of the joints' errors, rad, on a recording of the true arm that begins in
    mid-motion."""
    run = recorded(true, rate, 17, seconds=12.0)
    found = play(arm, run.between(begin, run.duration))
    assert found is not None and len(found.t) > 0.5 * rate * (run.duration - begin)
    return float(np.sqrt(np.mean(found.errors**2, axis=0)).max())


@pytest.mark.parametrize("begin", [0.0, 3.37])
@pytest.mark.parametrize(
    "changes", [{}, LATE, WHOLE], ids=["prompt", "late", "late by whole steps"]
)
@pytest.mark.parametrize("rate", [50.0, 250.0])
def test_a_true_model_moves_as_recorded(
    changes: Mapping[str, str], begin: float, rate: float
) -> None:
    """From rest and in mid-motion, with commands on their way or without: within 0.2 mrad, at 50 Hz
    0.5."""
    true = servo_arm(changes)
    assert error(true, true, rate, begin) < (2e-4 if rate > 100.0 else 5e-4)


@pytest.mark.parametrize("integrator", ["RK4", "Euler", "implicitfast"])
def test_a_simulation_that_stamps_commands_and_angles_alike_is_played_as_it_was(
    integrator: str,
) -> None:
    """Each command acts from the time step on that begins at its stamp: within 0.1 mrad, where a
    step of 1 ms is 2 mrad."""
    true = servo_arm({'integrator="RK4"': f'integrator="{integrator}"'})
    run = recorded(true, 250.0, 17)
    assert run.link is not None and run.reference is not None
    alike = replace(run, link=replace(run.link, stamp_ns=run.reference.stamp_ns))
    for one in (run, alike):
        found = play(true, one.between(3.37, one.duration))
        assert found is not None
        assert np.sqrt(np.mean(found.errors**2, axis=0)).max() < 1e-4


@pytest.mark.parametrize("begin", [0.0, 3.37])
def test_an_integral_begins_as_it_was(begin: float) -> None:
    """What the integral of a controller held when the recording began is found: within 0.3 mrad at
    every joint."""
    true = integrating(servo_arm(TENDER))
    assert error(true, true, 250.0, begin) < 3e-4


def test_a_model_without_the_delay_errs_by_it() -> None:
    """The recording of late servos is 5 mrad off and more by prompt ones: what is played does
    depend on the delay."""
    assert error(servo_arm(), servo_arm(LATE), 250.0, 3.37) > 5e-3


def test_a_part_is_played_with_the_commands_before_it() -> None:
    """The last third of a whole recording starts from what is recorded there, late commands
    included."""
    true = servo_arm(LATE)
    run = recorded(true, 250.0, 17, seconds=12.0)
    found = play(true, run, span=(8.0, 12.0))
    assert found is not None
    assert found.t[0] == pytest.approx(8.0, abs=0.01)
    assert np.sqrt(np.mean(found.errors**2, axis=0)).max() < 2e-4


def test_without_commands_or_servos_nothing_is_played() -> None:
    """A recording without a reference, and a model of motors, are none that follows commands."""
    arm = servo_arm()
    run = recorded(arm, 50.0, 12)
    assert play(arm, replace(run, reference=None)) is None
