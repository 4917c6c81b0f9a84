"""The torque that the gear of a joint carries in MuJoCo: the torque for the motion of its links.

    tau_J = (M - B) ddq + bias = tau_m - B ddq - friction

B is the armature, which, like the friction of the drive, acts in front of the gear. MuJoCo knows
accelerations only at the end of a step, so they are those of the previous step.
"""

from typing import Any

import numpy as np

from elastic_arm.arrays import Array, Indices
from elastic_arm.robot.mjcf import engine


def carried(model: Any, data: Any, dofs: Indices) -> Array:
    """Return the torques (n,) Nm behind the gears of some dofs."""
    moved = np.empty(model.nv)
    engine().mj_mulM(model, data, moved, data.qacc)
    return (moved + data.qfrc_bias - model.dof_armature * data.qacc)[dofs]
