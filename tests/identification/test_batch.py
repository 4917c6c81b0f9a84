"""One estimator online and offline, honest intervals, clear refusals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.codegen import parallel
from elastic_arm.dynamics import Model, build_model
from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.motion import Motion
from elastic_arm.estimation.resampling import Clock, part
from elastic_arm.estimation.smoother import design_smoother
from elastic_arm.identification import (
    Identification,
    IdentificationSettings,
    Identifier,
    identifier_of,
    identify,
    parse_laws,
)
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.batch.derivatives import DerivativeStage
from elastic_arm.identification.stream import smoothed
from elastic_arm.identification.verdict import relative_std
from elastic_arm.recording import Recording, Samples, Side
from elastic_arm.robot import load_robot, to_urdf
from elastic_arm.robot.urdf import parse_urdf
from tests.helpers.periodic_arm import record, recording_of

REAL = {"encoder_noise": 1e-6, "velocity_noise": 1e-4}
SEEDS = range(9)


@pytest.fixture(scope="module")
def model() -> Model:
    return build_model(load_robot(None), "mod3")


@pytest.fixture(scope="module")
def samples(model: Model) -> Samples:
    return record(model, np.random.default_rng(0), **REAL)


def recorded(samples: Samples, **changes: Side | None) -> Recording:
    return recording_of(samples, load_robot(None), **changes)


def fed(model: Model, samples: Samples, cuts: list[int]) -> Identifier:
    identifier = Identifier(model)
    for piece in np.split(np.arange(len(samples)), cuts):
        identifier.add(part(samples, piece))
    identifier.finish()
    return identifier


def test_all_threads_identify_what_one_does(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a recording of several runs, smoothed ahead, parameters and standard deviations are the
    same to rounding."""
    long = recorded(record(model, np.random.default_rng(3), periods=7, **REAL))
    settings = IdentificationSettings(consistent=False)
    found = []
    for threads in ("1", "2"):
        monkeypatch.setattr(parallel.os, "sched_getaffinity", lambda _: range(2), raising=False)
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        found.append(identify(long, model.robot, settings))
    alone, shared = found
    assert shared.Psi_base == pytest.approx(alone.Psi_base, rel=1e-9)
    assert [e.std for e in shared.estimates] == pytest.approx(
        [e.std for e in alone.estimates], rel=1e-6
    )


def test_both_torques_identify_an_arm_described_as_rigid(samples: Samples) -> None:
    """A description without transmissions has one equation a joint, measured by both torque
    sensors: both are used."""
    rigid = parse_urdf(to_urdf(load_robot(None)))
    found = identify(recorded(samples), rigid, IdentificationSettings(consistent=False))
    assert set(found.noise) == {"joint", "whole"}
    equations = BaseRegression(
        build_model(rigid), ("q", "theta", "tau_J", "tau_m"), joints=rigid.joint_names
    )
    q, dq, ddq, tau_J, tau_m = np.random.default_rng(3).standard_normal((5, 50, rigid.n))
    motion = Motion(np.arange(50.0), q, dq, ddq, tau_J=tau_J, tau_m=tau_m)
    rows = equations.rows(motion)
    R = equations.information(motion)
    squares = np.swapaxes(R, 1, 2) @ R
    np.testing.assert_allclose(squares, np.swapaxes(rows, 1, 2) @ rows, rtol=1e-9, atol=1e-6)


@pytest.mark.slow(4)
def test_intervals_cover_the_truth_over_seeds(model: Model) -> None:
    """95 % intervals of all 26 parameters, with a smoother's coloured errors, cover in 92 to 98.5 %
    of cases."""
    hits = []
    bias = []
    for seed in SEEDS:
        identifier = fed(model, record(model, np.random.default_rng(100 + seed), **REAL), [])
        found = identifier.fit()
        true = identifier.equations.base.T @ model.Psi
        hits.append(np.abs(found.Psi - true) < 1.96 * found.std)
        bias.append((found.Psi - true) / found.std)
    assert 0.92 <= np.mean(hits) <= 0.985
    # Noise in the regressor itself would shift estimates the same way every time.
    assert np.sqrt(np.mean(np.mean(bias, axis=0) ** 2)) < 2.0 / np.sqrt(len(SEEDS))


