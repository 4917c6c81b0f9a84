"""Torques against the gravity of the description: wrong signs and mountings are found, right ones
are not blamed."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from elastic_arm.cli.application import app
from elastic_arm.cli.options import ClockChoice, read_by_clock
from elastic_arm.dynamics import build_model
from elastic_arm.recording import Recording, Side, read_recording, write_recording
from elastic_arm.recording.inspection.check import check_bag, doubts, misread
from elastic_arm.recording.inspection.described_gravity import (
    _comparisons,
    _findings,
    contradicted,
    misread_channels,
)
from elastic_arm.recording.inspection.report import Finding
from elastic_arm.recording.inspection.side_motion import side_motions
from elastic_arm.robot import Robot, load_robot, parse_urdf, save_robot
from elastic_arm.robot.parts import Limits
from tests.helpers import six_axes
from tests.helpers.nightly import nightly
from tests.helpers.random_arms import random_arm
from tests.helpers.shared_data import DATA, needs_data

REPORTS = DATA / "public_reports_2"
Array = NDArray[np.float64]
DOWN = np.array([0.0, 0.0, -9.81])
RATE = 200.0


def arm(seed: int = 2, *, elastic: bool = False) -> Robot:
    """An arm of four joints that stands on the floor."""
    return random_arm(4, np.random.default_rng(seed), elastic=elastic).with_(gravity=DOWN)


def recorded(
    robot: Robot,
    gravity: Array = DOWN,
    side: str = "link",
    speed: float = 1.0,
    flipped: Sequence[int] = (),
    seconds: float = 20.0,
    noise: float = 0.1,
) -> Recording:
    """Sines, with torques of the arm under some gravity, friction, zeros and noise; `flipped` have
    the other sign."""
    rng = np.random.default_rng(5)
    n = robot.n
    t = np.arange(round(seconds * RATE))[:, None] / RATE
    w = speed * rng.uniform(0.5, 2.0, (2, n))
    phase = rng.uniform(-3.0, 3.0, (2, n))
    rates = [
        sum(0.6 * w[k] ** d * np.sin(w[k] * t + phase[k] + d * np.pi / 2) for k in range(2))
        for d in range(3)
    ]
    true = robot.with_(gravity=gravity)
    rows = build_model(true, "mod3").inverse_dynamics(
        *(np.hstack([r, r]) if robot.elastic else r for r in rates)
    )
    torque = 1.2 * (rows[:, :n] + (rows[:, n:] if robot.elastic and side == "motor" else 0.0))
    friction = 0.1 * np.std(torque, axis=0) * np.sign(rates[1])
    torque += friction + rng.normal(0.0, noise, torque.shape) + rng.normal(0.0, 0.5, n)
    torque[:, list(flipped)] *= -1.0
    stamp_ns = 10**18 + np.rint(1e9 * t[:, 0]).astype(np.int64)
    position = Side(stamp_ns, rates[0], rates[1])
    effort = Side(stamp_ns, effort=torque)
    if side == "motor":
        return Recording(robot.joint_names, link=position, motor=effort)
    return Recording(robot.joint_names, link=position.filled(effort))


def contradicted_gravity(recording: Recording, robot: Robot) -> list[Finding]:
    return contradicted([*side_motions(recording, robot)], robot)


@pytest.mark.parametrize(("of", "kept"), [(3, 2), (10, 7), (10, 2)])
def test_samples_lost_in_a_pattern_are_no_other_gravity(of: int, kept: int) -> None:
    """Rates over the samples that are left are rates over time; where holes are everywhere, nothing
    is told."""
    whole = recorded(arm(), speed=3.0)
    left = np.arange(len(whole.link or ())) % of < kept
    lossy = replace(whole, **{name: side.at(left) for name, side in whole.sides().items()})  # type: ignore[arg-type]
    assert contradicted_gravity(lossy, arm()) == []
    for (_, motion), (_, true) in zip(
        side_motions(lossy, arm()), side_motions(whole, arm()), strict=True
    ):
        if len(motion.q):
            assert motion.ddq.std(axis=0) == pytest.approx(true.ddq.std(axis=0), rel=0.1)


@pytest.mark.parametrize("seed", [0, *nightly([1, 2, 3])])
@pytest.mark.parametrize("speed", [0.3, 1.0, 4.0])
def test_right_signs_are_not_blamed(seed: int, speed: float) -> None:
    """However fast the arm moves: torques of inertia run against gravity where links point
    upwards."""
    assert contradicted_gravity(recorded(arm(seed), speed=speed), arm(seed)) == []


@pytest.mark.parametrize(
    ("side", "elastic"), [("link", False), ("motor", False), ("link", True), ("motor", True)]
)
def test_a_joint_of_the_wrong_sign_is_named(side: str, elastic: bool) -> None:
    """With the factor of its gravity, and the joints whose sign is right; of rigid and of elastic
    arms."""
    robot = arm(elastic=elastic)
    (finding,) = contradicted_gravity(recorded(robot, side=side, flipped=[1]), robot)
    words = finding.message
    assert finding.code == "gravity_sign"
    assert words.startswith(
        f"{side} side: the torque of joint_2 has the opposite sign of the description"
    )


def test_findings_are_those_of_the_joints_with_a_measured_torque() -> None:
    """Findings are kept by motion; the same samples with fewer measured torques are another
    motion."""
    robot = arm()
    ((side, motion),) = side_motions(recorded(robot, flipped=(1,)), robot)
    fewer = motion._replace(measured=[0, 2, 3])
    assert [one.code for one in contradicted([(side, motion)], robot)] == ["gravity_sign"]
    assert contradicted([(side, fewer)], robot) == contradicted([(side, fewer)], arm()) == []


def test_findings_that_are_kept_cannot_be_changed() -> None:
    """A caller that changes the list of findings changes no later one."""
    robot = arm()
    motions = list(side_motions(recorded(robot, flipped=(1,)), robot))
    first = contradicted(motions, robot)
    kept = list(first)
    first.clear()
    assert contradicted(motions, robot) == kept
    for comparison in _comparisons(motions, robot):
        assert all(type(findings) is tuple for findings in _findings(comparison))
        assert not comparison.motion.torque.flags.writeable


def test_another_unit_of_an_angle_is_the_only_finding(tmp_path: Path) -> None:
    """Degrees taken as radians at one joint: what its torques then resemble is a consequence. The
    torques at right angles stay compared where only the velocity has another unit."""
    robot = random_arm(3, np.random.default_rng(0), elastic=False).with_(gravity=DOWN)
    for joint in robot.joints:
        robot = robot.with_joint(joint.name, limits=Limits(-2.0, 2.0))
    right = recorded(robot, side="motor", speed=0.3, noise=0.02)
    degrees = np.where(np.arange(robot.n) == 1, 180.0 / np.pi, 1.0)
    wrong = replace(right, link=replace(right.link, position=right.link.position * degrees))
    wrong = replace(wrong, link=replace(wrong.link, velocity=right.link.velocity * degrees))
    assert contradicted_gravity(wrong, robot)
    (words,) = doubts(wrong, robot)
    assert "check the unit (degrees taken as radians)" in words
    write_recording(tmp_path / "bag", wrong)
    found = check_bag(tmp_path / "bag", robot=robot).findings
    assert [one.code for one in found if one.severity == "warning"] == ["beyond_limits"]
    assert words in (misread([wrong], robot) or "")
    flipped = recorded(arm(), flipped=[1], speed=2.0)
    fast = replace(
        flipped, link=replace(flipped.link, velocity=flipped.link.velocity * 180 / np.pi)
    )
    assert any("joint_2 has the opposite sign" in one for one in doubts(fast, arm()))


def test_the_parts_of_a_recording_are_judged_together() -> None:
    """A wrong sign of which no part of two seconds tells is told by ten of them."""
    robot = arm()
    recording = recorded(robot, flipped=[1], noise=20.0)
    each = [[*side_motions(recording.between(t, t + 2.0), robot)] for t in range(0, 20, 2)]
    assert not any(contradicted(motion, robot) for motion in each)
    (finding,) = contradicted([one for motion in each for one in motion], robot)
    assert finding.code == "gravity_sign" and "joint_2" in finding.message


@pytest.mark.parametrize(
    ("which", "words"),
    [
        ("all signs", "all torques have the wrong sign"),
        ("the mounting", "the arm is mounted upside down"),
    ],
)
def test_inertia_tells_signs_of_all_torques_from_an_arm_upside_down(which: str, words: str) -> None:
    """Gravity is reversed in both, inertia and friction in one of them."""
    robot = arm()
    gravity = DOWN if which == "all signs" else -DOWN
    (finding,) = contradicted_gravity(
        recorded(robot, gravity, speed=0.3, flipped=range(4) if which == "all signs" else ()), robot
    )
    assert words in finding.message
    assert "either" not in finding.message


def test_a_creeping_arm_does_not_tell_its_mounting() -> None:
    """Without inertia and friction both readings are named."""
    (finding,) = contradicted_gravity(recorded(arm(), -DOWN, speed=0.05, noise=0.3), arm())
    assert "either all torques" in finding.message and "upside down" in finding.message


@needs_data
@pytest.mark.parametrize(
    ("run", "words"),
    [
        ("ceiling/s_ceil_1", "the arm is mounted upside down"),
        ("ceiling/s_ceil_2", "the arm is mounted upside down"),
        ("compensated_with_tool/s_comp_1", "the gravity of about 1.5 kg on the last link"),
        ("compensated_with_tool/s_comp_2", "the gravity of about 1.5 kg on the last link"),
    ],
)
def test_mounting_and_compensation_of_the_reports(run: str, words: str) -> None:
    """On a ceiling, and without the arm's gravity while a tool hangs at the flange: no unit and no
    sign is blamed."""
    robot = load_robot(REPORTS / run.partition("/")[0] / "b.urdf")
    (finding,) = contradicted_gravity(read_recording(REPORTS / run), robot)
    assert words in finding.message
    assert "wrong sign" not in finding.message and "unit" not in finding.message
    assert ("gravity was subtracted" in finding.message) == run.startswith("compensated")


@pytest.mark.parametrize("mass", [0.0, six_axes.TOOL])
def test_another_unit_beside_a_tool_is_a_unit(mass: float) -> None:
    """Torques ten times too small of an arm that carries a tool which is not described."""
    recording = six_axes_recorded(np.zeros(6), mass)
    assert recording.motor is not None and recording.motor.effort is not None
    small = replace(recording.motor, effort=0.1 * recording.motor.effort)
    (finding,) = contradicted_gravity(replace(recording, motor=small), parse_urdf(six_axes.urdf()))
    assert finding.code == "gravity_size"


def test_an_arm_on_a_wall_has_no_torques_of_the_wrong_sign() -> None:
    """Its gravity is stated by the check of the bag; the commands that fit look for the mounting
    themselves."""
    robot = arm()
    recording = recorded(robot, np.array([0.0, 9.81, 0.0]))
    (finding,) = contradicted_gravity(recording, robot)
    assert finding.code == "mounting" and "but the description has 0 0 -9.81" in finding.message


def test_little_is_concluded_from_little() -> None:
    """A single sweep through half a period may be anything; less than a second of samples is not
    looked at."""
    robot = arm()
    assert contradicted_gravity(recorded(robot, flipped=range(4), seconds=0.9), robot) == []
    weightless = robot.with_(gravity=np.zeros(3))
    assert contradicted_gravity(recorded(robot, flipped=[1]), weightless) == []


def test_check_and_the_commands_that_fit_say_so(tmp_path: Path) -> None:
    """One finding of `bag check --robot`, and a note of the recording that `identify` and
    `diagnose` read."""
    robot = arm()
    bag = write_recording(tmp_path / "bag", recorded(robot, flipped=[1]))
    (finding,) = [
        finding
        for finding in check_bag(bag, robot=robot).findings
        if finding.code == "gravity_sign"
    ]
    assert not check_bag(bag, robot=robot).ok
    notes = read_by_clock(bag, None, robot, ClockChoice.auto).notes
    assert f"{bag}: {finding.message}." in notes


@pytest.mark.parametrize(
    ("factor", "words"), [(1e-3, "torques in kNm taken for Nm"), (121.0, "Nm_motor with its ratio")]
)
def test_torques_of_a_wrong_unit_are_named_with_their_factor(factor: float, words: str) -> None:
    """What follows gravity a thousand times too small is in another unit; 1.2 times is a matter of
    masses."""
    robot = arm()
    recording = recorded(arm(), speed=0.3)
    wrong = replace(recording, link=replace(recording.link, effort=factor * recording.link.effort))
    (finding,) = contradicted_gravity(wrong, robot)
    assert finding.code == "gravity_size" and words in finding.message
    assert "follows the predicted gravity" in finding.message


def test_angles_taken_for_degrees_show_in_gravity() -> None:
    """Positions and velocities 57 times too small agree with each other: the torques swing too much
    for them."""
    robot = arm(4)
    recording = recorded(robot, speed=0.3)
    link = recording.link
    small = replace(link, position=np.radians(link.position), velocity=np.radians(link.velocity))
    (finding,) = contradicted_gravity(replace(recording, link=small), robot)
    assert (
        finding.code == "gravity_size" and "angles in radians taken for degrees" in finding.message
    )


def arranged(
    recording: Recording, side: str, order: Sequence[int], signs: Sequence[float], which: str
) -> Recording:
    """The recording with columns of its torques, of its angles, or of all channels in another order
    and with signs."""
    changed = {}
    for name, one in recording.measured().items():
        of_torque = ("effort",) if which != "angles" else ()
        of_angle = ("position", "velocity") if which != "torques" else ()
        kept = {
            k: v[:, list(order)] * signs
            for k, v in one.channels().items()
            if k in (*of_torque, *of_angle)
        }
        changed[name] = replace(one, **kept)
    return replace(recording, **changed)


def heavier(robot: Robot) -> Robot:
    """The arm with masses that are half as large again: descriptions are never right."""
    links = [
        replace(joint.link, mass=1.5 * joint.link.mass, inertia=1.5 * joint.link.inertia)
        for joint in robot.joints
    ]
    return robot.with_(
        joints=tuple(replace(j, link=link) for j, link in zip(robot.joints, links, strict=True))
    )


ONES = (1.0, 1.0, 1.0, 1.0)


@pytest.mark.parametrize("wrong", [(), (5,), *nightly([((4,),), (tuple(range(6)),)])])
def test_mirrored_joints_of_a_noisy_arm_of_six_are_named(wrong: tuple[int, ...]) -> None:
    """Angle and torque, by noise as large as the torques of a wrist: those that are mirrored, and
    no others."""
    robot = random_arm(6, np.random.default_rng(2), elastic=False).with_(gravity=DOWN)
    signs = np.where(np.isin(np.arange(6), wrong), -1.0, 1.0)
    given = arranged(recorded(robot, noise=1.0), "link", range(6), signs.tolist(), "all")
    found = contradicted_gravity(given, heavier(robot))
    assert {finding.code for finding in found} <= {"mirrored"}
    names = ("every joint",) if len(wrong) == 6 else tuple(robot.joint_names[k] for k in wrong)
    assert [f.message.partition(" turns")[0] for f in found] == [
        f"link side: {name}" for name in names
    ]


TORQUES = (
    (0, 2, 1, 3),
    ONES,
    "torques",
    "exchanged",
    "efforts of joint_2 and joint_3 seem to be exchanged",
)
MIRRORED = (
    (0, 1, 2, 3),
    (1.0, 1.0, -1.0, 1.0),
    "all",
    "mirrored",
    "joint_3 turns in the opposite direction of the description",
)
OTHERS = [
    (
        (3, 1, 2, 0),
        ONES,
        "all",
        "exchanged",
        "all channels of joint_1 and joint_4 seem to be exchanged",
    ),
    ((3, 2, 1, 0), ONES, "all", "exchanged", "all channels are in reversed joint order"),
    (
        (0, 1, 2, 3),
        (1.0, 1.0, -1.0, 1.0),
        "angles",
        "mirrored",
        "the angle of joint_3 has the opposite sign",
    ),
]
LINK = ("link", False, 2)
MOTOR = ("motor", True, 3)


@pytest.mark.parametrize(
    ("side", "elastic", "seed", "order", "signs", "which", "code", "words"),
    [
        *((*LINK, *case) for case in (TORQUES, MIRRORED, *OTHERS)),
        *((*MOTOR, *case) for case in (TORQUES, MIRRORED)),
        *nightly((*MOTOR, *case) for case in OTHERS),
    ],
)
def test_joints_and_channels_that_were_confused_are_named(
    side: str,
    elastic: bool,
    seed: int,
    order: Sequence[int],
    signs: Sequence[float],
    which: str,
    code: str,
    words: str,
) -> None:
    """By the geometry: whatever the masses, and whether the joint carries any gravity."""
    robot = arm(seed, elastic=elastic)
    wrong = arranged(recorded(robot, side=side), side, order, signs, which)
    (finding,) = contradicted_gravity(wrong, heavier(robot))
    assert finding.code == code and words in finding.message


@pytest.mark.parametrize(
    ("left", "words"), [(0.0, "contains no gravity"), (0.3, "contains only part of the gravity")]
)
def test_torques_without_gravity_are_named_with_the_correlation(left: float, words: str) -> None:
    """Where the compensation of the arm's weight was subtracted, wholly or in part."""
    robot = arm()
    (finding,) = contradicted_gravity(recorded(robot, left * DOWN), robot)
    assert (
        finding.code == "gravity_missing"
        and words in finding.message
        and "correlation" in finding.message
    )


