"""Recordings: the interchange type of the suite, stored in rosbag2 bags.

`Recording` is what the rest of the suite sees; nothing downstream knows whether the arm was real. Names are loaded when
they are first used: commands that read no bag import no reader.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from elastic_arm.recording.foreign.channels import ChannelMap, load_channels
    from elastic_arm.recording.reading import read_recording
    from elastic_arm.recording.recording import Recording
    from elastic_arm.recording.sides import Samples, Side
    from elastic_arm.recording.writing import write_recording

__all__ = ["ChannelMap", "Recording", "Samples", "Side", "load_channels", "read_recording", "write_recording"]

_MODULES = {
    "ChannelMap": "foreign.channels",
    "Recording": "recording",
    "Samples": "sides",
    "Side": "sides",
    "load_channels": "foreign.channels",
    "read_recording": "reading",
    "write_recording": "writing",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
