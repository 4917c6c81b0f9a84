"""What LeRobot states of a dataset beside its tables: the names of the columns of its arrays.

meta/info.json: {"features": {"action": {"names": ["shoulder_pan.pos", …]}, …}}
"""

import json
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ValidationError

from elastic_arm.errors import RecordingError
from elastic_arm.input_files import read_text

INFO = Path("meta", "info.json")


def _flat(names: object) -> object:
    """Return the one list of names of a dictionary such as {"motors": […]}, as older datasets have
    it; no names where they are not those of columns."""
    if isinstance(names, dict):
        lists = [value for value in names.values() if isinstance(value, list)]
        names = lists[0] if len(lists) == 1 else None
    of_columns = isinstance(names, list) and all(isinstance(name, str) for name in names)
    return names if of_columns else ()


class _Feature(BaseModel):
    names: Annotated[tuple[str, ...], BeforeValidator(_flat)] = ()


class _Info(BaseModel):
    features: dict[str, _Feature] = {}


def lerobot_columns(folder: Path) -> dict[str, tuple[str, ...]]:
    """Return the names of the columns of the arrays of a dataset, where it states them.

    Raises a RecordingError if its description cannot be read.
    """
    path = folder / INFO
    if not path.is_file():
        return {}
    remedy = "Restore it from the dataset; without meta/ the tables are read without names."
    try:
        info = _Info.model_validate(json.loads(read_text(path, RecordingError, remedy)))
    except (json.JSONDecodeError, ValidationError) as error:
        reason = str(error).splitlines()[0]
        raise RecordingError(f"{path} is no description of a dataset: {reason}", remedy) from None
    return {name: feature.names for name, feature in info.features.items() if feature.names}
