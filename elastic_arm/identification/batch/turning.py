"""Where the dry friction of an arm turns over, for those who need it before they know the friction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.effects.library.friction import PLAIN
from elastic_arm.effects.text import parse_laws
from elastic_arm.errors import IdentificationError
from elastic_arm.identification.batch.selection import Trials
from elastic_arm.identification.batch.settings import IdentificationSettings
from elastic_arm.recording import Recording
from elastic_arm.recording.inspection.outliers import without_outliers
from elastic_arm.robot import Robot


def turning_speeds(recordings: Sequence[Recording], robot: Robot) -> Array | None:
    """Return the speed (n,) within which each joint's dry friction turns over, rad/s; None where nothing shows it.

    Base parameters, friction and zeros of the torques are fitted beside it.
    """
    chosen = [without_outliers(recording.select(robot.joint_names)) for recording in recordings]
    recorded = [(recording, recording.samples()) for recording in chosen]
    side = "" if all(samples.tau_m is not None for _, samples in recorded) else ":side=link"
    laws = parse_laws([f"{law}{side}" for law in PLAIN], robot)
    settings = IdentificationSettings(model="mod1", effects=laws)
    trials = Trials(recorded, robot, settings, report=lambda what, share: None, beside=True)
    try:
        speeds = trials.selected().sign_speed
    except IdentificationError:
        return None
    return np.broadcast_to(np.asarray(speeds, dtype=float), (robot.n,)).copy()
