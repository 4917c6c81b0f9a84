"""Whole diagnoses of short simulated recordings: the right effect at the right joint, with its
size."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from elastic_arm.diagnosis import Diagnosis, Question, diagnose
from elastic_arm.effects import EFFECTS, Effect, parse
from elastic_arm.effects.text import known_effects
from elastic_arm.excitation import FourierTrajectory, Shape, random_trajectories
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot
from elastic_arm.simulation import SimulationSettings, simulate
from tests.helpers.gap_recordings import LIMITS, MODEL, ROBOT
from tests.helpers.nightly import nightly

pytestmark = pytest.mark.slow(8)

SECONDS, RATE = 6.0, 500.0  # at 250 Hz the smoother takes a part of the residuals' band
FRICTION = "coulomb_friction:joint_2:torque=6"
# Enough where not the choice among all is asked for.
FEW = tuple(
    EFFECTS[name] for name in ("coulomb_friction", "stiffness_mismatch", "joint_torque_offset")
)


LOAD = {"mass": 2.0, "position": (0.05, 0.1, 0.0)}
GAIN = {"gain": 1.15}


@cache
def motion(seed: int) -> FourierTrajectory:
    """Return a lively motion."""
    shape = Shape(5, SECONDS - 2.0, 1.0)
    return random_trajectories(MODEL, LIMITS, 1, rng=np.random.default_rng(seed), shape=shape)[0]


def recorded(*effects: str, seed: int = 1, robot: Robot = ROBOT) -> Recording:
    """Let an arm with effects follow a motion of its own."""
    settings = SimulationSettings(effects=[parse(text, robot) for text in effects], rate=RATE)
    return simulate(
        robot, motion(seed), settings, duration=SECONDS, rng=np.random.default_rng(seed)
    )


def diagnosed(*effects: str, question: Question | None = None) -> Diagnosis:
    """Diagnose an arm with effects by two motions, the second of which judges."""
    return diagnose(
        [recorded(*effects, seed=1)], question or Question(ROBOT), [recorded(*effects, seed=2)]
    )


def assert_size(
    found: Diagnosis, effect: str, joint: str | None, **sizes: float | Sequence[float]
) -> None:
    """Assert that an effect is among the causes for sure, with these sizes within 4 deviations."""
    (cause,) = [c for c in found.causes if (c.effect, c.joint) == (effect, joint)]
    assert cause.confidence > 0.9
    for name, true in sizes.items():
        estimate = cause.parameters[name]
        errors = (np.asarray(estimate.value) - true) / np.asarray(estimate.std)
        assert (np.abs(errors) < 4.0).all(), (effect, name, estimate, true)


def names(found: Diagnosis) -> set[tuple[str, str | None]]:
    return {(cause.effect, cause.joint) for cause in found.causes}


def test_an_arm_as_described_has_no_cause() -> None:
    """A clean recording is called `none`, nothing is blamed, and no share of a gap is stated."""
    found = diagnosed()
    assert (found.verdict, found.causes, found.unexplained, found.shrink) == ("none", (), (), None)


@pytest.mark.parametrize(
    ("text", "effect", "joint", "sizes"),
    [
        (FRICTION, "coulomb_friction", "joint_2", {"torque": 6.0}),
        *nightly(
            [
                ("payload:mass=2,position=0.05/0.1/0", "payload", "joint_3", LOAD),
                ("joint_torque_gain:joint_1:gain=1.15", "joint_torque_gain", "joint_1", GAIN),
            ]
        ),
    ],
    ids=["dry friction", "load", "torque sensor"],
)
def test_one_effect_is_the_one_cause(
    text: str, effect: str, joint: str | None, sizes: dict[str, float | Sequence[float]]
) -> None:
    """Effect, joint and size come out, nothing beside it, and the gap is gone on another motion."""
    found = diagnosed(text)
    assert names(found) == {(effect, joint)}
    assert_size(found, effect, joint, **sizes)
    assert found.verdict == "explained" and found.shrink is not None and found.shrink > 0.95


@pytest.mark.nightly
def test_a_late_torque_of_an_arm_that_is_not_exactly_known_is_a_delay() -> None:
    """With `refit` the numbers of the arm are open, and 6 ms of one joint's torque sensor are still
    its delay."""
    late = "time_delay:joint_2:delay=6e-3,channels=joint_torque"
    found = diagnosed(late, question=Question(ROBOT, refit=True))
    assert names(found) == {("time_delay", "joint_2")}
    assert_size(found, "time_delay", "joint_2", delay=6e-3)
    assert "as measured" not in found.trust


@pytest.mark.nightly
def test_two_effects_at_once_are_told_apart() -> None:
    """Dry friction and a transmission error, each at its joint with its size."""
    found = diagnosed(FRICTION, "transmission_error:joint_1:amplitude=3e-5,phase=0.7")
    assert names(found) == {("coulomb_friction", "joint_2"), ("transmission_error", "joint_1")}
    assert_size(found, "coulomb_friction", "joint_2", torque=6.0)
    assert_size(found, "transmission_error", "joint_1", amplitude=3e-5, phase=0.7)


@pytest.mark.nightly
def test_friction_stated_ten_times_too_large_goes_from_its_number_to_the_true_one() -> None:
    """Stated 60 Nm, true 6: the cause is that number of the description, from 60 to 6."""
    stated = ROBOT.with_(
        effects=(
            {"effect": "coulomb_friction", "joint": "joint_2", "parameters": {"torque": 60.0}},
        )
    )
    found = diagnosed(FRICTION, question=Question(stated))
    (cause,) = found.causes
    assert (cause.effect, cause.joint) == ("coulomb_friction", "joint_2")
    assert cause.stated is not None and cause.stated["torque"] == pytest.approx(60.0)
    assert_size(found, "coulomb_friction", "joint_2", torque=6.0)
    written = cause.to_dict()
    assert written["from"]["torque"] == 60.0 and written["to"]["torque"] == pytest.approx(
        6.0, rel=0.05
    )


@pytest.mark.nightly
def test_friction_that_is_another_one_in_one_recording_is_a_change() -> None:
    """6 Nm in the first recording and 9 in the second: one change, with both sizes by recording."""
    sizes = {"before": 6.0, "after": 9.0}
    fitted = [
        replace(recorded(f"coulomb_friction:joint_2:torque={torque}", seed=k), source=name)
        for k, (name, torque) in enumerate(sizes.items(), 1)
    ]
    found = diagnose(fitted, Question(ROBOT, effects=FEW), [recorded(FRICTION, seed=3)])
    (change,) = found.changes
    assert (change.effect, change.joint, change.parameter) == (
        "coulomb_friction",
        "joint_2",
        "torque",
    )
    assert change.confidence > 0.9
    for name, value, std in change.values:
        assert abs(value - sizes[name]) < 4.0 * std
    alike = [recorded(FRICTION, seed=1), recorded(FRICTION, seed=2)]
    assert diagnose(alike, Question(ROBOT, effects=FEW), [recorded(FRICTION, seed=3)]).changes == ()


@pytest.mark.nightly
def test_an_effect_of_no_catalogue_is_unknown_at_its_place() -> None:
    """Without hysteresis among the candidates, what it leaves is unexplained at the drive on which
    it acts."""
    withheld = "hysteresis:joint_2:torque=15,width=1e-4"
    found = diagnosed(withheld, question=Question(ROBOT, effects=FEW))
    assert found.verdict == "unknown" and {p.joint for p in found.unexplained} == {"joint_2"}


def test_what_is_known_counts_as_part_of_the_model() -> None:
    """With --with the friction that the user knows is fitted with its size, and nothing is left to
    explain."""
    known = known_effects(["coulomb_friction:joint_2"], ROBOT)
    found = diagnosed(FRICTION, question=Question(ROBOT, given=known, effects=FEW))
    assert (found.verdict, found.causes) == ("none", ())
    (one,) = found.known
    size = one["parameters"]["torque"]
    assert abs(size["value"] - 6.0) < 4.0 * size["std"]


@pytest.mark.parametrize(
    "effects",
    [(*FEW, EFFECTS["inertia_coupling"]), *nightly([None])],
    ids=["few", "all"],
)
def test_a_simpler_model_lacks_what_it_leaves_out(effects: tuple[Effect, ...] | None) -> None:
    """Against mod2 the plain arm shows the missing coupling of inertias, which has no size, and
    nothing else."""
    found = diagnosed(question=Question(ROBOT, "mod2", effects=effects))
    assert names(found) == {("inertia_coupling", None)}
    assert found.causes[0].held_as == "variant"


@pytest.mark.parametrize("sides", ["motor", *nightly(["link"])])
def test_friction_is_found_with_the_motor_side_alone_and_no_motor_friction_with_the_links(
    sides: str,
) -> None:
    """The motor's equation holds its friction; of links with their sensors alone it is in no
    equation."""
    without = {"motor": "link", "link": "motor"}[sides]
    pair = [replace(recorded(FRICTION, seed=k), **{without: None}) for k in (1, 2)]
    found = diagnose(pair[:1], Question(ROBOT, effects=FEW), pair[1:])
    expected = {("coulomb_friction", "joint_2")} if sides == "motor" else set()
    assert names(found) == expected
