"""The diagnosis while the arm moves, without ROS: a window of samples, and what is said of it."""

import re
from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis import live as live_diagnosis
from elastic_arm.diagnosis.live import Sizes, Window, answering
from elastic_arm.errors import DiagnosisError
from elastic_arm.recording import Recording, Samples
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel
from tests.helpers.candidates import candidates
from tests.helpers.hidden_arms import recordings

ROBOT = load_robot(None)
COULOMB = ("coulomb_friction", 1, "motor", "torque", 6.0)
NOISY = SensorModel(encoder_noise=1e-6)


@pytest.fixture(scope="module")
def moved() -> Recording:
    """8 s of an arm with friction on motor 2."""
    return recordings(COULOMB, instruments=NOISY)[0]


def batches(samples: Samples, length: int = 100) -> Iterator[Samples]:
    """Cut samples as they would arrive."""
    for first in range(0, len(samples), length):
        part = {
            f.name: values[first : first + length]
            for f in fields(samples)
            if f.name not in ("notes", "lacking")
            and (values := getattr(samples, f.name)) is not None
        }
        yield replace(samples, **part)


def filled(recording: Recording, length: float = 15.0) -> Window:
    window = Window(ROBOT.joint_names, length)
    for batch in batches(recording.samples()):
        window.add(batch)
    return window


def test_the_window_holds_what_came_last(moved: Recording) -> None:
    """A recording made of the window is the last part of what was fed, sample for sample."""
    samples = moved.samples()
    kept = filled(moved, 3.0).recording().samples()
    assert 2.9 < len(kept) / 1000 < 3.2
    for name in ("stamp_ns", "q", "dq", "tau_J", "theta", "dtheta", "tau_m"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(samples, name)[-len(kept) :])


def test_memory_stays_bounded_however_long_the_arm_moves(moved: Recording) -> None:
    """After a minute no more samples are kept than after the first window, and stamps that crawl
    change nothing."""
    samples = moved.samples()
    window = Window(ROBOT.joint_names, 3.0)
    for turn in range(8):
        shift = turn * 8_000_000_000
        for batch in batches(replace(samples, stamp_ns=samples.stamp_ns + shift)):
            window.add(batch)
            assert len(window.recording().motor or ()) <= 3100
    crawling = Window(ROBOT.joint_names, 3.0)
    for turn in range(30):
        crawling.add(replace(samples, stamp_ns=np.arange(len(samples)) + turn * len(samples)))
    assert len(crawling.recording().motor or ()) <= 200_000


def test_a_clock_set_back_starts_the_window_again(moved: Recording) -> None:
    """Samples of an earlier run are not mixed with those of the next."""
    window = filled(moved)
    first = next(batches(moved.samples()))
    window.add(first)
    assert window.seconds == pytest.approx(0.099)


def test_other_channels_start_the_window_again(moved: Recording) -> None:
    """When a torque sensor drops out, what is kept has the channels of what comes."""
    window = filled(moved.between(0.0, 4.0))
    for batch in batches(moved.between(4.0, 6.0).samples()):
        window.add(replace(batch, tau_J=None))
    kept = window.recording()
    assert kept.link is not None
    assert kept.link.effort is None
    assert window.seconds < 2.0


def test_an_empty_window_says_so() -> None:
    """Nothing heard is an error in words."""
    with pytest.raises(DiagnosisError, match="no samples yet"):
        Window(ROBOT.joint_names).recording()


@pytest.mark.slow(4)
def test_the_live_diagnosis_is_that_of_the_recording(moved: Recording) -> None:
    """Fed in batches, the window gives the diagnosis that the recording gives, and names the
    cause."""
    few = ("coulomb_friction", "viscous_friction", "hysteresis")
    halved = {name: side.at(slice(None, None, 2)) for name, side in moved.sides().items()}
    moved = replace(moved, **halved)
    with candidates(live_diagnosis, *few):
        live = answering(None, "mod3", (), False)(filled(moved).recording())
    assert [(c["effect"], c["joint"]) for c in live["causes"]] == [("coulomb_friction", "joint_2")]
    assert live["verdict"] == "explained"
    offline = diagnose([moved], Question(ROBOT, effects=few)).to_dict()
    for part in ("noise", "gap", "causes"):
        assert live[part] == offline[part]


def friction(value: float, std: float = 0.1) -> dict[str, object]:
    size = {"value": value, "std": std, "unit": "Nm"}
    cause = {
        "effect": "coulomb_friction",
        "joint": "joint_2",
        "parameters": {"torque": size, "side": {"value": "motor", "std": None, "unit": ""}},
    }
    return {"causes": [cause], "known": []}


@pytest.mark.parametrize("spread", [0.1, 0.5], ids=["as their deviations", "more than these"])
def test_a_size_that_changes_is_said_with_its_size_and_what_varies_is_none(spread: float) -> None:
    """From 6 to 9 Nm, as long as it lasts; not one in 300 values that spread about 6 Nm, whatever
    they are said to."""
    rng, sizes = np.random.default_rng(0), Sizes()
    false = sum(bool(sizes.changes(friction(6.0 + spread * e))) for e in rng.normal(size=300))
    assert false <= 1
    for _ in range(3):
        (said,) = sizes.changes(friction(9.0))
        assert re.match(
            r"torque of coulomb_friction on joint_2 changed from (6\.0|5\.9)\S* ± \S+ Nm to 9\.00 ±"
            r" 0\.10 Nm",
            said,
        )
    assert not sizes.changes(friction(6.05))
