"""Steps of the calibration: the same point with other priors, and lags whose columns are noisy."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from elastic_arm.diagnosis import Question
from elastic_arm.diagnosis.calibration.calibrate import FittedExpansion
from elastic_arm.diagnosis.calibration.expansion import Expansion, expand
from elastic_arm.diagnosis.preparation import PreparedData, prepare
from elastic_arm.effects.text import known_effects
from elastic_arm.sensors import Encoder, Sensors, TorqueSensor
from tests.helpers.gap_recordings import ROBOT, motions, record

WIDTH = 30.0


@lru_cache(maxsize=1)
def prepared() -> PreparedData:
    """An arm with encoders of 19 bits and dry friction, all motor torques of which are late."""
    encoder = Encoder(resolution=2 * np.pi / 2**19)
    sensors = Sensors(encoder, encoder, motor_torque=TorqueSensor(delay=1e-3))
    friction = known_effects(("coulomb_friction", "viscous_friction"), ROBOT)
    first, second = (
        record(motion, "coulomb_friction:joint_2:torque=8,side=motor", seed=k, sensors=sensors)
        for k, motion in enumerate(motions())
    )
    return prepare([first], [second], Question(ROBOT, refit=True, given=friction))


def test_wider_priors_scale_the_columns_of_an_expansion() -> None:
    """Residuals and derivatives are those of an expansion made anew with wider priors at the same point."""
    problem, found = prepared().calibration, prepared().found.expansion
    factors = np.where([p.what in ("link_mass", "joint_torque_gain") for p in problem.parameters], WIDTH, 1.0)
    pairs = zip(problem.parameters, factors, strict=True)
    parameters = tuple(p if factor == 1.0 else p.of_fault(WIDTH) for p, factor in pairs)
    wide = replace(problem, parameters=parameters, directions=problem.directions * factors)
    at, again = found.widened(factors), expand(wide, found.values / factors, None, found.acting)
    assert at.nuisance is not None and again.nuisance is not None
    np.testing.assert_allclose(at.values, again.values)
    np.testing.assert_allclose(at.data[0].white, again.data[0].white, atol=1e-9)
    # Derivatives are kept where a step moves little: by so much they may differ.
    lengths = np.linalg.norm(again.nuisance.white[0], axis=0)
    apart = np.linalg.norm(at.nuisance.white[0] - again.nuisance.white[0], axis=0)
    assert np.max(apart / np.maximum(lengths, 1e-9)) < 2.0 * problem.settings.refit.same_torques
    np.testing.assert_allclose(at.nuisance.limits, again.nuisance.limits)
    np.testing.assert_allclose(at.nuisance.centre, again.nuisance.centre)


def fitted(found: Expansion, step: np.ndarray) -> FittedExpansion:
    return FittedExpansion(found, 1.0, step, 1.0, (), ())


def test_steps_of_lags_that_go_a_part_of_the_way_are_lengthened_by_the_secant() -> None:
    """Where each step goes 0.6 of the way, two of them tell the whole; other numbers, and longer steps, are kept."""
    problem, found = prepared().calibration, prepared().found.expansion
    count, share = len(problem.parameters), 0.6
    lags = np.array([p.is_lag for p in problem.parameters])
    end = np.linspace(1.0, 2.0, count)
    first = replace(found, values=np.zeros(count))
    second = replace(found, values=share * end)
    before, now = fitted(first, share * end), fitted(second, share * (1.0 - share) * end)
    step = now.step_beyond(before, problem)
    np.testing.assert_allclose(step[lags], (1.0 - share) * end[lags])
    np.testing.assert_allclose(step[~lags], now.step[~lags])
    # A step that is nearly as long as the one before says nothing of where they end.
    again = fitted(second, 0.9 * before.step)
    np.testing.assert_array_equal(again.step_beyond(before, problem), again.step)
