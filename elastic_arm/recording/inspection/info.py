"""The contents of a bag in short."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from elastic_arm.errors import RecordingError
from elastic_arm.recording.foreign.channels import ChannelMap
from elastic_arm.recording.reading import read_recording
from elastic_arm.recording.storage.bag import open_bag


@dataclass
class TopicInfo:
    """A topic of a bag: type, messages, first and last log time, and the rate (None below two
    messages)."""

    name: str
    type_name: str
    count: int = 0
    first_ns: int = 0
    last_ns: int = 0

    @property
    def rate(self) -> float | None:
        """Messages a second."""
        span = (self.last_ns - self.first_ns) * 1e-9
        return (self.count - 1) / span if span > 0 else None


@dataclass
class BagInfo:
    """A summary of a bag."""

    path: str  # Folder or file
    files: dict[str, int]  # Names, with sizes in bytes
    compression: list[str]  # Of its chunks or files: "none", "lz4", "zstd", "unchunked", or several
    topics: list[TopicInfo]  # In order of appearance
    # Of the recording in it: `link.position` ...; empty where it holds none
    joints: list[str] = field(default_factory=list)
    channels: list[str] = field(default_factory=list)
    # What a reader assumes, or why it cannot use the bag
    notes: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)  # What is wrong with the files

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(topic.count for topic in self.topics)

    @property
    def start_ns(self) -> int | None:
        """First log time; None for an empty bag."""
        return min((topic.first_ns for topic in self.topics if topic.count), default=None)

    @property
    def duration(self) -> float:
        """Seconds between the first and the last message."""
        last = max((topic.last_ns for topic in self.topics if topic.count), default=0)
        return (last - (self.start_ns or 0)) * 1e-9 if self.messages else 0.0

    def to_json(self) -> dict[str, Any]:
        """Return plain data."""
        plain = asdict(self)
        for topic, source in zip(plain["topics"], self.topics, strict=True):
            topic["rate"] = source.rate
        return {
            **plain,
            "messages": self.messages,
            "start_ns": self.start_ns,
            "duration": self.duration,
        }


def bag_info(
    path: str | Path, channels: ChannelMap | None = None, namespace: str | None = None
) -> BagInfo:
    """Summarise a bag.

    Of several arms, the one in a namespace is used. A RecordingError if nothing can be read.
    """
    info = _counted(path)
    try:
        recording = read_recording(path, channels, namespace=namespace)
    except RecordingError as error:
        info.notes.append(str(error))
        return info
    info.joints = list(recording.joints)
    info.notes = [n for n in recording.notes if n not in info.damage]
    info.channels = [
        f"{side}.{name}" for side, values in recording.sides().items() for name in values.channels()
    ]
    return info


def _counted(path: str | Path) -> BagInfo:
    """Count the messages of a bag.

    Its files are closed afterwards: one may take half of the memory when unpacked.
    """
    bag = open_bag(path)
    topics: dict[str, TopicInfo] = {}
    kinds: set[str] = set()
    for file in bag.files:
        kinds |= file.packing()
        for block in file.blocks(strict=False):
            for channel, count in block.counts().items():
                described = file.topic(channel)
                log_ns = block.log_ns(channel)
                new = TopicInfo(
                    described.name, described.type_name, 0, int(log_ns.min()), int(log_ns.max())
                )
                topic = topics.setdefault(described.name, new)
                topic.count += count
                topic.first_ns = min(topic.first_ns, new.first_ns)
                topic.last_ns = max(topic.last_ns, new.last_ns)
    sizes = {file.path.name: file.path.stat().st_size for file in bag.files}
    return BagInfo(str(path), sizes, sorted(kinds), list(topics.values()), damage=bag.all_damage())
