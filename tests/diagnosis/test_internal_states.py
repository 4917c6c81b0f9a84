"""Internal states of effects run through a recording that is cut in two, and begin where the
recording says."""

import numpy as np
import pytest

from elastic_arm.diagnosis import Question
from elastic_arm.diagnosis.preparation import prepare
from elastic_arm.effects import EFFECTS, parse
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.equations.places import feature_of
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.problem import ALL, FITTED, JUDGING
from elastic_arm.excitation import FourierTrajectory
from elastic_arm.recording import Recording
from elastic_arm.robot import load_robot
from elastic_arm.simulation import SimulationSettings
from elastic_arm.simulation.rollout import simulate

ROBOT = load_robot(None)
HYSTERESIS = "hysteresis:joint_2:torque=12,width=3e-4"
STRIBECK = "stribeck_friction:joint_2:torque=5,speed=0.1"


def recording(seconds: float = 12.0, skipped: float = 0.0) -> Recording:
    """An arm with hysteresis, from some time after its start on."""
    a, b = np.random.default_rng(3).uniform(-0.25, 0.25, (2, 3, 3))
    motion = FourierTrajectory(2 * np.pi / 7.0, a, b, np.array([0.0, 0.4, 0.5]), seconds, 1.0)
    whole = simulate(
        ROBOT,
        motion,
        SimulationSettings(effects=[parse(HYSTERESIS, ROBOT)], rate=500.0),
        rng=np.random.default_rng(0),
    )
    return whole.between(skipped, seconds + 1.0)


def linearised(found: Recording, which: int = FITTED) -> Linearisation:
    """Return a part of a recording beside the description."""
    problem = prepare([found], [], Question(ROBOT, effects=(EFFECTS["hysteresis"],))).problem
    return Linearisation(problem, np.zeros(len(problem.numbers)), (), which)


def left(found: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Drive residual of joint 2 over its noise that the true effect leaves, in the fitted and in
    the judging part."""
    feature = feature_of(parse(HYSTERESIS, ROBOT), ArmEquations(ROBOT)).whole()
    rows = []
    for which in (FITTED, JUDGING):
        data = linearised(found, which).data
        (y,), (columns,) = data.y, data.plain(feature, (12.0, 3e-4))
        rows.append((y - columns[:, :, 0])[:, 4] / y[:, 4].std() * 12.0)
    return rows[0], rows[1]


def test_columns_at_several_numbers_are_those_at_each() -> None:
    """Columns that are made side by side are those that are made one by one, those of a law of the
    motion alone also where some are known already."""
    linear = linearised(recording())
    hysteresis = feature_of(parse(HYSTERESIS, ROBOT), ArmEquations(ROBOT)).whole()
    friction = feature_of(parse(STRIBECK, ROBOT), ArmEquations(ROBOT))
    for feature, points in (
        (hysteresis, [(12.0, 3e-4), (6.0, 2e-4)]),
        (friction, [(0.1,), (0.2,), (0.3,)]),
    ):
        each = [linear.data.plain(feature, point)[0] for point in points[:2]]
        each += [linearised(recording()).data.plain(feature, point)[0] for point in points[2:]]
        (together,) = linear.data.plain_at(feature, points)
        scale = float(np.abs(together).max())
        np.testing.assert_allclose(together, np.concatenate(each, axis=2), atol=1e-12 * scale)


def test_a_part_of_a_linearisation_is_what_it_is_alone() -> None:
    """What the judging recordings take of the motion from all of them changes nothing."""
    whole = linearised(recording(), ALL)
    own = linearised(recording(), JUDGING)
    for part in (whole.judging, whole.anew().judging):
        np.testing.assert_allclose(part.data.white, own.data.white, atol=1e-9)
        plain = zip(part.plain_numbers, own.plain_numbers, strict=True)
        for taken, made in plain:
            np.testing.assert_allclose(taken, made, atol=1e-9 * np.abs(made).max())


def test_states_go_on_across_the_cut() -> None:
    """The last third of a recording begins with the states that the first two thirds end with."""
    _, judged = left(recording())
    assert np.abs(judged[:100]).max() < 1.2 * np.abs(judged[100:]).max()


def test_the_start_of_a_recording_is_estimated() -> None:
    """A recording that begins in the middle of a motion is explained from its first second on."""
    fitted, _ = left(recording(skipped=1.3))
    assert np.abs(fitted[:100]).max() < 1.3 * np.abs(fitted[100:]).max()


def test_the_second_part_knows_the_whole_recording() -> None:
    """The judging part holds the motion before it, and where it lies in the recording."""
    prepared = prepare([recording()], [], Question(ROBOT, effects=(EFFECTS["hysteresis"],)))
    (first,), (rest,) = prepared.problem.observed
    assert first.quiet[0].before is None and rest.quiet[0].before is not None
    assert first.quiet[0].span == pytest.approx((0.0, 12.0), abs=0.01)
    assert rest.quiet[0].span == pytest.approx((-8.0, 4.0), abs=0.01)
