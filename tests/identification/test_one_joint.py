"""One joint whose truth is known: stated friction, an elastic joint taken for rigid, motion in one
direction."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.identification import (
    Estimate,
    Identification,
    IdentificationSettings,
    identify,
    parse_laws,
)
from elastic_arm.recording import Recording, Side
from elastic_arm.robot import Robot, parse_urdf
from tests.helpers.nightly import nightly

RATE = 250.0
T = np.arange(round(20 * RATE)) / RATE
URDF = """<robot name="one"><link name="base"/><joint name="j" type="revolute">
<parent link="base"/><child link="l"/><axis xyz="0 {y} {z}"/>
<limit lower="-7" upper="7" effort="100" velocity="9"/>{dynamics}</joint><link name="l">
<inertial><origin xyz="0 0 {c}"/><mass value="2"/>
<inertia ixx="{I}" iyy="{I}" izz="{I}" ixy="0" ixz="0" iyz="0"/>
</inertial></link></robot>"""
LAWS = ("viscous_friction", "coulomb_friction")
VISCOUS = 0.2
DRY = 0.3
INERTIA = 0.065
MOMENT = 0.3


def pendulum(friction: float) -> Robot:
    """Return the true pendulum, with so many times its friction."""
    dynamics = (
        f'<dynamics damping="{VISCOUS * friction}" friction="{DRY * friction}"/>'
        if friction
        else ""
    )
    return parse_urdf(
        URDF.format(y=1, z=0, c=MOMENT / 2, I=INERTIA - MOMENT**2 / 2, dynamics=dynamics)
    )


def recorded(q: np.ndarray, torque: np.ndarray, seed: int) -> Recording:
    rng = np.random.default_rng(seed)
    q = q + 2e-5 * rng.standard_normal(len(T))
    torque = torque + 0.02 * rng.standard_normal(len(T))
    side = Side(np.rint(T * 1e9).astype(np.int64), q[:, None], None, torque[:, None])
    return Recording(("j",), motor=side, source=f"run_{seed}")


def swung(seed: int, *, gravity: float = 1.0, steady: float = 0.0, zero: float = 0.0) -> Recording:
    """Return the pendulum in motion, at a steady speed besides; its torques lack some gravity, or
    have a zero."""
    q = steady * T
    dq = np.full(len(T), steady)
    ddq = np.zeros(len(T))
    for f, phase in zip(
        (0.13, 0.31, 0.53), np.random.default_rng(seed).uniform(0, 2 * np.pi, 3), strict=True
    ):
        w = 2 * np.pi * f
        size = 0.3 / (2 * np.pi * f)
        q = q + size * np.sin(w * T + phase)
        dq = dq + size * w * np.cos(w * T + phase)
        ddq = ddq - size * w**2 * np.sin(w * T + phase)
    torque = (
        INERTIA * ddq
        - gravity * 9.81 * MOMENT * np.sin(q)
        + VISCOUS * dq
        + DRY * np.tanh(dq / 5e-3)
        + zero
    )
    return recorded(q, torque, seed)


def found(
    robot: Robot, fit: Recording, *held_out: Recording, laws: tuple[str, ...] = LAWS
) -> Identification:
    return identify(
        fit, robot, IdentificationSettings(effects=parse_laws(laws, robot)), validate=held_out
    )


def of_law(result: Identification, law: str) -> Estimate:
    return next(e for e in result.estimates if e.name.startswith(law))


def test_friction_that_is_asked_for_has_the_stated_value_as_nominal() -> None:
    """Ten times the friction is stated: it is the nominal, the description errs by its excess, and
    the fit is right."""
    result = found(pendulum(10.0), swung(1), swung(2))
    for law, true in (("viscous", VISCOUS), ("coulomb", DRY)):
        assert of_law(result, law).nominal == pytest.approx(10 * true)
        assert of_law(result, law).value == pytest.approx(true, rel=0.05)
    arms = result.validation["run_2"]
    dq = np.gradient(swung(2).motor.position[:, 0], T)
    excess = np.sqrt(np.mean((9 * (VISCOUS * dq + DRY * np.sign(dq))) ** 2))
    assert arms["nominal"]["whole"]["j"] == pytest.approx(excess, rel=0.1)
    assert not any("worse than" in note for note in result.notes)


@pytest.mark.parametrize("seed", [1, 3, 9])
def test_a_fit_as_good_as_a_right_description_is_not_called_worse(seed: int) -> None:
    """What is left between the two is within the deviations of the fit: the description is said to
    be as good."""
    notes = found(pendulum(1.0), swung(seed), swung(seed + 1)).notes
    assert any("as well as the fit" in note for note in notes)
    assert not any("worse" in note or "do not use" in note for note in notes)


def test_a_right_description_with_friction_is_better_than_a_fit_of_wrong_torques() -> None:
    """Torques without gravity predict worse than the description, whose friction is stated and
    asked for."""
    result = found(pendulum(1.0), swung(1, gravity=0.0), swung(2))
    assert any("worse than" in note for note in result.notes)
    assert result.validation["run_2"]["nominal"]["whole"]["j"] < 0.05


@pytest.mark.parametrize("every", [25, *nightly([5])])
def test_a_held_torque_counts_when_it_is_read(every: int) -> None:
    """Updated at 50 or 10 Hz of 250: friction is right with deviations that hold, a right
    description is right."""
    read = np.arange(len(T)) // every * every
    runs = [swung(seed) for seed in (1, 2)]
    runs = [replace(r, motor=replace(r.motor, effort=r.motor.effort[read])) for r in runs]
    result = found(pendulum(0.0), *runs)
    for law, true in (("viscous", VISCOUS), ("coulomb", DRY)):
        fitted = of_law(result, law)
        assert abs(fitted.value - true) < 3.0 * fitted.std < 0.3 * true
    assert any(f"it changes every {every} samples" in note for note in result.notes)
    causes = {
        c.effect: c.parameters for c in diagnose(runs[:1], Question(pendulum(0.0)), runs[1:]).causes
    }
    assert causes["coulomb_friction"]["torque"].value == pytest.approx(DRY, rel=0.1)
    assert causes["viscous_friction"]["coefficient"].value == pytest.approx(VISCOUS, rel=0.1)
    assert diagnose(runs[:1], Question(pendulum(1.0)), runs[1:]).verdict == "none"


def two_masses() -> tuple[Robot, Recording, Recording]:
    """Return a rigid joint, a recording of the same with a resonance of 6 Hz, and one of itself."""
    motor = 0.4
    link = 1.3
    damping = 3.0
    rng = np.random.default_rng(4)
    stiffness = (2 * np.pi * 6.0) ** 2 / (1 / motor + 1 / link)
    rigid, elastic, torque = np.zeros((3, len(T)))
    for f in np.arange(0.5, 9.0, 0.05):
        s = 2j * np.pi * f
        phase = np.exp(1j * rng.uniform(0, 2 * np.pi))
        spring = stiffness + damping * s
        moved = (link * s**2 + spring) / (
            (motor * s**2 + spring) * (link * s**2 + spring) - spring**2
        )
        wave = phase * np.exp(s * T)
        torque += wave.real
        elastic += (moved * wave).real
        rigid += (wave / ((motor + link) * s**2)).real
    arm = parse_urdf(URDF.format(y=0, z=1, c=0, I=motor + link, dynamics=""))
    return arm, recorded(elastic, torque, 1), recorded(rigid, torque, 2)


def test_an_elastic_joint_described_as_rigid_is_named_with_its_frequency() -> None:
    """A resonance of 6 Hz: joint, ratio to the noise and frequency are said; of a rigid joint
    nothing is."""
    arm, elastic, rigid = two_masses()
    (note,) = [note for note in found(arm, elastic).notes if "the residual is" in note]
    assert note.startswith("j: the residual is") and "may be elastic" in note
    assert float(re.search(r"([\d.e+]+) times the noise", note)[1]) > 50
    assert float(re.search(r"near ([\d.]+) Hz", note)[1]) == pytest.approx(6.0, rel=0.1)
    assert not any("the residual is" in note for note in found(arm, rigid).notes)


def test_an_elastic_joint_with_friction_has_its_resonance() -> None:
    """Friction that nobody identifies hides no resonance, and a joint about a vertical axis carries
    nothing, as its mass is not determined."""
    arm, elastic, _ = two_masses()
    rate = np.gradient(elastic.motor.position[:, 0], T)
    rubs = elastic.motor.effort[:, 0] + 0.1 * np.std(elastic.motor.effort) * np.tanh(rate / 5e-3)
    rough = replace(elastic, motor=replace(elastic.motor, effort=rubs[:, None]))
    result = found(arm, rough, laws=())
    (note,) = [note for note in result.notes if "the residual is" in note]
    assert result.carried is None
    assert float(re.search(r"near ([\d.]+) Hz", note)[1]) == pytest.approx(6.0, rel=0.1)


def test_a_torque_of_another_motion_is_no_elastic_joint() -> None:
    """What a fit leaves of torques that have nothing to do with the motion is said, and no
    resonance is named."""
    for seed in range(3):
        moved = swung(seed)
        slow = lfilter([0.02], [1.0, -0.98], np.random.default_rng(seed).normal(0.0, 30.0, len(T)))
        wrong = replace(moved, motor=replace(moved.motor, effort=slow[:, None]))
        (note,) = [note for note in found(pendulum(0.0), wrong).notes if "the residual is" in note]
        assert "elastic" not in note


@pytest.mark.nightly
def test_a_diagnosis_suggests_elasticity_with_its_frequency() -> None:
    """What effects of a rigid joint leave has a resonance of 6 Hz; a recording of a rigid joint has
    no note."""
    arm, elastic, rigid = two_masses()
    noted = [note for note in diagnose([elastic], Question(arm)).notes if "may be elastic" in note]
    assert [float(re.search(r"near ([\d.]+) Hz", note)[1]) for note in noted] == [
        pytest.approx(6.0, rel=0.1)
    ]
    plain = diagnose([rigid], Question(arm))
    assert plain.verdict == "none" and not any("elastic" in note for note in plain.notes)


@pytest.mark.parametrize("laws", [("coulomb_friction",), ("motor_torque_offset",)])
@pytest.mark.parametrize("steady", [1.5, -1.5])
def test_motion_in_one_direction_tells_no_zero_from_dry_friction(
    laws: tuple[str, ...], steady: float
) -> None:
    """Neither is called well determined, and the reason is said; a motion that reverses has
    neither."""
    one_way = found(pendulum(1.0), swung(1, steady=steady, zero=0.5), laws=laws)
    assert any("j turned in only one direction" in note for note in one_way.notes)
    assert {e.verdict for e in one_way.estimates if "coulomb" in e.name or "offset" in e.name} <= {
        "poorly",
        "not",
    }
    both = found(pendulum(1.0), swung(1, zero=0.5), laws=LAWS)
    assert not any("one direction" in note for note in both.notes)
    assert of_law(both, "coulomb").verdict == of_law(both, "motor_torque_offset").verdict == "well"
