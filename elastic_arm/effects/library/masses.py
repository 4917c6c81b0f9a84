"""Masses on the links that the model does not know, and weight that something outside the model
carries."""

import casadi as ca

from elastic_arm.effects.law import (
    Confusion,
    Contribution,
    Effect,
    Numbers,
    Parameter,
    Scope,
    SymbolicMotion,
    amount,
    searched,
)

NONE = (0.0, 0.0, 0.0)
PLACE = searched(
    "position",
    "m",
    -0.5,
    0.5,
    "p, in the link's frame O_i",
    default=NONE,
    size=3,
    draw=(-0.15, 0.15),
)
WHAT = "only knowledge of the mounted part"
POINT = f"{WHAT}; a change that no point mass can cause is a mismatch"


def carried(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """Weight and inertia of a point mass fixed to link i."""
    mass = p["mass"]
    position = p["position"]
    inertia = mass * (ca.sumsqr(position) * ca.SX.eye(3) - position @ position.T)
    return motion.everywhere(motion.carried_body(i, mass, mass * position, inertia))


def relieved(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """Minus the weight of a mass that link i carries; its inertia stays."""
    rest = ca.SX(*motion.x.shape)
    moment = p["mass"] * p["position"]
    return motion.everywhere(
        motion.equations.carried_body(i, -p["mass"], -moment, ca.SX(3, 3), motion.x, rest, rest)
    )


PAYLOAD = Effect(
    "payload",
    formula="a point mass m at p in O_n, fixed to the last link",
    description="A tool or workpiece that the model lacks.",
    plain="carries {mass} at its tool",
    signature=(
        "Additional weight and inertia on the last link, visible on the link side of"
        " every joint before it."
    ),
    law=carried,
    parameters=(amount("mass", "kg", 0.05, 50.0, "m"), PLACE),
    scope=Scope.LAST,
    sides=("link",),
    regime="load",
    confusions=(
        Confusion(
            "link_inertia_mismatch",
            "always: both change the last link; a payload changes it by a point mass",
            POINT,
        ),
    ),
)
LOAD = Effect(
    "load",
    formula="a point mass m at p in O_i, fixed to link i, not the last",
    description=("A part mounted on a link: a valve block, a cable drum, a camera on the forearm."),
    plain="carries {mass} on its link",
    signature=(
        "Additional weight and inertia on that link, visible on the link side of its"
        " joint and of those before it."
    ),
    law=carried,
    parameters=(amount("mass", "kg", 0.05, 50.0, "m"), PLACE),
    scope=Scope.BUT_LAST,
    sides=("link",),
    regime="load",
    confusions=(
        Confusion(
            "link_inertia_mismatch",
            "always: both change that link; a load changes it by a point mass",
            POINT,
        ),
        Confusion(
            "load",
            "a mass on the axis of the next joint can also belong to the neighbouring link",
            f"{WHAT}: both act through the same base parameters",
        ),
        Confusion(
            "payload",
            "the joints beyond the link do not move",
            "motion of all joints over a wide range",
        ),
    ),
)
CARRIED = Effect(
    "carried_weight",
    formula="- weight of m at p in O_i",
    description=(
        "A massless support carries part of the weight of a link, like gravcomp of a MuJoCo body."
    ),
    plain="has the weight of {mass} supported without added inertia",
    signature="The residual depends on the pose like gravity, with the opposite sign.",
    law=relieved,
    parameters=(Parameter("mass", "kg", 0.05, 50.0, neutral=0.0, meaning="m"), PLACE),
    sides=("link",),
    regime="position",
    # Where a description or a user states it: a recording shows it as a payload or load that has no
    # inertia.
    searched=False,
)

EFFECTS = (PAYLOAD, LOAD, CARRIED)
