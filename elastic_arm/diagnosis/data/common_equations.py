"""The equations and the band in which all recordings of a diagnosis are compared."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from elastic_arm.diagnosis.settings import PreprocessingSettings
from elastic_arm.dynamics import Model
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.equations import EquationSet
from elastic_arm.estimation.observation import Observation, widest_band
from elastic_arm.robot import Robot


def common_equations(
    observations: Sequence[Observation], model: Model, settings: PreprocessingSettings
) -> tuple[EquationSet, Band]:
    """Return equations and band that all recordings allow.

    Parameters
    ----------
    observations
        Of all recordings.
    model
        The nominal model.
    settings
        Shares and edges of the band.

    Raises
    ------
    DiagnosisError
        If the recordings hold different channels, or have different sample rates.
    """
    layouts = [EquationSet.of(o.pieces[0], model) for o in observations]
    if any(layout != layouts[0] for layout in layouts):
        raise DiagnosisError(
            "the recordings do not hold the same channels", "Diagnose those with equal channels together"
        )
    rate = min(o.rate for o in observations)
    if max(o.rate for o in observations) > settings.rate_tolerance * rate:
        raise DiagnosisError("the recordings have different sample rates", "Diagnose those of one rate together")
    longest = min(max(len(piece) / o.rate - 2.0 * o.margin for piece in o.pieces) for o in observations)
    torque_band = max(min(o.torque_band for o in observations), settings.narrow_filter / max(longest, 1e-3))
    return layouts[0], common_band(layouts[0], model, rate, settings, torque_band)


def common_band(
    layout: EquationSet, model: Model, rate: float, settings: PreprocessingSettings, torque_band: float = np.inf
) -> Band:
    """Return the band in which residuals are compared.

    Parameters
    ----------
    layout
        Usable equations.
    model
        The nominal model.
    rate
        Hz, of the recordings.
    settings
        Upper edge where only one encoder is recorded.
    torque_band
        Hz, from which on torques were low-passed before they were recorded: above, they are not those of the motion.
    """
    widest = min(widest_band(rate), torque_band)
    return Band(min(widest, settings.one_encoder_band) if has_one_encoder(layout, model.robot) else widest, rate)


def has_one_encoder(layout: EquationSet, robot: Robot) -> bool:
    """Whether an elastic arm is one equation a joint, in which the deflection follows the load."""
    return len(layout.sides) == 1 and robot.elastic
