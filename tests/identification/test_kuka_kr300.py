"""A real robot: KUKA KR300, encoders on both sides of three axes, no joint torque sensors, link
encoders 3 ms late."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from elastic_arm.identification import Identification, IdentificationSettings, identify, parse_laws
from elastic_arm.identification.batch.selection import BatchChoice, Trials
from elastic_arm.recording import Recording, Side
from elastic_arm.robot import load_robot

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "kuka_kr300"
missing = pytest.mark.skipif(
    not DATA.is_dir(), reason=f"the recordings of the KR300 are not in {DATA}"
)
pytestmark = [pytest.mark.nightly, pytest.mark.slow(20), missing]

LAWS = ("viscous_friction", "coulomb_friction")
RATIO = np.array([256.857, 267.429, 252.333])


def load(run: str) -> Recording:
    record = loadmat(DATA / f"run_{run}.mat", simplify_cells=True)["rec"]
    stamps = np.round(1e9 * record["time_cont"]).astype(np.int64)
    link, motor = (
        Side(
            stamps,
            *(
                np.deg2rad(record[f"act_{what}"][:3].T)
                for what in (f"pos_{side}_deg", f"vel_{side}_deg_per_s")
            ),
        )
        for side in ("se", "mot")
    )
    motor = replace(motor, effort=record["act_torque_abs_nm"][:3].T * RATIO)
    return Recording(("a1", "a2", "a3"), link=link, motor=motor, source=f"run {run}")


@pytest.fixture(scope="module")
def result() -> Identification:
    robot = load_robot(DATA / "kr300_3_elastic.yaml")
    laws = parse_laws(LAWS, robot)
    return identify(
        [load("A"), load("C")], robot, IdentificationSettings(effects=laws), validate=[load("B")]
    )


def value_of(result: Identification, name: str) -> float:
    return next(e.value for e in result.estimates if e.name == name)


def test_stiffness_is_never_called_well_determined_far_from_the_nominal(
    result: Identification,
) -> None:
    """A stiffness is the description's and "not" known, or within a factor of two of it: there is
    no collapse."""
    for e in result.estimates:
        if e.name.endswith(".K"):
            assert (e.value == e.nominal and e.verdict == "not") or 0.5 < e.value / e.nominal < 2.0


@pytest.mark.parametrize("laws", [LAWS, LAWS[::-1]])
def test_undetermined_springs_stay_described_whatever_the_speeds_of_friction(
    laws: tuple[str, ...],
) -> None:
    """Where each joint's friction turns over at its own speed, springs are the description's, in
    each order of laws."""
    robot = load_robot(DATA / "kr300_3_elastic.yaml")
    recorded = [(recording, recording.samples()) for recording in (load("A"), load("C"))]
    effects = parse_laws(laws, robot)
    trials = Trials(
        recorded, robot, IdentificationSettings(effects=effects), lambda what, share: None
    )
    trial = trials(BatchChoice(sign_speed=(1e-3, 1e-4, 1e-4)))
    place = trial.identifier.equations.base.names.index
    for joint in robot.joints:
        K = place(f"{joint.name}.K")
        assert trial.fit.Psi[K] == joint.transmission.stiffness
        assert trial.fit.std[K] == np.inf


def test_link_encoders_lag_by_what_is_known(result: Identification) -> None:
    """The lag of the link encoders is 2.5 to 3.2 ms on every axis."""
    for joint in result.joints:
        lag = value_of(result, f"link_encoder:{joint}.K_delay") / value_of(result, f"{joint}.K")
        assert 2.5e-3 < lag < 3.2e-3


def test_friction_of_axis_1_is_the_published_one(result: Identification) -> None:
    """Coulomb and viscous friction of axis 1 are within 10 % of 355 Nm and 2050 Nm s/rad."""
    assert value_of(result, "coulomb_friction:a1.torque") == pytest.approx(355, rel=0.1)
    assert value_of(result, "viscous_friction:a1.coefficient") == pytest.approx(2050, rel=0.1)


def test_held_out_torque_is_no_worse_than_a_plain_fit(result: Identification) -> None:
    """Run B is missed by no more than 119, 297 and 261 Nm."""
    (by_arm,) = result.validation.values()
    assert np.all(np.array(list(by_arm["identified"]["motor"].values())) <= (119, 297, 261))
