"""The levels of the challenge: distributions of arms, sensors, motions and effects."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from elastic_arm.effects import EFFECTS
from elastic_arm.errors import DiagnosisError
from elastic_arm.studies.blind_challenge.hidden_arms.further_laws import FOREIGN
from elastic_arm.studies.blind_challenge.hidden_arms.realistic_sensors import BOTH, LINK, MOTOR


@dataclass(frozen=True)
class Floor:
    """Smallest size that a workshop would call an effect."""

    amount: float  # in the unit of the effect's size; the distance from no effect
    scaled: bool = False  # whether it goes with the size of the joint: torques do
    sides: tuple[str, ...] = (BOTH,)  # recorded sides on which the effect can show


_ANY = (BOTH, MOTOR, LINK)
_MOTOR = (BOTH, MOTOR)
_LINK = (BOTH, LINK)
# Below these sizes nobody repairs anything; of numbers that every arm has wrong, far beyond what is
# ordinary.
FLOORS = {
    "stribeck_friction": Floor(0.5, True, _MOTOR),
    "load_dependent_friction": Floor(0.01, False, _MOTOR),
    "asymmetric_friction": Floor(0.15, False, _MOTOR),
    "nonlinear_stiffness": Floor(1e8, True),
    "hysteresis": Floor(0.5, True),
    "backlash": Floor(2e-5),
    "transmission_error": Floor(1e-5),
    "torque_ripple": Floor(0.5, True, _MOTOR),
    "bearing_compliance": Floor(0.5),
    "payload": Floor(0.2, True, _ANY),
    "load": Floor(0.5, True, _ANY),
    "base_tilt": Floor(2e-3, False, _ANY),
    "motor_torque_gain": Floor(0.08),
    "joint_torque_gain": Floor(0.08, False, _LINK),
    "motor_torque_offset": Floor(4.0, True, _MOTOR),
    "joint_torque_offset": Floor(4.0, True, _LINK),
    "gravity_compensation": Floor(0.1, False, _ANY),
    "joint_zero": Floor(0.01, False, _ANY),
    "encoder_offset": Floor(5e-5),
    "encoder_eccentricity": Floor(5e-5),
    "time_delay": Floor(2e-3),
    "link_inertia_mismatch": Floor(0.4, False, _ANY),
    "rotor_inertia_mismatch": Floor(0.35, False, _MOTOR),
    "stiffness_mismatch": Floor(0.5),
    "damping_mismatch": Floor(1.5),
    "joint_spring": Floor(2.0, True, _ANY),
    "torque_drift": Floor(0.02, True, _ANY),
    "torque_lowpass": Floor(0.01, False, (BOTH,)),
    "thermal_friction": Floor(0.25, False, _MOTOR),
}
FOREIGN_FLOORS = {
    "dress_pack": Floor(10.0, True, _ANY),
    "periodic_disturbance": Floor(1.0, True, _ANY),
    "loose_payload": Floor(1.0, True, _ANY),
    "cogging_cable": Floor(1.0, True, _ANY),
    "saturating_drive": Floor(0.1, False, _MOTOR),
    "gear_creep": Floor(3e3, True),
    "worn_zone": Floor(2.0, True, _MOTOR),
    "oil_drag": Floor(3.0, True, _MOTOR),
    "dragging_brake": Floor(2.0, True, _MOTOR),
    "sensor_crosstalk": Floor(0.02, False, _LINK),
}
assert set(FOREIGN_FLOORS) == set(FOREIGN)
# What every arm has more or less of, and what only a change of tells.
CHANGE_FLOORS = {
    "coulomb_friction": Floor(1.0, True, _MOTOR),
    "viscous_friction": Floor(2.0, True, _MOTOR),
}


@dataclass(frozen=True)
class Level:
    """A level of the challenge."""

    name: str
    effects: tuple[str, ...]  # ids that are drawn, as far as the catalogue has them
    # arms are as described but for their effects, with sensors without errors of their own
    exact: bool = False
    joints: tuple[int, ...] = (3,)  # one of which each arm has
    sides: tuple[str, ...] = (BOTH,)  # what is recorded, one of which each arm has
    rates: tuple[float, ...] = (1000.0,)  # Hz, one of which each arm has
    points: float = 0.0  # share of recordings that go from point to point, with dwells
    mountings: bool = (
        False  # whether arms hang from walls and ceilings, too, as their description states
    )
    lift: float = 0.0  # share of the larger arms whose first axis slides
    lost: float = 0.0  # share of samples that are lost, at most; of every other arm
    corner: tuple[float, float] | None = (
        None  # Hz, range of what colours the torque noise; white where None
    )
    torque_constant: float = (
        0.0  # largest relative error of the motors' torques beyond the sensors' own
    )
    drift: float = (
        0.0  # largest wander of a torque channel's zero, in standard deviations of its noise
    )
    warming: float = 0.0  # largest relative change of all friction during the run
    urdf: bool = False  # whether arms are described by a URDF with their drives in an overlay
    foreign: tuple[str, ...] = ()
    # of what is fitted and of what judges, or of each bag of a history
    seconds: tuple[float, ...] = (20.0, 10.0)
    changing: bool = False  # whether bags are a history, and what is drawn begins with one of them
    # the question: refit, effects that are known, and priors
    asked: dict[str, Any] = field(default_factory=dict)
    bits: int | None = (
        # of the encoders of servo arms, recorded by commands and positions; None for other arms
        None
    )

    def sides_of(self, effects: Sequence[str]) -> tuple[str, ...]:
        """Return the recorded sides of this level on which all of some effects can show.

        Effects of a catalogue or none.
        """
        floors = [floor for e in effects if (floor := FLOORS.get(e) or FOREIGN_FLOORS.get(e))]
        return tuple(
            side
            for side in self.sides
            if self.exact or all(side in floor.sides for floor in floors)
        )

    def drawn(self, catalogue: Sequence[str]) -> tuple[str, ...]:
        """Return the effects that are drawn: the level's own, and all that a user adds.

        The level's own are of the default catalogue.
        """
        users = [effect for effect in catalogue if effect not in EFFECTS] if self.exact else []
        return (*(effect for effect in self.effects if effect in catalogue), *users)


LABORATORY = Level(
    "laboratory",
    (*FLOORS, "coulomb_friction", "viscous_friction", "inertia_coupling", "spline_inertia"),
    exact=True,
    seconds=(12.0, 8.0),
)
_ASKED = {"refit": True, "with": ["coulomb_friction", "viscous_friction"]}
WORKSHOP = Level(
    "workshop",
    tuple(FLOORS),
    joints=(3, 3, 6),
    points=0.3,
    mountings=True,
    lift=0.25,
    lost=0.02,
    foreign=tuple(FOREIGN),
    asked=_ASKED,
)
FIELD = replace(
    WORKSHOP,
    name="field",
    effects=tuple(effect for effect, floor in FLOORS.items() if set(floor.sides) & {MOTOR, LINK}),
    joints=(6, 7),
    sides=(MOTOR, LINK),
    rates=(100.0, 125.0, 200.0, 250.0),
    corner=(3.0, 20.0),
    torque_constant=0.15,
    drift=1.0,
    warming=0.1,
    urdf=True,
    foreign=tuple(
        effect for effect in FOREIGN if set(FOREIGN_FLOORS[effect].sides) & {MOTOR, LINK}
    ),
    asked={**_ASKED, "priors": {"sensors": {"motor_torque_gain": 0.15}}},
)
_SERVOS = (
    "coulomb_friction", "viscous_friction", "payload", "position_gain", "velocity_gain",
    "command_delay", "torque_saturation", "position_dead_band", "integral_gain",
    "rotor_inertia_mismatch", "joint_spring",
)  # fmt: skip
SERVO = Level(
    "servo", _SERVOS, rates=(30.0, 50.0, 100.0), foreign=("dress_pack",), seconds=(20.0, 12.0),
    asked={"refit": True}, bits=12,
)  # fmt: skip
POSITION = replace(SERVO, name="position", rates=(250.0, 500.0), bits=17)
HISTORY = replace(
    WORKSHOP,
    name="history",
    effects=(
        *CHANGE_FLOORS, "payload", "motor_torque_offset", "joint_torque_offset",
        "motor_torque_gain", "joint_zero", "time_delay", "backlash", "stiffness_mismatch",
        "joint_spring",
    ),
    joints=(3,),
    points=0.0,
    foreign=(),
    seconds=(8.0,) * 12,
    changing=True,
)  # fmt: skip
LEVELS = {level.name: level for level in (LABORATORY, WORKSHOP, FIELD, SERVO, POSITION, HISTORY)}


def level_of(name: str) -> Level:
    """Return a level by its name; DiagnosisError where there is none."""
    if name not in LEVELS:
        raise DiagnosisError(f"unknown level {name!r}", f"Choose one of {', '.join(LEVELS)}")
    return LEVELS[name]
