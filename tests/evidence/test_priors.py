"""The file of priors."""

from pathlib import Path

import numpy as np
import pytest

from elastic_arm.effects import EFFECTS
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.equations.places import features
from elastic_arm.errors import DiagnosisError
from elastic_arm.evidence.numbers import LARGEST_SCALE, numbers_of, unreferenced
from elastic_arm.evidence.priors import ZERO_AS_MOUNTED, Priors, read_priors
from elastic_arm.robot import load_robot

SENSORS = [effect for effect in EFFECTS.values() if effect.prior is not None]
IDS = [effect.id for effect in SENSORS]


def written(folder: Path, text: str) -> Path:
    path = folder / "priors.yaml"
    path.write_text(text)
    return path


def test_a_file_changes_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    """Numbers of the arm and of a sensor are read; those left out keep their defaults."""
    found = read_priors(
        written(tmp_path, "stiffness: 0.3\nsensors: {motor_torque_gain: 0.15}\n"), IDS
    )
    assert found == Priors(stiffness=0.3, sensors={"motor_torque_gain": 0.15})


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("stifness: 0.3", "stifness: unknown key"),
        ("sensors: {motor_gain: 0.1}", "sensors.motor_gain: unknown key"),
        ("mass: -0.1", "mass: is -0.1, but must be above 0"),
        ("mass: heavy", "mass: is 'heavy', not a number"),
        ("mass: true", "mass: is yes or no, not a number"),
        (
            "sensors: {motor_torque_gain: yes}",
            "sensors.motor_torque_gain: is yes or no, not a number",
        ),
        ("mass: .inf", "mass: inf is not a finite number"),
        ("[1, 2]", "contains no fields"),
    ],
)
def test_what_is_no_prior_is_refused_in_one_line(tmp_path: Path, text: str, problem: str) -> None:
    """Unknown keys and what is no standard deviation are named, with file and remedy."""
    path = written(tmp_path, text)
    with pytest.raises(DiagnosisError) as caught:
        read_priors(path, IDS)
    assert (
        problem in str(caught.value)
        and str(path) in str(caught.value)
        and "\n" not in str(caught.value)
    )


def test_numbers_have_the_stated_deviations() -> None:
    """A file's numbers are the priors of the arm's and the sensors', and a stiffness stays
    positive."""
    robot = load_robot()
    shown = features(ArmEquations(robot, "mod3"), SENSORS)
    priors = Priors(mass=0.2, stiffness=0.3, sensors={"joint_torque_gain": 0.05})
    made = numbers_of(
        robot, shown, 1000.0, priors, (), np.full(robot.n, 100.0), None, ("link", "drive", "motor")
    )
    found = {(p.what, p.joint): p for p in made}
    assert found["link_mass", "joint_2"].prior_std == 0.2
    assert found["joint_torque_gain", "joint_2"].prior_std == 0.05
    assert found["motor_torque_gain", "joint_2"].prior_std == 0.015
    stiffness = found["stiffness", "joint_1"]
    assert stiffness.limit == pytest.approx(LARGEST_SCALE / 0.3)
    # half is as far off as twice
    assert stiffness.value(-2.0) * stiffness.value(2.0) == pytest.approx(1.0)
    assert stiffness.slope(1.0) == pytest.approx(0.3 * stiffness.value(1.0))


def test_a_stated_deviation_of_encoders_holds_without_joint_torque_sensors() -> None:
    """No known torque sets their zeros there, so the default is that of mounting."""
    robot = load_robot()
    shown = features(ArmEquations(robot, "mod3"), SENSORS)
    largest = np.full(robot.n, 100.0)
    for priors, expected in (
        (Priors(), ZERO_AS_MOUNTED),
        (Priors(sensors={"encoder_offset": 2e-5}), 2e-5),
    ):
        made = numbers_of(
            robot, shown, 1000.0, priors, (), largest, None, ("link", "drive", "motor")
        )
        zeros = [unreferenced(p, priors) for p in made if p.what == "encoder_offset"]
        assert len(zeros) == robot.n
        assert {p.prior_std for p in zeros} == {expected}


def test_how_gradually_friction_turns_over_is_uncertain_about_where_it_was_found_to() -> None:
    """Speeds are tried a factor of four apart: friction may turn over from a quarter to four times
    the one found."""
    robot = load_robot()
    turning, largest = np.linspace(0.0, 0.02, robot.n), np.full(robot.n, 100.0)
    found = numbers_of(robot, (), 1000.0, Priors(), (), largest, turning, ("link", "motor"))
    for side in ("link", "motor"):
        own = [p for p in found if p.speeds and p.side == side]
        speeds = [p.speeds for p in own if p.joint == robot.joint_names[-1]]
        assert speeds == [pytest.approx(pair) for pair in ((0.005, 0.02), (0.02, 0.08), (0.02,))]
        usual = [p.speeds for p in own if p.joint == robot.joint_names[0]]
        assert usual == [pytest.approx(pair) for pair in ((5e-4, 2e-3), (2e-3, 8e-3), (2e-3,))]
    # Of one equation a joint both sides would be one parameter twice, with a prior that is too
    # wide.
    single = numbers_of(robot, (), 1000.0, Priors(), (), largest, turning, ("motor",))
    assert {p.side for p in single if p.speeds} == {"motor"}


def test_gains_of_currents_are_as_uncertain_as_torque_constants(tmp_path: Path) -> None:
    """Where a file states the gain, that counts; other sensors keep their priors."""
    default = Priors().of_currents(["motor_torque"])
    assert dict(default.sensors) == {"motor_torque_gain": 0.15}
    stated = read_priors(
        written(tmp_path, "sensors: {motor_torque_gain: 0.05}"), ["motor_torque_gain"]
    )
    assert dict(stated.of_currents(["motor_torque"]).sensors) == {"motor_torque_gain": 0.05}
    wider = read_priors(written(tmp_path, "torque_constant: 0.3"), [])
    assert dict(wider.of_currents(["motor_torque"]).sensors) == {"motor_torque_gain": 0.3}
    assert dict(Priors().of_currents([]).sensors) == {}
