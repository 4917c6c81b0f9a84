"""Servos whose duty is limited before the back-EMF: read, written, played and diagnosed."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.errors import RobotError
from elastic_arm.evidence.priors import Priors
from elastic_arm.identification import identify
from elastic_arm.mujoco import export_mjcf, export_new_mjcf
from elastic_arm.mujoco.closed_loop import at_gains, play, with_controllers
from elastic_arm.mujoco.judgement import Judging
from elastic_arm.mujoco.refinable import robot_at
from elastic_arm.mujoco.refinement import refine
from elastic_arm.mujoco.servo_numbers import servo_numbers, within_prior
from elastic_arm.recording import Recording, read_recording, write_recording
from elastic_arm.recording.made_torque import at_common_gain
from elastic_arm.robot import JointController, Robot, load_robot, save_robot
from elastic_arm.robot.mjcf import MjcfArm, open_mjcf
from tests.helpers.servo_arms import EXAMPLE, recorded, servo_arm

PER_VOLT, BACK_EMF, SUPPLY, DUTY = 0.5, 1.2, 8.0, 4.45  # Nm/V, V s/rad, V, 1/rad
KP, KD, STALL = DUTY * SUPPLY * PER_VOLT, PER_VOLT * BACK_EMF, SUPPLY * PER_VOLT
MOTOR = (
    f'input="pos" motorconst="{BACK_EMF} {BACK_EMF}" resistance="{BACK_EMF / PER_VOLT}"'
    f' controller="{KP} 0 {KD} 0 0 {SUPPLY}"'
)


@pytest.fixture
def base(tmp_path: Path) -> Path:
    """Return the arm of the example with a motor at each joint, as a file."""
    text = (EXAMPLE / "arm.xml").read_text()
    begin, end = text.index("<actuator>"), text.index("</actuator>")
    motors = "".join(
        f'<dcmotor name="{joint}" joint="{joint}" {MOTOR}/>' for joint in ("pan", "lift", "elbow")
    )
    file = tmp_path / "arm.xml"
    stated = '<custom><numeric name="firmware_gain" data="1"/></custom>'
    file.write_text(f"{text[:begin]}{stated}<actuator>{motors}{text[end:]}")
    return file


def changed(arm: MjcfArm, joint: str, **numbers: float) -> MjcfArm:
    """Return a model whose set-points hold other numbers of a joint's controller."""
    drive = arm.robot.joints[arm.robot.joint_names.index(joint)].controller
    assert drive is not None
    return with_controllers(arm, arm.robot.with_joint(joint, controller=replace(drive, **numbers)))


def run_at(arm: MjcfArm, gain: float, seed: int) -> Recording:
    """Return a recording with another number in the registers of all joints."""
    gains = dict.fromkeys(arm.robot.joint_names, gain)
    found = recorded(at_gains(arm, gains), 250.0, 17, seed=seed, seconds=8.0)
    return replace(found, firmware_gains=gains, source=f"gain_{gain:g}_{seed}")


def error(arm: MjcfArm, run: Recording) -> float:
    """Return the largest error of a joint, rad."""
    found = play(arm, run)
    assert found is not None
    return float(np.sqrt(np.mean(found.errors**2, axis=0)).max())


def test_a_motor_with_firmware_is_read_as_the_law_that_mujoco_simulates(base: Path) -> None:
    """MuJoCo's torque is that of the controller that is read, within and beyond the duty."""
    arm = open_mjcf(base)
    drive = arm.robot.joints[0].controller
    assert drive is not None
    assert (drive.kp, drive.kd, drive.stall) == pytest.approx((KP, KD, STALL), rel=1e-9)
    data = mujoco.MjData(arm.model)
    for asked, speed in ((0.1, 0.0), (0.1, 2.0), (1.0, 2.0), (-3.0, 1.0)):
        data.qpos[:] = 0.0
        data.qvel[arm.dofs[0]] = speed
        data.ctrl[0] = asked
        mujoco.mj_forward(arm.model, data)
        wanted = drive.supplied(np.array(drive.kp * asked)) - drive.kd * speed
        assert data.actuator_force[0] == pytest.approx(float(wanted), rel=1e-9)


def test_the_motor_of_an_arm_file_is_its_gains_and_its_stall_torque(
    base: Path, tmp_path: Path
) -> None:
    """`motor:` gives kp, kd and stall; beside kp it is refused; what is saved is read again."""
    robot = load_robot(base)
    file = tmp_path / "arm.yaml"
    save_robot(robot, file)
    assert load_robot(file).joints[0].controller == robot.joints[0].controller
    text = file.read_text()
    begin = text.index("controller:")
    motor = (
        f"{{supply: {SUPPLY}, torque_per_volt: {PER_VOLT}, back_emf: {BACK_EMF},"
        f" duty_per_rad: {DUTY}}}"
    )
    stated = f"controller:\n  pan: {{motor: {motor}, sag: 0.1}}\n...\n"
    file.write_text(text[:begin] + stated)
    drive = load_robot(file).joints[0].controller
    assert drive is not None and drive.sag == 0.1
    assert (drive.kp, drive.kd, drive.stall) == pytest.approx((KP, KD, STALL))
    file.write_text(text[:begin] + stated.replace("sag: 0.1", "kp: 3.0"))
    with pytest.raises(RobotError, match="give either motor, or kp, kd and stall"):
        load_robot(file)