def test_a_lost_sample_and_a_gap_lose_nothing_else(model: Model, samples: Samples) -> None:
    """Short holes are bridged, a long gap starts a new piece; the estimate stays within its
    intervals."""
    lost = np.r_[3000:3002, 9000:9500]
    identifier = fed(model, part(samples, np.setdiff1d(np.arange(len(samples)), lost)), [5000])
    found = identifier.fit()
    true = identifier.equations.base.T @ model.Psi
    assert identifier.progress.pieces == 2
    assert np.mean(np.abs(found.Psi - true) < 4 * found.std) > 0.9


def test_late_and_repeated_samples_are_refused_and_counted(model: Model, samples: Samples) -> None:
    """Samples whose stamps do not advance are left out, and progress says how many."""
    identifier = Identifier(model)
    identifier.add(part(samples, slice(0, 6000)))
    identifier.add(part(samples, slice(5990, 8000)))
    assert identifier.progress.refused == 10
    assert identifier.progress.received == 8010


def test_reset_forgets_and_pause_ignores(model: Model, samples: Samples) -> None:
    """After a reset nothing is known; while paused samples do not count."""
    identifier = Identifier(model)
    identifier.add(part(samples, slice(0, 8000)))
    identifier.pause()
    before = identifier.progress.samples
    identifier.add(part(samples, slice(8000, 12000)))
    assert identifier.progress.samples == before
    identifier.resume()
    identifier.reset()
    with pytest.raises(IdentificationError, match="no samples yet"):
        identifier.fit()


@pytest.mark.parametrize(
    ("missing", "sides"),
    [
        ((), ("link", "motor", "drive")),
        (("tau_J",), ("link", "motor")),
        (("tau_m",), ("link", "drive")),
        (("theta", "dtheta", "tau_m"), ("joint",)),
        (("q", "dq", "tau_J"), ("whole",)),
    ],
)
def test_every_set_of_channels_is_identified_by_the_equations_it_allows(
    model: Model, samples: Samples, missing: tuple[str, ...], sides: tuple[str, ...]
) -> None:
    """Whatever is missing, the remaining equations give the parameters that they see, without a
    bias that stands out.

    Where one encoder stands for both, theta = q is an approximation: what is left then is the
    elasticity.
    """
    identifier = fed(model, replace(samples, **dict.fromkeys(missing)), [])
    assert identifier.equations.sides == sides
    found = identifier.fit()
    equations = identifier.equations
    error = np.abs(found.Psi - equations.base.T @ model.Psi)
    assert np.median(relative_std(equations, found.Psi, error)) < (0.01 if len(sides) > 1 else 0.05)


def test_without_any_torque_identification_is_refused(model: Model, samples: Samples) -> None:
    """Both encoders alone say nothing about the scale, and the error names what to record."""
    with pytest.raises(IdentificationError, match="no torque"):
        Identifier(model).add(replace(samples, tau_J=None, tau_m=None))


def test_recordings_with_different_channels_are_refused(model: Model, samples: Samples) -> None:
    """The error names the channels of both."""
    first = recorded(samples)
    second = recorded(samples, motor=None)
    with pytest.raises(IdentificationError, match="another q, tau_J"):
        identify([first, second], model.robot, IdentificationSettings(consistent=False))


def test_a_law_beside_the_model_is_identified(model: Model, samples: Samples) -> None:
    """Viscous friction added to the motor torque of joint 2 is found within its interval, and none
    elsewhere."""
    rubbed = samples.tau_m.copy()
    rubbed[:, 1] += 12.0 * samples.dtheta[:, 1]
    laws = parse_laws(["viscous_friction"], model.robot)
    recording = recorded(replace(samples, tau_m=rubbed))
    result = identify(
        recording, model.robot, IdentificationSettings(effects=laws, consistent=False)
    )
    found = {e.name: e for e in result.estimates if e.name.startswith("viscous")}
    assert found["viscous_friction:joint_2.coefficient"].value == pytest.approx(12.0, abs=0.05)
    for joint in ("joint_1", "joint_3"):
        e = found[f"viscous_friction:{joint}.coefficient"]
        assert abs(e.value) < 4 * e.std


