"""A real robot: KUKA LWR 4+, seven joints with torque sensors, and what must be said about its poor
excitation.

The known figures are of a plain base-parameter least squares, see the data's README.
"""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.identification import Identification, IdentificationSettings, identify, parse_laws
from elastic_arm.recording import Recording, Side
from elastic_arm.robot import Robot, load_robot

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "kuka_lwr4"
missing = pytest.mark.skipif(
    not DATA.is_dir(), reason=f"the recordings of the LWR 4+ are not in {DATA}"
)
pytestmark = [pytest.mark.nightly, pytest.mark.slow(11), missing]

LAWS = ("viscous_friction:side=link", "coulomb_friction:side=link", "joint_torque_offset")
# RMSE, Nm, joints 1 to 7.
KNOWN_ON_2 = (0.31, 0.28, 0.29, 0.17, 0.27, 0.20, 0.19)
KNOWN_FAILURE_ON_3 = (1.5, 2.2, 1.1, 1.4, 1.2, 0.7, 0.5)
KNOWN_PRIOR = (1.37, 1.78, 0.75, 0.76, 1.14, 0.91, 0.29)


@pytest.fixture(scope="module")
def robot() -> Robot:
    # The known figures are without the friction that the URDF states.
    return load_robot(DATA / "kuka_lwr4.urdf").with_(effects=())


@pytest.fixture(scope="module")
def runs(robot: Robot) -> dict[int, Recording]:
    return {k: load(robot, k) for k in (1, 2, 3)}


def load(robot: Robot, k: int) -> Recording:
    arrays = np.load(DATA / f"measurements_{k}.npz")
    stamps = np.rint(arrays["times"] * 1e9).astype(np.int64)
    link = Side(stamps, arrays["positions"], arrays["velocities"], arrays["torques"])
    return Recording(robot.joint_names, link=link, source=f"run {k}")


def found(robot: Robot, fit: list[Recording], held_out: Recording) -> Identification:
    laws = parse_laws(LAWS, robot)
    return identify(fit, robot, IdentificationSettings(effects=laws), validate=[held_out])


@pytest.fixture(scope="module")
def on_two_speeds(robot: Robot, runs: dict[int, Recording]) -> Identification:
    return found(robot, [runs[1], runs[3]], runs[2])


@pytest.fixture(scope="module")
def on_one_speed(robot: Robot, runs: dict[int, Recording]) -> Identification:
    return found(robot, [runs[1]], runs[3])


def rmse(result: Identification, arm: str) -> np.ndarray:
    (by_arm,) = result.validation.values()
    return np.array(list(by_arm[arm]["joint"].values()))


def test_fit_on_two_speeds_is_no_worse_than_known(on_two_speeds: Identification) -> None:
    """Fitted on runs 1 and 3, run 2 is missed by no more than the known figures, to their two
    decimals."""
    assert np.all(np.round(rmse(on_two_speeds, "identified"), 2) <= KNOWN_ON_2)


def test_prior_misses_as_much_as_known(on_two_speeds: Identification) -> None:
    """The URDF's own parameters miss run 2 as the README says of all runs, to 8 %: kinematics and
    signs are right."""
    assert rmse(on_two_speeds, "nominal") == pytest.approx(KNOWN_PRIOR, rel=0.08)


def test_poor_excitation_of_one_run_is_said_before_the_fit(on_one_speed: Identification) -> None:
    """Run 1 alone, one sinusoid at one speed, is called poor from its motion alone."""
    assert on_one_speed.excitation["poor"]
    assert any(
        "base parameters have standard deviations above" in reason
        for reason in on_one_speed.excitation["reasons"]
    )


def test_half_the_parameters_of_one_run_are_called_undetermined(
    on_one_speed: Identification,
) -> None:
    """After the fit too: at least a third of the base parameters is said to be determined poorly or
    not at all."""
    words = [e.verdict for e in on_one_speed.estimates]
    assert words.count("well") < 2 / 3 * len(words)


def test_identify_stays_far_below_the_plain_failure(on_one_speed: Identification) -> None:
    """Fitted on run 1 alone, the base parameters miss run 3 by at most 0.7 of the known failure on
    every joint."""
    assert np.all(rmse(on_one_speed, "identified") <= 0.7 * np.array(KNOWN_FAILURE_ON_3))


def test_consistent_arm_stays_far_below_the_plain_failure(on_one_speed: Identification) -> None:
    """Fitted on run 1 alone, the consistent arm misses run 3 by at most half of the known failure
    on the whole."""
    assert np.linalg.norm(rmse(on_one_speed, "consistent")) <= 0.5 * np.linalg.norm(
        KNOWN_FAILURE_ON_3
    )


def test_well_determined_parameters_of_two_recordings_agree_within_their_deviations(
    robot: Robot, runs: dict[int, Recording]
) -> None:
    """Each run alone: what is called well differs by 1.2 deviations (rms) at most between runs, and
    never by three."""
    settings = IdentificationSettings(effects=parse_laws(LAWS, robot), consistent=False)
    single = [
        {e.name: e for e in identify(run, robot, settings).estimates} for run in runs.values()
    ]
    for one, other in combinations(single, 2):
        pairs = [(a, other[name]) for name, a in one.items() if name in other]
        well = [(a, b) for a, b in pairs if a.verdict == b.verdict == "well"]
        z = np.array([(a.value - b.value) / np.hypot(a.std, b.std) for a, b in well])
        assert len(z) >= 5 and np.sqrt(np.mean(z**2)) < 1.2 and np.abs(z).max() < 3.0
