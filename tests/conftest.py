"""What all tests share: how they are grouped over the processes of a parallel run."""

from __future__ import annotations

import pytest

# Tests of one group run one after another in one process. Nodes keep real time: two graphs at once would starve.
GRAPH_GROUP = "graph"


# Before pytest-xdist reads the groups.
@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep the tests of a module in one process, and begin with the graph and then with what takes longest.

    Tests marked `apart` share nothing with their module, and may run in any process.
    """
    for item in items:
        item.add_marker(pytest.mark.xdist_group(_group_of(item)))
    seconds: dict[str, float] = {}
    for item in items:
        group = _group_of(item)
        seconds[group] = max(seconds.get(group, 0.0), _seconds(item))
    items.sort(key=lambda item: (_group_of(item) != GRAPH_GROUP, -seconds[_group_of(item)]))


def _group_of(item: pytest.Item) -> str:
    if item.get_closest_marker("graph"):
        return GRAPH_GROUP
    return item.nodeid if item.get_closest_marker("apart") else item.nodeid.split("::")[0]


def _seconds(item: pytest.Item) -> float:
    """Processor time as the marker `slow(seconds)` states it, of the test or of its module as a whole."""
    marker = item.get_closest_marker("slow")
    return float(marker.args[0]) if marker else 0.0
