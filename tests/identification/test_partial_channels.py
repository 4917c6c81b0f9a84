"""Link encoders at three of six joints: each joint is identified by the channels that it has."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.errors import IdentificationError
from elastic_arm.identification import (
    Identification,
    IdentificationSettings,
    identifier_of,
    identify,
)
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot
from tests.helpers.partial_arm import ENCODERS, recordings, robot

pytestmark = pytest.mark.slow(30)


@pytest.fixture(scope="module")
def found() -> Identification:
    (recording,) = recordings(seconds=(10.0,))
    return identify(recording, _softer(robot()), IdentificationSettings(consistent=False))


def _softer(described: Robot) -> Robot:
    """Return a description whose drives are too soft by a fifth."""
    drives = [
        replace(j.transmission, stiffness=0.8 * j.transmission.stiffness)
        for j in described.joints
        if j.transmission
    ]
    joints = (
        replace(j, transmission=drive) for j, drive in zip(described.joints, drives, strict=True)
    )
    return described.with_(joints=tuple(joints))


@pytest.mark.nightly
def test_joints_with_both_encoders_have_an_equation_of_their_deflection(
    found: Identification,
) -> None:
    """The link's equation is that of three joints, the motor torque's that of all, with residuals
    as large as noise."""
    assert {side: len(by_joint) for side, by_joint in found.noise.items()} == {
        "link": ENCODERS,
        "motor": 6,
    }
    assert max(found.noise["motor"].values()) < 0.15


@pytest.mark.nightly
def test_stiffnesses_come_out_where_both_encoders_show_the_deflection(
    found: Identification,
) -> None:
    """Three stiffnesses within 3 %, and none of the other joints, whose springs are bridged."""
    values = {e.name: e.value for e in found.estimates}
    names = robot().joint_names
    for joint in robot().joints[:ENCODERS]:
        assert joint.transmission is not None
        assert values[f"{joint.name}.K"] == pytest.approx(joint.transmission.stiffness, rel=0.03)
    assert not [
        name
        for name in values
        if name.partition(".")[0] in names[ENCODERS:] and name.endswith(".K")
    ]


@pytest.mark.nightly
def test_gravity_of_the_wrist_is_identified_without_its_encoders(found: Identification) -> None:
    """Base parameters of all links are within four deviations of the arm's, whatever encoders their
    joints have."""
    true = identify_nominal(robot())
    known = [
        e
        for e in found.estimates
        if e.verdict == "well" and not e.name.endswith((".K", ".D", "offset", "delay"))
    ]
    wrist = [e for e in known if "link_4" in e.name or "link_5" in e.name or "link_6" in e.name]
    assert len(known) > 15 and wrist
    assert max(abs(e.value - true[e.name]) / e.std for e in known) < 4.0


def identify_nominal(described: Robot) -> dict[str, float]:
    """Return the base parameters of a description."""
    identifier = identifier_of(described, encoder_columns=True)
    (recording,) = recordings(seconds=(10.0,))
    equations = identifier.choose_equations(recording.samples())
    return dict(zip(equations.base.names, equations.base.T @ equations.nominal, strict=True))


def test_recordings_whose_joints_differ_in_channels_are_refused() -> None:
    """A channel that a joint has in one recording only is named as the trouble."""
    (recording,) = recordings(seconds=(2.0,))
    assert recording.motor is not None and recording.motor.position is not None
    position = recording.motor.position.copy()
    whole = Recording(
        recording.joints, replace(recording.motor, effort=None, position=position), recording.motor
    )
    identifier = identifier_of(robot())
    identifier.choose_equations(recording.samples())
    with pytest.raises(IdentificationError, match="not at the same joints"):
        identifier.choose_equations(whole.samples())


def test_residuals_of_absent_equations_are_null() -> None:
    """Rows of an equation that a joint lacks hold nothing, so that they weigh nothing."""
    (recording,) = recordings(seconds=(2.0,))
    identifier = identifier_of(robot())
    equations = identifier.choose_equations(recording.samples())
    live = equations.equations.live.reshape(2, 6)
    np.testing.assert_array_equal(live, [[True] * ENCODERS + [False] * (6 - ENCODERS), [True] * 6])
