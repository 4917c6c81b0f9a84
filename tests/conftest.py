"""What all tests share: which of them stay together when they are distributed over processes, and
in which order."""

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from xdist.scheduler import LoadScopeScheduling

if TYPE_CHECKING:
    from elastic_arm.diagnosis import Diagnosis
    from tests.helpers.shared_diagnoses import Commanded

# Nodes keep real time, and many graphs at once would starve: the tests of the nodes are two groups,
# of about the same length, so that two graphs run at most.
GRAPHS = ("tests/nodes/test_graph.py", "tests/nodes/")
# Seconds of a test that is marked slow without a number.
SLOW = 3.0
# Modules that share diagnoses, which are made once in a process, or parsed sources.
SHARING = (
    (
        "tests/report/test_diagnosis.py",
        "tests/diagnosis/test_prediction.py",
        "tests/diagnosis/test_next_motion.py",
        "tests/diagnosis/test_two_effects.py",
    ),
    ("tests/test_architecture.py", "tests/test_docstrings.py"),
)
# Modules whose tests share no fixture of the module, so that each may run in any process.
APART = ("tests/diagnosis/test_recordings.py",)


class GroupScheduling(LoadScopeScheduling):
    """Hands out groups of tests as a whole, in the order of the collection."""

    def _split_scope(self, nodeid: str) -> str:
        return group_of(nodeid)


def group_of(nodeid: str) -> str:
    """Return the group of a test: the tests of a group run one after another in one process."""
    for graph in GRAPHS:
        if nodeid.startswith(graph):
            return graph
    for modules in SHARING:
        if nodeid.startswith(modules):
            return modules[0]
    return nodeid if nodeid.startswith(APART) else nodeid.split("::")[0]


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> GroupScheduling:
    """Keep the groups together whenever pytest-xdist distributes."""
    return GroupScheduling(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the graphs, and then with what takes longest."""
    seconds: dict[str, float] = {}
    for item in items:
        group = group_of(item.nodeid)
        seconds[group] = max(seconds.get(group, 0.0), _seconds(item))

    def order(item: pytest.Item) -> tuple[bool, float]:
        group = group_of(item.nodeid)
        return group not in GRAPHS, -seconds[group]

    items.sort(key=order)


def _seconds(item: pytest.Item) -> float:
    """Processor time as the marker `slow(seconds)` states it, of the test or of its module as a
    whole."""
    marker = item.get_closest_marker("slow")
    return float(marker.args[0] if marker.args else SLOW) if marker else 0.0


# Imported when first used: most processes need none of it, and all of them collect.
@pytest.fixture(scope="session")
def two_causes() -> "Diagnosis":
    """A diagnosis that finds friction of joint 2 and a transmission error of joint 1."""
    from tests.helpers.shared_diagnoses import with_two_causes

    return with_two_causes()


@pytest.fixture(scope="session")
def clean_diagnosis() -> "Diagnosis":
    """A diagnosis of an arm as it is described."""
    from tests.helpers.shared_diagnoses import without_cause

    return without_cause()


@pytest.fixture(scope="session")
def commanded(tmp_path_factory: pytest.TempPathFactory) -> "Commanded":
    """A command's diagnosis that cannot tell play from an offset, with the motion that would."""
    from tests.helpers.shared_diagnoses import with_play

    return with_play(tmp_path_factory.mktemp("commanded"))


@pytest.fixture
def compiled_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Models of the tests' own compiled in this process.

    A process for each, which loads MuJoCo first, is for files of others: see
    tests/robot/test_mjcf.py.
    """
    mujoco = pytest.importorskip("mujoco")
    from elastic_arm.robot.mjcf import compiling_process

    engine = importlib.import_module("elastic_arm.robot.mjcf.engine")  # a function has its name
    apart = engine._processed

    def processed(path: Path, what: str) -> tuple[list[str], bytes]:
        try:
            return compiling_process.compiled(path, what)
        except (compiling_process.Refused, ValueError, mujoco.FatalError):
            return apart(path, what)  # which gives the error of a user

    monkeypatch.setattr(engine, "_processed", processed)
