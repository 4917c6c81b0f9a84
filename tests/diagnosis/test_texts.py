"""Numbers as a reader takes them: no more digits than are known, no certainty, units everywhere."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from elastic_arm.diagnosis.inference.estimates import ParameterEstimate
from elastic_arm.diagnosis.result import Cause
from elastic_arm.diagnosis.selection.candidates import feature_of
from elastic_arm.diagnosis.texts.findings import _name, negative_shrink_note
from elastic_arm.diagnosis.texts.notes import known_effect_note
from elastic_arm.diagnosis.texts.values import estimates_text, instance_text, percent, probability_text
from elastic_arm.effects import parse
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.formatting import JointUnits, rounded
from elastic_arm.robot import load_robot


@pytest.mark.parametrize(
    ("value", "std", "told"),
    [
        (0.9036, 0.02031, "0.904 ± 0.020"),
        (1.037, 0.1676, "1.04 ± 0.17"),
        (5.0, 0.0996, "5.00 ± 0.10"),
        (99.96, 1.0, "100.0 ± 1.0"),
        (-27.1028, 0.0032, "-27.1028 ± 0.0032"),
        (46.2453, 288.0, "50 ± 290"),
        (150103.0, 114.0, "150100 ± 110"),
        (3.562e7, 4.757e5, "3.562e+07 ± 4.8e+05"),
        (1.388e-5, 7.31e-6, "1.39e-05 ± 7.3e-06"),
        (0.001, 5.0, "0 ± 5.0"),
        (0.444, 1e-12, "0.4440000 ± 1.0e-12"),
    ],
)
def test_values_have_the_digits_that_their_deviation_warrants(value: float, std: float, told: str) -> None:
    """The deviation is told with two digits, the value to the same place, at most seven of them."""
    assert " ± ".join(rounded(value, std)) == told


def test_sizes_carry_units_and_leave_out_deviations_of_what_is_given() -> None:
    """Whole orders have no deviation, undetermined ones a question mark, and vectors one for each number."""
    told = estimates_text(
        {
            "amplitude": ParameterEstimate(2.0312e-5, 1.7e-7, "rad"),
            "order": ParameterEstimate(2.0, 0.0, "1"),
            "phase": ParameterEstimate(0.7, None, "rad"),
            "position": ParameterEstimate([0.0123, 0.1], [0.0011, 0.02], "m"),
        }
    )
    assert told == (
        "amplitude 2.031e-05 ± 1.7e-07 rad, order 2, phase 0.7 ± ? rad, position (0.0123, 0.100) ± (0.0011, 0.020) m"
    )


@pytest.mark.parametrize(("std", "told"), [(0.1, ", fitted with torque 5.00 ± 0.10 Nm"), (38000.0, ", whose size")])
def test_a_known_effect_of_any_size_has_no_number(std: float, told: str) -> None:
    """A friction that is as certain of any size which an arm can have is not told as 5 ± 38000 Nm."""
    robot = load_robot()
    feature = feature_of(parse("coulomb_friction:joint_2:torque=5", robot), ArmEquations(robot, "mod3"))
    note = known_effect_note(feature, {"torque": ParameterEstimate(5.0, std, "Nm")})
    assert note.startswith(f"Known: coulomb_friction of joint_2{told}")


@pytest.mark.parametrize(
    ("probability", "told"),
    [(1.0, "> 99.9 %"), (0.9996, "> 99.9 %"), (0.9957, "99.6 %"), (0.85, "85 %"), (0.005, "0.5 %"), (0.0, "< 0.1 %")],
)
def test_certainty_is_never_claimed(probability: float, told: str) -> None:
    """A confidence is never told as 100 %, nor as 0 %."""
    assert probability_text(probability) == told


def test_shares_next_to_nothing_have_no_sign() -> None:
    """A share that is told as zero is told without a minus."""
    assert (percent(-0.0003), percent(-0.048), percent(None)) == ("0.0 %", "-4.8 %", "0.0 %")


@dataclass
class _Cause:
    shrink: float


def test_shares_below_zero_are_explained_where_they_occur() -> None:
    """What "-4.8 %" means is said beside it, and nowhere else."""
    assert "makes the gap larger" in negative_shrink_note([_Cause(0.9), _Cause(-0.048)])  # type: ignore[list-item]
    assert negative_shrink_note([_Cause(0.9), _Cause(-0.0003)]) == ""  # type: ignore[list-item]


@pytest.mark.parametrize(
    ("effect", "told"),
    [
        ("coulomb_friction:joint_2:torque=13.9", "torque 13.9 Nm, side motor"),
        ("payload:mass=5,position=0/0/0.1", "mass 5 kg, position (0, 0, 0.1) m"),
    ],
)
def test_given_effects_are_told_with_units(effect: str, told: str) -> None:
    """What a simulation was given has its unit behind every number, and its choices by name."""
    robot = load_robot()
    assert instance_text(parse(effect, robot), robot.units) == told


def test_given_effects_of_a_joint_that_slides_are_forces() -> None:
    """The units of a rail are N and m."""
    robot = load_robot()
    rail = JointUnits(robot.joint_names, ["joint_2"])
    given = parse("coulomb_friction:joint_2:torque=13.9", robot)
    assert instance_text(given, rail) == "torque 13.9 N, side motor"


def test_causes_of_one_effect_and_joint_are_told_apart_by_their_channels() -> None:
    """Two low passes of a joint are not the same cause twice; one alone is named by effect and joint."""
    given = [f"torque_lowpass:joint_2:cutoff=10,channels={channel}" for channel in ("joint_torque", "motor_torque")]
    causes = [
        Cause("torque_lowpass", "joint_2", ("motor",), "frequency", {}, 1.0, 1.0, (), parse(text, load_robot(None)))
        for text in given
    ]
    assert _name(causes[0], causes[:1]) == "torque_lowpass on joint_2"
    assert [_name(cause, causes) for cause in causes] == [
        "torque_lowpass on joint_2 (joint_torque)",
        "torque_lowpass on joint_2 (motor_torque)",
    ]
