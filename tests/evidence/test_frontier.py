"""The best-first search over sets, on made-up problems whose best set is known."""

from collections.abc import Hashable, Iterable
from dataclasses import dataclass

import pytest

from elastic_arm.evidence.frontier import Frontier, Node


@dataclass(frozen=True)
class MadeSet:
    """A set of letters with a score."""

    keys: frozenset[str]
    score: float


def made(letters: str, score: float) -> MadeSet:
    """Return a set of some letters."""
    return MadeSet(frozenset(letters), score)


class Problem:
    """Sets with scores at their own linearisations, and the paths that a search finds from each."""

    def __init__(self, own: dict[str, float], paths: dict[tuple[str, int], list[str]]) -> None:
        self.own = {frozenset(letters): score for letters, score in own.items()}
        self.paths = {(frozenset(start), depth): path for (start, depth), path in paths.items()}
        self.linearised: list[str] = []
        self.expanded: list[tuple[str, int]] = []

    def linearise(self, fit: MadeSet, near: Node) -> Node:
        self.linearised.append("".join(sorted(fit.keys)))
        return Node(MadeSet(fit.keys, self.own[fit.keys]), None)

    def expand(self, node: Node, scores: dict[Hashable, float]) -> list[MadeSet]:
        self.expanded.append(("".join(sorted(node.fit.keys)), node.depth))
        path = self.paths.get((node.fit.keys, node.depth), [])
        return [node.fit, *(made(letters, 100.0) for letters in path)]

    def frontier(self) -> Frontier:
        start = Node(made("", self.own[frozenset()]), None)
        return Frontier(start, self.linearise, self.expand, depths=2)


def letters(keys: Iterable[str]) -> str:
    """Return the letters of a set in order."""
    return "".join(sorted(keys))


def test_a_path_to_a_better_set_is_followed() -> None:
    problem = Problem({"": 0.0, "a": 5.0, "ab": 9.0}, {("", 0): ["a", "ab"]})
    assert letters(problem.frontier().run().fit.keys) == "ab"
    assert problem.linearised == ["ab"]


def test_a_step_that_was_too_long_is_halved() -> None:
    """The end of the path is worse at its own linearisation; the set half way is better, and the
    search goes on."""
    own = {"": 0.0, "a": 5.0, "ab": 6.0, "abc": 7.0, "abcd": -50.0, "az": 20.0}
    problem = Problem(own, {("", 0): ["a", "ab", "abc", "abcd"], ("ab", 0): ["az"]})
    assert letters(problem.frontier().run().fit.keys) == "az"
    assert problem.linearised == ["abcd", "ab", "az"]


def test_a_set_is_linearised_about_itself_once() -> None:
    """What was found worse there is not tried again, however well it looks from elsewhere."""
    own = {"": 0.0, "a": 5.0, "b": -20.0}
    problem = Problem(own, {("", 0): ["a"], ("a", 0): ["b"], ("a", 1): ["b"]})
    frontier = problem.frontier()
    assert letters(frontier.run().fit.keys) == "a"
    assert problem.linearised.count("b") == 1
    assert frontier.scores[frozenset("b")] == -20.0


def test_a_set_that_settled_badly_is_tried_again_from_the_best_one() -> None:
    """From another linearisation it has another score; one that is no better there changes
    nothing."""
    own = {"": 0.0, "a": -3.0, "ab": 5.0}
    problem = Problem(own, {("", 0): ["a"], ("", 1): ["ab"]})
    frontier = problem.frontier()
    assert letters(frontier.run().fit.keys) == "ab"
    assert not frontier.retry([made("a", 7.0)])
    problem.own[frozenset("a")] = 9.0
    assert frontier.retry([made("a", 7.0)])
    assert letters(frontier.run().fit.keys) == "a"


def test_expensive_moves_come_where_cheap_ones_lead_nowhere() -> None:
    problem = Problem({"": 0.0, "a": 5.0, "ab": 8.0}, {("", 0): ["a"], ("a", 1): ["ab"]})
    assert letters(problem.frontier().run().fit.keys) == "ab"
    assert problem.expanded == [("", 0), ("a", 0), ("a", 1), ("ab", 0), ("ab", 1)]


def test_a_gain_of_less_than_a_nat_is_no_better_set() -> None:
    problem = Problem({"": 0.0, "a": 0.5}, {("", 0): ["a"]})
    assert letters(problem.frontier().run().fit.keys) == ""


@pytest.mark.parametrize("steps", [0, 1, 2])
def test_a_search_that_is_ended_gives_the_best_set_so_far(steps: int) -> None:
    own = {"": 0.0, "a": 5.0, "ab": 9.0, "abc": 12.0}
    problem = Problem(own, {("", 0): ["a"], ("a", 0): ["ab"], ("ab", 0): ["abc"]})
    frontier = problem.frontier()
    frontier.is_over = lambda: len(problem.linearised) >= steps
    assert letters(frontier.run().fit.keys) == "abc"[:steps]


def test_a_runner_up_within_a_few_nats_is_expanded() -> None:
    """Its next move overtakes the best set; one that is far behind is not looked at."""
    own = {"": 0.0, "a": 50.0, "b": 45.0, "bc": 60.0, "d": 20.0}
    paths = {("", 0): ["a"], ("b", 0): ["bc"], ("d", 0): ["a"]}
    problem = Problem(own, paths)
    frontier = problem.frontier()
    frontier.follow([made("", 0.0), made("a", 100.0)])
    frontier.take(made("b", 100.0))
    frontier.take(made("d", 100.0))
    assert letters(frontier.run().fit.keys) == "bc"
    assert ("d", 0) not in problem.expanded


@dataclass
class MadeLinearisation:
    """A linearisation that knows whether it was made anew."""

    is_new: bool = False

    def anew(self) -> "MadeLinearisation":
        """Return it as made anew."""
        return MadeLinearisation(is_new=True)


@dataclass(frozen=True)
class SetWithData(MadeSet):
    """A set that knows whether it holds data."""

    has_data: bool = True

    def without_data(self) -> "SetWithData":
        """Return it without them."""
        return SetWithData(self.keys, self.score, has_data=False)


def test_only_the_best_set_keeps_its_data() -> None:
    """Sets behind the best one let go of their data, the one that was the best as well; what shares
    the linearisation of the best one keeps it."""
    own, shared = {"a": 5.0, "b": 3.0, "c": 4.0}, MadeLinearisation()

    def linearise(fit: MadeSet, near: Node) -> Node:
        linear = shared if fit.keys <= {"a", "c"} else MadeLinearisation()
        return Node(SetWithData(fit.keys, own[letters(fit.keys)]), linear)

    start = Node(SetWithData(frozenset(), 0.0), MadeLinearisation(), found="a search")
    frontier = Frontier(start, linearise, lambda node, scores: [node.fit], depths=1)
    for one in "bac":
        frontier.take(made(one, 0.0))
    assert letters(frontier.best.fit.keys) == "a"
    assert not start.fit.has_data
    assert start.linear.is_new
    assert start.found is None
    kept = {letters(node.fit.keys): node.fit.has_data for node in frontier.runners_up}
    assert kept == {"c": True, "b": False}
    assert frontier.best.fit.has_data
