"""Residuals: zero where the model holds, and what is added where it does not."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.equation_sets import EquationSet
from elastic_arm.estimation.motion import CompletedMotion, Motion, completed
from elastic_arm.estimation.observation import Observation, observe, widest_band
from elastic_arm.estimation.residuals import motion_noise, raw_residuals, residuals
from elastic_arm.robot import load_robot
from elastic_arm.sensors import Encoder, Sensors
from tests.helpers.gap_recordings import motions, record
from tests.helpers.smooth_motion import smooth_motion

ROBOT = load_robot(None)
MODEL = build_model(ROBOT, "mod3")
ENCODER = Encoder(noise=1e-4)
N = MODEL.n


def motion() -> CompletedMotion:
    return completed(smooth_motion(MODEL, samples=200), MODEL)


def _coordinates(whole: CompletedMotion) -> list[tuple[np.ndarray, np.ndarray]]:
    return [(whole.q, whole.theta), (whole.dq, whole.dtheta), (whole.ddq, whole.ddtheta)]


@cache
def observation() -> Observation:
    return observe(record(motions()[0], sensors=Sensors.exact()))


def setting(seen: Observation) -> tuple[EquationSet, Band]:
    return EquationSet.direct(seen.pieces[0].recorded, N), Band(widest_band(seen.rate), seen.rate)


def test_residuals_are_what_the_equations_of_motion_leave() -> None:
    """Of any motion with a spring's joint torque, drive and motor rows are zero, the link's is the
    left side of (1)."""
    whole = motion()
    left = MODEL.inverse_dynamics(*(np.hstack(pair) for pair in _coordinates(whole)))
    found = raw_residuals(MODEL, whole)
    np.testing.assert_allclose(found[:, :N], -left[:, :N], atol=1e-6)
    np.testing.assert_allclose(found[:, N:], 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("channel", "signs"),
    # A joint torque pulls the link and brakes the motor; the drive's equation compares it with the
    # spring.
    [("tau_m", (0.0, 0.0, 1.0)), ("tau_J", (1.0, 1.0, -1.0))],
)
def test_a_torque_beyond_the_model_appears_in_its_equations(
    channel: str, signs: tuple[float, ...]
) -> None:
    """What a sensor shows too much stands in the link, drive and motor residual with the sign of
    that equation."""
    exact, added = motion(), np.random.default_rng(0).normal(size=(200, N))
    changed: dict[str, Any] = {channel: getattr(exact, channel) + added}
    found = raw_residuals(MODEL, replace(exact, **changed)) - raw_residuals(MODEL, exact)
    np.testing.assert_allclose(found, np.hstack([sign * added for sign in signs]), atol=1e-6)


def test_an_arm_without_transmissions_has_no_drive_residual() -> None:
    """Joint and motor torque are compared with one another, the joint torque with the rigid arm."""
    joints = tuple(replace(joint, transmission=None) for joint in ROBOT.joints)
    rigid = build_model(ROBOT.with_(joints=joints), "mod1")
    whole = smooth_motion(MODEL, samples=50)
    left = rigid.inverse_dynamics(whole.q, whole.dq, whole.ddq)
    found = raw_residuals(
        rigid, CompletedMotion(**{**whole.channels(), "tau_J": left + 2.0, "tau_m": left + 5.0})
    )
    np.testing.assert_allclose(
        found, np.hstack([np.full_like(left, v) for v in (2.0, 0.0, 3.0)]), atol=1e-9
    )


def test_the_ends_of_a_stretch_are_dropped_and_its_rows_lie_at_the_kept_rate() -> None:
    """Residuals begin and end a margin inside of the motion that they are made of."""
    seen = observation()
    equations, band = setting(seen)
    (stretch,) = residuals(MODEL, seen, equations, band)
    assert (
        stretch.t[0] >= stretch.motion.t[0] + seen.margin
        and stretch.t[-1] <= stretch.motion.t[-1] - seen.margin
    )
    np.testing.assert_allclose(np.diff(stretch.t), 1.0 / band.kept_rate, rtol=1e-6)
    assert stretch.values.shape == (len(stretch.t), equations.rows)


def test_a_clean_arm_with_exact_sensors_leaves_a_thousandth_of_its_torques() -> None:
    """What differentiation and the band leave of a motion without noise is small against the
    torques."""
    seen = observation()
    (stretch,) = residuals(MODEL, seen, *setting(seen))
    assert np.sqrt(np.mean(stretch.values**2)) < 1e-3 * np.sqrt(
        np.mean(np.asarray(stretch.motion.tau_m) ** 2)
    )


def test_a_stretch_shorter_than_a_second_is_left_out() -> None:
    """Nothing is made of a piece that the margins leave less than a second of."""
    seen = observation()
    (piece,) = seen.pieces
    short: Motion = piece[: int(seen.rate * (2 * seen.margin + 0.9))]
    assert residuals(MODEL, replace(seen, pieces=(short,), quiet=(short,)), *setting(seen)) == []


def test_an_arm_that_is_compared_makes_the_noise_of_the_described_one() -> None:
    """Half the inertia makes half the noise of accelerations. Compared with the described arm, the
    noise of the encoders remains."""
    exact = observation()
    noisy = observe(record(motions()[0], sensors=replace(Sensors.exact(), link_encoder=ENCODER)))
    light = MODEL.at(0.5 * MODEL.Psi)
    layout, band = setting(exact)
    powers = []
    for arm, is_compared in ((MODEL, False), (light, False), (light, True)):
        both = []
        for seen in (exact, noisy):
            noise = motion_noise(MODEL, seen) if is_compared else None
            both += residuals(arm, seen, layout, band, noise=noise)
        length = min(len(one.t) for one in both)
        noise = both[1].values[-length:, :N] - both[0].values[-length:, :N]
        powers.append(np.sum(noise**2))
    own, alone, compared = powers
    assert alone < 0.5 * own
    assert compared == pytest.approx(own, rel=0.1)
