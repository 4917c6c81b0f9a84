"""The house rules of docs/architecture.md, held by reading the imports of every module."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "elastic_arm"

# Outside libraries that belong to one room alone.
ROS = ("rclpy", "ament_index_python", "builtin_interfaces", "diagnostic_msgs", "elastic_arm_msgs", "rcl_interfaces")
ROS += ("rosgraph_msgs", "sensor_msgs", "std_msgs", "std_srvs", "trajectory_msgs")
KEPT_TO = {
    **dict.fromkeys(ROS, "nodes"),
    "rosbags": "recording",
    "mcap": "recording",
    "matplotlib": "report",
    "jinja2": "report",
    "typer": "cli",
    "mujoco": "paper",
    "pinocchio": "gap",
    "dask": "gap",
    "distributed": "gap",
}
DOORS = {"nodes", "cli"}


def rooms_in_order() -> list[str]:
    """Return the rooms as the table of docs/architecture.md lists them."""
    text = (ROOT / "docs" / "architecture.md").read_text()
    return re.findall(r"^\| `(\w+?)(?:\.py|/)`", text, flags=re.MULTILINE)


def room_of(path: Path) -> str:
    """Return the room of a module: its folder, or its own name at the top of the package."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports_of(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the line and the full name of everything that a module imports."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *(node.module or "").split(".")]).strip(".")
            yield from ((node.lineno, f"{module}.{alias.name}") for alias in node.names)


MODULES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")
named = pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))


@named
def test_a_module_imports_only_from_rooms_above_its_own(path: Path) -> None:
    """Imports follow the flow of the data: only from the module's own room and those listed before it."""
    order = rooms_in_order()
    room = room_of(path)
    assert room in order, f"{room} has no row in the table of docs/architecture.md"
    allowed = {*order[: order.index(room) + 1]} - (DOORS - {room})
    for line, name in imports_of(path):
        parts = name.split(".")
        if parts[0] == "elastic_arm" and (len(parts) > 1 and parts[1] in order):
            assert parts[1] in allowed, f"{path}:{line} imports {name}, which stands below {room}"


@named
def test_outside_libraries_stay_in_their_room(path: Path) -> None:
    """Only the nodes know ROS, only the recording knows MCAP, only the report draws."""
    for line, name in imports_of(path):
        room = KEPT_TO.get(name.split(".")[0], room_of(path))
        assert room_of(path) == room, f"{path}:{line} imports {name}; that belongs to {room}/"


@named
def test_modules_and_functions_stay_short(path: Path) -> None:
    """No module is longer than 400 lines, and no function than 70."""
    text = path.read_text()
    assert text.count("\n") <= 400
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno - node.lineno < 70, f"{path}:{node.lineno} {node.name}"