def test_a_sag_without_a_stall_torque_is_refused() -> None:
    """The share is one of a torque that has to be known."""
    with pytest.raises(RobotError, match="without a stall torque"):
        JointController(kp=1.0, sag=0.2)


def test_corrected_constants_are_written_into_the_users_file(base: Path, tmp_path: Path) -> None:
    """What is read back is what was meant; a sag is told to be left out."""
    robot = load_robot(base)
    drive = robot.joints[1].controller
    assert drive is not None
    wanted = replace(drive.scaled(1.3, 1.2), sag=0.2)
    done = export_mjcf(robot.with_joint("lift", controller=wanted), base, tmp_path / "new.xml")
    read = load_robot(tmp_path / "new.xml").joints[1].controller
    assert read is not None
    numbers = ("kp", "kd", "stall", "supply")
    assert [getattr(read, n) for n in numbers] == pytest.approx(
        [getattr(wanted, n) for n in numbers], rel=1e-8
    )
    assert [one.numbers["sag"] for one in done.left if one.joint == "lift"] == [0.2]


def test_one_arm_is_played_at_the_firmware_gain_of_each_recording(base: Path) -> None:
    """At twice and half the gain a true model moves as recorded; without being told it does
    not."""
    arm = open_mjcf(base)
    for gain in (0.5, 2.0):
        run = run_at(arm, gain, 0)
        assert error(arm, run) < 2e-4
        assert error(arm, replace(run, firmware_gains={})) > 5e-3


def test_an_mjcf_that_states_no_firmware_gain_is_played_as_it_is(tmp_path: Path) -> None:
    """Its kp is that of the one gain of the recordings; of several, one has to be stated."""
    arm = servo_arm()
    gains = dict.fromkeys(arm.robot.joint_names, 400.0)
    run = replace(recorded(arm, 250.0, 17), firmware_gains=gains)
    assert error(arm, run) < 2e-4
    told = at_common_gain(arm.robot, [run, replace(run, firmware_gains={})])
    assert [joint.controller.firmware_gain for joint in told.joints if joint.controller] == [
        400.0
    ] * 3
    assert told.joints[0].controller.kp == arm.robot.joints[0].controller.kp  # type: ignore[union-attr]
    done = export_mjcf(told, EXAMPLE / "arm.xml", tmp_path / "new.xml")
    assert (done.changes, done.left) == ((), ())
    other = replace(run, firmware_gains={**gains, "lift": 100.0}, source="other")
    wanted = (
        r"firmware gains 100 and 400 at lift, and the description does not state(?s:.*)"
        r'<numeric name="firmware_gain:lift" data="100"/>'
    )
    for asked in (
        lambda: diagnose([run, other], Question(arm.robot)),
        lambda: identify([run, other], arm.robot),
    ):
        with pytest.raises(RobotError, match=wanted):
            asked()


def test_a_stated_firmware_gain_is_read_and_written(base: Path, tmp_path: Path) -> None:
    """A <numeric> of one joint goes before that of all; a new MJCF and an arm file state it."""
    text = base.read_text()
    own = '<numeric name="firmware_gain:lift" data="400"/></custom>'
    base.write_text(text.replace("</custom>", own))
    robot = load_robot(base)

    def gains(arm: Robot) -> list[float | None]:
        return [joint.controller.firmware_gain for joint in arm.joints if joint.controller]

    assert gains(robot) == [1.0, 400.0, 1.0]
    export_new_mjcf(robot, None, tmp_path / "new.xml")
    save_robot(robot, tmp_path / "arm.yaml")
    for name in ("new.xml", "arm.yaml"):
        assert gains(load_robot(tmp_path / name)) == [1.0, 400.0, 1.0]
    save_robot(servo_arm().robot, tmp_path / "plain.yaml")
    assert gains(load_robot(tmp_path / "plain.yaml")) == [None] * 3


def test_the_firmware_gain_of_a_recording_is_kept_in_its_bag(base: Path, tmp_path: Path) -> None:
    """It is in the bag's metadata, and goes with the joint when joints are selected."""
    run = replace(run_at(open_mjcf(base), 2.0, 0), firmware_gains={"lift": 400.0, "pan": 32.5})
    write_recording(tmp_path / "run", run)
    for path in (tmp_path / "run", next((tmp_path / "run").glob("*.mcap"))):
        read = read_recording(path)
        assert read.firmware_gains == {"lift": 400.0, "pan": 32.5}
    assert read.select(["lift"]).firmware_gains == {"lift": 400.0}


