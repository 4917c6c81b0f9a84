"""Settings of a simulation for commands, nodes and callers: model, effects, sensors, rates."""

from collections.abc import Sequence
from dataclasses import dataclass

from elastic_arm.effects import Catalogue, EffectInstance
from elastic_arm.robot import Robot
from elastic_arm.sensors import Sensors
from elastic_arm.simulation.controller import Controller


@dataclass(frozen=True)
class SimulationSettings:
    """How an arm is simulated."""

    model: str = "mod3"  # mod1, mod2 or mod3
    bearings: bool = False  # let the bearings tilt (12 coordinates for three joints)
    # effects in addition to those that the description lists; as text, too
    # ("coulomb_friction:joint_2:torque=6")
    effects: Sequence[EffectInstance | str] = ()
    sensors: Sensors | None = (
        None  # what the measured channels add to the truth; those of `Sensors()` when None
    )
    controller: Controller | None = (
        None  # default: what `nominal` states, else one that is tuned to it
    )
    nominal: Robot | None = (
        None  # what the controller, and a recording, believe; the true arm when None
    )
    # rate, substeps: samples a second, and integration steps a sample (an even number), or more
    # where the arm is stiff
    rate: float = 1000.0
    substeps: int = 10
    engine: str | None = None  # "c", "casadi", or None for the faster one that this machine has
    # where the ids of the description's effects are looked up; the default catalogue when None
    catalogue: Catalogue | None = None


USUAL = SimulationSettings()
