"""A motor torque that is recorded too large or too small."""

from collections.abc import Mapping
from typing import Any

from elastic_arm.effects.library.gain import GAIN, excess, scaling
from elastic_arm.effects.model import Confusion, Effect, SensorEffect
from elastic_arm.effects.motion import Contribution, SymbolicMotion


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """In recorded torque: (1 - 1/gain) tau_m.

    Parameters
    ----------
    motion, i
        Symbols of the motion, and index of the joint.
    p
        `gain` (1).
    """
    return motion.at(i, motor=excess(motion.tau_m[i], p))


EFFECT: Effect = SensorEffect(
    id="motor_torque_gain",
    formula="tau_m recorded = gain * true",
    description="The motor's torque constant is not what the drive believes.",
    signature="The motor residual follows the motor torque itself, through rest and motion alike.",
    law=law,
    parameters=(GAIN,),
    sides=("motor",),
    regime="load",
    change=scaling("motor_torque"),
    prior=lambda rate: 0.02,  # current sensors and torque constants: 1 to 3 %
    confusions=(
        Confusion(
            "rotor_inertia_mismatch",
            "no gravity or load acts on the joint, as on a vertical first axis",
            "motion in which other joints or gravity load this one",
        ),
    ),
)
