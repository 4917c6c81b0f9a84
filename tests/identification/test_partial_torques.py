"""Torques at two of three joints: each joint is identified by the channels that it has."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from elastic_arm.effects.text import parse_laws
from elastic_arm.identification import Identification, IdentificationSettings, identify
from elastic_arm.recording import Recording, Side
from tests.helpers.gap_recordings import ROBOT, motions, record
from tests.helpers.nightly import nightly

BARE = "joint_2"
FRICTION = {"joint_1": 4.0, "joint_2": 3.0, "joint_3": 2.0}  # Nm


def without(side: Side | None, joint: str) -> Side:
    """Return a side without the torque of a joint."""
    assert side is not None and side.effort is not None
    effort = side.effort.copy()
    effort[:, ROBOT.joint_names.index(joint)] = np.nan
    return replace(side, effort=effort)


@cache
def whole() -> Recording:
    """Return a recording with friction at every joint."""
    effects = [f"coulomb_friction:{joint}:torque={size}" for joint, size in FRICTION.items()]
    return record(motions()[0].repeated(2), *effects)


@cache
def found(side: str) -> Identification:
    """Return the identification by the torques of one side, without that of a joint, beside
    friction at all joints."""
    recording = whole()
    assert recording.link is not None
    link = replace(recording.link, effort=None)
    kept = {
        "link": replace(recording, link=without(recording.link, BARE), motor=None),
        "motor": replace(recording, link=link, motor=without(recording.motor, BARE)),
    }[side]
    laws = parse_laws([f"coulomb_friction:side={side}"], ROBOT)
    return identify(kept, ROBOT, IdentificationSettings(effects=laws, consistent=False))


@pytest.mark.parametrize("side", ["link", *nightly(["motor"])])
def test_the_equation_of_a_joint_without_a_torque_is_left_out(side: str) -> None:
    """It has no residual of that torque, and its own friction is left out, with a note; the result
    is finite.

    Nothing else of it is left out where both encoders give the equation of its link.
    """
    result = found(side)
    torques = {"link": "joint", "motor": "motor"}[side]
    assert set(result.noise[torques]) == set(FRICTION) - {BARE}
    assert not [e.name for e in result.estimates if e.name.startswith(f"coulomb_friction:{BARE}")]
    assert any(note.startswith(f"{BARE}: no torque was recorded") for note in result.notes) == (
        side == "link"
    )
    assert any(note.startswith(f"coulomb_friction:{BARE}: excluded") for note in result.notes)
    assert all(np.isfinite([e.value, e.std]).all() for e in result.estimates)


def test_friction_of_the_other_joints_is_identified() -> None:
    """Coulomb friction of the motors that have a torque comes out within five deviations, and
    within a tenth."""
    values = {e.name: e for e in found("motor").estimates}
    for joint in set(FRICTION) - {BARE}:
        estimate = values[f"coulomb_friction:{joint}.torque"]
        assert estimate.value == pytest.approx(FRICTION[joint], rel=0.1)
        assert abs(estimate.value - FRICTION[joint]) < 5.0 * estimate.std


def test_deflection_shows_the_load_of_a_joint_without_a_torque() -> None:
    """Both encoders of the joint give the equation of its link, and its stiffness."""
    result = found("motor")
    assert set(result.noise["link"]) == set(FRICTION)
    transmission = ROBOT.joints[1].transmission
    assert transmission is not None
    values = {e.name: e.value for e in result.estimates}
    assert values[f"{BARE}.K"] == pytest.approx(transmission.stiffness, rel=0.05)
