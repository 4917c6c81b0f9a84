"""An arm of six joints of which three have link encoders, and none a torque sensor, as big arms are
built."""

from dataclasses import replace
from functools import cache

import numpy as np

from elastic_arm.recording import Recording, Side
from elastic_arm.robot import Robot
from elastic_arm.studies.blind_challenge.hidden_arms.base_arms import industrial_arm
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import HiddenArm
from elastic_arm.studies.blind_challenge.hidden_arms.motion import random_motion
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel, measure
from tests.helpers.hidden_arms import fault

ENCODERS = 3  # link encoders, from the base on


@cache
def robot() -> Robot:
    """Return the description, which is that of the arm."""
    return industrial_arm(6, np.random.default_rng(11))


@cache
def recordings(
    *faults: tuple[object, ...], seconds: tuple[float, ...] = (10.0, 6.0)
) -> tuple[Recording, ...]:
    """Return recordings of the arm with faults, as in
    :func:`tests.helpers.hidden_arms.recordings`."""
    arm, rng = HiddenArm(robot(), [fault(*one) for one in faults]), np.random.default_rng(5)
    found = []
    for length in seconds:
        course = arm.run(random_motion(rng, arm.n, length))
        whole = measure(course, robot().joint_names, (), SensorModel(encoder_noise=1e-6), rng)
        link = {name: whole.link.channels()[name].copy() for name in ("position", "velocity")}
        for values in link.values():
            values[:, ENCODERS:] = np.nan
        found.append(replace(whole, link=Side(whole.link.stamp_ns, **link)))
    return tuple(found)
