"""Files written by users, read as text or YAML, with errors that name the mistake."""

import os
import re
import stat
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import yaml
from pydantic import BeforeValidator, ValidationError
from pydantic_core import ErrorDetails

from elastic_arm.errors import ElasticArmError

SHOWN_FAULTS = 5
# Limits of what a user's file may ask for; the largest arm files and URDFs have some hundred
# kilobytes.
LARGEST = 50_000_000  # bytes
DEEPEST = 50  # collections in each other
MOST_NODES = 500_000  # entries of a YAML file, aliases written out
# First and last line of a YAML file that the suite wrote: one that is cut off may be YAML all the
# same.
WHOLE_FROM, WHOLE_TO = (
    "# Written by elastic_arm, whole up to the last line, which has three dots.",
    "...",
)
LONGEST_NUMBER = (
    1000  # characters; the largest number has 309 digits, and Python writes out no more than 4300
)
# Written in C where the library has it: in Python, metadata.yaml takes as long as a hundred
# thousand messages.
_SAFE_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
# YAML's kinds of scalars that not every text can be, and what the library raises where one is not.
_SCALARS = {
    "bool": "neither yes nor no",
    "int": "not a whole number",
    "float": "not a number",
    "timestamp": "not a date",
}
_NO_SCALAR = (ValueError, LookupError, AttributeError, OverflowError)
# What pydantic adds to the path of a value that may be of several types.
_TYPE = re.compile(r"(literal|list|dict|tuple|function-before)\[|(float|int|str|bool)$")


def refuse_truth(value: Any) -> Any:
    """Return a value that is to be a number; Python takes yes for 1."""
    if isinstance(value, bool):
        raise ValueError("is yes or no, not a number")
    return value


# Numbers of a user's file.
Number = Annotated[float, BeforeValidator(refuse_truth)]
WholeNumber = Annotated[int, BeforeValidator(refuse_truth)]
# pydantic's kinds of faults by what was wanted there.
_WANTED = {
    "tuple_type": "a list",
    "list_type": "a list",
    "dict_type": "a block of fields",
    "model_type": "a block of fields",
    "model_attributes_type": "a block of fields",
    "string_type": "a text",
    "float_type": "a number",
    "float_parsing": "a number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
}


def read_bytes(
    path: str | Path, kind: type[ElasticArmError], remedy: str, most: int = LARGEST
) -> bytes:
    """Read a file of bounded size; never a pipe or a device, which may not end."""
    problem = ""
    try:
        status = os.stat(path)
        if stat.S_ISDIR(status.st_mode):
            problem = "is a folder, not a file"
        elif not stat.S_ISREG(status.st_mode):
            problem = "is a pipe or a device, not a file"
        elif status.st_size > most:
            problem = f"has {status.st_size} bytes; the limit is {most}"
        else:
            with open(path, "rb", opener=_at_once) as file:
                content: bytes | None = file.read(most)
            if content is not None:
                return content
            problem = "is not a file and contains no data"
    except FileNotFoundError:
        problem = "no such file"
    except OSError as error:
        problem = f"cannot be read ({error.strerror})"
    except ValueError:
        problem = "is not a valid file name: it contains a NUL character"
    raise kind(f"{path}: {problem}", remedy)


def _at_once(path: str, flags: int) -> int:
    """Open a file without waiting: some of /proc call themselves regular files and wait, as
    /proc/kmsg does."""
    return os.open(path, flags | os.O_NONBLOCK)


def read_text(
    path: str | Path, kind: type[ElasticArmError], remedy: str, most: int = LARGEST
) -> str:
    """Read a text file."""
    try:
        return read_bytes(path, kind, remedy, most).decode("utf-8")
    except UnicodeDecodeError:
        raise kind(f"{path}: is not a text file", remedy) from None


def read_fields(
    path: str | Path, kind: type[ElasticArmError], remedy: str, most: int = LARGEST
) -> dict[str, Any]:
    """Read a YAML file that holds fields.

    Otherwise an error of `kind` names file, line and reason.
    """
    text = read_text(path, kind, remedy, most)
    if text.startswith(WHOLE_FROM) and text.rstrip().rpartition("\n")[2] != WHOLE_TO:
        raise kind(
            f"{path}: is truncated: its last line is not {WHOLE_TO}",
            "Write it again, or complete it and add that line.",
        )
    try:
        content = parse_yaml(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        # The end of a file may count as a line of its own.
        line = f"line {min(mark.line, text.count(chr(10))) + 1}: " if mark else ""
        reason = (
            getattr(error, "problem", None) or getattr(error, "reason", None) or "not valid YAML"
        )
        raise kind(
            f"{path}: {line}{reason}", "Correct the YAML; check indentation and colons."
        ) from None
    if not isinstance(content, dict):
        raise kind(f"{path}: contains no fields", remedy)
    return content


def parse_yaml(text: str) -> Any:
    """Return what a YAML text holds, within the limits of this module."""
    _check_yaml(text)
    return yaml.load(text, Loader=_Loader)


_MERGE = "tag:yaml.org,2002:merge"  # "<<", which may come several times


class _Loader(_SAFE_LOADER):
    """The safe loader, which refuses scalars that are not of their kind, and fields that are given
    twice."""

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        """Return a mapping; a key that comes again with another value would take the first one's
        place in silence."""
        given: dict[tuple[str, str], yaml.Node] = {}
        for key, value in node.value if isinstance(node, yaml.MappingNode) else ():
            if not isinstance(key, yaml.ScalarNode) or key.tag == _MERGE:
                continue
            first = given.setdefault((key.tag, key.value), value)
            if first is not value and (first.tag, first.value) != (value.tag, value.value):
                problem = f"{key.value[:40]!r} is given twice, with different values: keep one"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
        return super().construct_mapping(node, deep)


def _scalar(kind: str) -> Callable[[Any, yaml.ScalarNode], Any]:
    """Return what reads scalars of a kind, and refuses what is none, such as 2001-99-99 or !!bool
    x."""
    construct = getattr(yaml.constructor.SafeConstructor, f"construct_yaml_{kind}")

    def constructed(loader: Any, node: yaml.ScalarNode) -> Any:
        try:
            if isinstance(node, yaml.ScalarNode) and len(node.value) <= LONGEST_NUMBER:
                return construct(loader, node)
        except _NO_SCALAR:
            pass
        problem = f"{str(node.value)[:40]!r} is {_SCALARS[kind]}; quote it if it is text"
        raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)

    return constructed


