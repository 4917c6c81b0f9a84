"""Friction of teeth pressed together by the load."""

from collections.abc import Mapping
from typing import Any

import casadi as ca

from elastic_arm.effects.model import Confusion, Effect
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Parameter


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """mu abs(tau_J) sign(w) on the motor side."""
    return motion.at(i, motor=p["coefficient"] * ca.fabs(motion.tau_J[i]) * motion.sign("motor", i))


EFFECT = Effect(
    id="load_dependent_friction",
    formula="mu abs(tau_J) sign(w)",
    description="Dry friction in proportion to the torque that the drive transmits: teeth and wave bearing under load.",
    signature="The jump at a velocity reversal grows with the joint torque there; unloaded reversals show none.",
    law=law,
    parameters=(Parameter("coefficient", "1", 0.002, 0.2, neutral=0.0, least=0.0, meaning="mu"),),
    sides=("motor",),
    regime="load",
    needs_motion=True,
    friction=True,
    confusions=(
        Confusion("coulomb_friction", "the joint torque is nearly constant", "reversals under clearly different loads"),
        Confusion(
            "motor_torque_gain",
            "the velocity seldom reverses, or the load has the sign of the velocity",
            "reversals under load: a gain shows no jump there",
        ),
    ),
)
