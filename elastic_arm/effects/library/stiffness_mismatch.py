"""A drive softer or stiffer than the model believes."""

from collections.abc import Mapping
from typing import Any

from elastic_arm.effects.model import Confusion, Effect
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Parameter


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """(ratio - 1) K d.

    Parameters
    ----------
    motion, i
        Symbols of the motion, and index of the joint.
    p
        `stiffness` (1).
    """
    motion.gear(i)
    return motion.at(i, drive=(p["stiffness"] - 1.0) * motion.K[i] * motion.deflection[i])


EFFECT = Effect(
    id="stiffness_mismatch",
    formula="(ratio - 1) K (theta - q)",
    description="The drive's stiffness differs from the nominal one.",
    signature="The drive residual is a straight line over the deflection.",
    law=law,
    parameters=(
        Parameter("stiffness", "1", 0.5, 2.0, neutral=1.0, above=0.0, example=(0.75, 0.9), meaning="true / nominal K"),
    ),
    sides=("drive",),
    regime="load",
    model_parameter=True,
    confusions=(
        Confusion(
            "joint_torque_gain",
            "only the drive equation can be used",
            "the link or motor equation: a gain shows there too",
        ),
        Confusion("nonlinear_stiffness", "the load covers a narrow range", "motion with light and heavy load"),
    ),
)
