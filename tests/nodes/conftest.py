"""What the tests of nodes share."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.helpers.ros_graph import Graph, ros_graph


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[Graph]:
    """A graph of the test's own."""
    with ros_graph(tmp_path) as made:
        yield made