def test_laws_too_long_for_the_recording_and_unreadable_ones_are_refused(
    model: Model, samples: Samples
) -> None:
    """A run that outlasts the smoother once, but not the laws' second pass, is refused; so is a law
    said twice."""
    identifier = identifier_of(model.robot, "mod3", parse_laws(["viscous_friction"], model.robot))
    grid = Clock.of(samples).place(samples)[0]
    smoother = design_smoother([grid], model.n)
    with pytest.raises(IdentificationError, match="too short for the smoother"):
        smoothed(smoother, grid[: 3 * smoother.lag], identifier.choose_equations(samples))
    with pytest.raises(IdentificationError, match="cannot read the law"):
        parse_laws(["viscous_friction:joint_1:coefficient=1:side=link"], model.robot)


def test_a_poor_excitation_is_known_before_any_fit(model: Model) -> None:
    """A slow motion of two harmonics is called poor without a look at the torques, a rich one is
    not."""
    verdicts = []
    for harmonics in (2, 10):
        samples = record(model, np.random.default_rng(3), harmonics=harmonics, **REAL)
        garbled = replace(
            samples, tau_m=samples.tau_m[::-1].copy(), tau_J=samples.tau_J[::-1].copy()
        )
        verdicts.append(fed(model, garbled, []).excitation())
    assert verdicts[0].poor
    assert verdicts[0].reasons
    assert not verdicts[1].poor


def test_a_second_of_motion_is_called_too_short(model: Model) -> None:
    """What a second determines to all appearance is known to be judged too well, and said so."""
    second = part(record(model, np.random.default_rng(0)), slice(0, 1000))
    judged = fed(model, second, []).excitation()
    assert judged.poor
    assert "too short to estimate the errors" in judged.reasons[0]


def test_result_survives_its_json_file(model: Model, samples: Samples, tmp_path: Path) -> None:
    """A saved result loads with equal numbers, and its table can be used."""
    result = identify(recorded(samples), model.robot, IdentificationSettings())
    result.to_json(tmp_path / "identification.json")
    loaded = Identification.load(tmp_path / "identification.json")
    assert loaded.Psi_base == pytest.approx(result.Psi_base, rel=0, abs=0)
    assert loaded.table() == result.table()
    assert np.array_equal(loaded.T, result.T)


def test_a_file_that_is_no_identification_is_refused(tmp_path: Path) -> None:
    """Another JSON file is refused with the schema that is expected."""
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(IdentificationError, match="is not an identification"):
        Identification.load(tmp_path / "other.json")
    (tmp_path / "part.json").write_text(
        '{"schema": "elastic_arm/identification/1", "estimates": []}'
    )
    with pytest.raises(IdentificationError, match="not a complete identification"):
        Identification.load(tmp_path / "part.json")


def test_an_arm_at_rest_is_refused(samples: Samples) -> None:
    """A recording in which nothing moves identifies nothing, and says so before it fits noise."""
    still = replace(samples, q=0.0 * samples.q, theta=0.0 * samples.theta)
    with pytest.raises(IdentificationError, match="contains no motion"):
        identify(recorded(still), load_robot(None))


def test_noise_is_that_of_the_rows_that_count(model: Model, samples: Samples) -> None:
    """Leaving out every other instant of a joint, as if it stuck there, makes its noise no
    smaller."""
    found = []
    for every in (1, 2):
        identifier = Identifier(model)
        for motion in DerivativeStage(samples)().motions:
            stuck = np.zeros_like(motion.theta, dtype=bool)
            stuck[1::every, 1] = every > 1
            identifier.add_motion(replace(motion, stuck=stuck))
        noise = identifier.estimate().noise["motor"]
        found.append(list(noise.values()))
    assert found[1] == pytest.approx(found[0], rel=0.1)
