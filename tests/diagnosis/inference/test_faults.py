"""Sensors and numbers of the arm that are further off than ordinary ones."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_arm.diagnosis import Question
from elastic_arm.diagnosis.inference import faults
from elastic_arm.diagnosis.preparation import PreparedData, prepare
from tests.helpers.gap_recordings import ROBOT, motions, record


@pytest.fixture(scope="module")
def prepared() -> PreparedData:
    """An arm as described."""
    first, second = (record(motion, seed=k) for k, motion in enumerate(motions()))
    return prepare([first], [second], Question(ROBOT, refit=True))


@pytest.mark.parametrize(("inertia", "named"), [(0.47, {"joint_1"}), (0.1, set())])
def test_a_mass_may_be_less_clear_where_the_inertia_of_its_link_is_beyond_ordinary(
    prepared: PreparedData, monkeypatch: pytest.MonkeyPatch, inertia: float, named: set[str]
) -> None:
    """Both take a part of the same inertia: 0.97 ± 0.22 of the mass is a cause beside 0.47 ± 0.075 of the tensor."""
    parameters = prepared.calibration.parameters
    alone = {"link_mass": (0.97, 0.22), "link_inertia_zz": (inertia, 0.075)}
    values, stds = -prepared.found.values, np.ones(len(parameters))
    for k, p in enumerate(parameters):
        if p.joint == "joint_1" and p.what in alone:
            value, std = (number / p.prior_std for number in alone[p.what])
            stds[k] = (1.0 + std**-2.0) ** -0.5
            values[k] += value * (1.0 - stds[k] ** 2)
    monkeypatch.setattr(faults, "posterior", lambda *_: (values, stds))
    found = faults.faults_beside(prepared, prepared.given)
    assert {fault.feature.joint for fault in found} == named
    assert all(fault.value == pytest.approx(0.97) and fault.confidence > 0.9 for fault in found)


@pytest.mark.parametrize(
    ("wrist", "places"),
    [((2e-4, 4e-4), [None]), ((2e-4, 2e-5), ["joint_1", "joint_2"]), ((0.0, 8e-5), ["joint_1", "joint_2"])],
)
def test_joints_of_which_little_shows_have_what_all_others_have_alike(
    prepared: PreparedData, monkeypatch: pytest.MonkeyPatch, wrist: tuple[float, float], places: list[str | None]
) -> None:
    """Motor torques of two joints are 2 ms late; a third that may be is, and one that is not makes it two faults."""
    parameters = prepared.calibration.parameters
    lags = {"joint_1": (2.0e-3, 2e-5), "joint_2": (2.01e-3, 1e-5), "joint_3": wrist}
    values, stds = -prepared.found.values, np.ones(len(parameters))
    for k, p in enumerate(parameters):
        if p.is_lag and p.channel == "motor_torque":
            value, std = (number / p.prior_std for number in lags[p.joint])
            stds[k] = (1.0 + std**-2.0) ** -0.5
            values[k] += value * (1.0 - stds[k] ** 2)
    monkeypatch.setattr(faults, "posterior", lambda *_: (values, stds))
    found = faults.faults_beside(prepared, prepared.given)
    assert [fault.feature.joint for fault in found] == places
    assert all(fault.value == pytest.approx(2e-3, rel=0.01) for fault in found)