@pytest.mark.parametrize(("share", "joints"), [(0.7, [1]), (0.4, [0, 1, 2, 3])])
def test_a_share_of_gravity_that_was_taken_is_named_with_its_size(
    share: float, joints: list[int]
) -> None:
    """Of one joint, or less than half of all joints' weight, where the torques have a gain of
    1.2."""
    robot = arm()
    whole, without = (recorded(robot, down, speed=2.0) for down in (DOWN, 0.0 * DOWN))
    effort = whole.link.effort.copy()
    effort[:, joints] += share * (without.link.effort - whole.link.effort)[:, joints]
    given = replace(whole, link=replace(whole.link, effort=effort))
    (finding,) = contradicted_gravity(given, robot)
    assert (
        finding.code == "gravity_missing"
        and ("all joints" if len(joints) > 1 else "joint_2") in finding.message
    )
    size, _, std = finding.message.partition("share of ")[2].split()[:3]
    assert abs(float(size) - share) < 4.0 * float(std) + 0.2 * share


@pytest.mark.parametrize(
    ("side", "elastic", "seed", "joint"),
    [("motor", True, 2, 0), *nightly([("link", False, 2, 1), ("motor", False, 3, 0)])],
)
def test_a_joint_whose_zero_is_elsewhere_is_named_with_the_angle(
    side: str, elastic: bool, seed: int, joint: int
) -> None:
    """0.08 rad at one joint, whatever the masses; of the last joint it is another mass, and nothing
    is said."""
    robot = arm(seed, elastic=elastic)
    recording = recorded(robot, side=side)
    link = recording.link
    assert link is not None and link.position is not None

    def found(j: int) -> list[Finding]:
        position = link.position + 0.08 * np.eye(4)[j]
        return contradicted_gravity(
            replace(recording, link=replace(link, position=position)), heavier(robot)
        )

    (finding,) = found(joint)
    assert finding.code == "other_zero" and f"the zero of joint_{joint + 1}" in finding.message
    offset, _, std = finding.message.partition("differ by ")[2].split()[:3]
    assert abs(float(offset) - 0.08) < 4.0 * float(std) < 0.02
    assert found(3) == []


