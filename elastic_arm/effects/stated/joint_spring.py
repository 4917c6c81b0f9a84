"""A spring that pulls a joint towards an angle."""

from collections.abc import Mapping
from typing import Any

from elastic_arm.effects.model import Effect
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Parameter, Role


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """k (q - q_0) on the link side.

    Parameters
    ----------
    motion, i
        Symbols of the motion, and index of the joint.
    p
        `stiffness` (Nm/rad) and `rest` (rad).
    """
    return motion.at(i, link=p["stiffness"] * (motion.q[i] - p["rest"]))


EFFECT = Effect(
    id="joint_spring",
    formula="k (q - q_0)",
    description="A spring between a link and the one before it, such as a balancer, relaxed at one angle.",
    signature="The residual is a straight line over the joint's angle, whatever the motion.",
    law=law,
    parameters=(
        Parameter("stiffness", "Nm/rad", 0.1, 1000.0, neutral=0.0, meaning="k"),
        Parameter("rest", "rad", -3.2, 3.2, role=Role.SEARCHED, default=0.0, meaning="q_0"),
    ),
    sides=("link",),
    regime="position",
    searched=False,
)
