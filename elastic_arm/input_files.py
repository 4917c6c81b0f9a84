"""Files that a user writes: read as text or YAML, with errors that name what is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from elastic_arm.errors import ElasticArmError

SHOWN_FAULTS = 5
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


def read_text(path: str | Path, kind: type[ElasticArmError], remedy: str) -> str:
    """Read a text file.

    Parameters
    ----------
    kind, remedy
        Of the error where it cannot be read.
    """
    try:
        return Path(path).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise kind(f"{path}: no such file", remedy) from None
    except IsADirectoryError:
        raise kind(f"{path}: is a folder, not a file", remedy) from None
    except OSError as error:
        raise kind(f"{path}: cannot be read ({error.strerror})", remedy) from None
    except UnicodeDecodeError:
        raise kind(f"{path}: is no text file", remedy) from None


def read_fields(path: str | Path, kind: type[ElasticArmError], remedy: str) -> dict[str, Any]:
    """Read a YAML file that holds fields; an error of `kind` names file, line and reason where it does not.

    Parameters
    ----------
    path
        The file.
    kind, remedy
        Of the error where it is no text, no YAML, or holds no fields.
    """
    text = read_text(path, kind, remedy)
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f"line {mark.line + 1}: " if mark else ""
        reason = getattr(error, "problem", None) or "no YAML"
        raise kind(f"{path}: {line}{reason}", "Mend the YAML; indentation and colons matter.") from None
    if not isinstance(content, dict):
        raise kind(f"{path}: holds no fields", remedy)
    return content


def explain(error: ValidationError, reference: str) -> tuple[str, str]:
    """Return what is wrong in words, each field's path and reason, and the remedy of the first.

    Parameters
    ----------
    reference
        Clause that names the description of the fields.
    """
    faults = error.errors(include_url=False)
    words = []
    for fault in faults[:SHOWN_FAULTS]:
        where = _field_path(fault["loc"])
        words.append(f"{where}: {_reason(fault)}" if where else _reason(fault))
    if len(faults) > SHOWN_FAULTS:
        words.append(f"and {len(faults) - SHOWN_FAULTS} more")
    return "; ".join(words), _remedy(faults[0], reference)


def _field_path(location: tuple[int | str, ...]) -> str:
    path = ""
    for step in location:
        path += f"[{step}]" if isinstance(step, int) else f".{step}"
    return path.lstrip(".")


def _reason(fault: ErrorDetails) -> str:
    kind, value = fault["type"], fault.get("input")
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
            return f"has {fault['ctx']['actual_length']} entries, needs {fault['ctx']['min_length']} or more"
        case "too_long":
            return f"has {fault['ctx']['actual_length']} entries, takes {fault['ctx']['max_length']} at most"
        case "string_too_short":
            return "is empty"
        case "literal_error":
            return f"is {_shown(value)}"
        case "greater_than":
            return f"is {_shown(value)}, but must be above {fault['ctx']['gt']:g}"
        case "greater_than_equal":
            return f"is {_shown(value)}, but must be {fault['ctx']['ge']:g} or more"
        case "value_error":
            return fault["msg"].removeprefix("Value error, ")
    return f"{fault['msg']}, but is {_shown(value)}"


def _remedy(fault: ErrorDetails, reference: str) -> str:
    name = str(fault["loc"][-1]) if fault["loc"] else ""
    match fault["type"]:
        case "missing" if isinstance(fault["loc"][-1], int):
            return f"Give all entries; {reference}."
        case "missing":
            return f"Add {name} there; {reference}."
        case "extra_forbidden":
            return f"Remove {name}, or correct its spelling; {reference}."
        case "finite_number":
            return "Give a finite number."
        case "literal_error":
            return f"Choose one of {fault['ctx']['expected']}."
    return f"Mend it; {reference}."


def _shown(value: Any) -> str:
    return repr(value) if len(repr(value)) <= 60 else f"{repr(value)[:57]}…"
