"""A proposed motion, and the pairs of effects between which it is expected to discriminate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from elastic_arm.excitation import FourierTrajectory


@dataclass(frozen=True)
class PairSeparation:
    """Two effects of which one is there, and how far a recording discriminates between them.

    Parameters
    ----------
    cause, alternative
        Effect and joint of the two.
    here, expected
        Log-likelihood by which this recording decides, and by which the proposed motion is expected to, nats.
    decides
        Whether the proposed motion is expected to decide.
    """

    cause: tuple[str, str | None]
    alternative: tuple[str, str | None]
    here: float
    expected: float = 0.0
    decides: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {
            **{
                name: {"effect": effect, "joint": joint}
                for name, (effect, joint) in (("cause", self.cause), ("alternative", self.alternative))
            },
            "log_likelihood": {"this_recording": float(f"{self.here:.4g}"), "proposed": float(f"{self.expected:.4g}")},
            "decides": self.decides,
        }


@dataclass(frozen=True)
class Proposal:
    """A motion that is expected to discriminate between effects.

    Parameters
    ----------
    trajectory
        None where no motion within the limits was found.
    pairs
        Between which it discriminates, and how well.
    candidates
        How many motions were judged.
    notes
        What had to be assumed, or why there is no motion.
    """

    trajectory: FourierTrajectory | None
    pairs: tuple[PairSeparation, ...]
    candidates: int
    notes: tuple[str, ...] = ()

    @property
    def seconds(self) -> float:
        """Length of the motion, s."""
        return 0.0 if self.trajectory is None else self.trajectory.duration

    @property
    def decided(self) -> set[tuple[tuple[str, str | None], tuple[str, str | None]]]:
        """Cause and alternative of each pair on which the motion is expected to decide."""
        return set() if self.trajectory is None else {(p.cause, p.alternative) for p in self.pairs if p.decides}

    @property
    def worthwhile(self) -> bool:
        """Whether there is a motion, and it is expected to decide anything."""
        return self.trajectory is not None and any(pair.decides for pair in self.pairs)

    def to_dict(self, file: str) -> dict[str, Any]:
        """Return it as plain data; `file` is where the trajectory is written."""
        return {
            "file": file if self.worthwhile else None,
            "duration_s": self.seconds or None,
            "candidates": self.candidates,
            "pairs": [pair.to_dict() for pair in self.pairs],
            "notes": list(self.notes),
        }
