"""How far the numbers of a description are ordinarily off."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Priors:
    """Standard deviations of what a description states of an arm, relative where no unit is given.

    CAD masses leave out cables, grease and covers; catalogues of harmonic drives state stiffness to about 30 % and give
    no damping. What sensors do is stated in the files of their effects.
    """

    mass: float = 0.10
    centre_of_mass: float = 0.01  # m
    inertia: float = 0.15  # of the mean moment of inertia about the centre of mass
    product_of_inertia: float = 0.05  # of the same
    rotor: float = 0.10
    stiffness: float = 0.15
    damping: float = 0.40
    presliding: float = 2.0  # Nm; dry friction turns over gradually, below a speed that nobody states
