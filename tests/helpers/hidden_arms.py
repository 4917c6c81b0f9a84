"""Recordings of hidden arms that several tests share; simulated once a session."""

from functools import cache

import numpy as np

from elastic_arm.recording import Recording
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import HiddenArm, TrueChannels
from elastic_arm.studies.blind_challenge.hidden_arms.motion import random_motion
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel, measure

SECONDS = (8.0, 6.0)


@cache
def courses(*faults: tuple[object, ...]) -> tuple[TrueChannels, TrueChannels]:
    """Return two motions of an arm with faults given as (effect, joint, side, name, value, name,
    value, …)."""
    rng = np.random.default_rng(5)
    arm = HiddenArm(load_robot(None), [fault(*f) for f in faults])
    first, second = (arm.run(random_motion(rng, arm.n, s)) for s in SECONDS)
    return first, second


def fault(
    effect: str, joint: int | None, side: str, *numbers: object, channels: tuple[str, ...] = ()
) -> Fault:
    """Return a fault from its flat form."""
    return Fault(effect, joint, dict(zip(numbers[::2], numbers[1::2], strict=True)), side, channels)  # type: ignore[arg-type]


def recordings(
    *mechanical: tuple[object, ...],
    sensors: tuple[Fault, ...] = (),
    instruments: SensorModel | None = None,
    seed: int = 1,
) -> tuple[Recording, Recording]:
    """Return what the sensors make of the courses: one recording to fit, one to judge."""
    rng = np.random.default_rng(seed)
    robot = load_robot(None)
    made = [
        measure(course, robot.joint_names, sensors, instruments or SensorModel(), rng)
        for course in courses(*mechanical)
    ]
    return made[0], made[1]
