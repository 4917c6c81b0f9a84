"""What a simulated arm is made of and how finely it is computed, for commands, nodes and callers alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from elastic_arm.effects import Catalogue, EffectInstance
from elastic_arm.robot import Robot
from elastic_arm.sensors import Sensors
from elastic_arm.simulation.controller import Controller


@dataclass(frozen=True)
class SimulationSettings:
    """How an arm is simulated.

    Parameters
    ----------
    model
        mod1, mod2 or mod3.
    bearings
        Let the bearings tilt (12 coordinates for three joints).
    effects
        Effects beyond the model, beside those that the description lists.
    sensors
        What the measured channels add to the truth; those of `Sensors()` when None.
    controller
        Default: what `nominal` states, else one that is tuned to it.
    nominal
        What the controller, and a recording, believe; the true arm when None.
    rate, substeps
        Samples a second, and integration steps a sample (an even number), or more where the arm is stiff.
    engine
        "c", "casadi", or None for the faster one that this machine has.
    catalogue
        Where the ids of the description's effects are looked up; the default catalogue when None.
    """

    model: str = "mod3"
    bearings: bool = False
    effects: Sequence[EffectInstance] = ()
    sensors: Sensors | None = None
    controller: Controller | None = None
    nominal: Robot | None = None
    rate: float = 1000.0
    substeps: int = 10
    engine: str | None = None
    catalogue: Catalogue | None = None


USUAL = SimulationSettings()
