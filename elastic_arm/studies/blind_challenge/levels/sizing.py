"""How much of an effect an arm gets: a multiple of what its own recording can know, and no less than its floor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from elastic_arm.errors import SimulationError
from elastic_arm.robot import Robot
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import SENSOR_EFFECTS, Fault
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import HiddenArm
from elastic_arm.studies.blind_challenge.hidden_arms.motion import MultiSine
from elastic_arm.studies.blind_challenge.hidden_arms.realistic_sensors import RealisticSensors
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel, measure
from elastic_arm.studies.blind_challenge.hidden_arms.true_channels import TrueChannels
from elastic_arm.studies.blind_challenge.levels.information import ENDS, EVERY, SHAPES, MarginalInformation
from elastic_arm.studies.blind_challenge.levels.level import ChallengeLevel

Array = NDArray[np.float64]

ROUNDS = 3  # corrections of a size
NEAR = 0.1  # of the wanted distance
IDEAL = SensorModel(torque_noise=0.0, velocity_noise=0.0)
# Which ordinary numbers of its joint an effect is itself; their priors do not stand against it.
ITSELF = {
    "link_inertia_mismatch": ("mass", "inertia", *SHAPES),
    "rotor_inertia_mismatch": ("rotor",),
    "stiffness_mismatch": ("stiffness",),
    "damping_mismatch": ("damping",),
    "thermal_friction": ("thermal", "thermal_viscous"),
    "torque_drift": ("drift_1", "drift_2", "drift_3"),
    "encoder_offset": ("encoder_offset",),
    **{e: (e,) for e in ("motor_torque_gain", "joint_torque_gain", "motor_torque_offset", "joint_torque_offset")},
}


@dataclass(frozen=True)
class EffectDraft:
    """An effect without its size."""

    make: Callable[[float], Fault]  # returns the effect with so much of it
    # low, high: Smallest and largest amount
    low: float
    high: float


@dataclass(frozen=True)
class SizedEffect:
    """An effect of a size."""

    fault: Fault  # the effect
    # distance, bound: Multiple of its bound that it is, and that bound
    distance: float
    bound: float
    excess: float  # mean square of what it does to the residuals, Nm^2


class Sizing:
    """Sizes of effects on one arm."""

    def __init__(
        self,
        description: Robot,
        robot: Robot,
        sensors: RealisticSensors,
        level: ChallengeLevel,
        motion: MultiSine,
        ordinary: Sequence[Fault],
    ) -> None:
        self._description, self._robot = description, robot
        self._motion = motion
        self._friction = {(f.effect, f.joint): f.parameters for f in ordinary}
        self._plain = HiddenArm(robot, geometry=description).run(motion)
        self._information = MarginalInformation(
            robot, sensors, self._plain, warming=level.warming, torque_constant=level.torque_constant
        )
        self._left = self._information.residuals(self._plain)

    def peak(self) -> Array:
        """Return the largest motor torques (n,) of the plain motion, Nm."""
        return np.asarray(np.abs(self._plain.tau_m).max(axis=0))

    def sized(self, draft: EffectDraft, wanted: float) -> SizedEffect:
        """Return an effect of the wanted distance, within its limits."""
        high = draft.high
        tried = reached = draft.low
        distance = excess = 0.0
        for _ in range(ROUNDS):
            try:
                (distance, excess), reached = self._change(draft.make(tried)), tried
            except SimulationError:
                high = tried = 0.5 * tried
                continue
            better = float(np.clip(tried * wanted / max(distance, 1e-9), min(draft.low, high), high))
            if abs(better / tried - 1.0) < NEAR:
                break
            tried = better
        return SizedEffect(draft.make(reached), distance, reached / max(distance, 1e-9), excess)

    def _change(self, fault: Fault) -> tuple[float, float]:
        """Return how far the residuals change by a fault, whitened and marginalised, and their mean square in Nm^2."""
        # Without the arm's ordinary friction, which would stand in the residuals beside the effect.
        true = HiddenArm(self._robot, [fault], geometry=self._description).run(self._motion)
        if fault.effect == "thermal_friction":
            change = self._warmed(fault)
        else:
            read = _read(true, fault, self._robot.joint_names)
            # What sampling leaves of the plain motion is no effect.
            change = self._information.residuals(read) - self._left
        without = {(name, fault.joint or 0) for name in ITSELF.get(fault.effect, ())}
        return self._information.distance(change, without=without), float(np.mean(change[ENDS:-ENDS] ** 2))

    def _warmed(self, fault: Fault) -> Array:
        """Change of the residuals by friction that changes, from its law: without friction nothing would change."""
        j = fault.joint or 0
        w = self._plain.dtheta[::EVERY, j]
        torque = self._friction["coulomb_friction", j]["torque"] * np.sign(w)
        torque += self._friction["viscous_friction", j]["coefficient"] * w
        rows = np.zeros((3, len(w), self._robot.n))
        rows[2, :, j] = fault.parameters["change"] * np.linspace(-0.5, 0.5, len(w)) * torque
        return self._information.seen(*rows)


def _read(true: TrueChannels, fault: Fault, joints: Sequence[str]) -> TrueChannels:
    """Return what ideal sensors with this fault read."""
    if fault.effect not in SENSOR_EFFECTS:
        return true
    read = measure(true, joints, [fault], IDEAL, np.random.default_rng(0))
    assert read.link is not None and read.motor is not None
    sides = {"q": read.link.position, "dq": read.link.velocity, "tau_J": read.link.effort}
    sides |= {"theta": read.motor.position, "dtheta": read.motor.velocity, "tau_m": read.motor.effort}
    return TrueChannels(true.t, **{name: np.asarray(values) for name, values in sides.items()})
