"""A drive with more or less damping than the model believes."""

from elastic_arm.effects.library.mismatch import scaled
from elastic_arm.effects.model import Confusion, Effect
from elastic_arm.effects.parameters import Parameter

EFFECT = Effect(
    id="damping_mismatch",
    formula="(ratio - 1) D (theta' - q')",
    description="The drive's damping differs from the nominal one.",
    signature="The drive residual follows the rate of deflection: small on slow motion, largest where the arm rings.",
    law=scaled("damping", "drive", lambda motion, i: motion.D[i] * motion.deflection_rate[i]),
    parameters=(Parameter("damping", "1", 0.1, 10.0, neutral=1.0, least=0.0, meaning="true / nominal D"),),
    sides=("drive",),
    regime="frequency",
    model_parameter=True,
    number="damping",
    confusions=(
        Confusion(
            "time_delay",
            "only the drive equation can be used: a delay of tau_J acts there as dD = -K delay",
            "the link or motor equation: a delay shows there too",
        ),
        Confusion("hysteresis", "the drive is wound at one speed", "the same motion slower"),
    ),
)
