"""Message definitions that a bag brings along, read as data: no text of a bag is ever executed.

A definition is reduced to types, fields and array sizes, each checked by the grammar of ROS interfaces, before the
library that parses it sees it. Constants, defaults and annotations do not change where numbers lie and are left out.
Everything here takes time in proportion to the length of the text.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import TypesysError, get_types_from_idl, get_types_from_msg

from elastic_arm.errors import RecordingError
from elastic_arm.recording import limits

_NAME = r"[A-Za-z][A-Za-z0-9_]*"
_TYPE_NAME = re.compile(rf"{_NAME}(/{_NAME}){{1,2}}")
_SEPARATOR = re.compile(r"={20,}\s*")
_HEAD = re.compile(rf"\s*(?:MSG|IDL):\s*({_NAME}(?:/{_NAME}){{1,2}})\s*")
_MEMBER = re.compile(
    rf"\s*(?P<type>w?string<=\d{{1,10}}|{_NAME}(?:/{_NAME}){{0,2}})(?P<array>\[(?:<=)?\d{{0,10}}\])?\s+(?P<name>{_NAME})"
    r"(?P<rest>\s*=.*|\s.*|#.*)?"
)
# Comments and strings that do not end are tokens up to the end of the text: so none is looked through twice.
_TOKEN = re.compile(
    r'//[^\n]*|/\*(?:[^*]|\*(?!/))*(?:\*/)?|"(?:\\.|[^"\\])*"?|' + rf"'[^'\n]*'|{_NAME}|::|\d[\w.]*|\S", re.DOTALL
)
# What ROS 2 sends of a message without fields.
_EMPTY: list[Any] = [("structure_needs_at_least_one_member", (Nodetype.BASE, ("uint8", 0)))]
_MODULES = 8  # nested in each other
_BRACES = {"{": 1, "}": -1}
_BRACKETS = {"<": 1, ">": -1, "[": 1, "]": -1}


def parse_definition(type_name: str, encoding: str, text: str) -> Typesdict:
    """Return the fields of a type and of all that it is made of."""
    try:
        if not _TYPE_NAME.fullmatch(type_name):
            raise _Unusable(f"{type_name[:60]!r} is no name of a type")
        if len(text) > limits.DEFINITION_BYTES:
            raise _Unusable(f"it has {len(text)} characters, {limits.DEFINITION_BYTES} are the limit")
        if encoding == "ros2msg":
            found: Typesdict = dict(get_types_from_msg(_plain_msg(text), type_name))
        elif encoding in ("ros2idl", ""):
            found = dict(get_types_from_idl(_plain_idl(text)))
        else:
            raise _Unusable(f"it is written in {encoding[:60]!r}, not in ros2msg or ros2idl")
        found = {name: (constants, fields or _EMPTY) for name, (constants, fields) in found.items()}
        _check_depth(found)
    except _Unusable as error:
        problem = f"the definition of message type {type_name[:60]!r} in the bag cannot be read: {error}"
        raise RecordingError(problem, "Record again with the definitions of ROS.") from None
    except (TypesysError, ValueError, RecursionError) as error:
        reason = "it does not follow the grammar" if "\n" in str(error) else str(error)[:80]
        problem = f"the definition of message type {type_name!r} in the bag cannot be read: {reason}"
        raise RecordingError(problem, "Record again with the definitions of ROS.") from None
    return found


class _Unusable(Exception):
    """Why a definition cannot be used."""


def _plain_msg(text: str) -> str:
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
        lines.append(f"{member['type']}{member['array'] or ''} {member['name']}")
        _check_size(member["array"] or "")
        _check_counts(types, fields)
    return "\n".join([*lines, ""])


def _plain_idl(text: str) -> str:
    """Return an IDL text without comments and annotations, within bounds that keep the library's parser quick."""
    words = list(_tokens(text))
    _check_counts(words.count("struct") + words.count("typedef"), sum(map(words.count, ";,[")))
    depth, inner, scopes = 0, 0, 0
    for before, word in pairwise(["", *words]):
        depth += _BRACES.get(word, 0)
        inner += _BRACKETS.get(word, 0)
        scopes = scopes + 1 if word == "::" else scopes if re.fullmatch(_NAME, word) and before == "::" else 0
        if not 0 <= depth <= _MODULES or not 0 <= inner <= 2 or scopes > _MODULES:
            raise _Unusable(f"brackets, modules or names in more than {_MODULES} levels")
        if not (re.fullmatch(rf"{_NAME}|\d[\w.]*|\".*\"|'.*'|::", word, re.DOTALL) or word in "{}[]<>,;=-+"):
            raise _Unusable(f"{word[:60]!r} stands in it")
        if before in ("[", ","):
            _check_size(word)
    return " ".join(words).replace(" :: ", "::")


def _tokens(text: str) -> Iterator[str]:
    """Yield the words and marks of an IDL text without its comments, preprocessor lines and annotations."""
    lines = (line for line in text.splitlines() if not (line.startswith("#") or _skipped(line)))
    found = [match[0] for match in _TOKEN.finditer("\n".join(lines))]
    if found and found[-1].startswith("/*") and not found[-1].endswith("*/"):
        raise _Unusable("a comment does not end")
    words = [word for word in found if not word.startswith(("//", "/*"))]
    at = 0
    while at < len(words):
        if words[at] != "@":
            yield words[at]
            at += 1
            continue
        at += 2
        while at < len(words) and words[at] == "::":
            at += 2
        depth = 0
        while at < len(words) and (depth or words[at] == "("):
            depth += {"(": 1, ")": -1}.get(words[at], 0)
            at += 1


def _skipped(line: str) -> bool:
    return bool(_SEPARATOR.fullmatch(line) or _HEAD.fullmatch(line))


def _check_size(text: str) -> None:
    digits = "".join(letter for letter in text if letter.isdecimal())
    if len(digits) > 10 or int(digits or 0) > limits.ARRAY_LENGTH:
        raise _Unusable(f"an array of {digits[:20]} items")


def _check_counts(types: int, fields: int) -> None:
    if types > limits.DEFINITION_TYPES or fields > limits.DEFINITION_FIELDS:
        raise _Unusable(
            f"more than {limits.DEFINITION_TYPES} types or {limits.DEFINITION_FIELDS} fields, which are the limits"
        )


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
