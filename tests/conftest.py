"""What all tests share: how they are grouped over the processes of a parallel run."""

from __future__ import annotations

import pytest

# Tests of one group run one after another in one process. Nodes keep real time: two graphs at once would starve.
GRAPH_GROUP = "graph"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep the tests of a module in one process, and begin with what takes long.

    A test with an `xdist_group` of its own stays in that group.
    """
    for item in items:
        if item.get_closest_marker("xdist_group") is None:
            group = GRAPH_GROUP if item.get_closest_marker("graph") else item.nodeid.split("::")[0]
            item.add_marker(pytest.mark.xdist_group(group))
    long = {_group(item) for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: (_group(item) != GRAPH_GROUP, _group(item) not in long))


def _group(item: pytest.Item) -> str:
    marker = item.get_closest_marker("xdist_group")
    assert marker is not None
    return str(marker.args[0])
