"""Arms on which everything is a little wrong, on the challenge's engine: what `--refit` is for."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.recording import Recording
from elastic_arm.robot import Robot
from elastic_arm.studies.blind_challenge.hidden_arms.base_arms import imprecise
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import HiddenArm
from elastic_arm.studies.blind_challenge.hidden_arms.motion import random_motion
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel

__all__ = ["imprecise", "ordinary_faults", "record"]

LINK_STEP, MOTOR_STEP = 2 * np.pi / 2**19, 2 * np.pi / 2**13  # rad, before the gear


def ordinary_faults(n: int, rng: np.random.Generator) -> list[Fault]:
    """Dry and viscous friction on every joint, torque sensors off by 1 % and 0.5 Nm."""
    found = []
    for i in range(n):
        found.append(Fault("coulomb_friction", i, {"torque": float(rng.uniform(4, 14))}))
        found.append(Fault("viscous_friction", i, {"coefficient": float(rng.uniform(3, 20))}))
        for sensor in ("motor_torque", "joint_torque"):
            found.append(Fault(f"{sensor}_gain", i, {"gain": float(1 + rng.uniform(-0.01, 0.01))}))
            found.append(Fault(f"{sensor}_offset", i, {"offset": float(rng.uniform(-0.5, 0.5))}))
    return found


def record(
    robot: Robot,
    faults: Sequence[Fault],
    seconds: Sequence[float],
    rng: np.random.Generator,
    noise: Callable[[tuple[int, ...], float, np.random.Generator], NDArray[np.float64]]
    | None = None,
) -> list[Recording]:
    """Record an arm with encoders of 19 and 13 bits, no velocities, and stamps that jitter by 20
    us.

    The engine samples at 1000 Hz, of which every second sample is kept. The noise of the torques
    is white, or made of their shape and the samples a second.
    """
    arm, found = HiddenArm(robot, faults), []
    sensors = (
        SensorModel(jitter=2e-5) if noise is None else SensorModel(jitter=2e-5, torque_noise=0.0)
    )
    ratios = np.array([joint.transmission.r_tot for joint in robot.joints if joint.transmission])
    for k, duration in enumerate(seconds):
        exact = arm.record(random_motion(rng, robot.n, duration), sensors, rng)
        sides = {}
        for name, every, step in (
            ("link", exact.link, LINK_STEP),
            ("motor", exact.motor, MOTOR_STEP / ratios),
        ):
            side = every.at(slice(None, None, 2))
            sides[name] = replace(
                side, position=np.round(side.position / step) * step, velocity=None
            )
            if noise is not None and side.effort is not None:
                rate = 1e9 / float(np.median(np.diff(side.stamp_ns)))
                sides[name] = replace(
                    sides[name], effort=side.effort + noise(side.effort.shape, rate, rng)
                )
        found.append(replace(exact, **sides, source=f"run_{k}"))
    return found