def six_axes_recorded(zeros: Array, mass: float, gains: Array | float = 1.0) -> Recording:
    """Angles and motor torques of a six-axis arm with friction, a tool and joint zeros."""
    rng = np.random.default_rng(102)
    t, q, dq, ddq = six_axes.motion(2)
    torque = gains * six_axes.torques(q, dq, ddq, mass=mass)
    torque += 0.01 * np.abs(torque).max(axis=0) * rng.normal(size=torque.shape)
    stamp_ns = np.rint(1e9 * t).astype(np.int64)
    read = q + zeros + 2e-5 * rng.normal(size=q.shape)
    return Recording(six_axes.JOINTS, Side(stamp_ns, read), Side(stamp_ns, effort=torque))


@pytest.mark.parametrize("size", [-0.04, *nightly([0.04])])
@pytest.mark.parametrize("joint", [1, *nightly([2, 3])])
def test_a_zero_of_40_mrad_is_named_beside_a_tool(joint: int, size: float) -> None:
    """Either way round, of an arm whose links are as described: only the last one carries
    more."""
    recording = six_axes_recorded(size * np.eye(6)[joint], six_axes.TOOL)
    (finding,) = contradicted_gravity(recording, parse_urdf(six_axes.urdf()))
    assert finding.code == "other_zero"
    assert f"the zero of {six_axes.JOINTS[joint]} seems" in finding.message
    offset, _, std = finding.message.partition("differ by ")[2].split()[:3]
    assert abs(float(offset) - size) < 4.0 * float(std) < 0.03


