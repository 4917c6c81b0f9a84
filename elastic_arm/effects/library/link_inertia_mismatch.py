"""A link that is heavier or otherwise distributed than the model believes."""

from typing import Any

import casadi as ca
import numpy as np

from elastic_arm.effects.law import (
    Confusion,
    Contribution,
    Effect,
    Numbers,
    SymbolicMotion,
    ratio,
    signed,
)


def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """What the true link has beyond the nominal one, as a body carried along with it."""
    link = motion.robot.joints[i].link
    mass = p["mass"] * link.mass
    com = ca.DM(link.com) + p["com"]
    about_origin = p["inertia"] * p["mass"] * ca.DM(link.inertia) + mass * _steiner(com)
    nominal = ca.DM(link.inertia + link.mass * np.array(_steiner(ca.DM(link.com))))
    rows = motion.carried_body(
        i, mass - link.mass, mass * com - link.mass * ca.DM(link.com), about_origin - nominal
    )
    return motion.everywhere(rows)


def _steiner(p: Any) -> Any:
    return ca.sumsqr(p) * ca.DM.eye(3) - p @ p.T


EFFECT = Effect(
    id="link_inertia_mismatch",
    formula="mass m -> r m, centre of mass c -> c + s, inertia about it I -> rho r I",
    description=(
        "The inertial parameters of the link differ from the nominal ones: wall"
        " thickness, cables, covers."
    ),
    plain="has a link of {mass} times the described mass",
    signature=(
        "Wrong weight and inertia of that link, visible on the link side of its joint"
        " and of those before it."
    ),
    law=law,
    parameters=(
        ratio("mass", 0.5, 2.0, "r, true / nominal", default=1.0, above=0.0),
        signed("com", "m", 0.2, "s, shift of the centre of mass", default=(0.0, 0.0, 0.0), size=3),
        ratio("inertia", 0.5, 2.0, "rho, in addition to the mass ratio", default=1.0, above=0.0),
    ),
    sides=("link",),
    regime="load",
    model_parameter=True,
    number="link_mass",
    confusions=(
        Confusion(
            "payload", "the last link changes by a point mass", "only knowledge of the mounted part"
        ),
        Confusion(
            "link_inertia_mismatch",
            "a neighbouring link acts through the same base parameters",
            "no motion: only combinations of the parameters of both links act on the joints",
        ),
        Confusion(
            "joint_torque_gain",
            "one common gain of all torque sensors scales all masses, K and D alike",
            "motor torques: they are independent of the joint torque sensors",
        ),
    ),
)
