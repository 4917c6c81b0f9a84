"""Servo arms in MuJoCo, recorded by commands and positions alone: what is withheld is named, and no
more."""

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks import bench_servo_fit
from elastic_arm.diagnosis import Diagnosis, Question, diagnose
from elastic_arm.diagnosis.corrected_robot import repaired_robot
from elastic_arm.errors import DiagnosisError
from elastic_arm.identification import identify
from elastic_arm.robot.mjcf import MjcfArm, open_mjcf
from tests.helpers.nightly import nightly
from tests.helpers.servo_arms import recorded, servo_arm

pytestmark = pytest.mark.usefixtures("compiled_here")

FAST, SLOW = (250.0, 17), (50.0, 12)  # Hz, bits of the encoders
ELBOW = 'name="elbow" axis="0 1 0" armature="0.028" damping="0.05" frictionloss="0.05"'
STATED = 'kp="17.8" kv="0.6" joint="lift"'
LIMIT = 'joint="lift" forcerange="-4 4"'


# The effects of a servo; the whole catalogue takes half as long again.
OF_SERVOS = [
    "coulomb_friction",
    "viscous_friction",
    "stribeck_friction",
    "payload",
    "position_gain",
    "velocity_gain",
    "command_delay",
    "torque_saturation",
    "position_dead_band",
    "integral_gain",
]


@pytest.fixture(scope="module")
def nominal() -> MjcfArm:
    return servo_arm()


@pytest.fixture(params=[OF_SERVOS, *nightly([None])], ids=["few", "all"])
def effects(request: pytest.FixtureRequest) -> list[str] | None:
    """The candidates: None for the whole catalogue."""
    return request.param  # type: ignore[no-any-return]


def answer(
    nominal: MjcfArm,
    effects: list[str] | None,
    recording: tuple[float, int],
    changes: dict[str, str] | None = None,
    late: int = 0,
) -> Diagnosis:
    true = servo_arm(changes)
    runs = [recorded(true, *recording, seed=seed, late=late) for seed in (0, 1)]
    return diagnose(runs[:1], Question(nominal.robot, effects=effects), runs[1:])


def test_a_clean_arm_has_no_cause(nominal: MjcfArm, effects: list[str] | None) -> None:
    """If arm and controllers are as described, nothing is found, and the scale of torque is
    stated."""
    found = answer(nominal, effects, SLOW)
    assert (found.verdict, found.causes) == ("none", ())
    assert set(found.torque_scale) == set(nominal.robot.joint_names)
    for joint, written in found.to_dict()["torque_scale"].items():
        scale = found.torque_scale[joint]
        assert written == {"value": pytest.approx(scale.value), "std": pytest.approx(scale.std)}


DRY = {ELBOW: ELBOW.replace('loss="0.05"', 'loss="0.12"')}
VISCOUS = {ELBOW: ELBOW.replace('ing="0.05', 'ing="0.15')}
STIFFER = {STATED: STATED.replace("17.8", "23")}
FASTER = {STATED: STATED.replace("0.6", "0.9")}
WEAK = {LIMIT: LIMIT.replace("4", "1.2")}


@pytest.mark.parametrize(
    ("changes", "late", "wanted", "recorded"),
    [
        (DRY, 0, ("coulomb_friction", "elbow", "torque", 0.12), SLOW),
        ({}, 1, ("command_delay", None, "delay", None), SLOW),
        *nightly(
            [
                (VISCOUS, 0, ("viscous_friction", "elbow", "coefficient", 0.15), SLOW),
                (STIFFER, 0, ("position_gain", "lift", "gain", 23 / 17.8), FAST),
                (WEAK, 0, ("torque_saturation", "lift", "torque", 1.2), FAST),
            ]
        ),
    ],
    ids=["dry", "delay", "viscous", "kp", "saturation"],
)
def test_what_is_withheld_is_named(
    nominal: MjcfArm,
    effects: list[str] | None,
    changes: dict[str, str],
    late: int,
    wanted: tuple[str, str | None, str, float],
    recorded: tuple[float, int],
) -> None:
    """Friction, kp, late commands and a weak drive come first, sizes right to 3 %; nothing else
    closes 2 % of the gap.

    MuJoCo's friction turns over within a millisecond, which the law's sign does not.
    """
    found = answer(nominal, effects, recorded, changes, late)
    effect, joint, name, size = wanted
    cause, *rest = found.causes
    assert all(abs(other.shrink) < 0.02 for other in rest)
    assert (found.verdict, cause.effect, cause.joint) == ("explained", effect, joint)
    assert cause.parameters[name].value == pytest.approx(size or late / recorded[0], rel=0.03)


@pytest.mark.parametrize(
    ("number", "size", "effect"),
    [
        ("dead_band", 0.02, "position_dead_band"),
        *nightly([("ki", 15.0, "integral_gain")]),
    ],
)
def test_what_no_actuator_of_mujoco_has_is_named(
    effects: list[str] | None, number: str, size: float, effect: str
) -> None:
    """A dead band and an integral of the controller are the one cause, right to 3 %; ki is no surer
    than its scale."""
    # Nm; an integral beside a torque at its limit would rest
    stated = servo_arm({LIMIT: LIMIT.replace("4", "30")})
    drive = stated.robot.joints[1].controller
    assert drive is not None
    changed = replace(drive, **{number: size})  # type: ignore[arg-type]
    true = replace(stated, robot=stated.robot.with_joint("lift", controller=changed))
    runs = [recorded(true, 50.0, 12, seed=seed) for seed in (0, 1)]
    question = Question(stated.robot, refit=True, effects=effects)
    diagnosed = diagnose(runs[:1], question, runs[1:])
    (cause,) = diagnosed.causes
    (found,) = cause.parameters.values()
    assert (cause.effect, cause.joint, found.value) == (
        effect,
        "lift",
        pytest.approx(size, rel=0.03),
    )
    assert number == "dead_band" or found.std > diagnosed.torque_scale["lift"].std * found.value


