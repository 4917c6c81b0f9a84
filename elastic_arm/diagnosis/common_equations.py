"""The equations and the frequency band that all recordings of a diagnosis have in common."""

from collections.abc import Sequence

import numpy as np

from elastic_arm.dynamics import Model
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.equation_sets import EquationSet
from elastic_arm.estimation.observation import Observation, widest_band
from elastic_arm.robot import Robot

ONE_ENCODER = (
    5.0  # Hz; above it, the deflection that a single encoder does not measure changes the motion
)
# Band edge, Hz, times length of a stretch, s, below which the filters of the band leave too few
# samples. The filters take 4.2 and 3.6 over the edge, and half of what the first one leaves must be
# longer than the second.
NARROW = 12.0


def common_equations(observations: Sequence[Observation], model: Model) -> tuple[EquationSet, Band]:
    """Return the equations and the band that all recordings allow.

    Raises a DiagnosisError if the recordings have different channels.
    """
    layouts = [EquationSet.of(o.pieces[0], model) for o in observations]
    if any(layout != layouts[0] for layout in layouts):
        raise DiagnosisError(
            "the recordings contain different channels",
            "Diagnose recordings with the same channels together",
        )
    rate = min(o.rate for o in observations)
    # s, longest piece of each recording without the samples that the smoother loses at its ends
    lengths = []
    for one in observations:
        samples = max(len(piece) for piece in one.pieces)
        lengths.append(samples / one.rate - 2.0 * one.margin)
    longest = min(lengths)
    torque_band = max(min(o.torque_band for o in observations), NARROW / max(longest, 1e-3))
    return layouts[0], common_band(layouts[0], model, rate, torque_band)


def common_band(
    layout: EquationSet, model: Model, rate: float, torque_band: float = np.inf
) -> Band:
    """Return the band in which residuals are compared.

    torque_band: Hz, above which torques were low-passed before they were recorded and do not match
    the motion.
    """
    widest = min(widest_band(rate), torque_band)
    return Band(min(widest, ONE_ENCODER) if has_one_encoder(layout, model.robot) else widest, rate)


def has_one_encoder(layout: EquationSet, robot: Robot) -> bool:
    """Whether an elastic arm has one equation per joint, with deflections that follow the load."""
    return len(layout.sides) == 1 and robot.elastic
