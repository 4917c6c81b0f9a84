"""`ros2 run elastic_arm recorder`: write topics to an MCAP bag, byte for byte as they arrive."""

import json
import re
import sys
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

from ament_index_python import PackageNotFoundError, get_package_share_directory
from rclpy.impl.implementation_singleton import rclpy_implementation as rcl

from elastic_arm.errors import GraphError, RecordingError
from elastic_arm.nodes.support import graph
from elastic_arm.nodes.support.node import LONGEST_REST, ArmNode, Health, Listener
from elastic_arm.nodes.support.parameters import Setting, declared
from elastic_arm.nodes.support.running import run
from elastic_arm.recording import message_types, topics
from elastic_arm.recording.storage.stream_writer import COMPRESSIONS, StreamWriter

# How often to look for publishers of topics not yet found, seconds.
SEARCH_PERIOD = 0.1
PARAMETERS = {
    "bag": Setting("recording", "Bag folder to create; must not exist"),
    "topics": Setting([], "Topics to record; empty: all topics of the suite"),
    "compression": Setting("zstd", "Compression of the bag", choices=COMPRESSIONS),
}


class Recorder(ArmNode):
    """Records each topic as soon as it has a publisher."""

    def __init__(self) -> None:
        super().__init__("recorder")
        wanted = declared(self, PARAMETERS)
        _load_types()  # takes long where the machine is busy: not while samples arrive
        names = wanted.topics or [graph.relative(topic) for topic in topics.TYPES]
        self._wanted = {self._resolved(name) for name in names}
        self._listeners: dict[
            str, tuple[str, Listener]
        ] = {}  # topic -> type of its messages, and who receives them
        self._refused: set[str] = set()  # whose type is not installed
        self._writer = StreamWriter(wanted.bag, wanted.compression)
        # before anybody publishes: what comes first is kept, too
        for topic in sorted(self._wanted):
            if (own := f"/{topic.rpartition('/')[2]}") in topics.TYPES:
                self._listen(topic, topics.TYPES[own])
        Health(self, "bag", "recording", self._status)
        self.every(SEARCH_PERIOD, self._search)
        self.get_logger().info(f"recording to {wanted.bag}")

    def _resolved(self, name: str) -> str:
        try:
            return self.resolve_topic_name(name)
        except rcl.RCLError:
            raise GraphError(
                f"{name!r} is not a name of a topic",
                "It consists of letters, digits, _ and /, and does not start with a digit.",
            ) from None

    def tick(self) -> float:
        """Write the messages that have waited long enough."""
        self._writer.tick()
        return LONGEST_REST

    def close(self) -> None:
        """Complete the bag."""
        if self.failure is not None:
            return  # a full disk takes no more; what is there is readable
        self._writer.close()
        counts = self._writer.counts
        self.get_logger().info(
            f"{sum(counts.values())} messages of {len(counts)} topics in {self._writer.path}"
        )

    def _search(self) -> None:
        """Subscribe to the wanted topics that have a publisher, with its type."""
        for topic in sorted(self._wanted - self._writer.counts.keys() - self._refused):
            if infos := self.get_publishers_info_by_topic(topic):
                if self._listeners.get(topic, ("",))[0] != infos[0].topic_type:
                    self._listen(topic, infos[0].topic_type)
                self._announce(topic)

    def _listen(self, topic: str, type_name: str) -> None:
        if topic in self._listeners:
            self._listeners.pop(topic)[1].close()
        try:
            kind = graph.message_class(type_name)
        except GraphError as error:
            self._refused.add(topic)
            self.get_logger().error(f"{topic} is not recorded: {error}")
            return
        self._listeners[topic] = (
            type_name,
            Listener(self, kind, topic, partial(self._take, topic), raw=True),
        )
        self._writer.tick()  # to subscribe may take long as well

    def _announce(self, topic: str) -> None:
        if topic in self._listeners:
            type_name = self._listeners[topic][0]
            self._writer.add_topic(topic, type_name, *_definition(type_name))

    def _take(self, topic: str, data: bytes) -> None:
        try:
            self._announce(topic)
            self._writer.write(topic, data, self.get_clock().now().nanoseconds)
        except RecordingError as error:
            self.failure = error

    def _status(self) -> tuple[list[str], dict[str, Any]]:
        counts = self._writer.counts
        return [] if counts else ["none of the topics is published"], {
            "messages": sum(counts.values()),
            **counts,
        }


_SEPARATOR = "=" * 80
# A field's type at the beginning of a line: package, name; arrays, bounds and what follows do not
# matter.
_FIELD = re.compile(r"^\s*(?:(\w+)/(?:msg/)?)?([A-Z]\w*)", flags=re.MULTILINE)


def installed_definition(type_name: str) -> tuple[str, str]:
    """Return the full ros2msg text of a type, and its RIHS01 hash.

    Empty if not found.
    """
    package, _, name = type_name.split("/")
    texts: dict[str, str] = {}
    try:
        _gather(package, name, texts)
        described = json.loads((_share(package) / f"{name}.json").read_text())
    except (PackageNotFoundError, OSError, ValueError):
        return "", ""
    hashes = {entry["type_name"]: entry["hash_string"] for entry in described["type_hashes"]}
    whole, *parts = texts.items()
    blocks = [whole[1], *(f"{_SEPARATOR}\nMSG: {key}\n{text}" for key, text in parts)]
    return "\n".join(blocks), hashes.get(type_name, "")


def _share(package: str) -> Path:
    return Path(get_package_share_directory(package)) / "msg"


def _gather(package: str, name: str, texts: dict[str, str]) -> None:
    """Add the text of a type and those of its fields."""
    key = f"{package}/{name}"
    if key in texts:
        return
    texts[key] = (_share(package) / f"{name}.msg").read_text(encoding="utf-8")
    plain = re.sub(r"#.*", "", texts[key])
    for other, field in _FIELD.findall(plain):
        if field == "Header" and not other:
            other = "std_msgs"
        _gather(other or package, field, texts)


@cache
def _definition(type_name: str) -> tuple[str, str]:
    """Return text and hash of a type, as known to this package or otherwise as installed."""
    known = message_types.known(type_name)
    return message_types.definition(type_name) if known else installed_definition(type_name)


def _load_types() -> None:
    """Load the types of the suite, so that a topic is subscribed to as soon as it is found."""
    for type_name in topics.TYPES.values():
        with suppress(GraphError):  # reported where a topic of the type is found
            graph.message_class(type_name)
        _definition(type_name)


if __name__ == "__main__":
    sys.exit(run(Recorder))
