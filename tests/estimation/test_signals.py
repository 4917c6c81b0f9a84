"""What the arguments of laws share with those of the same motion with other torques."""

from dataclasses import replace

import numpy as np

from elastic_arm.dynamics import build_model
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.equation_sets import EquationSet
from elastic_arm.estimation.motion import CompletedMotion
from elastic_arm.estimation.observation import observe
from elastic_arm.estimation.regressors import INPUTS, SIGNS, Signals
from elastic_arm.estimation.residuals import residuals
from elastic_arm.sensors import Sensors
from tests.helpers.gap_recordings import ROBOT, motions, record

STILL = np.full(ROBOT.n, 0.01), np.full(ROBOT.n, 0.02)  # rad/s


def moved() -> CompletedMotion:
    """Return a motion of the arm with both encoders."""
    seen = observe(record(motions()[0], sensors=Sensors.real()))
    model = build_model(ROBOT, "mod3")
    layout = EquationSet.direct(("theta", "tau_m"), model.n)
    return residuals(model, seen, layout, Band(5.0, seen.rate))[0].quiet


def test_other_torques_are_those_of_the_motion_with_them() -> None:
    """Rates are made anew, and all else stays."""
    motion = moved()
    load, drive = 2.0 * motion.tau_J, 3.0 * motion.tau_m
    expected = Signals.of(replace(motion, tau_J=load, tau_m=drive), STILL)
    found = Signals.of(motion, STILL).with_torques(load, drive)
    for name, one, other in zip(INPUTS, found.arrays, expected.arrays, strict=True):
        np.testing.assert_array_equal(one, other, err_msg=name)


def test_signs_are_taken_over_from_the_same_motion_alone() -> None:
    """Another speed or standstill has signs of its own."""
    motion = moved()
    first = Signals.of(motion, STILL)
    alike = Signals.of(motion, STILL, near=first)
    assert all(alike.values[name] is first.values[name] for name in SIGNS)
    faster = replace(motion, dq=2.0 * motion.dq)
    for other, still in ((faster, STILL), (motion, (STILL[1], STILL[0]))):
        expected = Signals.of(other, still).values["sign_link"]
        found = Signals.of(other, still, near=first).values["sign_link"]
        np.testing.assert_array_equal(found, expected)
        assert not np.array_equal(found, first.values["sign_link"])
