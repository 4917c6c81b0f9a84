"""Laws of a drive beside its stiffness: both are regressed on the load that the model predicts."""

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.effects import EffectInstance
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.text import parse
from elastic_arm.equations.places import feature_of
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.equation_sets import EquationSet
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.estimation.observation import observe
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.recording import Recording
from elastic_arm.sensors import Encoder, Sensors
from tests.helpers.gap_recordings import ROBOT, gentle, record

MODEL = build_model(ROBOT, "mod3")
JOINT = 1
CUBIC = f"nonlinear_stiffness:{ROBOT.joint_names[JOINT]}:cubic=3e8"
# Encoders of 19 bits.
SENSORS = Sensors(*[Encoder(resolution=2 * np.pi / 2**19)] * 2)


def data(recording: Recording, *acting: ActingEffect) -> WhitenedData:
    seen = observe(recording, 40.0)
    return WhitenedData(
        MODEL,
        [seen],
        EquationSet.direct(seen.pieces[0].recorded, MODEL.n),
        Band(40.0, seen.rate),
        predicted=True,
        acting=acting,
    )


def cubic() -> tuple[Feature, EffectInstance]:
    instance = parse(CUBIC, ROBOT)
    return feature_of(instance, ArmEquations(ROBOT, "mod3")), instance


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_cubic_stiffness_beside_a_free_one_is_not_drawn_to_the_encoders_noise(seed: int) -> None:
    """Where the load hardly changes, the two act nearly alike, and their difference would be noise
    of the encoders."""
    found, (feature, instance) = (
        data(record(gentle(seed), CUBIC, seed=seed, sensors=SENSORS)),
        cubic(),
    )
    part, row = found.parts[0], MODEL.n + JOINT
    load = np.zeros((len(part.signals.t), 3 * MODEL.n, 2))
    load[:, row, 0], load[:, row, 1] = part.signals.model_torques["tau_J"][:, JOINT], 1.0
    free = found.in_band(part, load)
    law = found.plain(feature)[0]
    columns = found.whiten([np.concatenate([free, law], axis=2)])
    scale = np.linalg.norm(columns, axis=0)
    beta = np.linalg.lstsq(columns / scale, found.white, rcond=None)[0] / scale
    left = found.white - columns @ beta
    std = (
        np.sqrt(np.linalg.inv((columns / scale).T @ (columns / scale))[2, 2] * np.mean(left**2))
        / scale[2]
    )
    assert abs(beta[2] - float(instance.parameters["cubic"])) < 3.0 * std


@pytest.mark.parametrize("size", [3e8, 1e11, -4e9])
@pytest.mark.parametrize("acts", [False, True])
def test_a_law_carries_its_part_of_the_load_at_the_deflection_of_the_drive(
    size: float, acts: bool
) -> None:
    """K d + D d' + K_3 d³ is the predicted load, be the law more than twice as steep as the spring,
    or falling."""
    recording, (feature, _) = record(gentle(1), CUBIC, seed=1, sensors=SENSORS), cubic()
    acting = [ActingEffect(feature.whole(), (size,), np.ones(1))] if acts else []
    signals = data(recording, *acting).parts[0].signals
    law = feature.whole().columns(signals, (size,))[:, MODEL.n + JOINT, 0]
    wound = np.cbrt(law / size)
    spring = ROBOT.joints[JOINT].transmission
    assert spring is not None
    linear = spring.stiffness * wound + spring.damping * np.gradient(wound, signals.t)
    load = signals.values["tau_J"][:, JOINT]
    assert np.abs(linear + law - load).max() < 0.02 * np.abs(law).max()
