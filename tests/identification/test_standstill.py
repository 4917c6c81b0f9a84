"""Standstill tells nothing of friction, and takes nothing away of what motion told."""

from functools import cache

import numpy as np
import pytest

from elastic_arm.effects import parse
from elastic_arm.estimation.resampling import part
from elastic_arm.identification import IdentificationSettings, identifier_of, identify, parse_laws
from elastic_arm.recording import Recording
from elastic_arm.sensors import Encoder, Sensors
from elastic_arm.simulation import SimulationSettings, simulate
from tests.helpers.gap_recordings import ROBOT, motions

TRUE = 10.0  # Nm
LAW = "coulomb_friction:joint_2"
NAME = "coulomb_friction:joint_2.torque"
ENCODER = Encoder(noise=2e-5, velocity_noise=2e-3)


@cache
def recorded(rest: float) -> Recording:
    """Return 6 s of motion and then standstill, by encoders whose noise turns the sign of a
    velocity at rest."""
    settings = SimulationSettings(
        effects=[parse(f"{LAW}:torque={TRUE}", ROBOT)],
        sensors=Sensors(link_encoder=ENCODER, motor_encoder=ENCODER),
    )
    motion = motions()[0]
    return simulate(
        ROBOT, motion, settings, duration=motion.duration + rest, rng=np.random.default_rng(0)
    )


def live(rest: float) -> tuple[float, float]:
    """Return the friction that the stream finds, and its standard deviation."""
    samples = recorded(rest).samples()
    stream = identifier_of(ROBOT, "mod3", parse_laws([LAW], ROBOT))
    for first in range(0, len(samples), 100):
        stream.add(part(samples, slice(first, first + 100)))
    stream.finish()
    found = stream.fit()
    k = stream.equations.base.names.index(NAME)
    return float(found.Psi[k]), float(found.std[k])


def test_rest_takes_nothing_from_the_live_estimate() -> None:
    """Friction is as certain after 60 s of standstill as after 3 s of it, and within three
    deviations of the truth."""
    (early, before) = live(3.0)
    (late, after) = live(60.0)
    assert abs(late - early) < 0.2 * before
    assert after < 1.1 * before < 0.2
    assert abs(late - TRUE) < 3.0 * after


def test_identify_finds_as_much_in_a_recording_that_stands_mostly() -> None:
    """Friction of a recording that stands for ten times its motion is "well" determined, as without
    that."""
    settings = IdentificationSettings(effects=parse_laws([LAW], ROBOT), consistent=False)
    found = identify(recorded(60.0), ROBOT, settings)
    friction = next(e for e in found.estimates if e.name == NAME)
    assert friction.verdict == "well" and friction.value == pytest.approx(
        TRUE, abs=3.0 * friction.std
    )
    assert any("standstill" in note for note in found.notes)
