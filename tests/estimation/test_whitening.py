"""The noise of residuals: carried from the channels into the equations, and whitened."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.dynamics.bodies import TENSOR
from elastic_arm.equations.numbers import Number
from elastic_arm.equations.robot_at import calibrated_robot
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.equation_sets import EquationSet
from elastic_arm.estimation.observation import Observation, observe, widest_band
from elastic_arm.estimation.whitening import EDGE, FLOOR, WhitenedData, noise_at, noise_models
from elastic_arm.recording import Side
from elastic_arm.sensors import Encoder, Sensors, TorqueSensor
from elastic_arm.simulation import SimulationSettings, simulate
from tests.helpers.gap_recordings import ROBOT, motions, record
from tests.helpers.motions import trajectory
from tests.helpers.random_arms import random_arm

MODEL = build_model(ROBOT, "mod3")


@lru_cache(maxsize=1)
def observation() -> Observation:
    return observe(record(motions()[0], sensors=Sensors.real(), rate=1000.0))


def setting() -> tuple[EquationSet, Band]:
    seen = observation()
    return EquationSet.direct(seen.pieces[0].recorded, MODEL.n), Band(
        widest_band(seen.rate), seen.rate
    )


def mean_square(data: WhitenedData) -> float:
    """Return that of the whitened residuals over the independent rows, of which the band leaves a
    part."""
    count = sum(len(y) - 2 * EDGE for y in data.y) * data.layout.rows
    return float(data.white @ data.white / (count * 2 * data.band.cutoff / data.band.kept_rate))


def test_whitened_residuals_of_a_clean_arm_are_white_noise_of_variance_one() -> None:
    """What is left where nothing is missing in the model is as much as the noise model states."""
    data = WhitenedData(MODEL, [observation()], *setting())
    assert mean_square(data) == pytest.approx(1.0, abs=0.15)


def test_holes_are_bridged_and_nothing_is_taken_from_them() -> None:
    """Of every 1.5 s the last 0.3 s are lost: one motion, with no more than noise in what is left
    of the rows."""
    whole = record(motions()[0], sensors=Sensors.real(), rate=1000.0)
    lost = {
        name: s.at(np.mod(s.stamp_ns, 1_500_000_000) < 1_200_000_000)
        for name, s in whole.measured().items()
    }
    seen = observe(replace(whole, **lost))
    assert len(seen.pieces) == 1
    assert any("ms are bridged" in note for note in seen.notes), seen.notes
    assert mean_square(WhitenedData(MODEL, [seen], *setting())) < 1.15


def test_a_torque_sensor_noisier_than_stated_spoils_its_own_row_alone() -> None:
    """Three times the noise of tau_J makes that of the drives' whitened rows nine times as strong
    in the mean square. The links' stay as they are, and the motors' nearly so at low frequency."""
    (noise,) = noise_models(MODEL, observation(), *setting(), (0.0,))
    louder = replace(
        observation(), noise=replace(observation().noise, tau_J=3.0 * observation().noise.tau_J)
    )
    (true,) = noise_models(MODEL, louder, *setting(), (0.0,))
    f = np.array([1.0, 5.0, 20.0])
    W = noise.whitener(f)
    at = np.rint(f / (noise.f[1] - noise.f[0])).astype(int)
    power = np.real(np.einsum("fij,fjk,fik->fi", W, true.covariance[at], W.conj()))
    layout, n = setting()[0], MODEL.n
    assert layout.sides == ("link", "drive", "motor")
    np.testing.assert_allclose(power[:, :n], 1.0, rtol=1e-6)
    assert (power[:, n : 2 * n] > 6.0).all() and (power[:2, 2 * n :] < 1.01).all()


@pytest.mark.parametrize("side", ["link", "motor"])
def test_an_encoder_counts_in_all_accelerations_that_are_made_of_it(side: str) -> None:
    """Be it the link's or the motor's of a rigid arm: what a clean one leaves is as large as the
    noise model states."""
    robot, encoder = random_arm(3, np.random.default_rng(2), elastic=False), Encoder(noise=5e-5)
    sensors = Sensors(
        link_encoder=encoder, motor_encoder=encoder, motor_torque=TorqueSensor(noise=0.02)
    )
    settings, rng = SimulationSettings(sensors=sensors), np.random.default_rng(1)
    recorded = simulate(robot, trajectory(seed=3), settings, duration=15.0, rng=rng)
    link, motor = recorded.link, recorded.motor
    assert link is not None and motor is not None
    alone = (
        replace(motor, velocity=None)
        if side == "motor"
        else replace(link, velocity=None, effort=motor.effort)
    )
    sides = {"link": None, "motor": None, side: alone}
    seen = observe(replace(recorded, **sides))
    equations = EquationSet.direct(seen.pieces[0].recorded, robot.n, elastic=False)
    data = WhitenedData(build_model(robot, "mod3"), [seen], equations, Band(20.0, seen.rate))
    assert mean_square(data) == pytest.approx(1.0, abs=0.2)


def test_the_whitener_inverts_the_covariance() -> None:
    """W C W^H is the identity at every frequency in the band."""
    (noise,) = noise_models(MODEL, observation(), *setting(), (FLOOR,))
    whitener = noise.whitener(noise.f)
    product = whitener @ noise.covariance @ whitener.conj().transpose(0, 2, 1)
    np.testing.assert_allclose(
        product, np.broadcast_to(np.eye(product.shape[1]), product.shape), atol=1e-8
    )


def test_the_autocovariance_leaves_the_covariance_as_it_is() -> None:
    """Beyond the band it takes other powers than the noise model, which whitens up to its edge."""
    layout, band = setting()
    (noise,) = noise_models(MODEL, observation(), layout, band, (FLOOR,))
    before = noise.covariance.copy()
    noise.autocovariance(band)
    np.testing.assert_array_equal(noise.covariance, before)


def test_the_floor_of_a_joint_is_a_part_of_its_own_sensors_noise() -> None:
    """The fine sensors of a wrist are not given a part of the coarse ones' noise at the base, those
    of a kind are."""
    seen, (equations, band) = observation(), setting()

    def floors(stds: list[float]) -> np.ndarray:
        noise = replace(seen.noise, tau_J=np.array(stds), tau_m=np.array(stds))
        with_floor, without = noise_models(
            MODEL, replace(seen, noise=noise), equations, band, (0.1, 0.0)
        )
        found, own = (
            np.real(np.einsum("frr->fr", one.covariance)[0])[: MODEL.n]
            for one in (with_floor, without)
        )
        # Beside a hundredth of all noise of the equation.
        return np.asarray(found - 1.01 * own)

    np.testing.assert_allclose(floors([0.3, 0.29, 0.01]), [9e-4, 9e-4, 1.4e-6], rtol=0.3)


def test_rows_of_a_motor_that_sticks_are_freed_of_its_friction() -> None:
    """Where a joint stands for 0.2 s, its motor's rows are next to null, those of link and drive as
    they were."""
    recording = record(motions()[0], sensors=Sensors.real(), rate=1000.0)
    motor, link = recording.motor, recording.link
    assert (
        motor is not None
        and link is not None
        and motor.position is not None
        and link.position is not None
    )
    stands = slice(2000, 2200)

    def held(side: Side) -> Side:
        assert side.position is not None
        position = side.position.copy()
        position[stands, 1] = position[stands.start, 1]
        position[stands.stop :, 1] += position[stands.start, 1] - side.position[stands.stop, 1]
        return replace(side, position=position, velocity=None)

    seen = observe(replace(recording, motor=held(motor), link=held(link)))
    whole, moving = (
        WhitenedData(MODEL, [seen], *setting(), sticking_removed=removed)
        for removed in (False, True)
    )
    motor_row = 2 * MODEL.n + 1
    t = moving.parts[0].stretch.t
    inside = (t > 2.05) & (t < 2.15)
    freed, kept = (np.abs(data.y[0][:, motor_row]) for data in (moving, whole))
    assert freed[inside].max() < 0.1 * kept[inside].max()
    assert (freed == kept).mean() > 0.8
    np.testing.assert_array_equal(moving.y[0][:, : 2 * MODEL.n], whole.y[0][:, : 2 * MODEL.n])


def test_a_scale_common_to_arm_and_torques_is_told_by_nothing() -> None:
    """A recording is as dense, to 0.01 a row, of links, rotors and springs 1.25 times as large
    beside sensors that read 0.8: each torque alone makes it 0.22. Motors that links carry keep
    their masses."""
    ordinary = {"link_mass", "rotor_inertia", "spline_inertia_ratio", "stiffness", "damping"}
    zero = {
        "link_com_x",
        "link_com_y",
        "link_com_z",
        *(f"link_inertia_{'xyz'[a]}{'xyz'[b]}" for a, b in TENSOR),
    }
    numbers = [
        Number(what, j, "1", 1.0, 1.0)
        for j in ROBOT.joint_names
        for what in sorted(ordinary | zero)
    ]
    values = np.array([0.25 if number.what in ordinary else 0.0 for number in numbers])
    larger = build_model(calibrated_robot(ROBOT, numbers, values), "mod3")
    gains = {"tau_J": np.full(MODEL.n, 0.8), "tau_m": np.full(MODEL.n, 0.8)}
    one = WhitenedData(MODEL, [observation()], *setting())
    other = WhitenedData(larger, [observation().corrected({}, gains)], *setting())
    assert other.density == pytest.approx(one.density, abs=0.01 * len(one.white))


def test_a_part_frees_the_rows_that_all_recordings_free() -> None:
    """A joint sticks below a share of its highest speed, which another recording may have."""
    seen = observe(record(motions()[0], sensors=Sensors.real(), rate=1000.0))
    faster = [replace(one, dq=5.0 * one.dq, dtheta=5.0 * one.dtheta) for one in seen.quiet]
    other = replace(seen, quiet=tuple(faster))
    alone = WhitenedData(MODEL, [seen], *setting(), sticking_removed=True)
    part = WhitenedData(MODEL, [seen], *setting(), sticking_removed=True, whole=[seen, other])
    both = WhitenedData(MODEL, [seen, other], *setting(), sticking_removed=True)
    np.testing.assert_array_equal(part.y[0], both.y[0])
    assert part.shares()[0].sum() < alone.shares()[0].sum()


def test_the_noise_of_accelerations_is_that_of_the_pose() -> None:
    """In the mean of the motion it is one; stretched out, the base has more inertia."""
    seen = observation()
    layout, band = setting()
    data = WhitenedData(MODEL, [seen], layout, band)
    noise = data.parts[0].noise
    motion = seen.pieces[0]
    assert motion.q is not None
    poses = motion.q[:: len(motion) // 12]
    each = noise_at(poses, MODEL, seen, layout, noise, band.cutoff)
    np.testing.assert_allclose(each.mean(axis=0), 1.0)
    inertia = np.array(
        [np.linalg.norm(M[0, :3]) for M in MODEL.mass_matrix(np.hstack([poses] * 2))]
    )
    base = each[:, 0]
    assert base[np.argmax(inertia)] == base.max() > 1.01 * base.min()
