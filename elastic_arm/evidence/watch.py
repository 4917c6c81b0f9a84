"""What is seen of a search while it lasts, and what ends it early."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any


class Stage(Enum):
    """The stages of a diagnosis, in their order."""

    CHECKED = auto()
    ORDINARY = auto()
    CAUSES = auto()
    CONFIRMED = auto()
    FOLLOWED = auto()
    CLOSED_LOOP = auto()


def _nothing(words: str, stage: Stage, done: float = 0.0) -> None:
    """Say nothing."""


def _never() -> bool:
    """Return that a search is not to end early."""
    return False


@dataclass(frozen=True)
class Watch:
    """Who watches a search.

    say: takes words, the stage, and which share of the stage is done, a rough estimate; is_over:
    whether the search is to end with the best answer that it has; show: takes the first look at
    the recordings, a :class:`elastic_arm.diagnosis.first_look.FirstLook`, None where nobody looks.
    """

    say: Callable[..., None] = _nothing
    is_over: Callable[[], bool] = _never
    show: Callable[[Any], None] | None = None
