"""Another publisher of a topic that can have only one, as discovery brings it: without its name at
first."""

from types import SimpleNamespace
from typing import Any

import pytest

from elastic_arm.errors import GraphError
from elastic_arm.nodes.support import graph
from elastic_arm.recording import topics

NAMELESS = ("_NODE_NAME_UNKNOWN_", "_NODE_NAMESPACE_UNKNOWN_")
OTHER = ("simulator", "/left")


class Discovery:
    """What a node sees of the publishers of a topic, one look after the other; the last one
    stays."""

    publishers: tuple[Any, ...] = ()

    def __init__(self, *looks: list[tuple[str, str]]) -> None:
        self.looks = list(looks)

    def resolve_topic_name(self, topic: str) -> str:
        return f"/left/{topic}"

    def get_fully_qualified_name(self) -> str:
        return "/left/newcomer"

    def get_publishers_info_by_topic(self, topic: str) -> list[Any]:
        look = self.looks.pop(0) if len(self.looks) > 1 else self.looks[0]
        return [
            SimpleNamespace(node_name=name, node_namespace=namespace) for name, namespace in look
        ]


def refusal(node: Discovery) -> str:
    """Return the error by which a node gives up."""
    with pytest.raises(GraphError) as caught:
        graph.require_single_publisher(node, [topics.MOTOR_STATES], 0.1)  # type: ignore[arg-type]
    return str(caught.value)


def test_the_error_waits_for_the_name_of_the_other_node() -> None:
    """A publisher discovered before the name of its node is reported by that name."""
    nameless: list[list[tuple[str, str]]] = [[], *[[NAMELESS]] * 20]
    assert "/left/simulator already publishes /left/motor_states" in refusal(
        Discovery(*nameless, [OTHER])
    )
    assert "/left/simulator already publishes" in refusal(Discovery([NAMELESS, OTHER]))


def test_a_node_without_a_name_is_refused_in_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the name never comes, the topic has another source all the same."""
    monkeypatch.setattr(graph, "NAMING", 0.2)
    assert "another node already publishes /left/motor_states" in refusal(Discovery([NAMELESS]))


def test_a_publisher_that_goes_before_its_name_has_come_is_none() -> None:
    """An endpoint of a process that has ended disappears without a name, and the newcomer stays."""
    graph.require_single_publisher(
        Discovery([NAMELESS], [NAMELESS], []), [topics.MOTOR_STATES], 0.1
    )  # type: ignore[arg-type]


def test_another_name_than_the_own_is_found_among_both() -> None:
    """A newcomer of another name stands beside the node's own publisher."""
    node = Discovery([OTHER, ("newcomer", "/left")])
    node.publishers = (SimpleNamespace(topic_name="/left/motor_states"),)
    assert graph.other_publishers(node, topics.MOTOR_STATES) == ["/left/simulator"]  # type: ignore[arg-type]
