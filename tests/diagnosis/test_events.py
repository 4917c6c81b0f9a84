"""Events inside a recording: found where they are, left out of the fit, and none where there is
none."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.diagnosis import Diagnosis, Question, diagnose
from elastic_arm.diagnosis.events import runs_at_poses, runs_of
from elastic_arm.effects import EFFECTS
from elastic_arm.recording import Recording
from tests.helpers.gap_recordings import ROBOT, motions, record

COUNT = 24.0  # values of a block
FRICTION = "coulomb_friction:joint_2:torque=6"


def squares(power: np.ndarray, seed: int) -> np.ndarray:
    """Return sums of squares of noise of some powers (M,), at least those of noise of power 1."""
    return np.maximum(power * np.random.default_rng(seed).chisquare(COUNT, len(power)), COUNT)


def runs(power: np.ndarray, seed: int = 0) -> list[tuple[int, int]]:
    return runs_of(np.full(len(power), COUNT), squares(power, seed), 9).runs


def test_noise_and_powers_that_vary_hold_no_event() -> None:
    """Nor does a residual hold one that is ten times larger wherever the joint turns one way."""
    varying = [1.0 + np.random.default_rng(k).gamma(1.0, 20.0, 100) for k in range(10)]
    bursts = np.where(np.arange(100) % 10 < 4, 11.0, 1.0)
    assert not any(runs(np.ones(100), seed) for seed in range(50))
    assert not any(runs(power, k) for k, power in enumerate(varying))
    assert not any(runs(bursts, seed) for seed in range(10))


@pytest.mark.parametrize("stretches", [[(40, 42)], [(70, 100)], [(10, 12), (50, 80)]])
def test_stretches_that_the_rest_contradicts_are_found(stretches: list[tuple[int, int]]) -> None:
    """Two of a hundred blocks, a third of them, and both: to the block."""
    power = np.ones(100)
    for begin, end in stretches:
        power[begin:end] = 30.0
    assert runs(power) == stretches


def touched(recording: Recording, begin: float, end: float, torque: float) -> Recording:
    """Return a recording in which something presses on the second link for a while: torques and
    wind-up hold it."""
    stiffness, sides = ROBOT.joints[1].transmission.stiffness, {}
    for name in ("link", "motor"):
        side = getattr(recording, name)
        t = (side.stamp_ns - recording.start_ns) * 1e-9
        press = 0.5 * torque * (np.tanh((t - begin) / 0.03) - np.tanh((t - end) / 0.03))
        effort, position = side.effort.copy(), side.position.copy()
        effort[:, 1] -= press
        position[:, 1] -= press / stiffness * (name == "motor")
        sides[name] = replace(side, effort=effort, position=position)
    return replace(recording, **sides)


@pytest.fixture(scope="module")
def contact() -> Diagnosis:
    fit, judge = (
        replace(record(m, FRICTION, seed=k), source=f"run_{k}") for k, m in enumerate(motions())
    )
    question = Question(ROBOT, effects=(EFFECTS["coulomb_friction"],))
    return diagnose([touched(fit, 3.0, 3.5, 8.0)], question, [judge])


def test_a_contact_of_half_a_second_is_named_with_its_times(contact: Diagnosis) -> None:
    """To half a second, at its joint alone, in the result, a note and its file; the verdict is
    unknown."""
    assert {(e.recording, e.joint) for e in contact.events} == {("run_0", "joint_2")}
    link = [e for e in contact.events if e.side == "link"]
    assert [(e.begin, e.end) for e in link] == [
        (pytest.approx(3.0, abs=0.4), pytest.approx(3.5, abs=0.4))
    ]
    assert link[0].begin < 3.0 and link[0].end > 3.5 and 4.0 < link[0].rmse < 8.0
    assert contact.verdict == "unknown" and ("joint_2", "link", "event") in {
        (p.joint, p.side, p.regime) for p in contact.unexplained
    }
    assert any("joint_2 (link side) from " in note for note in contact.notes)
    assert contact.to_dict()["events"][0]["recording"] == "run_0"


def test_what_the_rest_tells_is_as_without_it(contact: Diagnosis) -> None:
    """Dry friction within three deviations, known to 1 %."""
    (cause,) = contact.causes
    found = cause.parameters["torque"]
    assert (cause.effect, cause.joint) == ("coulomb_friction", "joint_2")
    assert abs(found.value - 6.0) < 3.0 * found.std < 0.18


@pytest.mark.parametrize("follows_pose", [True, False])
def test_noise_that_varies_with_the_pose_is_no_event(follows_pose: bool) -> None:
    """An arm is stretched out for a third of a recording, where noise of accelerations has nine
    times the power. What is left has such noise, or it has the same noise everywhere."""
    n = np.full(60, 24.0)
    power = np.where((np.arange(60) >= 10) & (np.arange(60) < 30), 9.0, 1.0)
    noise = np.random.default_rng(3).chisquare(n)
    s = noise * power if follows_pose else noise
    assert runs_at_poses(n, s, power, 6) == []
    wrong = s if follows_pose else s / power
    assert runs_of(n, wrong, 6).runs != []