@pytest.mark.parametrize("mass", [six_axes.TOOL, *nightly([0.0])])
def test_an_arm_of_six_joints_upside_down_has_no_joint_of_the_wrong_sign(mass: float) -> None:
    """All gravity is reversed, but not the inertia."""
    recording = six_axes_recorded(np.zeros(6), mass)
    _, q, _, _ = six_axes.motion(2)
    weight = six_axes.torques(q, np.zeros_like(q), np.zeros_like(q), mass=mass)
    assert recording.motor is not None and recording.motor.effort is not None
    reversed_ = replace(recording.motor, effort=recording.motor.effort - 2.0 * weight)
    robot = parse_urdf(six_axes.urdf())
    (finding,) = contradicted_gravity(replace(recording, motor=reversed_), robot)
    assert finding.code in ("gravity_sign", "mounting")
    assert "mounted" in finding.message
    assert misread_channels(replace(recording, motor=reversed_), robot, weight=False) is None


@pytest.mark.parametrize("mass", [six_axes.TOOL, *nightly([0.0])])
def test_a_tool_and_other_torque_constants_are_no_zero(mass: float) -> None:
    """Gains of 10 % and a tool of 1.2 kg: nothing is said."""
    gains = np.array([1.1, 0.9, 1.05, 1.1, 0.95, 0.9])
    recording = six_axes_recorded(np.zeros(6), mass, gains)
    assert contradicted_gravity(recording, parse_urdf(six_axes.urdf())) == []


