"""A drive that stiffens."""

from casadi import SX

from elastic_arm.effects.law import Confusion, Contribution, Effect, Numbers, SymbolicMotion, signed


def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """K_3 d^3 added to tau_J."""

    def carried(d: SX) -> SX:
        return p["cubic"] * d**3

    return motion.at(i, drive=carried(motion.deflection_under_load(i, carried)))


EFFECT = Effect(
    id="nonlinear_stiffness",
    formula="K_3 (theta - q)^3 added to tau_J",
    description=(
        "The drive becomes stiffer with its deflection (softer if negative), as harmonic drives do."
    ),
    plain="has a drive whose torque includes {cubic} times the cube of its deflection",
    signature=(
        "Joint torque over deflection is a curved line: the residual grows with the"
        " cube of the deflection."
    ),
    law=law,
    parameters=(signed("cubic", "Nm/rad^3", 1e11, "K_3"),),
    sides=("drive",),
    regime="load",
    confusions=(
        Confusion(
            "stiffness_mismatch",
            "the load covers a narrow range",
            "motion under light and heavy load, in which a wrong stiffness is always visible",
        ),
    ),
)