@pytest.mark.parametrize(
    ("kind", "size", "within"),
    [*nightly([("play", 0.015, 0.1)]), ("elasticity", 40.0, 0.1)],
)
def test_a_joint_that_yields_behind_its_encoder_is_named(
    tmp_path: Path, kind: str, size: float, within: float
) -> None:
    """Of play, and of a spring, between encoder and link MuJoCo's servos show joint and size by
    their encoders alone.

    MuJoCo presses joints a millirad beyond their limits; a spring is known no better than the scale
    of its torques.
    """
    text, told = bench_servo_fit.recorded(kind, 0)
    (tmp_path / "arm.xml").write_text(text)
    robot = open_mjcf(tmp_path / "arm.xml").robot
    runs = [
        replace(one.recording(robot.joint_names), source=f"run_{k}") for k, one in enumerate(told)
    ]
    effects = [
        "joint_play",
        "joint_elasticity",
        "coulomb_friction",
        "position_dead_band",
        "position_gain",
    ]
    diagnosed = diagnose(runs[:1], Question(robot, refit=True, effects=effects), runs[1:])
    (cause,) = diagnosed.causes
    (found,) = cause.parameters.values()
    assert (cause.effect, cause.joint) == (f"joint_{kind}", "joint_2")
    assert found.value == pytest.approx(size, rel=within)
    assert (
        kind == "play"
        or found.std > diagnosed.torque_scale["joint_2"].std * found.value > 0.01 * found.value
    )


def test_gains_that_are_off_together_are_a_scale_and_no_cause(
    nominal: MjcfArm, effects: list[str] | None
) -> None:
    """kp and kd that are both 15 % higher are ordinary: the scale of that joint's torque, in the
    corrected arm, too."""
    true = servo_arm({STATED: 'kp="20.47" kv="0.69" joint="lift"'})
    runs = [recorded(true, 250.0, 17, seed=seed) for seed in (0, 1)]
    question = Question(nominal.robot, refit=True, effects=effects)
    found = diagnose(runs[:1], question, runs[1:])
    (scale,) = [p for p in found.imperfections if (p.what, p.joint) == ("torque_scale", "lift")]
    assert (found.verdict, scale.value) == ("none", pytest.approx(1.15, abs=0.03))
    repaired = repaired_robot(nominal.robot, found).joints[1].controller
    assert repaired is not None and repaired.kp == pytest.approx(20.47, rel=0.03)


def test_a_gain_of_speed_and_viscous_friction_are_alternatives(nominal: MjcfArm) -> None:
    """Of a controller that damps the motor's own speed, both are the same torque, and both are
    named."""
    runs = [recorded(servo_arm(FASTER), *SLOW, seed=seed) for seed in (0, 1)]
    effects = ("viscous_friction", "velocity_gain", "coulomb_friction", "position_gain")
    (cause,) = diagnose(runs[:1], Question(nominal.robot, effects=effects), runs[1:]).causes
    assert {cause.effect, *(a.effect for a in cause.alternatives)} == {
        "viscous_friction",
        "velocity_gain",
    }


def test_nothing_anchors_the_scale_of_a_vertical_axis(nominal: MjcfArm) -> None:
    """Where the description may be off, the scale of the first axis is known by its controller
    alone."""
    true = servo_arm()
    runs = [recorded(true, 50.0, 12, seed=seed) for seed in (0, 1)]
    found = diagnose(runs[:1], Question(nominal.robot, refit=True, effects=[]), runs[1:])
    assert found.torque_scale["pan"].std > found.torque_scale["lift"].std


def test_identification_takes_made_torques(nominal: MjcfArm) -> None:
    """Friction and masses are those of the arm, and the notes name where the torque is from."""
    true = servo_arm(DRY)
    result = identify(recorded(true, 250.0, 17), nominal.robot)
    (row,) = [row for row in result.table() if row[0] == "coulomb_friction:elbow.torque"]
    assert row[2] == pytest.approx(0.12, rel=0.03)
    assert any("no torque was recorded" in note for note in result.notes)
    assert not any("states no motor inertia" in note for note in result.notes)  # as the MJCF does


def test_without_a_controller_the_error_names_the_block_to_write(nominal: MjcfArm) -> None:
    """The one line names the entry `controller:` of the arm file."""
    bare = nominal.robot.with_(
        joints=tuple(replace(joint, controller=None) for joint in nominal.robot.joints)
    )
    with pytest.raises(
        DiagnosisError, match=r"contains no torque.*`controller: \{joint_1: \{kp: 30, kd: 0.5\}\}`"
    ):
        diagnose([recorded(servo_arm(), 50.0, 12)], Question(bare))
