"""A link encoder whose disc is off centre."""

from collections.abc import Mapping
from typing import Any

import casadi as ca

from elastic_arm.effects.library.sensor_error import changing
from elastic_arm.effects.model import Confusion, Effect, SensorEffect
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Parameter, Role


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """K and D times the false deflection and its rate."""
    motion.gear(i)
    angle = motion.q[i] + p["phase"]
    error = p["amplitude"] * ca.sin(angle)
    rate = p["amplitude"] * ca.cos(angle) * motion.dq[i]
    return motion.at(i, drive=motion.K[i] * error + motion.D[i] * rate)


EFFECT: Effect = SensorEffect(
    id="encoder_eccentricity",
    formula="link encoder = true + A sin(q + phi)",
    description="The link encoder's disc sits off centre.",
    signature="The drive residual is a sine over one turn of the link, whatever the speed and load.",
    law=law,
    parameters=(
        Parameter("amplitude", "rad", 1e-6, 5e-3, neutral=0.0, meaning="A"),
        Parameter("phase", "rad", -3.141592653589793, 3.141592653589793, role=Role.PHASE, default=0.0, meaning="phi"),
    ),
    sides=("drive",),
    regime="position",
    change=changing("link_encoder", eccentricity="amplitude", phase="phase"),
    confusions=(
        Confusion("encoder_offset", "the joint turns through a small angle", "motion over a wide range of the joint"),
    ),
)
