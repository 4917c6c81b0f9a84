"""A base that does not stand level."""

import casadi as ca

from elastic_arm.effects.effect import EffectInstance
from elastic_arm.effects.law import (
    Confusion,
    Contribution,
    Effect,
    Numbers,
    Scope,
    SymbolicMotion,
    signed,
)


def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """Gravity turned into the tilted base's axes, R' g with R = Rx(a) Ry(b)."""
    sa = ca.sin(p["x"])
    ca_ = ca.cos(p["x"])
    sb = ca.sin(p["y"])
    cb = ca.cos(p["y"])
    about_x = ca.vertcat(ca.horzcat(1, 0, 0), ca.horzcat(0, ca_, -sa), ca.horzcat(0, sa, ca_))
    about_y = ca.vertcat(ca.horzcat(cb, 0, sb), ca.horzcat(0, 1, 0), ca.horzcat(-sb, 0, cb))
    gravity = ca.DM(motion.robot.gravity)
    change = (about_x @ about_y).T @ gravity - gravity
    return motion.everywhere(motion.equations.gravity_columns(motion.x) @ change)


TILT = "base_tilt"

EFFECT = Effect(
    id=TILT,
    formula="base rotated by Rx(a) Ry(b) in the ground frame",
    description="The base of the arm is not level, so gravity acts in another direction.",
    plain="has a base that is tilted by {x} about x and {y} about y",
    signature=(
        "A link residual at all joints that depends only on the pose, even on a"
        " vertical first axis."
    ),
    law=law,
    # Beyond, the arm is mounted otherwise, which is looked for first.
    parameters=(
        signed("x", "rad", 0.35, "a", default=0.0, draw=(1e-3, 0.1)),
        signed("y", "rad", 0.35, "b", default=0.0, draw=(1e-3, 0.1)),
    ),
    magnitude=("x", "y"),
    scope=Scope.ARM,
    sides=("link",),
    regime="position",
    confusions=(
        Confusion(
            "link_inertia_mismatch",
            "the first joint hardly turns",
            "motion with large angles of the first joint, where a tilt loads the others"
            " differently",
        ),
    ),
)


def tilt(x: float, y: float) -> EffectInstance:
    """Return a base turned by Rx(x) Ry(y) in the ground frame, rad."""
    return EffectInstance(EFFECT, None, {"x": x, "y": y})
