"""Descriptions that are nearly right, diagnosed without `--refit`, on the challenge's engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.diagnosis import Diagnosis, Priors, Question, diagnose
from elastic_arm.effects import Catalogue
from elastic_arm.effects.text import known_effects
from elastic_arm.equations.robot_at import nearest_robot
from elastic_arm.evidence.numbers import numbers_of
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from tests.helpers.realistic_arms import ordinary_faults, record

ROBOT = load_robot()
FRICTION = known_effects(("coulomb_friction", "viscous_friction"), ROBOT)
# Masses within 2 %, centres of mass within 2 mm, stiffness within 3 %.
OFF = Priors(
    mass=0.015,
    centre_of_mass=0.0015,
    inertia=0.02,
    product_of_inertia=0.01,
    rotor=0.015,
    stiffness=0.02,
    damping=0.06,
)
NUMBERS = numbers_of(ROBOT, (), 1000.0, OFF, (), np.full(ROBOT.n, 100.0), None, ("link", "drive", "motor"))


def commissioned(seed: int, faults: Sequence[Fault] = ()) -> Diagnosis:
    """Diagnose an arm whose numbers are all a little off, with ordinary sensors and known friction."""
    rng = np.random.default_rng(seed)
    true = nearest_robot(ROBOT, NUMBERS, rng.uniform(-1.4, 1.4, len(NUMBERS)))
    first, judge = record(true, [*ordinary_faults(ROBOT.n, rng), *faults], (16.0, 8.0), rng)
    return diagnose([first], Question(ROBOT, given=FRICTION), [judge])


@pytest.mark.slow(30)
def test_what_is_a_little_off_is_no_cause_without_a_refit_either() -> None:
    """Torque sensors off by half a Nm and masses by 2 % are imperfections with their sizes, none is a cause."""
    found = commissioned(1)
    assert found.verdict == "none" and not found.causes
    rng = np.random.default_rng(1)
    rng.uniform(-1.4, 1.4, len(NUMBERS))
    listed = {(one.what, one.joint): one for one in found.imperfections}
    for fault in ordinary_faults(ROBOT.n, rng):
        if fault.effect.endswith("offset"):
            one = listed[fault.effect, ROBOT.joint_names[int(fault.joint or 0)]]
            assert one.ordinary and abs(one.value - fault.parameters["offset"]) < 4.0 * one.std


@pytest.mark.slow(60)
def test_one_thing_more_is_named_alone() -> None:
    """Hysteresis of 5 Nm in arms that are a little off everywhere is the one cause, at its size by its deviations."""
    deviations = []
    for seed in (3, 11):
        hysteresis = replace(Fault("hysteresis", 1, {"torque": 5.0, "width": 2e-4}), side="motor")
        (cause,) = commissioned(seed, [hysteresis]).causes
        assert (cause.effect, cause.joint) == ("hysteresis", "joint_2")
        for name, true in (("torque", 5.0), ("width", 2e-4)):
            estimate = cause.parameters[name]
            assert estimate.std is not None and estimate.std < 0.02 * true
            deviations.append((estimate.value - true) / estimate.std)
    assert np.sqrt(np.mean(np.square(deviations))) < 2.0


@pytest.mark.slow(15)
def test_an_effect_of_an_arm_as_described_is_no_ordinary_imperfection() -> None:
    """A torque sensor's gain of 0.975 that the catalogue lacks is `unknown` where nothing else is off."""
    gain = Fault("joint_torque_gain", 0, {"gain": 0.975})
    first, judge = record(ROBOT, [gain], (16.0, 8.0), np.random.default_rng(6))
    catalogue = Catalogue.default().withholding("joint_torque_gain")
    assert diagnose([first], Question(ROBOT, catalogue=catalogue), [judge]).verdict == "unknown"
