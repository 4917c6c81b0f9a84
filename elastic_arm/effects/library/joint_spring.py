"""A spring between two links."""

from collections.abc import Mapping
from typing import Any

from elastic_arm.effects.model import Confusion, Effect
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Parameter, Role


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """k (q - q_0) on the link."""
    return motion.at(i, link=p["stiffness"] * (motion.q[i] - p["rest"]))


EFFECT = Effect(
    id="joint_spring",
    formula="k (q - q_0) on the link",
    description="A spring from one link to the next: a counterbalance, a dress pack, a hose.",
    signature="The link residual is a straight line over the joint angle, whatever the speed and the other joints.",
    law=law,
    parameters=(
        Parameter("stiffness", "Nm/rad", 1.0, 2e4, neutral=0.0, least=0.0, example=(50.0, 200.0), meaning="k"),
        Parameter("rest", "rad", -3.2, 3.2, role=Role.SEARCHED, draw=(-1.0, 1.0), meaning="q_0, where it is relaxed"),
    ),
    sides=("link",),
    regime="position",
    confusions=(
        Confusion(
            "counterbalance",
            "the joint turns through a small angle, over which any curve is straight",
            "motion over a wide range of the joint",
        ),
        Confusion(
            "link_inertia_mismatch",
            "the joints above hardly move: gravity is then a function of the joint's own angle too",
            "motion of all joints over a wide range: gravity follows the angles of the others, a spring does not",
        ),
    ),
)
