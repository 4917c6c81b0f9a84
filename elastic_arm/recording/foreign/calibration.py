"""LeRobot's calibration file: what a per cent of a joint's calibrated range is.

    {"shoulder_pan": {"id": 1, "drive_mode": 0, "homing_offset": 0, "range_min": 8, "range_max": …}}

Positions and actions are by default -100 to 100 over the range, and 0 to 100 at the gripper. Zero
is the middle of the range, of the gripper its lower end.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, Field, TypeAdapter, ValidationError, model_validator

from elastic_arm.errors import RecordingError
from elastic_arm.input_files import read_text

TURN = 4096  # counts of the encoders of the servos that LeRobot calibrates
GRIPPER = "gripper"  # LeRobot's name of the joint that goes from 0 to 100
REMEDY = "Give the file that lerobot-calibrate wrote for this arm."


class _Motor(BaseModel):
    """A joint's entry; others of its numbers do not matter here."""

    range_min: Annotated[int, Field(ge=0, le=TURN)]
    range_max: Annotated[int, Field(ge=0, le=TURN)]

    @model_validator(mode="after")
    def _ordered(self) -> "_Motor":
        if self.range_max <= self.range_min:
            raise ValueError(f"range_max {self.range_max} is not above {self.range_min}")
        return self


_FILE = TypeAdapter(dict[str, _Motor])


def degrees_per_cent(path: str | Path, joints: Sequence[str]) -> dict[str, float]:
    """Return the degrees that a per cent of each joint is.

    Raises a RecordingError if the file cannot be read, or lacks one of the joints.
    """
    try:
        motors = _FILE.validate_python(json.loads(read_text(path, RecordingError, REMEDY)))
    except json.JSONDecodeError as error:
        raise RecordingError(f"{path} is no JSON: {error}", REMEDY) from None
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "the file"
        raise RecordingError(f"{path}: {place}: {first['msg']}", REMEDY) from None
    if missing := [name for name in joints if name not in motors]:
        raise RecordingError(
            f"{path} has no joint {', '.join(missing)}; it has {', '.join(motors) or 'none'}",
            "Name the joints in the mapping as the calibration file does.",
        )
    return {name: _degrees(name, motors[name]) for name in joints}


def _degrees(name: str, motor: _Motor) -> float:
    share = 1.0 / 100.0 if name == GRIPPER else 1.0 / 200.0
    return share * (motor.range_max - motor.range_min) * 360.0 / TURN
