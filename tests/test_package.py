"""The project as a package: what is installed, what it asks for, and that its declarations
agree."""

import importlib
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

import elastic_arm
from elastic_arm.errors import EXTRAS, MissingExtraError, require_libraries
from tests.helpers.command_line import refusal

ROOT = Path(__file__).parents[1]
PACKAGE_FILES = ("setup.py", "setup.cfg", "pyproject.toml", "package.xml", "LICENSE", "README.md")
PACKAGE_FOLDERS = ("elastic_arm", "resource", "launch", "config", "layouts", "tests", "msg_defs")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """The installable form of the package, built from its source distribution, that from a copy of
    the tree."""
    folder = tmp_path_factory.mktemp("package")
    source = folder / "source"
    for name in PACKAGE_FOLDERS:
        shutil.copytree(
            ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"), symlinks=True
        )
    for name in PACKAGE_FILES:
        shutil.copy(ROOT / name, source / name)
    setup = [sys.executable, "setup.py", "--quiet"]
    subprocess.run(
        [*setup, "sdist", "--dist-dir", str(folder)], cwd=source, check=True, capture_output=True
    )
    (folder / "unpacked").mkdir()
    subprocess.run(
        ["tar", "-xzf", next(folder.glob("*.tar.gz")), "-C", folder / "unpacked"], check=True
    )
    (unpacked,) = (folder / "unpacked").iterdir()
    command = [*setup, "bdist_wheel", "--dist-dir", str(folder)]
    subprocess.run(command, cwd=unpacked, check=True, capture_output=True)
    return zipfile.ZipFile(next(folder.glob("*.whl")))


def entry_points(wheel: zipfile.ZipFile) -> dict[str, str]:
    """Return the console scripts: name to `module:function`."""
    name = next(name for name in wheel.namelist() if name.endswith("entry_points.txt"))
    return dict(
        re.findall(r"^([\w-]+) = ([\w.:]+)$", wheel.read(name).decode(), flags=re.MULTILINE)
    )


def test_only_the_package_itself_is_installed(wheel: zipfile.ZipFile) -> None:
    """Neither tests nor benchmarks end up in the installation."""
    tops = {name.split("/")[0] for name in wheel.namelist()}
    assert {top for top in tops if not re.match(r"elastic_arm-.*\.(dist-info|data)$", top)} == {
        "elastic_arm"
    }


def test_all_that_the_code_reads_is_installed(wheel: zipfile.ZipFile) -> None:
    """The arm, message texts, templates and C sources travel with the code: all of the package that
    is no Python."""
    package = ROOT / "elastic_arm"
    folders = [package, package / "recording" / "msg"]  # a link, which rglob does not follow
    files = {path for folder in folders for path in folder.rglob("*") if path.is_file()}
    needed = {str(path.relative_to(ROOT)) for path in files if path.suffix not in {".py", ".pyc"}}
    assert needed
    assert needed <= set(wheel.namelist())


def test_launch_files_and_parameters_are_installed(wheel: zipfile.ZipFile) -> None:
    """Every launch file and parameter file is found where `ros2 launch` looks."""
    for folder in ("launch", "config", "layouts"):
        installed = {
            Path(name).name for name in wheel.namelist() if f"share/elastic_arm/{folder}/" in name
        }
        assert installed == {path.name for path in (ROOT / folder).iterdir() if path.is_file()}


def test_every_console_script_names_a_function_that_exists(wheel: zipfile.ZipFile) -> None:
    """No entry point leads nowhere."""
    scripts = entry_points(wheel)
    nodes = {
        "simulator",
        "trajectory_generator",
        "identifier",
        "gap_monitor",
        "recorder",
        "replayer",
    }
    assert {"elastic-arm"} | nodes <= set(scripts)
    for target in scripts.values():
        module, function = target.split(":")
        assert callable(getattr(importlib.import_module(module), function)), target


def test_one_version_everywhere() -> None:
    """The package, its ROS manifests and its citation carry the same version."""
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == elastic_arm.__version__
    for manifest in (ROOT / "package.xml", ROOT / "msg_defs" / "package.xml"):
        assert (
            ElementTree.parse(manifest).getroot().findtext("version") == elastic_arm.__version__
        ), manifest


def test_the_manifest_names_every_ros_package_that_a_node_imports() -> None:
    """`rosdep install` brings all that the nodes and launch files need."""
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    declared = {element.text for element in manifest.iter() if element.tag.endswith("depend")}
    known = {"rclpy", "launch", "launch_ros", "ament_index_python", "builtin_interfaces"}
    files = [*(ROOT / "elastic_arm" / "nodes").glob("*.py"), *(ROOT / "launch").glob("*.py")]
    for path in files:
        for name in re.findall(r"^\s*(?:from|import) (\w+)", path.read_text(), flags=re.MULTILINE):
            if name in known or name.endswith(("_msgs", "_srvs", "_interfaces")):
                assert name in declared, f"{path.name} imports {name}; package.xml lacks it"


