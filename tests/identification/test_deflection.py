"""Two encoders and motor torque without joint torque sensors: nothing collapses to nothing, and
doubts are listed."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.identification import Identification, IdentificationSettings, identify
from elastic_arm.recording import Recording, Samples, Side
from elastic_arm.robot import Robot, load_robot
from examples.known_arm import true_values
from tests.helpers.periodic_arm import record

LAG = 2e-3
OFFSET = 5e-4


@pytest.fixture(scope="module")
def arm() -> Robot:
    return load_robot(None)


def described(arm: Robot) -> Robot:
    """Return a description of the arm with links 30 % too heavy, springs 30 % too soft, dampings 50
    % too large."""
    for joint in arm.joints:
        springs = replace(
            joint.transmission,
            stiffness=0.7 * joint.transmission.stiffness,
            damping=1.5 * joint.transmission.damping,
        )
        arm = arm.with_joint(
            joint.name, link=replace(joint.link, mass=1.3 * joint.link.mass), transmission=springs
        )
    return arm


def without_sensors(
    arm: Robot, samples: Samples, link_angles: np.ndarray, source: str = "test"
) -> Recording:
    link = Side(samples.stamp_ns, link_angles, samples.dq)
    motor = Side(samples.stamp_ns, samples.theta, samples.dtheta, samples.tau_m)
    return Recording(arm.joint_names, link=link, motor=motor, source=source)


def measured(arm: Robot, noise: float, seed: int = 0) -> Samples:
    model = build_model(arm, "mod3")
    return record(
        model, np.random.default_rng(seed), encoder_noise=noise, velocity_noise=100 * noise
    )


def value_of(result: Identification, name: str) -> float:
    return next(e.value for e in result.estimates if e.name == name)


@pytest.mark.parametrize("noise", [1e-6, 1e-4])
def test_torque_sets_the_scale_whatever_the_encoders_noise(arm: Robot, noise: float) -> None:
    """From a description that is 30 % wrong, stiffnesses come out to 3 % and all parameters within
    their deviations."""
    samples = measured(arm, noise)
    result = identify(
        without_sensors(arm, samples, samples.q),
        described(arm),
        IdentificationSettings(consistent=False),
    )
    for joint in arm.joints:
        assert value_of(result, f"{joint.name}.K") == pytest.approx(
            joint.transmission.stiffness, rel=0.03
        )
    z = (result.Psi_base - true_values(result, arm)) / np.maximum(result.std, 1e-300)
    z = z[np.isfinite(z)]
    assert np.sqrt(np.mean(z**2)) < 1.6


def test_a_damping_that_the_recording_does_not_hold_stays_with_the_description(arm: Robot) -> None:
    """With 1e-4 rad of encoder noise no damping of joint 1 is known: it is the description's,
    "not", and listed."""
    samples = measured(arm, 1e-4)
    nominal = described(arm)
    result = identify(
        without_sensors(arm, samples, samples.q), nominal, IdentificationSettings(consistent=False)
    )
    damping = next(e for e in result.estimates if e.name == "joint_1.D")
    assert (damping.value, damping.verdict) == (nominal.joints[0].transmission.damping, "not")
    assert any("joint_1.D" in note and "described values are kept" in note for note in result.notes)


def test_lag_and_offset_of_a_link_encoder_are_not_read_as_compliance(arm: Robot) -> None:
    """A link encoder 2 ms late and 0.5 mrad off is said to be, and stiffnesses stay right to 3
    %."""
    samples = measured(arm, 1e-6)
    late = samples.q - LAG * samples.dq + OFFSET
    result = identify(
        without_sensors(arm, samples, late), arm, IdentificationSettings(consistent=False)
    )
    for joint in arm.joints:
        K = value_of(result, f"{joint.name}.K")
        assert pytest.approx(joint.transmission.stiffness, rel=0.03) == K
        assert value_of(result, f"link_encoder:{joint.name}.K_delay") / K == pytest.approx(
            LAG, rel=0.05
        )
        assert value_of(result, f"link_encoder:{joint.name}.K_offset") / K == pytest.approx(
            OFFSET, rel=0.05
        )
    assert sum("lags by" in note and "offset" in note for note in result.notes) == arm.n


def test_zeros_that_differ_between_recordings_are_aligned_and_said(arm: Robot) -> None:
    """Two recordings whose link encoders count from 3 mrad apart give the stiffness that each alone
    gives."""
    first = measured(arm, 1e-6)
    second = measured(arm, 1e-6, seed=1)
    both = [
        without_sensors(arm, first, first.q, "first"),
        without_sensors(arm, second, second.q + 3e-3, "second"),
    ]
    result = identify(both, arm, IdentificationSettings(consistent=False))
    assert value_of(result, "joint_1.K") == pytest.approx(
        arm.joints[0].transmission.stiffness, rel=0.01
    )
    assert any(note.startswith("second: zeros of the link encoders") for note in result.notes)
