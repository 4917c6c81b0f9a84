"""Progress reports of a search, and the ways to end it early."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any, Protocol


class Stage(Enum):
    """The stages of a diagnosis, in their order."""

    CHECKED = auto()
    ORDINARY = auto()
    CAUSES = auto()
    CONFIRMED = auto()
    FOLLOWED = auto()
    CLOSED_LOOP = auto()


class Say(Protocol):
    """A function that reports progress."""

    def __call__(self, words: str, stage: Stage, done: float = 0.0) -> None:
        """Report in words what is done now.

        done: rough estimate of the completed share of the stage.
        """


def _nothing(words: str, stage: Stage, done: float = 0.0) -> None:
    """Report nothing."""


def _never() -> bool:
    """Return that the search may go on."""
    return False


@dataclass(frozen=True)
class Watch:
    """The observer of a search.

    say: reports progress; is_over: whether the search must end now, with the best answer so far;
    show: takes the first look at the recordings, a
    :class:`elastic_arm.diagnosis.first_look.FirstLook`; None if nobody wants it.
    """

    say: Say = _nothing
    is_over: Callable[[], bool] = _never
    show: Callable[[Any], None] | None = None