def test_no_arm_is_written_by_channels_that_are_not_what_they_are_taken_for(tmp_path: Path) -> None:
    """`identify` of a joint that turns the other way than described leaves no robot.yaml, and says
    why."""
    robot = arm()
    save_robot(robot, tmp_path / "arm.yaml")
    right = recorded(robot, seconds=8.0)
    wrong = arranged(right, "link", (0, 1, 2, 3), (1.0, 1.0, -1.0, 1.0), "all")
    for name, recording in (("wrong", wrong), ("right", right)):
        bag = write_recording(tmp_path / name, recording)
        told = CliRunner().invoke(
            app, ["identify", str(bag), "--robot", str(tmp_path / "arm.yaml"), "--out", f"{bag}_o"]
        )
        assert told.exit_code == 0
        assert (tmp_path / f"{name}_o" / "robot.yaml").exists() == (name == "right")
        said = (
            "no corrected file:" in told.output
            and "joint_3 turns in the opposite direction" in told.output
        )
        assert said == (name == "wrong")


def test_a_tool_is_seen_on_an_arm_whose_motor_inertia_is_stated() -> None:
    """The last parameter is then that of the last motor, which weighs nothing."""
    t, q, dq, ddq = six_axes.motion(2)
    still = np.zeros_like(q)
    bare = six_axes.torques(q, still, still, mass=0.0)
    torque = six_axes.torques(q, dq, ddq, mass=2.0) - bare
    stamp_ns = np.rint(1e9 * t).astype(np.int64)
    recording = Recording(six_axes.JOINTS, Side(stamp_ns, q), Side(stamp_ns, effort=torque))
    robot = parse_urdf(six_axes.urdf())
    motors = zip(robot.joints, six_axes.ARMATURES.tolist(), strict=True)
    stated = robot.with_(joints=tuple(replace(joint, armature=b) for joint, b in motors))
    (finding,) = contradicted_gravity(recording, stated)
    assert "gravity was subtracted" in finding.message
    assert "the gravity of about 2 kg on the last link" in finding.message
