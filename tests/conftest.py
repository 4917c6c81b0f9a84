"""What all tests share: which of them stay together when they are distributed over processes, and
in which order."""

from typing import Any

import pytest
from xdist.scheduler import LoadScopeScheduling

# Nodes keep real time: two graphs at once would starve, so all tests of the nodes run one after
# another.
GRAPH = "tests/nodes/"
# Seconds of a test that is marked slow without a number.
SLOW = 3.0
# Modules whose tests share no fixture of the module, so that each may run in any process.
APART = ("tests/diagnosis/test_recordings.py",)


class GroupScheduling(LoadScopeScheduling):
    """Hands out groups of tests as a whole, in the order of the collection."""

    def _split_scope(self, nodeid: str) -> str:
        return group_of(nodeid)


def group_of(nodeid: str) -> str:
    """Return the group of a test: the tests of a group run one after another in one process."""
    if nodeid.startswith(GRAPH):
        return GRAPH
    return nodeid if nodeid.startswith(APART) else nodeid.split("::")[0]


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> GroupScheduling:
    """Keep the groups together whenever pytest-xdist distributes."""
    return GroupScheduling(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the graph, and then with what takes longest."""
    seconds: dict[str, float] = {}
    for item in items:
        group = group_of(item.nodeid)
        seconds[group] = max(seconds.get(group, 0.0), _seconds(item))
    items.sort(key=lambda item: (group_of(item.nodeid) != GRAPH, -seconds[group_of(item.nodeid)]))


def _seconds(item: pytest.Item) -> float:
    """Processor time as the marker `slow(seconds)` states it, of the test or of its module as a
    whole."""
    marker = item.get_closest_marker("slow")
    return float(marker.args[0] if marker.args else SLOW) if marker else 0.0
