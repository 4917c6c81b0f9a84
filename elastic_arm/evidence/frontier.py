"""Best-first search over sets of terms; each set is scored at its own linearisation.

    s(S) = ln p(y, S) with the residuals linearised about the posterior of S itself

A search at the linearisation of one set also scores other sets, but these scores are only as good
as that linearisation. Therefore:

1. The best known set is expanded: a search at its own linearisation gives a path of better and
   better sets.
2. The last set of the path is linearised about itself. If it is still better, it becomes the best
   known set.
3. If it is not, the step was too long, and the set half way along the path is tried.
4. A set from which no path leads to a better one is expanded by more expensive moves.
5. If no moves are left, each runner-up within a few nats is expanded once, because its next move
   may overtake the best set. The search ends when no such set is left.

A set that was linearised about itself keeps that score in all later searches.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from elastic_arm.evidence.priors import OPEN, RUNNERS_UP, WORTH
from elastic_arm.evidence.watch import Watch


class Scored(Protocol):
    """A set of terms with a score."""

    @property
    def keys(self) -> Hashable:
        """Return the content of the set."""

    @property
    def score(self) -> float:
        """Return the logarithm of its probability, nats."""


@dataclass
class Node:
    """A set at its own linearisation."""

    fit: Any  # the set with its score there
    linear: Any  # the linearisation
    depth: int = 0  # index of the next stage of moves
    found: Any = None  # path of the last search from the set
    is_expanded: bool = False  # whether it was expanded

    def let_go(self) -> None:
        """Discard the data of the linearisation, which can be recomputed."""
        self.linear = self.linear.anew()
        self.fit = self.fit.without_data()
        self.found = None


Path = Sequence[Scored]


@dataclass
class Frontier:
    """The sets that were linearised about themselves, and the best of them.

    linearise: returns a set at its own linearisation, starting from that of a node; expand: returns
    a path that begins with the node's own set; depths: number of stages of moves, the most
    expensive last; is_over: whether the search must end with the best set so far.
    """

    best: Node
    linearise: Callable[[Any, Node], Node]
    expand: Callable[[Node, dict[Hashable, float]], Path]
    depths: int
    is_over: Callable[[], bool] = Watch().is_over
    scores: dict[Hashable, float] = field(default_factory=dict)
    # The most probable sets after the best one; few, because each costs a search.
    runners_up: list[Node] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.scores[self.best.fit.keys] = self.best.fit.score

    def run(self) -> Node:
        """Return the best set after all its moves were tried."""
        while not self.is_over():
            node = self._next()
            if node is None:
                break
            # A path refers to the data of its linearisation, so it must not outlive its use.
            is_better = self.follow(self.expand(node, self.scores), node)
            node.is_expanded = True
            if not is_better:
                node.depth += 1
            self._let_go(node)
        return self.best

    def _next(self) -> Node | None:
        """Return the next set to expand: the best one while it has moves, then runners-up."""
        if self.best.depth < self.depths:
            return self.best
        least = self.best.fit.score - OPEN
        for node in self.runners_up:
            if node.fit.score > least and not node.is_expanded:
                return node
        return None

    def _let_go(self, node: Node) -> None:
        """Discard the data of a set other than the best one, to save memory."""
        if node.linear is not self.best.linear:
            node.let_go()

    def follow(self, path: Path, start: Node | None = None) -> bool:
        """Follow a path; return whether one of its sets became the best at its own linearisation.

        start: the node at which the path begins; None for the best one.
        """
        before = self.best
        start = start or before
        last = len(path) - 1
        while last > 0 and not self.is_over():
            fit = path[last]
            # The numbers of the start itself may have changed.
            if fit.keys not in self.scores or fit.keys == start.fit.keys:
                self.take(fit, start)
            if self.best is not before:
                return True
            last //= 2
        return False

    def retry(self, fits: Sequence[Scored]) -> bool:
        """Linearise sets about themselves again, from the best set; return whether one is better.

        From the linearisation of another set, a set may have settled at other numbers.
        """
        before = self.best
        for fit in fits:
            if self.is_over():
                break
            self.take(fit, before)
            if self.best is not before:
                return True
        return False

    def take(self, fit: Scored, near: Node | None = None) -> None:
        """Linearise a set about itself, and make it the best one if it is better there.

        near: the node at whose linearisation it was scored; None for the best one.
        """
        node = self.linearise(fit, near or self.best)
        known = self.scores.get(node.fit.keys, node.fit.score)
        self.scores[node.fit.keys] = max(known, node.fit.score)
        other = node
        if node.fit.score > self.best.fit.score + WORTH:
            other = self.best
            self.best = node
        self._let_go(other)
        ranked = sorted([*self.runners_up, other], key=lambda one: -one.fit.score)
        self.runners_up = ranked[:RUNNERS_UP]
