"""A mass on a link before the last that the model does not know."""

from elastic_arm.effects.library.payload import NUMBERS, law
from elastic_arm.effects.model import Confusion, Effect, Scope

EFFECT = Effect(
    id="load",
    formula="a point mass m at p in O_i, fixed to link i, not the last",
    description="Something mounted on a link: a valve block, a cable drum, a camera on the forearm.",
    signature="Extra weight and inertia on that link, felt by the link side of its joint and of those before it.",
    law=law,
    parameters=NUMBERS,
    scope=Scope.BUT_LAST,
    sides=("link",),
    regime="load",
    confusions=(
        Confusion(
            "link_inertia_mismatch",
            "always: both change that link; a load changes it by a point mass",
            "only knowing what was mounted; a change that no point mass makes is a mismatch",
        ),
        Confusion(
            "load",
            "a mass on the axis of the next joint is as well one on the neighbouring link",
            "only knowing what was mounted: both act through the same base parameters",
        ),
        Confusion(
            "payload",
            "the joints beyond the link stand still",
            "motion of all joints over a wide range",
        ),
    ),
)
