"""What of a servo arm's correction is written: that with which it moves as recorded, and what was
refined for it."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.cli.mujoco.corrected import Correction, Written
from elastic_arm.diagnosis.result import Imperfection
from elastic_arm.effects import Catalogue
from elastic_arm.evidence.watch import Watch
from elastic_arm.mujoco.judgement import Choice, Judging, chosen, closed_loop
from elastic_arm.mujoco.refinable import Moved, Refinable, robot_at, with_refined
from elastic_arm.mujoco.refinement import refine
from elastic_arm.robot import Robot, with_joints_of
from elastic_arm.robot.mjcf import MjcfArm
from tests.diagnosis.test_result import diagnosis
from tests.helpers.nightly import nightly
from tests.helpers.servo_arms import EXAMPLE, recorded, servo_arm

PAN, LIFT, ELBOW = (f'kp="17.8" kv="0.6" joint="{name}"' for name in ("pan", "lift", "elbow"))
DRY = 'name="elbow" axis="0 1 0" armature="0.028" damping="0.05" frictionloss="0.05"'
ROUGH = {DRY: DRY.replace('loss="0.05"', 'loss="0.12"')}
WRONG = {PAN: PAN.replace("17.8", "39.2")}


@pytest.fixture(scope="module")
def judging() -> list[Judging]:
    """A recording of an arm with a rough elbow."""
    return [Judging(recorded(servo_arm(ROUGH), 100.0, 14, seed=1))]


def choice(changes: Mapping[str, str], judging: list[Judging]) -> Choice:
    """Return what is chosen of a correction that changes the file so."""
    corrected = servo_arm(changes).robot

    def build(back: frozenset[str]) -> MjcfArm:
        kept = {
            old: new for old, new in changes.items() if not any(f'"{name}"' in old for name in back)
        }
        return servo_arm(kept)

    found = chosen(servo_arm(), build, corrected.joint_names, judging)
    assert found is not None
    return found


def test_a_true_correction_is_written_whole(judging: list[Judging]) -> None:
    """With the elbow's friction all joints move nearer, and nothing is taken back."""
    found = choice(ROUGH, judging)
    assert (found.taken_back, found.worse, found.better) == ((), (), True)
    elbow = found.errors["elbow"]
    assert elbow.corrected < 0.1 * elbow.described and elbow.refused is None


def test_a_joint_that_moves_worse_keeps_the_description(judging: list[Judging]) -> None:
    """A kp of the pan that is twice too large is taken back and said; the elbow's friction, which
    is right, stays.

    The lift moves worse with it, too, and needs nothing taken back when the pan's is.
    """
    found = choice({**ROUGH, **WRONG}, judging)
    assert found.taken_back == ("pan",)
    assert "pan" in found.worse and "elbow" not in found.worse
    pan, elbow = found.errors["pan"], found.errors["elbow"]
    assert pan.refused is not None and pan.refused > 2.0 * pan.described
    assert elbow.corrected < 0.1 * elbow.described


def test_the_description_is_not_worse_than_itself(judging: list[Judging]) -> None:
    """Nothing that changes is nothing worse and nothing better."""
    found = choice({}, judging)
    assert (found.taken_back, found.worse, found.better) == ((), (), False)


def test_pauses_part_a_recording() -> None:
    """What comes after a pause starts anew from what is recorded there: a true model errs by no
    more."""
    true = servo_arm()
    run = recorded(true, 100.0, 17, seconds=12.0)
    assert run.link is not None and run.reference is not None

    def without(stamps: np.ndarray) -> np.ndarray:
        t = (stamps - run.start_ns) * 1e-9
        return np.flatnonzero((t < 4.0) | (t > 7.0))

    cut = replace(run, link=run.link.at(without(run.link.stamp_ns)), reference=run.reference)
    assert len(list(Judging(cut).stretches())) == 2
    found = closed_loop(true, [Judging(cut)])
    assert found is not None and found.errors.max() < 3e-4


