"""Which part is fitted and which judges."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.diagnosis.split import independent, split
from elastic_arm.errors import DiagnosisError
from elastic_arm.recording import Recording, Side


def recording(seconds: float, seed: int, frequency: float = 0.37) -> Recording:
    """A joint that swings, with an encoder's noise."""
    t = np.arange(0.0, seconds, 0.01)
    noise = 1e-5 * np.random.default_rng(seed).standard_normal((len(t), 1))
    angle = np.sin(2 * np.pi * frequency * t + seed)[:, None] + noise
    return Recording(
        ("joint_1",),
        motor=Side(np.round(1e9 * t).astype(np.int64), position=angle),
        source=f"bag_{seed}",
    )


def test_the_last_third_judges() -> None:
    """Without a validation recording two thirds are fitted, and both parts are of the same
    recording."""
    (fitted,), (judging,) = split([recording(30.0, 1)], [])
    assert fitted.duration == pytest.approx(20.0, abs=0.1) and judging.duration == pytest.approx(
        10.0, abs=0.1
    )


def test_a_validation_recording_is_taken_whole() -> None:
    """Recordings named for judging judge, and all of the others is fitted."""
    first, second = recording(12.0, 1), recording(8.0, 2)
    assert split([first], [second]) == ([first], [second])


def test_what_is_fitted_may_not_judge() -> None:
    """A part of the same recording repeats its noise, which no other recording does."""
    first = recording(12.0, 1)
    with pytest.raises(DiagnosisError, match="bag_1 is also a fitted recording"):
        split([first], [first.between(3.0, 9.0)])


def test_coarse_currents_that_repeat_do_not_make_a_recording_the_same() -> None:
    """Whole amperes on the motors' side, angles on the links': another recording judges, the same
    one does not."""
    first, second = (
        replace(
            one,
            motor=Side(one.motor.stamp_ns, effort=np.round(3.0 * one.motor.position)),
            link=one.motor,
        )
        for one in (recording(12.0, 1), recording(8.0, 2))
    )
    assert split([first], [second]) == ([first], [second])
    with pytest.raises(DiagnosisError, match="also a fitted recording"):
        split([first], [first.between(3.0, 9.0)])


def test_coarse_angles_beside_a_torque_at_its_limit_do_not_make_a_recording_the_same() -> None:
    """Codes of a servo and a torque that hardly leaves its limit repeat in every motion."""
    first, second = (
        replace(
            one,
            motor=Side(
                one.motor.stamp_ns,
                np.round(one.motor.position, 2),
                effort=np.sign(one.motor.position),
            ),
        )
        for one in (recording(12.0, 1), recording(8.0, 2, frequency=0.61))
    )
    assert split([first], [second]) == ([first], [second])
    with pytest.raises(DiagnosisError, match="also a fitted recording"):
        split([first], [first.between(3.0, 9.0)])


def test_too_short_a_recording_is_refused_with_the_length_that_is_needed() -> None:
    """A third of 6 s is below 2.5 s; 8 s would do."""
    with pytest.raises(DiagnosisError, match="at least 8 s"):
        split([recording(6.0, 1)], [])


def test_a_repetition_is_no_independent_motion() -> None:
    """The same oscillation at another phase is found in the longer recording; another frequency is
    not."""
    assert not independent([recording(20.0, 1)], [recording(5.0, 2)])
    assert independent([recording(20.0, 1)], [recording(5.0, 2, frequency=0.61)])
