"""Fourier motions: smooth, periodic between start and stop, and kept in files that load again."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from elastic_arm.errors import ExcitationError
from elastic_arm.excitation import load_trajectory
from tests.helpers.motions import trajectory


def test_velocity_and_acceleration_are_the_derivatives_of_position() -> None:
    """dq and ddq agree with fourth-order differences of q all along, ramps included."""
    motion = trajectory()
    h = 1e-3
    t = np.linspace(0.01, motion.duration - 0.01, 900)
    _, dq, ddq = motion.evaluate(t)
    far, near = ([motion.evaluate(t + s * k * h) for s in (-1, 1)] for k in (2, 1))
    for order, derivative in enumerate((dq, ddq)):
        steps = [far[0][order] - far[1][order], near[1][order] - near[0][order]]
        np.testing.assert_allclose((steps[0] + 8 * steps[1]) / (12 * h), derivative, atol=1e-7)


def test_the_motion_starts_and_stops_at_rest_without_a_jump() -> None:
    """At both ends q = q0, dq = ddq = 0, and the acceleration leaves zero more slowly than the
    square of time."""
    motion = trajectory()
    ends = np.array([0.0, motion.duration])
    for values, expected in zip(motion.evaluate(ends), (motion.q0, 0.0, 0.0), strict=True):
        np.testing.assert_allclose(values, np.broadcast_to(expected, values.shape), atol=1e-12)
    early = np.abs(motion.evaluate(np.array([1e-3, 2e-3]))[2]).max(axis=1)
    assert early[1] / early[0] == pytest.approx(2.0**3, rel=0.05)


def test_between_the_ramps_the_motion_is_exactly_periodic() -> None:
    """Over the periodic section, q, dq and ddq repeat after one period."""
    motion = trajectory(periods=3)
    start = motion.ramp
    stop = motion.duration - motion.ramp
    t = np.linspace(start, stop - motion.period, 50)
    for now, later in zip(motion.evaluate(t), motion.evaluate(t + motion.period), strict=True):
        np.testing.assert_allclose(later, now, atol=1e-12)
    assert (stop - start) / motion.period == pytest.approx(3)


def test_outside_its_time_the_arm_rests_at_q0() -> None:
    """Before the beginning and after the end the motion holds q0."""
    motion = trajectory()
    q, dq, _ = motion.evaluate(np.array([-1.0, motion.duration + 1.0]))
    np.testing.assert_allclose(q, [motion.q0] * 2, atol=1e-12)
    assert not dq.any()


def test_a_saved_trajectory_loads_to_the_same_motion(tmp_path: Path) -> None:
    """The YAML file keeps every digit."""
    motion = trajectory()
    motion.save(tmp_path / "new folder" / "t.yaml")
    again = load_trajectory(tmp_path / "new folder" / "t.yaml")
    t = np.linspace(0, motion.duration, 40)
    for one, other in zip(motion.evaluate(t), again.evaluate(t), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("field", "value", "problem"),
    [
        ("a", [[], [], []], "no harmonics"),
        ("a", [[1.0, 2.0]], "a is (1, 2)"),
        ("q0", [0.0, "x", 0.0], "q0 is not made of numbers"),
        ("b", [[float("nan")] * 4] * 3, "b contains a number that is not finite"),
        ("omega", 0.0, "omega is 0"),
        ("ramp", -1.0, "ramp is -1"),
        ("ramp", 50.0, "leaves no time"),
        ("joints", ["one"], "1 joint names"),
        ("speed", 3, "unknown field speed"),
        ("omega", None, "misses omega"),
        ("schema", "other", "is not a trajectory file"),
    ],
)
def test_a_wrong_trajectory_file_is_refused_by_field(
    tmp_path: Path, field: str, value: object, problem: str
) -> None:
    """A file that holds no motion raises an error with its path and the field."""
    path = tmp_path / "t.yaml"
    trajectory().save(path)
    content = yaml.safe_load(path.read_text())
    if value is None:
        del content[field]
    else:
        content[field] = value
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(ExcitationError) as caught:
        load_trajectory(path)
    assert str(path) in str(caught.value)
    assert problem in str(caught.value)


def test_a_missing_or_broken_file_is_said(tmp_path: Path) -> None:
    """No file and no YAML are told apart."""
    with pytest.raises(ExcitationError, match="no such file"):
        load_trajectory(tmp_path / "none.yaml")
    (tmp_path / "bad.yaml").write_text("a: [1, 2")
    with pytest.raises(ExcitationError, match=r"bad\.yaml: line 1: "):
        load_trajectory(tmp_path / "bad.yaml")