for _kind in _SCALARS:
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _scalar(_kind))


def _check_yaml(text: str) -> None:
    """Raise a YAMLError if a document is nested too deeply, or too large with its aliases written
    out."""
    depth = nodes = 0
    begun: list[
        tuple[str | None, int]
    ] = []  # anchor of each collection that is open, and the nodes before it
    sizes: dict[str, int] = {}
    for event in yaml.parse(text, Loader=_SAFE_LOADER):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            begun.append((event.anchor, nodes))
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
            anchor, before = begun.pop()
            if anchor is not None:
                sizes[anchor] = nodes - before
        elif isinstance(event, yaml.AliasEvent):
            if event.anchor in (anchor for anchor, _ in begun):
                raise _beyond("an alias that contains itself", event)
            nodes += sizes.get(str(event.anchor), 0)
        nodes += 1
        if depth > DEEPEST:
            raise _beyond(f"nesting deeper than {DEEPEST} levels", event)
        if nodes > MOST_NODES:
            raise _beyond(f"more than {MOST_NODES} entries after expanding aliases", event)


def _beyond(problem: str, event: yaml.Event) -> yaml.MarkedYAMLError:
    mark: Any = event.start_mark
    return yaml.MarkedYAMLError(problem=problem, problem_mark=mark)


def explain(
    error: ValidationError, reference: str, called: Mapping[str, str] = MappingProxyType({})
) -> tuple[str, str]:
    """Return what is wrong in words, each field's path and reason, and the remedy of the first."""
    # Of a value that may be of several types, what each of them misses comes as a fault of its own.
    faults = list(
        {
            _field_path(fault["loc"]): fault for fault in error.errors(include_url=False)[::-1]
        }.values()
    )[::-1]
    words = []
    for fault in faults[:SHOWN_FAULTS]:
        where = _field_path(fault["loc"])
        reason = _reason(fault)
        if fault["type"] == "extra_forbidden" and (
            own := called.get(str(fault["loc"][-1]).lower())
        ):
            reason += f" (the name is {own})"
        words.append(f"{where}: {reason}" if where else reason)
    if len(faults) > SHOWN_FAULTS:
        words.append(f"and {len(faults) - SHOWN_FAULTS} more")
    return "; ".join(words), _remedy(faults[0], reference, called)


def _field_path(location: tuple[int | str, ...]) -> str:
    path = ""
    for step in location:
        if isinstance(step, str) and _TYPE.match(step):
            continue
        path += f"[{step}]" if isinstance(step, int) else f".{step}"
    return path.lstrip(".")


def _reason(fault: ErrorDetails) -> str:
    kind = fault["type"]
    value = fault.get("input")
    if kind in _WANTED:
        return f"is {_shown(value)}, not {_WANTED[kind]}"
    match kind:
        case "missing":
            return "missing entry" if isinstance(fault["loc"][-1], int) else "missing field"
        case "extra_forbidden":
            return "unknown key"
        case "finite_number":
            return f"{value} is not a finite number"
        case "too_short":
            return (
                f"has {fault['ctx']['actual_length']} entries, but needs at least"
                f" {fault['ctx']['min_length']}"
            )
        case "too_long":
            return (
                f"has {fault['ctx']['actual_length']} entries, but at most"
                f" {fault['ctx']['max_length']} are allowed"
            )
        case "string_too_short":
            return "is empty"
        case "literal_error":
            return f"is {_shown(value)}"
        case "greater_than":
            return f"is {_shown(value)}, but must be above {fault['ctx']['gt']:g}"
        case "greater_than_equal":
            return f"is {_shown(value)}, but must be at least {fault['ctx']['ge']:g}"
        case "value_error":
            return fault["msg"].removeprefix("Value error, ")
    return f"{fault['msg']}, but is {_shown(value)}"


def _remedy(fault: ErrorDetails, reference: str, called: Mapping[str, str]) -> str:
    name = str(fault["loc"][-1]) if fault["loc"] else ""
    match fault["type"]:
        case "missing" if isinstance(fault["loc"][-1], int):
            return f"Give all entries; {reference}."
        case "missing":
            return f"Add {name} there; {reference}."
        case "extra_forbidden" if name.lower() in called:
            return f"Replace {name} by {called[name.lower()]}; {reference}."
        case "extra_forbidden":
            return f"Remove {name}, or correct its spelling; {reference}."
        case "finite_number":
            return "Give a finite number."
        case "literal_error":
            return f"Choose one of {fault['ctx']['expected']}."
    return f"Correct it; {reference}."


def _shown(value: Any) -> str:
    return repr(value) if len(repr(value)) <= 60 else f"{repr(value)[:57]}…"
