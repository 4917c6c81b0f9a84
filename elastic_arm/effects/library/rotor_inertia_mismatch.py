"""A motor side that is heavier than the model believes."""

from elastic_arm.effects.library.mismatch import scaled
from elastic_arm.effects.model import Confusion, Effect
from elastic_arm.effects.parameters import Parameter

EFFECT = Effect(
    id="rotor_inertia_mismatch",
    formula="(ratio - 1) B_ii theta''",
    description="The inertia on the motor side differs: rotor, wave generator and spline act together in B.",
    signature="The motor residual follows the motor's acceleration.",
    law=scaled("inertia", "motor", lambda motion, i: motion.motor_inertia(i) * motion.ddtheta[i]),
    parameters=(Parameter("inertia", "1", 0.5, 2.0, neutral=1.0, above=0.0, meaning="true / nominal B_ii"),),
    sides=("motor",),
    regime="acceleration",
    needs_motion=True,
    model_parameter=True,
    number="rotor_inertia",
    confusions=(
        Confusion(
            "motor_torque_gain",
            "no gravity or load acts on the joint, as on a vertical first axis",
            "motion in which other joints or gravity load this one",
        ),
        Confusion(
            "inertia_coupling",
            "the link moves as the motor does",
            "motion that winds the drive: fast enough for link and motor accelerations to differ",
        ),
    ),
)
