"""The common scale of torques, masses, stiffnesses and friction, which no recording shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from elastic_arm.diagnosis import Question
from elastic_arm.diagnosis.calibration.calibrate import posterior
from elastic_arm.diagnosis.calibration.nuisance import nuisance_parameters
from elastic_arm.diagnosis.calibration.recalibration import but_for_common_scale
from elastic_arm.diagnosis.preparation import prepare
from elastic_arm.diagnosis.priors import Priors
from elastic_arm.diagnosis.selection.tangents import tangents
from elastic_arm.diagnosis.settings import RefitSettings
from elastic_arm.effects import EFFECTS, EffectInstance
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.effects.text import known_effects
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.sensors import Encoder, Sensors
from elastic_arm.simulation import SimulationSettings, simulate
from tests.helpers.gap_recordings import ROBOT, motions

PAYLOAD = EffectInstance(EFFECTS["payload"], "joint_3", {"mass": 3.0, "position": (0.05, 0.02, 0.1)})
TWIST = EffectInstance(EFFECTS["transmission_error"], "joint_2", {"amplitude": 1e-4, "phase": 0.7, "order": 2.0})
PLAY = EffectInstance(EFFECTS["backlash"], "joint_2", {"half_gap": 1e-4})
HYSTERESIS = EffectInstance(EFFECTS["hysteresis"], "joint_2", {"torque": 5.0, "width": 1e-4})
SPRING = EffectInstance(EFFECTS["joint_spring"], "joint_2", {"stiffness": 60.0, "rest": 0.3})


@pytest.mark.parametrize("acting", [PAYLOAD, TWIST, PLAY, HYSTERESIS, SPRING], ids=lambda one: one.effect.id)
def test_effects_leave_the_common_scale_as_uncertain_as_the_priors_of_the_gains(acting: EffectInstance) -> None:
    """What is proportional to torques tells nothing of their common scale.

    A drive is wound by the payload, too: of the model's load alone, stiffnesses would tell the scale of all torques.
    Then each gain was known to 0.06 %, and was ten of these deviations off. A transmission error turns a share of the
    joint torque to the motor, which the gain of its sensor scales. What play takes off the deflection, a stiffness
    multiplies as well.
    """
    encoder = Encoder(resolution=2 * np.pi / 2**19)
    known = [*known_effects(("coulomb_friction", "viscous_friction"), ROBOT), acting]
    settings = SimulationSettings(effects=[acting], sensors=Sensors(encoder, encoder))
    first, second = (simulate(ROBOT, one, settings, rng=np.random.default_rng(k)) for k, one in enumerate(motions()))
    data = prepare([first], [second], Question(ROBOT, refit=True, given=tuple(known)))
    stds = posterior(data.library, (*data.given, *tangents(data.library, data.given)), data.settings)[1]
    gains = [(p.prior_std, std) for p, std in zip(data.calibration.parameters, stds, strict=True) if p.is_gain]
    common = np.sum([prior**-2.0 for prior, _ in gains]) ** -0.5
    assert len(gains) == 2 * ROBOT.n
    for prior, std in gains:
        assert std * prior > 0.9 * common


EQUATIONS = ArmEquations(ROBOT, "mod3")
GAINS = ("joint_torque_gain", "motor_torque_gain")
FACTOR = 30.0


def left_of(sizes: Sequence[float], freed: Sequence[int]) -> list[int]:
    """Return which of the freed gains of three joints count as faults where all gains came out with these sizes."""
    features = [Feature(EFFECTS[effect], name, {}, EQUATIONS) for effect in GAINS for name in ROBOT.joint_names]
    ordinary = nuisance_parameters(ROBOT, features, 250.0, Priors(), RefitSettings())
    gains = [p for p in ordinary if p.is_gain]
    gains = [p.of_fault(FACTOR) if k in freed else p for k, p in enumerate(gains)]
    values = np.array([(size - 1.0) / p.prior_std for size, p in zip(sizes, gains, strict=True)])
    faulty = [features[k] for k in freed]
    return [features.index(fault) for fault in but_for_common_scale(gains, values, faulty, RefitSettings())]


@pytest.mark.parametrize("freed", [range(6), range(5)])
def test_gains_that_move_together_are_no_faults(freed: range) -> None:
    """A dress pack that no law states drew all gains to 1.4, and masses to 0.65: a recording shows no common scale."""
    assert left_of([1.42, 1.45, 1.42, 1.40, 1.43, 1.42], freed) == []


def test_one_gain_that_is_off_is_a_fault_beside_gains_that_move_together() -> None:
    """What is off by itself stays a fault."""
    assert left_of([1.42, 1.45, 1.42, 1.40, 1.85, 1.42], range(6)) == [4]


@pytest.mark.parametrize("sizes", [[1.0, 1.04, 1.01, 0.99, 1.0, 1.0], [1.0, 1.85, 1.01, 0.99, 1.0, 1.0]])
def test_one_gain_beside_ordinary_ones_is_a_fault(sizes: list[float]) -> None:
    """The others tell the scale."""
    assert left_of(sizes, [1]) == [1]


def test_gains_beside_one_that_tells_the_scale_are_faults() -> None:
    """One that kept its prior, and does not go along, tells the scale of the others."""
    assert left_of([1.2, 1.2, 1.2, 1.2, 1.2, 1.0], range(5)) == [0, 1, 2, 3, 4]