def test_numbers_are_refined_on_the_recording() -> None:
    """Friction and gains that are found 10 to 20 % wrong come to the true ones, to 2 %, within
    their deviations."""
    true = servo_arm(ROUGH)
    robot = true.robot
    numbers = (
        Refinable("coulomb_friction", "elbow", 0.02, -0.12),
        Refinable("scale", "lift", 0.1),
        Refinable("viscous_friction", "pan", 0.02, -0.05),
        Refinable("mass", "elbow", 0.1),
    )
    off = np.array([0.015, 0.1, -0.01, -0.08])
    wrong = robot_at(robot, numbers, off)
    start = model_of(wrong)
    moved = refine(start, wrong, numbers, [Judging(recorded(true, 100.0, 17))])
    by = np.array([one.by for one in moved])
    np.testing.assert_allclose(by[[0, 2]], -off[[0, 2]], atol=2e-3)
    np.testing.assert_allclose(by[[1, 3]], -off[[1, 3]], atol=0.02)


def test_a_true_arm_is_not_refined_away() -> None:
    """Numbers that are right stay within a fifth of their deviations."""
    true = servo_arm()
    numbers = (
        Refinable("coulomb_friction", "elbow", 0.02, -0.05),
        Refinable("scale", "lift", 0.1),
    )
    moved = refine(true, true.robot, numbers, [Judging(recorded(true, 50.0, 12))])
    assert all(abs(one.by) < 0.2 * one.number.std for one in moved) and len(moved) == 2


def test_what_a_recording_does_not_tell_of_a_cause_returns_to_the_description() -> None:
    """A limit of torque that no motion reaches was found too low: it becomes the stated one."""
    true = servo_arm()
    limits = [joint.controller.torque for joint in true.robot.joints if joint.controller]
    stated = limits[1]
    assert stated is not None
    limit = Refinable.of_cause("limit", true.robot.joint_names[1], 0.1, -0.9 * stated, 0.1 * stated)
    lower = robot_at(true.robot, [limit], np.array([-0.1 * stated]))
    (moved,) = refine(model_of(lower), lower, [limit], [Judging(recorded(true, 50.0, 12))])
    assert moved.by == pytest.approx(0.1 * stated, rel=0.05) and moved.std > 0.05 * stated


def test_a_diagnosis_holds_what_was_refined() -> None:
    """Ratios move by their logarithms, sizes of causes with their deviations."""
    scale = Imperfection("torque_scale", "joint_1", "1", 1.12, 0.04, 0.2, True, neutral=1.0)
    found = replace(diagnosis(), imperfections=(scale,), made=("joint_1",))
    number = Refinable("scale", "joint_1", 0.04, stated=-0.1, prior=0.2)
    refined = with_refined(found, [Moved(number, 0.02, 0.01)]).torque_scale["joint_1"]
    assert refined.value == pytest.approx(1.12 * np.exp(0.02))
    assert refined.std == pytest.approx(0.01 * refined.value)


def test_the_scale_of_the_torques_stands_beside_that_of_the_motion() -> None:
    """A refined scale starts from the diagnosis, one of the numbers of every servo from the
    description; numbers that are no scale are not compared."""
    scale = Imperfection("torque_scale", "joint_1", "1", 1.15, 0.01, 0.2, True, neutral=1.0)
    found = replace(diagnosis(), imperfections=(scale,), made=("joint_1",))
    gain = Moved(Refinable("scale", "joint_1", 0.01), float(np.log(1.1)), 0.02)
    other = Moved(Refinable("kd", "joint_1", 0.01), 0.5, 0.02)
    refined = Written(refined=(gain, other)).compared_scales(found)["joint_1"]
    fitted = Written(fitted=(other, gain)).compared_scales(found)["joint_1"]
    assert refined.of_torques == fitted.of_torques == found.torque_scale["joint_1"]
    assert refined.in_closed_loop.value == pytest.approx(1.15 * 1.1)
    assert fitted.in_closed_loop.value == pytest.approx(1.1)
    assert fitted.in_closed_loop.std == pytest.approx(0.02 * 1.1)
    assert not Written(refined=(other,)).compared_scales(found)


