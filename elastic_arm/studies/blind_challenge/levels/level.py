"""What a level of the challenge consists of, and what counts as an effect in a workshop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from elastic_arm.effects import EFFECTS
from elastic_arm.errors import DiagnosisError
from elastic_arm.studies.blind_challenge.hidden_arms.further_laws import FOREIGN
from elastic_arm.studies.blind_challenge.hidden_arms.realistic_sensors import BOTH, LINK, MOTOR

KNOWN_FRICTION = ("coulomb_friction", "viscous_friction")


@dataclass(frozen=True)
class Floor:
    """Smallest size that counts as an effect."""

    amount: float  # in the unit of the effect's size; the distance from no effect
    scaled: bool = False  # whether it goes with the size of the joint: torques do
    sides: tuple[str, ...] = (BOTH,)  # recorded sides on which the effect can show


_ANY, _MOTOR, _LINK = (BOTH, MOTOR, LINK), (BOTH, MOTOR), (BOTH, LINK)
# Below these sizes nobody repairs anything; of numbers that every arm has wrong, far beyond what is ordinary.
FLOORS = {
    "stribeck_friction": Floor(0.5, True, _MOTOR),
    "load_dependent_friction": Floor(0.01, False, _MOTOR),
    "nonlinear_stiffness": Floor(1e8, True),
    "hysteresis": Floor(0.5, True),
    "backlash": Floor(2e-5),
    "transmission_error": Floor(1e-5),
    "torque_ripple": Floor(0.5, True, _MOTOR),
    "bearing_compliance": Floor(0.5),
    "payload": Floor(0.2, True, _ANY),
    "base_tilt": Floor(2e-3, False, _ANY),
    "motor_torque_gain": Floor(0.08),
    "joint_torque_gain": Floor(0.08, False, _LINK),
    "motor_torque_offset": Floor(4.0, True, _MOTOR),
    "joint_torque_offset": Floor(4.0, True, _LINK),
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
# Of the effects that no catalogue has: size and sides.
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


@dataclass(frozen=True)
class ChallengeLevel:
    """A level of the challenge."""

    name: str  # as the user gives it
    effects: tuple[str, ...]  # ids that are drawn, as far as the catalogue has them
    joints: tuple[int, ...]  # numbers of joints, one of which each arm has
    sides: tuple[str, ...]  # what is recorded of an arm, one of which each arm has
    rates: tuple[float, ...]  # Hz, one of which each arm has
    # Range of the corner that colours the torque noise, Hz; None where the noise is white
    corner: tuple[float, float] | None = None
    torque_constant: float = 0.0  # largest relative error of the motors' torques beyond the sensors' own
    drift: float = 0.0  # largest wander of a torque channel's zero over the run, in standard deviations of its noise
    warming: float = 0.0  # largest relative change of all friction during the run
    urdf: bool = False  # whether arms are described by a URDF with their drives in an overlay
    # seconds, validate_seconds: Durations of the two recordings
    seconds: float = 20.0
    validate_seconds: float = 10.0

    def sides_of(self, effect: str) -> tuple[str, ...]:
        """Return the recorded sides of this level on which an effect, or one of no catalogue, can show."""
        floor = FLOORS.get(effect) or FOREIGN_FLOORS[effect]
        return tuple(side for side in self.sides if side in floor.sides)

    def common_sides(self, effects: Sequence[str]) -> tuple[str, ...]:
        """Return the recorded sides of this level on which all of some effects can show."""
        return tuple(side for side in self.sides if all(side in self.sides_of(effect) for effect in effects))


LABORATORY = "laboratory"
# Drawn in the laboratory, in this order, so that the same seed draws the same arms whatever the catalogue holds since.
LABORATORY_EFFECTS = (
    "backlash", "base_tilt", "bearing_compliance", "coulomb_friction",
    "damping_mismatch", "encoder_eccentricity", "encoder_offset", "hysteresis",
    "inertia_coupling", "joint_torque_gain", "joint_torque_offset", "link_inertia_mismatch",
    "load_dependent_friction", "motor_torque_gain", "motor_torque_offset", "nonlinear_stiffness",
    "payload", "rotor_inertia_mismatch", "spline_inertia", "stiffness_mismatch",
    "stribeck_friction", "time_delay", "torque_ripple", "transmission_error",
    "viscous_friction",
)  # fmt: skip
WORKSHOP = ChallengeLevel("workshop", tuple(FLOORS), (3, 3, 6), (BOTH,), (1000.0,))
FIELD = ChallengeLevel(
    "field",
    tuple(effect for effect, floor in FLOORS.items() if set(floor.sides) & {MOTOR, LINK}),
    (6, 7),
    (MOTOR, LINK),
    (100.0, 125.0, 200.0, 250.0),
    corner=(3.0, 20.0),
    torque_constant=0.15,
    drift=1.0,
    warming=0.1,
    urdf=True,
)
LEVELS = {level.name: level for level in (WORKSHOP, FIELD)}
NAMES = (LABORATORY, *LEVELS)


def level_of(name: str) -> ChallengeLevel | None:
    """Return a level by its name; None for the laboratory."""
    if name not in NAMES:
        raise DiagnosisError(f"there is no level {name!r}", f"Choose one of {', '.join(NAMES)}")
    return LEVELS.get(name)


def drawn_effects(catalogue: Sequence[str], level: str) -> tuple[str, ...]:
    """Return the effects that a level draws: of the default catalogue its own, and all that a user adds."""
    found = level_of(level)
    own = LABORATORY_EFFECTS if found is None else found.effects
    users = [effect for effect in catalogue if effect not in EFFECTS] if found is None else []
    return (*(effect for effect in own if effect in catalogue), *users)


def foreign_effects(level: str) -> tuple[str, ...]:
    """Return the effects of no catalogue that can show at a level; none in the laboratory."""
    found = level_of(level)
    return () if found is None else tuple(effect for effect in FOREIGN if found.sides_of(effect))


def stated_priors(level: str) -> dict[str, dict[str, float]]:
    """Return what the user of a level's arms states besides the default priors: torque constants of a catalogue."""
    found = level_of(level)
    if found is None or not found.torque_constant:
        return {}
    return {"sensors": {"motor_torque_gain": found.torque_constant}}
