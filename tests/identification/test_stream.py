"""The stream: the batch's result however samples are cut, saved and taken up again."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from elastic_arm.dynamics import Model, build_model
from elastic_arm.estimation.resampling import part
from elastic_arm.estimation.smoother import Smoother
from elastic_arm.excitation import FourierTrajectory
from elastic_arm.identification import Identifier, identifier_of
from elastic_arm.identification.least_squares import Fit
from elastic_arm.recording import Samples
from elastic_arm.robot import load_robot
from elastic_arm.sensors import Encoder, Sensors, TorqueSensor
from elastic_arm.simulation import SimulationSettings, Simulator
from examples.known_arm import chi_square
from tests.helpers.periodic_arm import RATE, record

SECONDS = 8
LOST = np.r_[1000:1002, 3000:3001, 4000:4300, 6500:6504]


@cache
def model() -> Model:
    return build_model(load_robot(None), "mod3")


@cache
def samples(kind: str) -> Samples:
    """Return a recording with holes and a gap, its samples taken regularly or at jittered
    stamps."""
    rng = np.random.default_rng(0)
    whole = record(
        model(), rng, period=float(SECONDS), periods=1, encoder_noise=1e-6, velocity_noise=1e-4
    )
    if kind == "irregular":
        t = np.sort(whole.t + 1e-4 * rng.standard_normal(len(whole)))
        moved = {
            name: CubicSpline(whole.t, getattr(whole, name))(t)
            for name in ("q", "dq", "theta", "dtheta")
        }
        whole = replace(whole, t=t, stamp_ns=np.rint(t * 1e9).astype(np.int64), **moved)
    return part(whole, np.setdiff1d(np.arange(len(whole)), LOST))


def identifier() -> Identifier:
    crossover = np.full(3, 2 * np.pi * 16.0)
    return Identifier(model(), smoother=Smoother(RATE, 2 * np.pi * 30.0, crossover, crossover))


def fed(kind: str, cuts: list[int]) -> tuple[Identifier, Fit]:
    found = identifier()
    for piece in np.split(np.arange(len(samples(kind))), cuts):
        found.add(part(samples(kind), piece))
    found.finish()
    return found, found.fit()


@cache
def batch(kind: str) -> tuple[Identifier, Fit]:
    return fed(kind, [])


@pytest.mark.parametrize(("kind", "mode"), [("regular", "regular"), ("irregular", "stamps")])
@settings(max_examples=8, deadline=None)
@given(
    cuts=st.lists(st.integers(1, SECONDS * 1000 - len(LOST) - 1), max_size=60, unique=True).map(
        sorted
    )
)
def test_any_cut_of_the_samples_gives_the_result_of_the_batch(
    kind: str, mode: str, cuts: list[int]
) -> None:
    """Estimates agree to 1e-6 std, with regular and irregular stamps, wherever holes and gaps meet
    a cut."""
    whole, expected = batch(kind)
    stream, found = fed(kind, cuts)
    assert stream.clock.mode == mode
    assert stream.progress == whole.progress
    assert np.abs((found.Psi - expected.Psi) / expected.std).max() < 1e-6
    assert found.std == pytest.approx(expected.std, rel=1e-5)
    assert stream.statistics.seconds == pytest.approx(whole.statistics.seconds)


@pytest.mark.parametrize("standing", [0.0, 1.0, 2.3, 20.0])
def test_an_arm_that_stands_first_is_identified_within_the_deviations(standing: float) -> None:
    """However long the arm stands before it moves, the smoother is chosen by the motion, and the
    deviations hold.

    A smoother chosen from the transition between the two is too wide: motion under a drive that
    holds its command from sample to sample then biases the estimate by four deviations.
    """
    robot = load_robot(None)
    rng = np.random.default_rng(5)
    a, b = (rng.normal(0.0, 0.3, (3, 5)) for _ in range(2))
    trajectory = FourierTrajectory(2 * np.pi / 5.0, a, b, np.zeros(3), 10.0, 0.5, robot.joint_names)
    reference = trajectory.evaluate(np.arange(-standing, 10.0, 1 / RATE).clip(0.0))
    torque = TorqueSensor(noise=0.26)
    encoder = Encoder(noise=0.0, velocity_noise=0.0)
    sensors = Sensors(encoder, encoder, torque, torque)
    simulator = Simulator(
        robot,
        SimulationSettings(sensors=sensors, rate=RATE),
        rng=np.random.default_rng(3),
        q0=reference[0][0],
    )
    _, measured = simulator.follow(*reference)
    stream = identifier_of(robot)
    stamps = np.arange(len(reference[0])) * round(1e9 / RATE)
    stream.add(Samples(stamp_ns=stamps, t=stamps * 1e-9, **measured))
    stream.finish()
    estimate = stream.estimate()
    true = np.array([e.nominal for e in estimate.estimates])
    assert np.sqrt(chi_square(estimate, true) / len(true)) < 1.5