def model_of(robot: Robot) -> MjcfArm:
    """Return the example's model with the numbers of an arm, by way of the file that is written."""
    from tempfile import TemporaryDirectory

    correction = Correction(EXAMPLE / "arm.xml", None, None, Catalogue.default())
    with TemporaryDirectory() as folder:
        assert not isinstance(correction.write(robot, Path(folder)), str)
        file = correction.path(Path(folder))
        assert file is not None
        return correction.open(file)


@pytest.mark.parametrize(
    ("caused", "right"), [(False, True), (False, False), *nightly([(True, False)])]
)
def test_what_is_written_never_moves_worse(
    tmp_path: Path, judging: list[Judging], caused: bool, right: bool
) -> None:
    """Without a cause, too, the file holds what moves nearer; where all that was found moves worse
    there is no file."""
    described = servo_arm().robot
    every = {form: form.replace("17.8", "60") for form in (PAN, LIFT, ELBOW)}
    found = servo_arm(ROUGH if right else every).robot
    correction = Correction(EXAMPLE / "arm.xml", None, None, Catalogue.default())
    written = correction.judged(
        described,
        lambda back: with_joints_of(found, described, back),
        described.joint_names,
        judging,
        tmp_path,
        caused=caused,
    )
    file = tmp_path / "arm_corrected.xml"
    assert (file.exists(), written.robot is not None) == (right, right)
    assert written.choice is not None
    for one in written.choice.errors.values():
        assert one.corrected <= one.described + 1e-4


def test_a_correction_of_an_arm_file_is_judged_by_a_newmodel_of(judging: list[Judging]) -> None:
    """Where the arm came from no MJCF, MuJoCo plays one that is made of it."""
    described, found = servo_arm().robot, servo_arm(ROUGH).robot
    correction = Correction(None, None, None, Catalogue.default())
    written = correction.judged(
        described,
        lambda back: with_joints_of(found, described, back),
        described.joint_names,
        judging,
        Path("unused"),
        caused=True,
    )
    assert written.choice is not None and written.choice.better and not written.choice.worse


class Stopped:
    """A watch that ends the work after some questions whether it is over."""

    def __init__(self, after: int) -> None:
        self.left = after
        self.said: list[str] = []

    @property
    def watch(self) -> Watch:
        """What is handed over."""
        return Watch(lambda words, stage, done=0.0: self.said.append(words), self.is_over)

    def is_over(self) -> bool:
        """Count a question."""
        self.left -= 1
        return self.left < 0


def test_a_refinement_tells_its_rounds_and_ends_with_the_best_so_far() -> None:
    """Stopped in its second round, it has the gain of the first; stopped before, it has none."""
    true = servo_arm(ROUGH)
    number = Refinable("coulomb_friction", "elbow", 0.02, -0.15)
    wrong = robot_at(true.robot, [number], np.array([0.03]))
    run = [Judging(recorded(true, 100.0, 17, seconds=6.0))]
    stopped = Stopped(after=2)
    (moved,) = refine(model_of(wrong), wrong, [number], run, watch=stopped.watch)
    assert -0.04 < moved.by < -0.01
    first, second = stopped.said
    assert first.startswith("closed loop: 1 numbers refined, round 1 of at most 30, error")
    assert "round 2" in second
    assert refine(model_of(wrong), wrong, [number], run, watch=Stopped(after=0).watch) == ()


def test_a_judgement_that_is_ended_takes_back_what_is_not_known_to_move_as_well(
    judging: list[Judging],
) -> None:
    """After the whole correction, which moves worse, nothing else is played."""
    corrected = servo_arm({**ROUGH, **WRONG})
    stopped = Stopped(after=0)
    names = corrected.robot.joint_names
    found = chosen(servo_arm(), lambda back: corrected, names, judging, stopped.watch)
    assert found is not None and found.taken_back == names and not found.better
    assert stopped.said == ["closed loop: judging the correction"]
    right = servo_arm(ROUGH)
    found = chosen(servo_arm(), lambda back: right, names, judging, Stopped(after=0).watch)
    assert found is not None and found.taken_back == () and found.better
