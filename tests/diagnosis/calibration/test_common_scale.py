"""The common scale of torques, masses, stiffnesses and friction, which no recording shows."""

from __future__ import annotations

import numpy as np

from elastic_arm.diagnosis import Question
from elastic_arm.diagnosis.calibration.calibrate import posterior
from elastic_arm.diagnosis.preparation import prepare
from elastic_arm.diagnosis.selection.tangents import tangents
from elastic_arm.effects import EFFECTS, EffectInstance
from elastic_arm.effects.text import known_effects
from elastic_arm.sensors import Encoder, Sensors
from elastic_arm.simulation import SimulationSettings, simulate
from tests.helpers.gap_recordings import ROBOT, motions

PAYLOAD = EffectInstance(EFFECTS["payload"], "joint_3", {"mass": 3.0, "position": (0.05, 0.02, 0.1)})


def test_a_load_leaves_the_common_scale_as_uncertain_as_the_priors_of_the_gains() -> None:
    """A drive is wound by the payload, too: of the model's load alone, stiffnesses would tell the scale of all torques.

    Then each gain was known to 0.06 %, and was ten of these deviations off.
    """
    encoder = Encoder(resolution=2 * np.pi / 2**19)
    known = [*known_effects(("coulomb_friction", "viscous_friction"), ROBOT), PAYLOAD]
    settings = SimulationSettings(effects=[PAYLOAD], sensors=Sensors(encoder, encoder))
    first, second = (simulate(ROBOT, one, settings, rng=np.random.default_rng(k)) for k, one in enumerate(motions()))
    data = prepare([first], [second], Question(ROBOT, refit=True, given=tuple(known)))
    stds = posterior(data.library, (*data.given, *tangents(data.library, data.given)), data.settings)[1]
    gains = [(p.prior_std, std) for p, std in zip(data.calibration.parameters, stds, strict=True) if p.is_gain]
    common = np.sum([prior**-2.0 for prior, _ in gains]) ** -0.5
    assert len(gains) == 2 * ROBOT.n
    for prior, std in gains:
        assert std * prior > 0.9 * common
