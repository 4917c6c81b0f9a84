"""Recordings: the interchange type of the suite, stored in rosbag2 bags.

`Recording` is what the rest of the suite sees; nothing downstream knows whether the arm was real.
Names are loaded when they are first used: commands that read no bag import no reader.
"""

from typing import TYPE_CHECKING

from elastic_arm.lazy_names import lazily

if TYPE_CHECKING:
    from elastic_arm.recording.foreign.channels import ChannelMap, load_channels
    from elastic_arm.recording.reading import read_recording
    from elastic_arm.recording.recording import Recording
    from elastic_arm.recording.sides import Samples, Side
    from elastic_arm.recording.writing import write_recording

__all__ = [
    "ChannelMap",
    "Recording",
    "Samples",
    "Side",
    "load_channels",
    "read_recording",
    "write_recording",
]

_MODULES = {
    "ChannelMap": "elastic_arm.recording.foreign.channels",
    "Recording": "elastic_arm.recording.recording",
    "Samples": "elastic_arm.recording.sides",
    "Side": "elastic_arm.recording.sides",
    "load_channels": "elastic_arm.recording.foreign.channels",
    "read_recording": "elastic_arm.recording.reading",
    "write_recording": "elastic_arm.recording.writing",
}

__getattr__, __dir__ = lazily(__name__, _MODULES)
