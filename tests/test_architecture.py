"""The rules of docs/architecture.md, held by reading the imports of every module."""

import ast
import functools
import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "elastic_arm"

# Outside libraries that belong to one package, or to some, alone.
ROS = (
    "rclpy",
    "ament_index_python",
    "builtin_interfaces",
    "diagnostic_msgs",
    "elastic_arm_msgs",
    "rcl_interfaces",
)
ROS += ("control_msgs", "rosgraph_msgs", "sensor_msgs", "std_msgs", "std_srvs", "trajectory_msgs")
KEPT_TO: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(ROS, ("nodes",)),
    "rosbags": ("recording",),
    "mcap": ("recording/storage",),
    "sqlite3": ("recording/storage",),
    "matplotlib": ("report", "studies/paper/report", "studies/blind_challenge/report"),
    "jinja2": ("report",),
    "typer": ("cli", "app.py", "studies/paper/command.py", "studies/blind_challenge/command.py"),
    "mujoco": ("studies/paper", "robot/mjcf", "mujoco"),
    "lxml": ("mujoco",),
    "pxr": ("mujoco",),
    "pinocchio": ("studies/blind_challenge",),
}
# Packages that only some others may import.
ENTRANCES = {"nodes": (), "studies": ("app",), "cli": ("studies", "app")}


@functools.cache
def tree_of(path: Path) -> ast.Module:
    """Return a module's syntax tree."""
    return ast.parse(path.read_text())


@functools.cache
def packages_in_order() -> list[str]:
    """Return the packages as the table of docs/architecture.md lists them."""
    text = (ROOT / "docs" / "architecture.md").read_text()
    return re.findall(r"^\| `(\w+?)(?:\.py|/)`", text, flags=re.MULTILINE)


def package_of(path: Path) -> str:
    """Return the package of a module: its folder, or its own name at the top."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


@functools.cache
def imports_of(path: Path) -> list[tuple[int, str]]:
    """Return the line and the full name of everything that a module imports."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    found: list[tuple[int, str]] = []
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *(node.module or "").split(".")]).strip(".")
            found += [(node.lineno, f"{module}.{alias.name}") for alias in node.names]
    return found


def module_name(path: Path) -> str:
    """Return the dotted name of a module."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def imported_modules(path: Path) -> set[str]:
    """Return the modules of the package that a module imports."""
    found = {name if name in KNOWN else name.rpartition(".")[0] for _, name in imports_of(path)}
    return found & KNOWN


MODULES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")
KNOWN = {module_name(path) for path in PACKAGE.rglob("*.py")}


def test_a_module_imports_only_from_packages_above_its_own() -> None:
    """Imports follow the flow of the data: only from the module's own package and those listed
    before it."""
    order = packages_in_order()
    for path in MODULES:
        own = package_of(path)
        assert own in order, f"{own} has no row in the table of docs/architecture.md"
        closed = {name for name, allowed in ENTRANCES.items() if own != name and own not in allowed}
        allowed = {*order[: order.index(own) + 1]} - closed
        for line, name in imports_of(path):
            parts = name.split(".")
            if parts[0] == "elastic_arm" and (len(parts) > 1 and parts[1] in order):
                assert parts[1] in allowed, (
                    f"{path}:{line} imports {name}, which stands below {own}"
                )


def test_outside_libraries_stay_in_their_package() -> None:
    """Only the nodes know ROS, only the storage of recordings knows its formats, only reports
    draw."""
    for path in MODULES:
        place = path.relative_to(PACKAGE).as_posix()
        for line, name in imports_of(path):
            kept_to = KEPT_TO.get(name.split(".")[0])
            assert kept_to is None or place.startswith(kept_to), (
                f"{path}:{line} imports {name}: not of {kept_to}"
            )


def test_imports_form_no_circle() -> None:
    """Every module can be imported before those that import it, imports inside functions and for
    types included."""
    graph = {module_name(path): imported_modules(path) for path in PACKAGE.rglob("*.py")}
    with_packages = {name: found - {name} for name, found in graph.items()}
    try:
        TopologicalSorter(with_packages).prepare()
    except CycleError as error:
        pytest.fail(f"imports form a circle: {' <- '.join(error.args[1])}")
