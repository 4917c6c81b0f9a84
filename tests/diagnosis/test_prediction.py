"""The short-horizon prediction error: motor torque in, angles out, without and with the causes."""

from collections.abc import Sequence
from dataclasses import replace

import pytest

from elastic_arm.diagnosis import Diagnosis, Question, diagnose
from elastic_arm.diagnosis.context import DiagnosisContext
from elastic_arm.diagnosis.prediction import HORIZONS, Prediction, predict
from elastic_arm.effects import EFFECTS, Effect, parse
from elastic_arm.recording import Recording
from tests.helpers.effect_samples import INSTANCES
from tests.helpers.gap_recordings import ROBOT, motions, record
from tests.helpers.nightly import nightly
from tests.helpers.shared_diagnoses import ERROR, FRICTION

pytestmark = pytest.mark.slow(20)


def context(*recordings: Recording, effects: Sequence[Effect] = ()) -> DiagnosisContext:
    """What a diagnosis with these effects to find leaves."""
    found = diagnose(
        [recordings[0]], Question(ROBOT, effects=tuple(effects)), [recordings[1]]
    ).context
    assert found is not None
    return found


def predicted(*effects: str, known: tuple[str, ...] | None = None) -> Prediction:
    """Prediction errors of an arm with effects, all of them known or only some."""
    recordings = [record(motion, *effects, seed=k) for k, motion in enumerate(motions())]
    acting = [parse(text, ROBOT) for text in (effects if known is None else known)]
    return predict(context(*recordings, effects=[one.effect for one in acting]), acting)


@pytest.fixture(scope="module")
def clean(clean_diagnosis: Diagnosis) -> Prediction:
    assert clean_diagnosis.context is not None
    return predict(clean_diagnosis.context, [])


def worst(size: object, horizon: int = -1) -> float:
    """The largest error at a horizon, rad."""
    return max(values[horizon] for values in size.values())  # type: ignore[attr-defined]


def test_the_model_of_a_clean_arm_sees_200_ms_ahead(clean: Prediction) -> None:
    """With the right model the error after 200 ms is micro-radians, from many starts, and grows
    with the horizon."""
    assert clean.before is not None and clean.reason == ""
    assert clean.horizons == HORIZONS and clean.starts >= 50
    assert set(clean.before) == {
        (joint, side) for joint in ROBOT.joint_names for side in ("link", "motor")
    }
    assert worst(clean.before) < 2e-5
    assert all(
        clean.before[joint, "motor"][0] < clean.before[joint, "motor"][-1]
        for joint in ROBOT.joint_names
    )


def test_adding_all_causes_brings_the_prediction_back(
    two_causes: Diagnosis, clean: Prediction
) -> None:
    """With friction of a motor, and an error that twists the drive and pushes the motor back."""
    assert two_causes.context is not None
    acting = [parse(text, ROBOT) for text in (FRICTION, ERROR)]
    found = predict(two_causes.context, acting)
    assert found.before is not None and found.after is not None and clean.before is not None
    # The friction of joint 2 acts there most; the small error of joint 1 is nearer to the noise.
    for joint, least in (("joint_1", 3.0), ("joint_2", 100.0)):
        assert found.before[joint, "motor"][4] > least * found.after[joint, "motor"][4]
    for k in (1, 4):
        assert worst(found.after, k) < 2.0 * worst(clean.before, k)


@pytest.mark.parametrize(
    "effect",
    [
        "motor_torque_gain",  # a sensor's: the torque that drives the prediction
        *nightly(
            [
                "coulomb_friction",  # in the motor
                "transmission_error",  # twists the drive and pushes the motor back
                "bearing_compliance",  # adds coordinates
            ]
        ),
    ],
)
def test_adding_the_effect_brings_the_prediction_back(effect: str, clean: Prediction) -> None:
    """With the effect added in the forward simulation, the arm is predicted as well as a clean
    one."""
    found = predicted(INSTANCES[effect][0])
    assert found.before is not None and found.after is not None and clean.before is not None
    gained = [
        found.before[place][k] / found.after[place][k] for place in found.before for k in (1, 4)
    ]
    assert max(gained) > (1.5 if effect == "bearing_compliance" else 10.0)
    for k in (1, 4):
        assert worst(found.after, k) < 2.0 * worst(clean.before, k)


@pytest.mark.parametrize(
    ("effect", "horizon"),
    [
        ("time_delay:joint_2:delay=0.004,channels=link_encoder", 0),
        *nightly([("motor_torque_gain:joint_2:gain=1.3", -1)]),
    ],
)
def test_what_the_calibration_took_out_of_a_channel_is_taken_out_once(
    effect: str, horizon: int
) -> None:
    """With `--refit` channels were moved back and torques divided: with the cause the arm is
    predicted as clean."""
    runs = [record(motion, effect, seed=k) for k, motion in enumerate(motions())]
    name = effect.split(":")[0]
    found = diagnose([runs[0]], Question(ROBOT, refit=True, effects=(EFFECTS[name],)), [runs[1]])
    (own,) = [cause for cause in found.causes if cause.effect == name]
    assert found.context is not None
    prediction = predict(found.context, [own.instance])
    assert prediction.before is not None and prediction.after is not None
    place = "joint_2", "link"
    assert prediction.after[place][horizon] < 0.1 * prediction.before[place][horizon]


def test_half_the_friction_leaves_about_half_the_error() -> None:
    """The prediction error measures what is missing: a cause found half as large mends half."""
    found = predicted(
        "coulomb_friction:joint_2:torque=10", known=("coulomb_friction:joint_2:torque=5",)
    )
    assert found.before is not None and found.after is not None
    assert found.after["joint_2", "motor"][-1] / found.before["joint_2", "motor"][
        -1
    ] == pytest.approx(0.5, abs=0.1)


def test_a_cause_takes_the_place_of_what_the_description_states_of_it() -> None:
    """Friction stated ten times too large is replaced by what was found, not added to it."""
    truth = "coulomb_friction:joint_2:torque=6"
    stated = ROBOT.with_(effects=(parse("coulomb_friction:joint_2:torque=60", ROBOT).to_dict(),))
    recordings = [record(motion, truth, seed=k) for k, motion in enumerate(motions())]
    question = Question(stated, effects=(EFFECTS["coulomb_friction"],))
    found = diagnose([recordings[0]], question, [recordings[1]])
    assert found.context is not None
    prediction = predict(found.context, [cause.instance for cause in found.causes])
    assert prediction.before is not None and prediction.after is not None
    assert (
        prediction.after["joint_2", "motor"][-1] < 0.01 * prediction.before["joint_2", "motor"][-1]
    )


def test_without_motor_torque_nothing_is_predicted_and_the_reason_is_said() -> None:
    """No motor torque: no prediction, in words, not a number made up."""
    recordings = [record(motion) for motion in motions()]
    silent = [replace(r, motor=replace(r.motor, effort=None)) for r in recordings]  # type: ignore[type-var]
    found = predict(context(*silent), [])
    assert found.before is None and found.after is None
    assert "motor torque" in found.reason
    assert found.to_dict()["before"] is None and found.to_dict()["reason"] == found.reason


def test_with_the_motor_side_alone_its_angles_are_predicted() -> None:
    """Where the link encoder is missing, motor angles are predicted, and nothing is said of
    links."""
    recordings = [replace(record(motion, seed=k), link=None) for k, motion in enumerate(motions())]
    found = predict(context(*recordings), [])
    assert found.before is not None
    assert {side for _, side in found.before} == {"motor"}
    assert worst(found.before) < 2e-4
