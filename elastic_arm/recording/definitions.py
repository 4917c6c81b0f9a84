"""Message definitions that a bag brings along, read as data: no text of a bag is ever executed.

A definition is reduced to types, fields and array sizes, each checked by the grammar of ROS interfaces, before the
library that parses it sees it. Constants and defaults do not change where numbers lie and are left out. Everything here
takes time in proportion to the length of the text. Definitions in IDL are not read: of known types none is needed.
"""

from __future__ import annotations

import re
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import TypesysError, get_types_from_msg

from elastic_arm.errors import RecordingError
from elastic_arm.recording import limits

_NAME = r"[A-Za-z][A-Za-z0-9_]*"
_TYPE_NAME = re.compile(rf"{_NAME}(/{_NAME}){{1,2}}")
_SEPARATOR = re.compile(r"={20,}\s*")
_HEAD = re.compile(rf"\s*MSG:\s*({_NAME}(?:/{_NAME}){{1,2}})\s*")
_MEMBER = re.compile(
    rf"\s*(?P<type>w?string<=\d{{1,10}}|{_NAME}(?:/{_NAME}){{0,2}})(?P<array>\[(?:<=)?\d{{0,10}}\])?\s+(?P<name>{_NAME})"
    r"(?P<rest>\s*=.*|\s.*|#.*)?"
)
# What ROS 2 sends of a message without fields.
_EMPTY: list[Any] = [("structure_needs_at_least_one_member", (Nodetype.BASE, ("uint8", 0)))]


def parse_definition(type_name: str, encoding: str, text: str) -> Typesdict:
    """Return the fields of a type, `package/msg/Type`, and of all that it is made of, from its ros2msg text.

    A RecordingError if that is none by the grammar, or beyond the limits of :mod:`elastic_arm.recording.limits`.
    """
    try:
        if not _TYPE_NAME.fullmatch(type_name):
            raise _Unusable(f"{type_name[:60]!r} is no name of a type")
        if len(text) > limits.DEFINITION_BYTES:
            raise _Unusable(f"it has {len(text)} characters, {limits.DEFINITION_BYTES} are the limit")
        if encoding != "ros2msg":
            raise _Unusable(f"it is written in {encoding[:60]!r}, not in ros2msg")
        found: Typesdict = dict(get_types_from_msg(_plain(text), type_name))
        found = {name: (constants, fields or _EMPTY) for name, (constants, fields) in found.items()}
        _check_depth(found)
    except (_Unusable, TypesysError, ValueError, RecursionError) as error:
        reason = "it does not follow the grammar" if "\n" in str(error) else str(error)[:200]
        raise RecordingError(
            f"the definition of message type {type_name[:60]!r} in the bag cannot be read: {reason}",
            "Record again with the definitions of ROS.",
        ) from None
    return found


class _Unusable(Exception):
    """Why a definition cannot be used."""


def _plain(text: str) -> str:
    """Return the types and fields of a ros2msg text, one a line, and nothing else."""
    lines: list[str] = []
    types = fields = 0
    for line in text.splitlines():
        if _SEPARATOR.fullmatch(line) or not line.strip() or line.lstrip()[0] in "#@":
            continue
        if head := _HEAD.fullmatch(line):
            types += 1
            lines += ["=" * 80, f"MSG: {head[1]}"]
            continue
        member = _MEMBER.fullmatch(line)
        if member is None:
            raise _Unusable(f"{line.strip()[:60]!r} is no field")
        if (member["rest"] or "").lstrip().startswith("="):
            continue
        fields += 1
        array = member["array"] or ""
        if int("".join(filter(str.isdecimal, array)) or 0) > limits.ARRAY_LENGTH:
            raise _Unusable(f"an array of {array} items")
        if types > limits.DEFINITION_TYPES or fields > limits.DEFINITION_FIELDS:
            most = f"{limits.DEFINITION_TYPES} types or {limits.DEFINITION_FIELDS} fields"
            raise _Unusable(f"more than {most}, which are the limits")
        lines.append(f"{member['type']}{array} {member['name']}")
    return "\n".join([*lines, ""])


def _check_depth(found: Typesdict) -> None:
    """Raise if a type contains itself, or types contain each other more deeply than the limit."""
    parts = {
        name: {part for _, desc in fields if (part := _part(desc)) in found} for name, (_, fields) in found.items()
    }
    depth: dict[str, int] = {}
    # From the simple types outward: what is left over at the end contains itself.
    while ready := [name for name in parts.keys() - depth.keys() if parts[name] <= depth.keys()]:
        for name in ready:
            depth[name] = 1 + max((depth[part] for part in parts[name]), default=0)
            if depth[name] > limits.TYPE_DEPTH:
                raise _Unusable(f"types in each other {depth[name]} deep, {limits.TYPE_DEPTH} is the limit")
    if len(depth) < len(parts):
        raise _Unusable(f"the type {min(parts.keys() - depth.keys())} contains itself")


def _part(desc: Any) -> str:
    """Return the name of the type that a field is made of; empty for numbers and strings."""
    kind, what = desc
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        kind, what = what[0]
    return str(what) if kind == Nodetype.NAME else ""
