"""A drive softer or stiffer than the model believes."""

from elastic_arm.effects.library.mismatch import scaled
from elastic_arm.effects.model import Confusion, Effect
from elastic_arm.effects.parameters import Parameter

EFFECT = Effect(
    id="stiffness_mismatch",
    formula="(ratio - 1) K (theta - q)",
    description="The drive's stiffness differs from the nominal one.",
    signature="The drive residual is a straight line over the deflection.",
    law=scaled("stiffness", "drive", lambda motion, i: motion.K[i] * motion.deflection[i]),
    parameters=(
        Parameter("stiffness", "1", 0.5, 2.0, neutral=1.0, above=0.0, example=(0.75, 0.9), meaning="true / nominal K"),
    ),
    sides=("drive",),
    regime="load",
    model_parameter=True,
    number="stiffness",
    confusions=(
        Confusion(
            "joint_torque_gain",
            "only the drive equation can be used",
            "the link or motor equation: a gain shows there too",
        ),
        Confusion("nonlinear_stiffness", "the load covers a narrow range", "motion with light and heavy load"),
    ),
)
