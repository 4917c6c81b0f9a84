"""Recordings: the interchange type of the suite, stored in rosbag2 bags.

`Recording` is what the rest of the suite sees; nothing downstream knows whether the arm was real.
"""

from elastic_arm.recording.foreign.channels import ChannelMap, load_channels
from elastic_arm.recording.reading import read_recording
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Samples, Side
from elastic_arm.recording.writing import write_recording

__all__ = ["ChannelMap", "Recording", "Samples", "Side", "load_channels", "read_recording", "write_recording"]