@pytest.mark.slow(18)
def test_a_supply_that_sags_is_named_with_its_share(base: Path) -> None:
    """Of a sweep of two gains the sag of one joint is found, its share to 2 %."""
    arm = open_mjcf(base)
    true = changed(arm, "lift", sag=0.3)
    runs = [run_at(true, gain, seed) for seed, gain in enumerate((1.0, 0.4))]
    effects = ("supply_sag", "coulomb_friction", "viscous_friction", "position_gain")
    found = diagnose(runs, Question(arm.robot, effects=effects), [run_at(true, 0.7, 3)])
    assert [(one.effect, one.joint) for one in found.causes] == [("supply_sag", "lift")]
    share = found.causes[0].parameters["share"]
    assert float(share.value) == pytest.approx(0.3, rel=0.02)


def loaded(robot: Robot, coefficient: float) -> Robot:
    """Return an arm whose lift loses a share of its torque to friction."""
    law = {
        "effect": "load_dependent_friction",
        "joint": "lift",
        "parameters": {"coefficient": coefficient},
    }
    return robot.with_(effects=(*robot.effects, law))


def test_friction_by_load_sticks_in_a_played_model(base: Path) -> None:
    """Held by it, a joint does not creep: it stays where it is to a microradian."""
    arm = open_mjcf(base)
    rubbing = with_controllers(arm, loaded(arm.robot, 0.5))
    run = recorded(rubbing, 250.0, 24)
    assert run.link is not None and run.link.position is not None
    assert error(rubbing, run) < 2e-4 < error(arm, run)


@pytest.mark.slow(4)
def test_gains_are_refined_at_another_number_in_the_registers(base: Path) -> None:
    """A torque constant a fifth smaller is found to 2 % of a recording at another firmware gain
    than that of the description, with a supply that sags."""
    arm = open_mjcf(base)
    drive = arm.robot.joints[1].controller
    assert drive is not None
    drive = replace(drive, sag=0.2)
    sagging = arm.robot.with_joint("lift", controller=drive)
    true = sagging.with_joint("lift", controller=drive.scaled(0.8, 0.8))
    file = base.parent / "true.xml"
    export_mjcf(true, base, file)
    run = run_at(with_controllers(open_mjcf(file), true), 0.4, 3)
    number = within_prior("scale", "lift", 0.2)
    (moved,) = refine(with_controllers(arm, sagging), sagging, (number,), [Judging(run)])
    assert np.exp(moved.by) == pytest.approx(0.8, rel=0.02)


def test_friction_by_load_follows_what_the_gear_carries(base: Path) -> None:
    """A rotor loads no teeth: with nearly all of the inertia in the armature and no weight,
    friction by load of half the torque hardly acts."""
    arm = open_mjcf(base)
    arm.model.opt.gravity[:] = 0.0
    arm.model.dof_armature[arm.dofs] = 5.0
    rubbing = with_controllers(arm, loaded(arm.robot, 0.5))
    run = recorded(rubbing, 250.0, 24)
    assert run.link is not None and run.link.position is not None
    assert error(arm, run) < 0.01 * np.ptp(run.link.position[:, 1])


def test_every_servo_begins_with_friction_and_a_sag(base: Path) -> None:
    """What no description states of a geared servo is among the numbers to be fitted."""
    begun, numbers = servo_numbers(open_mjcf(base).robot, Priors())
    frictions = {(one["effect"], one["joint"]) for one in begun.effects}
    fitted = {(one.what, one.joint) for one in numbers}
    for joint in begun.joints:
        laws = {(law, joint.name) for law in ("coulomb_friction", "load_dependent_friction")}
        assert laws <= frictions and laws <= fitted
        assert {("scale", joint.name), ("kd", joint.name), ("sag", joint.name)} <= fitted
        assert joint.controller is not None and joint.controller.sag > 0.0


@pytest.mark.nightly
@pytest.mark.slow(30)
def test_the_numbers_of_every_servo_are_fitted_in_closed_loop(base: Path) -> None:
    """From the description alone, a torque constant that is a fifth smaller is found to a tenth."""
    arm = open_mjcf(base)
    robot = loaded(arm.robot, 0.12)
    drive = robot.joints[1].controller
    assert drive is not None
    true = robot.with_joint("lift", controller=drive.scaled(0.8, 0.8))
    file = base.parent / "true.xml"
    export_mjcf(true, base, file)
    run = recorded(with_controllers(open_mjcf(file), true), 250.0, 17, seconds=12.0)
    begun, numbers = servo_numbers(arm.robot, Priors())
    started = base.parent / "started.xml"
    export_mjcf(begun, base, started)
    played = with_controllers(open_mjcf(started), begun)
    moved = refine(played, begun, numbers, [Judging(run)])
    fitted = robot_at(begun, [one.number for one in moved], np.array([one.by for one in moved]))
    lift = fitted.joints[1].controller
    assert lift is not None and lift.kp == pytest.approx(0.8 * KP, rel=0.1)


def test_the_numbers_of_every_servo_have_the_priors_that_were_asked_for() -> None:
    """A scale known to 1 % is refined within that, not within the usual 20 %."""
    _, usual = servo_numbers(servo_arm().robot, Priors())
    _, exact = servo_numbers(servo_arm().robot, Priors(controller=0.01))
    scales = [[one.prior for one in each if one.what == "scale"] for each in (usual, exact)]
    assert scales == [[0.2] * 3, [0.01] * 3]
