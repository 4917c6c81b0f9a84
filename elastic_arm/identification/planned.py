"""Rate a planned motion in the way `identify` will rate its recording."""

from typing import Any

import numpy as np

from elastic_arm.dynamics import Model
from elastic_arm.estimation.motion import Motion
from elastic_arm.excitation import FourierTrajectory
from elastic_arm.excitation.criteria import elastic_motion
from elastic_arm.identification.stream import Identifier
from elastic_arm.identification.verdict import Excitation

RATE = 100  # samples a second of the motion that is judged
MOST_PERIODS = 10  # beyond which a motion is not repeated: another one is better


def judged(
    model: Model, trajectory: FourierTrajectory, periods: int | None = None
) -> tuple[int, Excitation]:
    """Rate a motion that is repeated a number of times.

    None: as many times as are necessary for a good rating, if possible.
    """
    count = round(RATE * trajectory.period)
    n = model.n
    states = elastic_motion(model, trajectory, count)
    sides = ("q", "dq", "ddq"), ("theta", "dtheta", "ddtheta")
    channels: dict[str, Any] = {
        name: values[:, n * k : n * (k + 1)]
        for k, names in enumerate(sides if model.robot.elastic else sides[:1])
        for name, values in zip(names, states, strict=True)
    }
    identifier = Identifier(model, joints=model.robot.joint_names)
    t = np.arange(count) / RATE
    # Only which torques there are matters, not what they are.
    for done in range(1, (periods or MOST_PERIODS) + 1):
        identifier.add_motion(
            Motion(t + done * trajectory.period, **channels, tau_m=np.zeros((count, n)))
        )
        found = identifier.excitation()
        if periods is None and not found.poor:
            break
    return done, found
