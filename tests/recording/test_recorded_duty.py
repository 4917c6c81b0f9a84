"""A servo's register of PWM: the duty that it applied makes the torque."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.errors import RecordingError, RobotError
from elastic_arm.recording import Recording, Side, load_channels, read_recording, write_recording
from elastic_arm.recording.foreign.array_export import export_arrays
from elastic_arm.recording.foreign.arrays import import_arrays
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.made_torque import (
    at_common_gain,
    with_made_torque,
    with_recorded_duty,
)
from elastic_arm.robot import JointController, Robot, load_robot
from elastic_arm.robot.arm_file import MotorEntry
from tests.helpers.bags import JOINT_STATE, joint_state, write_foreign, write_yaml

JOINTS = ("joint_1", "joint_2", "joint_3")
SUPPLY = 7.4  # V
PER_VOLT = 0.1  # Nm/V
BACK_EMF = 0.4  # V s/rad
ELECTRICS = JointController(
    kp=3.0,
    kd=PER_VOLT * BACK_EMF,
    stall=SUPPLY * PER_VOLT,
    delay=0.05,
    dead_band=0.5,
    torque=0.01,
)
RATE = 200.0
T = np.arange(400) / RATE
W = 2 * np.pi
ANGLE = 0.5 * np.sin(W * T)
DUTY = 0.9 * np.cos(3.0 * W * T + 0.3)
STAMPS = np.round(1e9 * T).astype(np.int64)


@pytest.fixture(scope="module")
def arm() -> Robot:
    """A rigid arm with electrics at every joint."""
    robot = load_robot(None)
    joints = (replace(joint, transmission=None, controller=ELECTRICS) for joint in robot.joints)
    return robot.with_(joints=tuple(joints))


def recorded(**motor: Any) -> Recording:
    """Positions of the links and the duty of the motors."""
    given = {"stamp_ns": STAMPS, "pwm": DUTY[:, None].repeat(3, axis=1)} | motor
    link = Side(STAMPS, position=ANGLE[:, None].repeat(3, axis=1))
    return Recording(JOINTS, link=link, motor=Side(**given), source="run")


def wanted(t: np.ndarray) -> np.ndarray:
    """kt/R (supply u - back_emf dq)."""
    duty = 0.9 * np.cos(3.0 * W * t + 0.3)
    return PER_VOLT * (SUPPLY * duty - BACK_EMF * 0.5 * W * np.cos(W * t))


def test_the_described_electrics_make_the_torque(arm: Robot) -> None:
    """Neither gain, delay, dead band and limit of the firmware count, nor commands."""
    commanded = replace(recorded(), reference=Side(STAMPS, position=np.zeros((400, 3))))
    for recording in (recorded(), commanded):
        made = with_made_torque(recording, arm)
        inner = slice(5, -5)  # splines need some samples
        np.testing.assert_allclose(made.motor.effort[inner, 1], wanted(T)[inner], atol=1e-5)
        assert made.motor.pwm is None and len(made.motor) == 400
        assert {own.mode for own in made.made_by.values()} == {"duty"}
        assert any("recorded duty (pwm)" in note for note in made.notes)


def test_the_gain_of_the_firmware_may_be_unknown(arm: Robot) -> None:
    """It is not needed, and without it nothing is made of commands."""
    electrics = MotorEntry(supply=SUPPLY, torque_per_volt=PER_VOLT, back_emf=BACK_EMF)
    drive = JointController(**electrics.gains())
    bare = arm.with_(joints=tuple(replace(joint, controller=drive) for joint in arm.joints))
    made = with_made_torque(recorded(), bare)
    np.testing.assert_allclose(made.motor.effort[5:-5, 1], wanted(T)[5:-5], atol=1e-5)
    told = Recording(
        JOINTS, link=recorded().link, reference=Side(STAMPS, position=np.zeros((400, 3)))
    )
    assert with_made_torque(told, bare) is told
    sweep = [replace(told, firmware_gains={"joint_1": gain}) for gain in (100.0, 400.0)]
    assert at_common_gain(bare, sweep) is bare


def test_a_duty_with_other_stamps_is_interpolated(arm: Robot) -> None:
    """Register and encoder are polled one after the other."""
    later = T + 0.002
    duty = 0.9 * np.cos(3.0 * W * later + 0.3)[:, None].repeat(3, axis=1)
    made = with_made_torque(
        recorded(stamp_ns=np.round(1e9 * later).astype(np.int64), pwm=duty), arm
    )
    t = made.motor.stamp_ns * 1e-9
    np.testing.assert_allclose(made.motor.effort[5:-5, 0], wanted(t)[5:-5], atol=1e-4)


def test_other_joints_keep_their_torque(arm: Robot) -> None:
    """A duty of one joint beside measured torques, and beside commands."""
    only = np.full((400, 3), np.nan)
    only[:, 1] = DUTY
    effort = np.ones((400, 3))
    effort[:, 1] = np.nan
    made = with_made_torque(recorded(pwm=only, effort=effort), arm)
    assert list(made.made_by) == ["joint_2"]
    assert (made.motor.effort[:, [0, 2]] == 1.0).all()
    told = replace(recorded(pwm=only), reference=Side(STAMPS, position=np.zeros((400, 3))))
    made = with_made_torque(told, arm)
    assert {name: own.mode for name, own in made.made_by.items()} == {
        "joint_1": "position",
        "joint_2": "duty",
        "joint_3": "position",
    }
    here = np.isin(STAMPS, made.motor.stamp_ns)
    np.testing.assert_allclose(made.motor.effort[5:-5, 1], wanted(T[here])[5:-5], atol=1e-5)


def test_what_the_duty_needs_is_told(arm: Robot) -> None:
    """Electrics in the description, the duty in all recordings, the motor side, no torque beside
    it, and no more than full duty."""
    bare = arm.with_joint("joint_2", controller=replace(ELECTRICS, stall=None))
    with pytest.raises(RobotError, match=r"electrics of its motor.*motor: .*or leave pwm out"):
        with_made_torque(recorded(), bare)
    with pytest.raises(RecordingError, match="run contains the pwm of joint_1, but other does not"):
        with_recorded_duty(arm, [recorded(), replace(recorded(), motor=None, source="other")])
    with pytest.raises(RecordingError, match="all joints: both effort and pwm"):
        recorded(effort=np.ones((400, 3)))
    with pytest.raises(RecordingError, match="link has a pwm"):
        Recording(JOINTS, link=recorded().motor)
    with pytest.raises(ValueError, match="no torque without a stall"):
        JointController(mode="duty")


def test_a_bag_and_arrays_keep_the_duty_apart_from_torques(tmp_path: Path) -> None:
    """It comes back bit by bit, from a topic of its own and from exported arrays."""
    bag = write_recording(tmp_path / "bag", recorded())
    export_arrays(read_recording(bag), tmp_path / "run.csv")
    for read in (
        read_recording(bag),
        read_recording(bag / "bag_0.mcap"),
        import_arrays(tmp_path / "run.csv", tmp_path / "run.yaml"),
    ):
        np.testing.assert_array_equal(read.motor.pwm, recorded().motor.pwm)
        assert read.motor.effort is None and read.motor.position is None
        assert read.link.effort is None
    words = [finding.message for finding in check_bag(bag).findings]
    assert any(
        "electrics of a `motor:` in the arm file make them of /motor_pwm" in w for w in words
    )
    chosen = read_recording(bag).select(["joint_2"])
    np.testing.assert_array_equal(chosen.motor.pwm[:, 0], DUTY)
    sensed = replace(recorded(), link=replace(recorded().link, effort=np.ones((400, 3))))
    both = read_recording(write_recording(tmp_path / "both", sensed))
    assert both.link.effort is not None and both.motor.effort is None


STRONG = 1e4  # times the torque, which this arm needs to lift itself


def lifted(arm: Robot, scale: float) -> Recording:
    """A motion under gravity with `scale` times the duty that strong electrics need."""
    t = np.arange(1200) / RATE
    phases = W * np.outer(t, [0.31, 0.47, 0.61])
    angle = 0.6 * np.sin(phases)
    slope = 0.6 * W * np.array([0.31, 0.47, 0.61])
    speed = slope * np.cos(phases)
    bend = -slope * W * np.array([0.31, 0.47, 0.61]) * np.sin(phases)
    moved, pull = ArmEquations(arm).moved_and_pulled(angle, speed, bend, motors=True)
    torque = moved + pull @ arm.gravity
    duty = scale * (torque / PER_VOLT / STRONG + BACK_EMF * speed) / SUPPLY
    stamps = np.round(1e9 * t).astype(np.int64)
    link = Side(stamps, position=angle)
    return Recording(JOINTS, link=link, motor=Side(stamps, pwm=duty), source="run")


def test_a_wrong_full_scale_shows_in_the_weight_of_the_arm(arm: Robot, tmp_path: Path) -> None:
    """Ten times too large, the duty carries a tenth of the described weight."""
    drive = replace(ELECTRICS, stall=STRONG * SUPPLY * PER_VOLT, kd=STRONG * PER_VOLT * BACK_EMF)
    arm = arm.with_(joints=tuple(replace(joint, controller=drive) for joint in arm.joints))
    for scale, told in ((1.0, False), (0.1, True)):
        bag = write_recording(tmp_path / f"bag_{scale}", lifted(arm, scale))
        found = check_bag(bag, robot=arm).findings
        words = [one.message for one in found if one.severity != "note"]
        assert any("0.1 times as large" in w and "full_scale of pwm" in w for w in words) == told
        assert told or not words


def test_a_check_tells_what_the_duty_needs(arm: Robot, tmp_path: Path) -> None:
    """A description without electrics makes no torque of it, as `diagnose` says."""
    bag = write_recording(tmp_path / "bag", recorded())
    bare = arm.with_joint("joint_2", controller=replace(ELECTRICS, stall=None))
    words = [one.message for one in check_bag(bag, robot=bare).findings if one.severity == "error"]
    assert len(words) == 1 and "no electrics of its motor" in words[0]


PWM = {"key": "load", "full_scale": 885}
ARRAYS = {
    "times": {"key": "t"},
    "joints": ["a", "b"],
    "link": {"position": {"key": "q"}},
    "motor": {"pwm": PWM},
    "ignore": [],
}


def write_arrays(folder: Path) -> Path:
    load = np.round(885 * np.column_stack([DUTY, 0.5 * DUTY]))
    q = np.column_stack([ANGLE, ANGLE])
    np.savez(folder / "a.npz", t=T, q=q, load=load)
    return folder / "a.npz"


def test_a_mapping_of_arrays_states_the_full_scale(tmp_path: Path) -> None:
    """One for all joints or one a joint, with sign and offset; null leaves none out."""
    file = write_arrays(tmp_path)
    pwm = {**PWM, "sign": [1, -1], "full_scale": [885, 442.5]}
    content = {**ARRAYS, "motor": {"pwm": pwm}}
    read = import_arrays(file, write_yaml(tmp_path / "map.yaml", content))
    np.testing.assert_allclose(read.motor.pwm, np.column_stack([DUTY, -DUTY]), atol=2e-3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"motor": {"pwm": {"key": "load"}}}, "pwm needs full_scale: .* such as 885"),
        ({"motor": {"pwm": {**PWM, "full_scale": 100}}}, "times its full_scale of 100"),
        ({"motor": {"pwm": PWM, "effort": {"key": "q", "unit": "Nm"}}}, "both effort and pwm"),
        ({"motor": {"pwm": {**PWM, "unit": "Nm"}}}, "has no unit, but full_scale"),
        ({"motor": {"pwm": {**PWM, "ratio": 2}}}, "has no ratio, but full_scale"),
        ({"motor": {}, "link": {"position": {"key": "q"}, "pwm": PWM}}, "pwm under link"),
        ({"coupling": {"b": {"b": 1.0, "a": 0.5}}}, "pwm with coupling"),
        ({"link": {"position": {"key": "q", "full_scale": 2}}}, "position has none, only pwm"),
        ({"motor": {"load": PWM}}, "the name is pwm"),
    ],
)
def test_what_is_wrong_with_a_duty_of_arrays_is_told(
    change: dict[str, Any], words: str, tmp_path: Path
) -> None:
    """Each mistake has its own words."""
    file = write_arrays(tmp_path)
    with pytest.raises(RecordingError, match=words):
        import_arrays(file, write_yaml(tmp_path / "map.yaml", {**ARRAYS, **change}))


def test_a_channel_map_states_the_full_scale(tmp_path: Path) -> None:
    """A driver has its register in the field effort, by default; wrong maps are refused."""
    rows = zip(STAMPS.tolist(), ANGLE.tolist(), np.round(885 * DUTY).tolist(), strict=True)
    messages = [
        ("/servos", JOINT_STATE, stamp, joint_state(stamp, ["servo"], [q], effort=[pwm]))
        for stamp, q, pwm in rows
    ]
    bag = write_foreign(tmp_path / "bag", messages)
    pwm = {"topic": "/servos", "full_scale": 885, "sign": -1}
    position = {"topic": "/servos"}

    def load(**motor: Any) -> Recording:
        joint = {"link": {"position": position}, "motor": motor}
        return read_recording(bag, load_channels(mapped(joints={"servo": joint})))

    def mapped(**content: Any) -> Path:
        return write_yaml(tmp_path / "map.yaml", content)

    read = load(pwm=pwm)
    np.testing.assert_allclose(read.motor.pwm[:, 0], -DUTY, atol=1e-3)
    assert read.motor.effort is None
    for motor, words in (
        ({"pwm": {**pwm, "full_scale": 500}}, "times its full_scale of 500"),
        ({"pwm": {"topic": "/servos"}}, "pwm needs full_scale"),
        ({"pwm": pwm, "effort": position}, "both effort and pwm"),
    ):
        with pytest.raises(RecordingError, match=words):
            load(**motor)
    with pytest.raises(RecordingError, match="pwm under link"):
        load_channels(mapped(joints={"servo": {"link": {"position": position, "pwm": pwm}}}))
    coupled = {"servo": {"motor": {"position": position, "pwm": pwm}}}
    with pytest.raises(RecordingError, match="pwm with coupling"):
        load_channels(mapped(joints=coupled, coupling={"servo": {"servo": 2.0}}))