def metadata_of(wheel: zipfile.ZipFile) -> str:
    """Return what a wheel states about itself."""
    return wheel.read(
        next(name for name in wheel.namelist() if name.endswith("/METADATA"))
    ).decode()


def requirements(name: str) -> list[str]:
    """Return the lines of a requirements file, without comments."""
    lines = (line.split("#")[0].strip() for line in (ROOT / name).read_text().splitlines())
    return [line for line in lines if line]


PINNED = (
    "requirements.txt",
    "requirements-extras.txt",
    "requirements-ros.txt",
    "requirements-dev.txt",
    "constraints.txt",
)


def names_in(name: str) -> set[str]:
    """Return what a requirements file asks for, without versions."""
    return {line.split("==")[0].lower() for line in requirements(name)}


def asked_by_extras(wheel: zipfile.ZipFile) -> dict[str, set[tuple[str, str]]]:
    """Return what each extra of the package asks for: names and ranges."""
    lines = re.findall(
        r"^Requires-Dist: ([\w.-]+)(\S*); extra == \W(\w+)", metadata_of(wheel), flags=re.MULTILINE
    )
    found: dict[str, set[tuple[str, str]]] = {}
    for name, bound, extra in lines:
        found.setdefault(extra, set()).add((name.lower(), bound))
    return found


def test_requirements_are_pinned_as_the_constraints_say() -> None:
    """Every line is `name==version`: nothing floats, nothing points to a server, nothing
    contradicts another."""
    pins = dict(line.lower().split("==") for line in requirements("constraints.txt"))
    for line in (line for name in PINNED for line in requirements(name)):
        assert re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.]+", line), line
        name, version = line.lower().split("==")
        assert pins[name] == version, line


def test_what_the_package_asks_for_is_what_the_environment_pins(wheel: zipfile.ZipFile) -> None:
    """setup.py and requirements.txt list the same run-time libraries, `all` and
    requirements-extras.txt the same large ones, and the names of all extras stay."""
    metadata = metadata_of(wheel)
    assert {"all", "challenge", "learning", "mujoco", "paper"} <= set(
        re.findall(r"^Provides-Extra: (\w+)", metadata, re.M)
    )
    asked = re.findall(r"^Requires-Dist: ([\w.-]+)(?!.*extra ==)", metadata, flags=re.MULTILINE)
    assert {name.lower() for name in asked} == names_in("requirements.txt")
    extras = {name for name, _ in asked_by_extras(wheel)["all"]}
    assert extras == names_in("requirements-extras.txt")


def test_an_error_names_the_extra_that_brings_a_library(wheel: zipfile.ZipFile) -> None:
    """The extra that the error for a missing library names is one of setup.py that asks for it."""
    asked = asked_by_extras(wheel)
    for library, extra in EXTRAS.items():
        assert library in {name for name, _ in asked[extra]}
        with pytest.raises(MissingExtraError, match=f"pip install {library} .extra `{extra}`"):
            require_libraries("this command needs", f"{library}:a_module_that_is_not_there")


