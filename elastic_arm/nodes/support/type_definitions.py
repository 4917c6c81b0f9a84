"""Definitions of message types that are installed here: the text that a bag keeps of a type beside its messages."""

from __future__ import annotations

import json
import re
from pathlib import Path

from ament_index_python import PackageNotFoundError, get_package_share_directory

_SEPARATOR = "=" * 80
# A field's type at the beginning of a line: package, name; arrays, bounds and what follows do not matter.
_FIELD = re.compile(r"^\s*(?:(\w+)/(?:msg/)?)?([A-Z]\w*)", flags=re.MULTILINE)


def installed_definition(type_name: str) -> tuple[str, str]:
    """Return the full ros2msg text of a type and all it is made of, and its RIHS01 hash; empty where not found."""
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
    """Add the text of a type and of those of its fields."""
    key = f"{package}/{name}"
    if key in texts:
        return
    texts[key] = (_share(package) / f"{name}.msg").read_text(encoding="utf-8")
    plain = re.sub(r"#.*", "", texts[key])
    for other, field in _FIELD.findall(plain):
        if field == "Header" and not other:
            other = "std_msgs"
        _gather(other or package, field, texts)
