"""Message types without ROS: the standard ones of Jazzy, our own, and those that a foreign bag
brings along.

Definitions in a bag are read as data: no text of it is ever executed. The library's parser reads
types, fields and array sizes. What it takes minutes for, or does not know (separators and
preprocessor lines of bags, annotations), and what does not change where numbers lie (constants,
defaults) is left out first.
"""

import re
from functools import lru_cache
from importlib import resources
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

from elastic_arm.errors import RecordingError
from elastic_arm.recording import limits
from elastic_arm.recording.storage.metadata import Topic

OWN_PACKAGE = "elastic_arm_msgs"
_NAME = r"[A-Za-z]\w*(?:/[A-Za-z]\w*){1,2}"
_SEPARATOR = re.compile(r"={20,}\s*")
_HEAD = re.compile(rf"\s*MSG:\s*({_NAME})\s*")
_NO_IDL = re.compile(r"#.*|={20,}\s*|\s*IDL:.*")
_MEMBER = re.compile(r"\s*([^\s#@]\S*)\s+(\w+)\s*(=)?")
# Comments and strings that do not end go on to the end of the text: so none is looked through
# twice.
_SPOKEN = re.compile(r'//[^\n]*|/\*(?:[^*]|\*(?!/))*(?:\*/)?|"(?:\\.|[^"\\])*"?', re.DOTALL)
_ANNOTATION = re.compile(r"@[\w:]+\s*(?:\([^()]*\))?")
# Of these the library makes expressions, by all ways to read them, and numbers of any size.
_EXPRESSION = re.compile(r"[(*]|<<")
# What ROS 2 sends of a message without fields.
_EMPTY: list[Any] = [("structure_needs_at_least_one_member", (Nodetype.BASE, ("uint8", 0)))]


@lru_cache(maxsize=1)
def typestore() -> Typestore:
    """Return Jazzy's standard types with those of elastic_arm_msgs.

    Their .msg files are in `recording/msg`.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    types = {}
    for file in sorted(
        resources.files(__package__).joinpath("msg").iterdir(), key=lambda entry: entry.name
    ):
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
        raise RecordingError(
            f"message type {type_name} is not known", "Give its definition with the topic."
        )
    text, _ = store.generate_msgdef(type_name, ros_version=2)
    return text, store.hash_rihs01(type_name)


def types_of(topic: Topic) -> Typesdict:
    """Return the types of a topic's messages: those of the bag, or the known ones."""
    types = parse_definition(topic.type_name, topic.encoding, topic.definition)
    if topic.type_name not in types:
        problem = f"message type {topic.type_name} is not defined in the bag"
        raise RecordingError(problem, "Record it with its definition.")
    return types


# What makes ROS messages, or tables, of messages in other languages.
_AS_JSON = (
    "Export them as JSON Lines and import the result: mcap cat --json FILE >"
    " a.jsonl; elastic-arm bag import a.jsonl."
)
_FOREIGN = dict.fromkeys(("protobuf", "jsonschema", "flatbuffer", "omgidl"), _AS_JSON)
_FOREIGN["ros1msg"] = (
    "Convert the bag to ROS 2 first: rosbags-convert --src FILE --dst BAG (pip install rosbags)."
)


@lru_cache(maxsize=64)
def parse_definition(type_name: str, encoding: str, text: str) -> Typesdict:
    """Return the fields of a type and of its parts.

    Known types are taken where there is no text.
    """
    if not text:
        return typestore().fielddefs
    if encoding in _FOREIGN:
        problem = f"message type {type_name[:60]!r} is written in {encoding!r}, not as ROS 2 does"
        raise RecordingError(problem, _FOREIGN[encoding])
    reason = ""
    try:
        if not re.fullmatch(_NAME, type_name):
            reason = "that is not a valid type name"
        elif len(text) > limits.DEFINITION_BYTES:
            reason = f"it has {len(text)} characters; the limit is {limits.DEFINITION_BYTES}"
        elif encoding == "ros2msg":
            found = get_types_from_msg(_plain_msg(text), type_name)
        elif encoding in ("ros2idl", ""):
            found = get_types_from_idl(_plain_idl(text))
        else:
            reason = f"it is written in {encoding[:60]!r}, not in ros2msg or ros2idl"
    except (TypesysError, ValueError, RecursionError) as error:
        reason = "it does not follow the grammar" if "\n" in str(error) else str(error)[:80]
    if reason:
        problem = (
            f"the definition of message type {type_name[:60]!r} in the bag cannot be read: {reason}"
        )
        raise RecordingError(problem, "Record again with the definitions of ROS.")
    return {name: (constants, fields or _EMPTY) for name, (constants, fields) in found.items()}


def _plain_msg(text: str) -> str:
    """Return the types and fields of a ros2msg text, one a line, and nothing else."""
    lines: list[str] = []
    for line in text.splitlines():
        if head := _HEAD.fullmatch(line):
            lines += ["=" * 80, f"MSG: {head[1]}"]
        elif member := _MEMBER.match(line):
            lines += [] if member[3] else [f"{member[1]} {member[2]}"]
        elif not (_SEPARATOR.fullmatch(line) or line.lstrip()[:1] in ("", "#", "@")):
            raise ValueError(f"{line.strip()[:60]!r} is not a field")
    _check_count(len(lines))
    return "\n".join([*lines, ""])


def _plain_idl(text: str) -> str:
    """Return an IDL text without comments, annotations, preprocessor lines and what texts hold."""
    kept = "\n".join(line for line in text.splitlines() if not _NO_IDL.fullmatch(line))
    plain = _ANNOTATION.sub(
        "", _SPOKEN.sub(lambda found: '""' if found[0][0] == '"' else " ", kept)
    )
    if found := _EXPRESSION.search(plain):
        raise ValueError(f"{plain[found.start() :][:20]!r} is in it")
    _check_count(plain.count(";") + plain.count(","))
    return plain


def _check_count(fields: int) -> None:
    if fields > limits.DEFINITION_FIELDS:
        raise ValueError(f"it has more than {limits.DEFINITION_FIELDS} fields, the limit")