@pytest.mark.parametrize(
    ("module", "words", "extra"),
    [
        ("pinocchio", "challenge create OUT --clean 1 --per-effect 0 --pairs 0", "challenge"),
        ("sympy", "paper --quick --out OUT", "paper"),
        (
            "pyarrow",
            "bag import SERVO/dataset --guess --robot SERVO/arm.xml --out map.yaml",
            "learning",
        ),
    ],
)
def test_commands_without_their_extra_end_in_one_line(
    module: str, words: str, extra: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All other commands work without the large libraries; those that need one name its extra."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, module, None)
    arguments = words.replace("SERVO", str(ROOT / "examples" / "servo_arm")).split()
    assert f"extra `{extra}`" in refusal(*arguments)


def test_the_ranges_for_ubuntu_are_those_of_the_package(wheel: zipfile.ZipFile) -> None:
    """requirements-jazzy.txt allows what setup.py allows, NumPy below 2 alone, and what `make
    oldest` installs.

    What ROS has itself is in package.xml instead.
    """
    asked = dict(
        re.findall(r"^Requires-Dist: ([\w.-]+?)(>=[\d.]+)$", metadata_of(wheel), flags=re.MULTILINE)
    )
    asked |= dict(asked_by_extras(wheel)["all"])
    manifest = (ROOT / "package.xml").read_text()
    for name, key in {"pin": "pinocchio", "xacro": "xacro"}.items():
        del asked[name]
        assert f"<exec_depend>{key}</exec_depend>" in manifest
    ranges = dict(
        re.fullmatch(r"([\w.-]+?)(>=.+)", line).groups()
        for line in requirements("requirements-jazzy.txt")
    )  # type: ignore[union-attr]
    assert ranges.pop("numpy") == asked.pop("numpy") + ",<2"
    lowest = {"numpy": "1.26"} | {name: bound.removeprefix(">=") for name, bound in ranges.items()}
    assert {name.lower(): bound for name, bound in ranges.items()} == {
        n.lower(): b for n, b in asked.items()
    }
    for line in requirements("constraints-oldest.txt"):
        name, version = line.split("==")
        least = lowest.get(name, "0")  # the others need not be old
        assert tuple(map(int, version.split("."))) >= tuple(map(int, least.split("."))), line


def test_the_parameter_file_names_parameters_that_exist() -> None:
    """Every parameter in config/elastic_arm.yaml is declared by its node, and every one declared is
    in the file."""
    text = (ROOT / "config" / "elastic_arm.yaml").read_text()
    sections = re.split(r"^/\*\*/(\w+):$", text, flags=re.MULTILINE)[1:]
    assert len(sections) == 12
    for node, section in zip(sections[::2], sections[1::2], strict=True):
        declared = importlib.import_module(f"elastic_arm.nodes.{node}").PARAMETERS
        listed = set(re.findall(r"^    (?:# )?(\w+): ", section, flags=re.MULTILINE))
        assert listed == set(declared), node


def test_environments_name_what_the_package_asks_for() -> None:
    """pixi.toml has every library of setup.py, and the ROS packages of package.xml, and no file
    names a server."""
    pixi = tomllib.loads((ROOT / "pixi.toml").read_text())
    has = {name.lower() for table in ("dependencies", "pypi-dependencies") for name in pixi[table]}
    called = {
        "matplotlib": "matplotlib-base",
        "pin": "pinocchio",
        "lz4": "python-lz4",
        "xacro": "ros-jazzy-xacro",
    }
    names = names_in("requirements.txt") | names_in("requirements-extras.txt")
    assert {called.get(name, name) for name in names} <= has
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    keys = {str(element.text) for element in manifest.iter("exec_depend")}
    ros = {
        f"ros-jazzy-{key.replace('_', '-')}"
        for key in keys
        if not key.startswith(("python3-", "elastic_arm"))
    }
    assert ros - {"ros-jazzy-pinocchio"} <= has
    for name in (
        "pixi.toml",
        "Dockerfile",
        "setup.py",
        "pyproject.toml",
        *PINNED,
        "requirements-jazzy.txt",
    ):
        assert "://" not in (ROOT / name).read_text(), name


WITHOUT = {
    "rclpy=None": "needs ROS 2, which",
    "control_msgs=None, elastic_arm_msgs=None": "control_msgs, elastic_arm_msgs:",
}


@pytest.mark.parametrize("missing", WITHOUT)
def test_a_node_without_ros_is_one_line(missing: str) -> None:
    """`simulator` where ROS 2, or packages of it, are not installed names all that is missing, and
    what to do."""
    pytest.importorskip("rclpy")
    script = (
        "import sys",
        f"sys.modules.update({missing})",
        "from elastic_arm.nodes.entry import simulator",
        "simulator()",
    )
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(script)], cwd=ROOT, capture_output=True, text=True
    )
    (line,) = done.stderr.strip().splitlines()
    assert (done.returncode, line.split(":")[0]) == (2, "error")
    assert WITHOUT[missing] in line and "make setup" in line


def test_the_shell_of_a_project_that_is_not_set_up_says_so(tmp_path: Path) -> None:
    """`. tools/env.sh` before `make setup` names the command, fails, and leaves the shell as it
    was; with an environment it is silent."""
    (tmp_path / "tools").mkdir()
    shutil.copy(ROOT / "tools" / "env.sh", tmp_path / "tools")
    script = f"set -u; . {tmp_path}/tools/env.sh; echo $?; echo ${{VIRTUAL_ENV:-none}}"
    plain = {"PATH": os.environ["PATH"]}

    def said() -> subprocess.CompletedProcess[str]:
        return subprocess.run(["bash", "-c", script], env=plain, capture_output=True, text=True)

    first = said()
    assert "run `make setup`" in first.stderr and first.stdout.split() == ["1", "none"]
    python = tmp_path / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text("#!/bin/sh\n")
    python.chmod(0o755)
    second = said()
    assert not second.stderr and second.stdout.split() == ["0", str(tmp_path / ".venv")]
