"""The diagnosis while the arm moves: the same one, over the samples of the last while.

The node that publishes `/gap` feeds samples and asks now and then; there is no physics in it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from elastic_arm.gap.diagnosis import Question, diagnose
from elastic_arm.gap.result import Diagnosis
from elastic_arm.recording import Recording, Side

Array = NDArray[np.float64]


class LiveDiagnosis:
    """Keeps the last `window` seconds of both sides in constant memory and diagnoses them when asked.

    Parameters
    ----------
    question
        What is asked.
    window
        s; two thirds are fitted, the last third judges.
    rate
        Samples per second at most.
    """

    def __init__(self, question: Question, window: float = 15.0, rate: float = 1000.0) -> None:
        self.question, self.window = question, window
        room = int(window * rate)
        self._sides: dict[str, deque[tuple[int, Array]]] = {s: deque(maxlen=room) for s in ("link", "motor")}

    def add(self, side: str, stamp_ns: int, channels: Mapping[str, Array]) -> None:
        """Take one sample of the "link" or "motor" side.

        Parameters
        ----------
        stamp_ns
            Of the message; samples that are late or repeated are left out.
        channels
            "position", "velocity", "effort" (n,) in robot-description order; what is missing stays missing.
        """
        kept = self._sides[side]
        if kept and stamp_ns <= kept[-1][0]:
            return
        n = self.question.robot.n
        none = np.full(n, np.nan)
        row = np.concatenate([np.asarray(channels.get(c, none)) for c in ("position", "velocity", "effort")])
        kept.append((stamp_ns, row))

    @property
    def seconds(self) -> float:
        """How much both sides (or the one that is there) hold."""
        spans = [(kept[-1][0] - kept[0][0]) * 1e-9 for kept in self._sides.values() if len(kept) > 1]
        return min(spans, default=0.0)

    @property
    def ready(self) -> bool:
        """Whether the window is full enough to diagnose."""
        return self.seconds > 0.9 * self.window

    def diagnose(self) -> Diagnosis:
        """Diagnose what is kept.

        Raises
        ------
        ElasticArmError
            If nothing can be said of it yet.
        """
        return diagnose([self.recording()], self.question)

    def recording(self) -> Recording:
        """Return what is kept as a recording."""
        sides = {name: _side(list(kept), self.question.robot.n) for name, kept in self._sides.items() if len(kept)}
        return Recording(self.question.robot.joint_names, sides.get("link"), sides.get("motor"), source="live")


def _side(rows: list[tuple[int, Array]], n: int) -> Side:
    values = np.array([row for _, row in rows])
    parts = {"position": values[:, :n], "velocity": values[:, n : 2 * n], "effort": values[:, 2 * n :]}
    whole = {name: part for name, part in parts.items() if np.isfinite(part).all()}
    return Side(np.array([stamp for stamp, _ in rows], dtype=np.int64), **whole)
