"""What a link carries beyond its description: a tool is named as that, and nothing is where none
is."""

import functools

import numpy as np
import pytest

from elastic_arm.identification import Identification, IdentificationSettings, identify
from elastic_arm.recording import Recording
from elastic_arm.recording.sides import Side
from elastic_arm.robot.urdf import parse_urdf
from tests.helpers import six_axes
from tests.helpers.nightly import nightly

pytestmark = pytest.mark.slow(10)
FRICTION = ("coulomb_friction", "viscous_friction")


@functools.cache
def identified(
    link: int, mass: float, laws: tuple[str, ...] = FRICTION, seed: int = 1
) -> Identification:
    """Identify the six-axis arm of which a link carries a body."""
    rows = six_axes.table(seed, link=link, mass=mass)
    n = len(six_axes.JOINTS)
    stamps = np.round(1e9 * rows[:, 0]).astype(np.int64)
    torque = rows[:, 1 + 2 * n :] * six_axes.TORQUE_CONSTANTS * six_axes.RATIO
    recording = Recording(
        six_axes.JOINTS,
        Side(stamps, position=rows[:, 1 : 1 + n], velocity=rows[:, 1 + n : 1 + 2 * n]),
        Side(stamps, effort=torque),
    )
    robot = parse_urdf(six_axes.urdf())
    return identify(recording, robot, IdentificationSettings(effects=laws))


@pytest.mark.parametrize("mass", [1.2, *nightly([3.5])])
def test_a_tool_is_named_with_its_mass_and_place(mass: float) -> None:
    """A tool at the flange is said first, is in robot.yaml's last link, and no other link takes
    part of it."""
    result = identified(5, mass)
    found = result.carried
    assert found is not None and found.link == "wrist_3_link" and found.last
    assert found.mass == pytest.approx(mass, abs=max(4 * found.std, 0.02 * mass))
    np.testing.assert_allclose(found.centre, six_axes.TOOL_CENTRE, atol=5e-3)
    (words,) = (one for one in result.summary() if "carries" in one)
    assert words.startswith("wrist_3_link carries") and words.endswith("a tool?")
    masses = [joint.link.mass for joint in result.identified.joints]
    expected = np.array(six_axes.MASSES)
    expected[5] += mass
    np.testing.assert_allclose(masses, expected, atol=0.15)
    assert not any("no such link" in note for note in result.notes)


def test_what_another_link_carries_is_no_tool() -> None:
    """A valve block on the forearm is said of the forearm."""
    found = identified(2, 2.0).carried
    assert found is not None and found.link == "forearm_link" and not found.last
    assert found.mass == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("seed", [1, *nightly([2])])
def test_an_arm_without_a_tool_carries_none(seed: int) -> None:
    """Of an arm that is as described nothing is said."""
    result = identified(5, 0.0, seed=seed)
    assert result.carried is None and not any("carries" in one for one in result.summary())


def test_a_payload_that_is_asked_for_is_said_once() -> None:
    """With `payload` among the laws the tool is that law's, and no further one."""
    result = identified(5, 1.2, laws=(*FRICTION, "payload"))
    assert result.carried is None


def test_a_carried_body_is_read_again(tmp_path) -> None:
    """identification.json holds it, and without it is read as before."""
    result = identified(5, 1.2)
    result.to_json(tmp_path / "identification.json")
    assert Identification.load(tmp_path / "identification.json").carried == result.carried


@pytest.mark.parametrize("seed", [1, *nightly([2, 3])])
def test_friction_that_is_not_asked_for_is_no_elastic_joint(seed: int) -> None:
    """Rigid joints whose friction nobody identifies get the advice to do so, and no resonance."""
    notes = [note for note in identified(5, 0.0, (), seed).notes if "the residual is" in note]
    assert len(notes) > 3
    for note in notes:
        assert "identify its friction" in note and "elastic" not in note
