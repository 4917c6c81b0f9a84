"""Message types without ROS: the standard ones of Jazzy, our own, and those that a foreign bag brings along."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Protocol

from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from elastic_arm.errors import RecordingError
from elastic_arm.recording.definitions import parse_definition
from elastic_arm.recording.storage.metadata import Topic

OWN_PACKAGE = "elastic_arm_msgs"


@lru_cache(maxsize=1)
def typestore() -> Typestore:
    """Return Jazzy's standard types with those of elastic_arm_msgs (whose .msg files lie in `recording/msg`)."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types = {}
    for file in sorted(resources.files(__package__).joinpath("msg").iterdir(), key=lambda entry: entry.name):
        if file.name.endswith(".msg"):
            name = f"{OWN_PACKAGE}/msg/{file.name.removesuffix('.msg')}"
            types.update(get_types_from_msg(file.read_text(encoding="utf-8"), name))
    store.register(types)
    return store


def known(type_name: str) -> bool:
    """Whether a type is one of ROS's own or of elastic_arm_msgs."""
    return type_name in typestore().fielddefs


def definition(type_name: str) -> tuple[str, str]:
    """Return the full ros2msg text of a type, with all it is made of, and its RIHS01 hash."""
    store = typestore()
    if not known(type_name):
        raise RecordingError(f"message type {type_name} is not known", "Give its definition with the topic.")
    text, _ = store.generate_msgdef(type_name, ros_version=2)
    return text, store.hash_rihs01(type_name)


class TypeFields(Protocol):
    """What is known of message types: by name, their constants and fields, as rosbags describes them."""

    @property
    def fielddefs(self) -> Typesdict:
        """Constants and fields by type."""


@dataclass(frozen=True)
class _Defined:
    """The types that one definition in a bag describes; never compiled."""

    fielddefs: Typesdict


@lru_cache(maxsize=64)
def _defined(name: str, encoding: str, text: str) -> TypeFields:
    return _Defined(parse_definition(name, encoding, text)) if text else typestore()


def types_of(topic: Topic) -> TypeFields:
    """Return the types that a topic's messages are made of: as the bag defines them, or else the known ones."""
    types = _defined(topic.type_name, topic.encoding, topic.definition)
    if topic.type_name not in types.fielddefs:
        problem = f"message type {topic.type_name} is not defined in the bag"
        raise RecordingError(problem, "Record it with its definition.")
    return types
