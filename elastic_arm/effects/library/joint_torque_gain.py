"""A joint torque sensor that reads too much or too little."""

from collections.abc import Mapping
from typing import Any

from elastic_arm.effects.library.gain import GAIN, excess, scaling
from elastic_arm.effects.model import Confusion, Effect, SensorEffect
from elastic_arm.effects.motion import Contribution, SymbolicMotion


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """In recorded torque: (1 - 1/gain) tau_J, which the motor equation has with the other sign.

    Parameters
    ----------
    motion, i
        Symbols of the motion, and index of the joint.
    p
        `gain` (1).
    """
    error = excess(motion.tau_J[i], p)
    return motion.at(i, link=error, drive=error, motor=-error)


EFFECT: Effect = SensorEffect(
    id="joint_torque_gain",
    formula="tau_J recorded = gain * true",
    description="The joint torque sensor is scaled wrongly.",
    signature="All three residuals of the joint follow the joint torque, that of the motor with the other sign.",
    law=law,
    parameters=(GAIN,),
    sides=("link", "drive", "motor"),
    regime="load",
    change=scaling("joint_torque"),
    prior=lambda rate: 0.02,  # strain gauges: 0.5 to 2 % of the reading
    confusions=(
        Confusion(
            "stiffness_mismatch",
            "only the drive equation can be used",
            "the link or motor equation",
        ),
        Confusion(
            "link_inertia_mismatch",
            "one gain on all torque sensors scales all masses, K and D alike",
            "motor torques: they do not pass through the joint torque sensors",
        ),
    ),
)
