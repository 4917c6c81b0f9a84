"""The recorded voltage of a servo's supply: it makes the torque of a duty."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from elastic_arm.recording import Recording, Side, load_channels, read_recording, write_recording
from elastic_arm.recording.foreign.array_export import export_arrays
from elastic_arm.recording.foreign.arrays import import_arrays
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.made_torque import with_made_torque
from elastic_arm.robot import JointController, Robot, load_robot
from tests.helpers.bags import JOINT_STATE, joint_state, write_foreign, write_yaml
from tests.recording.test_recorded_duty import (
    ANGLE,
    BACK_EMF,
    DUTY,
    JOINTS,
    PER_VOLT,
    STAMPS,
    SUPPLY,
    T,
    W,
)

ELECTRICS = JointController(kd=PER_VOLT * BACK_EMF, stall=SUPPLY * PER_VOLT, supply=SUPPLY)
VOLTS = SUPPLY + 1.5 * np.sin(0.7 * W * T)


@pytest.fixture(scope="module")
def arm() -> Robot:
    """A rigid arm with electrics and a stated supply at every joint."""
    robot = load_robot(None)
    joints = (replace(joint, transmission=None, controller=ELECTRICS) for joint in robot.joints)
    return robot.with_(joints=tuple(joints))


def recorded(volts: np.ndarray = VOLTS) -> Recording:
    """Positions of the links, and duty and supply voltage of the motors."""
    link = Side(STAMPS, position=ANGLE[:, None].repeat(3, axis=1))
    supply = volts[:, None].repeat(3, axis=1)
    motor = Side(STAMPS, pwm=DUTY[:, None].repeat(3, axis=1), supply=supply)
    return Recording(JOINTS, link=link, motor=motor, source="run")


def wanted(volts: np.ndarray) -> np.ndarray:
    """kt/R (supply u - back_emf dq)."""
    return PER_VOLT * (volts * DUTY - BACK_EMF * 0.5 * W * np.cos(W * T))


def test_the_recorded_voltage_makes_the_torque(arm: Robot) -> None:
    """Also where it exceeds the stated one at full duty; a joint without it has the stated one."""
    run = recorded()
    assert run.motor is not None and run.motor.supply is not None
    run.motor.supply[:, 2] = np.nan
    made = with_made_torque(run, arm)
    assert made.motor is not None and made.motor.effort is not None
    inner = slice(5, -5)  # splines need some samples
    np.testing.assert_allclose(made.motor.effort[inner, 1], wanted(VOLTS)[inner], atol=1e-5)
    stated = wanted(np.full_like(T, SUPPLY))
    np.testing.assert_allclose(made.motor.effort[inner, 2], stated[inner], atol=1e-5)
    assert made.motor.supply is None
    assert any("duty of joint_1, joint_2 is one of the recorded" in note for note in made.notes)


def test_a_voltage_beside_no_stated_one_is_not_used(arm: Robot) -> None:
    """The torque is that of the stall torque."""
    bare = replace(ELECTRICS, supply=None)
    unstated = arm.with_(joints=tuple(replace(joint, controller=bare) for joint in arm.joints))
    made = with_made_torque(recorded(), unstated)
    assert made.motor is not None and made.motor.effort is not None
    stated = wanted(np.full_like(T, SUPPLY))
    np.testing.assert_allclose(made.motor.effort[5:-5, 1], stated[5:-5], atol=1e-5)


def test_a_bag_and_arrays_keep_the_voltage(tmp_path: Path) -> None:
    """It comes back bit by bit, from a topic of its own and from exported arrays."""
    bag = write_recording(tmp_path / "bag", recorded())
    export_arrays(read_recording(bag), tmp_path / "run.csv")
    for read in (read_recording(bag), import_arrays(tmp_path / "run.csv", tmp_path / "run.yaml")):
        assert read.motor is not None
        np.testing.assert_array_equal(read.motor.supply, recorded().motor.supply)  # type: ignore[union-attr]
        np.testing.assert_array_equal(read.motor.pwm, recorded().motor.pwm)  # type: ignore[union-attr]
        assert read.motor.effort is None


@pytest.mark.parametrize(
    ("volts", "words"),
    [
        (VOLTS, ""),
        (10.0 * VOLTS, r"supply of joint_1 is 80.1 V, where the description states 7.4 V"),
    ],
)
def test_a_check_names_a_voltage_far_from_the_stated_one(
    arm: Robot, tmp_path: Path, volts: np.ndarray, words: str
) -> None:
    """A register in tenths of a volt is found; a battery that varies by a fifth is not."""
    bag = write_recording(tmp_path / "bag", recorded(volts))
    found = check_bag(bag, robot=arm).findings
    said = [finding.message for finding in found if finding.code == "supply"]
    assert len(said) == (3 if words else 0)
    assert not words or said[0].startswith(words)
    unstated = arm.with_joint("joint_2", controller=replace(ELECTRICS, supply=None))
    codes = [one for one in check_bag(bag, robot=unstated).findings if one.code == "supply"]
    assert any("states no supply voltage of joint_2" in one.message for one in codes)


def test_a_register_of_tenths_is_mapped(tmp_path: Path) -> None:
    """In arrays and in a channel map, by a factor; on other sides and with a ratio it is
    refused."""
    rows = zip(STAMPS.tolist(), ANGLE.tolist(), np.round(10.0 * VOLTS).tolist(), strict=True)
    messages = []
    for stamp, angle, tenths in rows:
        for topic, effort in (("/servos", 0.0), ("/volts", tenths)):
            message = joint_state(stamp, ["servo"], [angle], effort=[effort])
            messages.append((topic, JOINT_STATE, stamp, message))
    bag = write_foreign(tmp_path / "bag", messages)
    supply = {"topic": "/volts", "factor": 0.1}
    position = {"topic": "/servos"}

    def load(link: dict[str, Any], motor: dict[str, Any]) -> Recording:
        joints = {"servo": {"link": link, "motor": motor}}
        return read_recording(
            bag, load_channels(write_yaml(tmp_path / "map.yaml", {"joints": joints}))
        )

    read = load({"position": position}, {"supply": supply})
    assert read.motor is not None
    np.testing.assert_allclose(read.motor.supply[:, 0], VOLTS, atol=0.051)  # type: ignore[index]
    with pytest.raises(RecordingError, match="supply under link: it is of the motor"):
        load({"position": position, "supply": supply}, {})
    with pytest.raises(RecordingError, match="supply is a voltage and has no ratio"):
        load({"position": position}, {"supply": {**supply, "ratio": 2.0}})
    np.savez(tmp_path / "a.npz", t=T, q=ANGLE[:, None], volts=np.round(10.0 * VOLTS)[:, None])
    content = {
        "times": {"key": "t"},
        "joints": ["a"],
        "link": {"position": {"key": "q"}},
        "motor": {"supply": {"key": "volts", "factor": 0.1}},
        "ignore": [],
    }
    array = import_arrays(tmp_path / "a.npz", write_yaml(tmp_path / "import.yaml", content))
    assert array.motor is not None
    np.testing.assert_allclose(array.motor.supply[:, 0], VOLTS, atol=0.051)  # type: ignore[index]
