"""What is seen of a search while it lasts, and what ends it early."""

from collections.abc import Callable
from dataclasses import dataclass


def _nothing(_: str) -> None:
    """Say nothing."""


def _never() -> bool:
    """Return that a search is not to end early."""
    return False


@dataclass(frozen=True)
class Watch:
    """Who watches a search.

    say: takes a line at each stage; is_over: whether the search is to end with the best answer that
    it has.
    """

    say: Callable[[str], None] = _nothing
    is_over: Callable[[], bool] = _never
