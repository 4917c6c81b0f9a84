"""The diagnosis of a moving arm, over its most recent samples.

The node that publishes `/gap` fills a :class:`Window` and passes its recordings to the function of
:func:`answering`, which runs in a separate process. The node itself contains no physics.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm, t

from elastic_arm.arrays import Array
from elastic_arm.diagnosis.answer import diagnose
from elastic_arm.diagnosis.question import Question
from elastic_arm.diagnosis.words import effect_at, size_text
from elastic_arm.effects import Catalogue
from elastic_arm.effects.text import known_effects
from elastic_arm.errors import DiagnosisError
from elastic_arm.evidence.priors import CHANGED
from elastic_arm.recording import Recording, Samples, Side
from elastic_arm.recording.sides import SAMPLED
from elastic_arm.robot import load_robot

# Largest number of samples, whatever their stamps; bounds the memory.
CAPACITY = 200_000


class Window:
    """The most recent samples, in bounded memory.

    length: s; two thirds of it are fitted, and the last third is for validation; currents: torque
    channels that are currents times a torque constant.
    """

    def __init__(
        self,
        joints: Sequence[str],
        length: float = 15.0,
        source: str = "live",
        currents: Sequence[str] = (),
    ) -> None:
        self.joints = tuple(joints)
        self.length = length
        self.source = source
        self.currents = tuple(currents)
        self._batches: deque[Samples] = deque()

    def add(self, samples: Samples) -> None:
        """Add samples; earlier ones are discarded if the clock was set back or the channels
        changed."""
        if not len(samples):
            return
        if self._batches and (
            samples.stamp_ns[0] <= self._batches[-1].stamp_ns[-1]
            or samples.recorded().keys() != self._batches[0].recorded().keys()
        ):
            self.clear()
        self._batches.append(samples)
        oldest = samples.stamp_ns[-1] - round(self.length * 1e9)
        while self._batches[0].stamp_ns[-1] <= oldest or sum(map(len, self._batches)) > CAPACITY:
            self._batches.popleft()

    def clear(self) -> None:
        """Discard all samples."""
        self._batches.clear()

    @property
    def seconds(self) -> float:
        """Time from the first to the last sample, s."""
        if not self._batches:
            return 0.0
        return float(self._batches[-1].stamp_ns[-1] - self._batches[0].stamp_ns[0]) * 1e-9

    @property
    def full(self) -> bool:
        """Whether the window has its whole length."""
        return self.seconds > 0.95 * self.length

    def recording(self) -> Recording:
        """Return all samples as a recording.

        Raises a DiagnosisError if there are none.
        """
        if not self._batches:
            raise DiagnosisError(
                "no samples yet",
                "Start the arm, or check that it publishes /joint_states and /motor_states",
            )
        stamps = np.concatenate([batch.stamp_ns for batch in self._batches])
        channels: dict[str, dict[str, Array]] = {}
        for name in self._batches[0].recorded():
            side, channel = SAMPLED[name]
            channels.setdefault(side, {})[channel] = np.concatenate(
                [getattr(batch, name) for batch in self._batches]
            )
        sides: dict[str, Any] = {side: Side(stamps, **own) for side, own in channels.items()}
        return Recording(self.joints, **sides, source=self.source, currents=self.currents)


@dataclass
class Level:
    """The mean and scatter of a size over the diagnoses so far (Welford)."""

    count: int = 0
    mean: float = 0.0
    squares: float = 0.0

    @property
    def std(self) -> float:
        """Standard deviation of a value."""
        return float(np.sqrt(self.squares / max(self.count - 1, 1)))

    def takes(self, value: float, std: float) -> bool:
        """Add a value, or return False if it probably is another size, up to twice as large."""
        if self.count:
            # Values scatter like the earlier ones, or by this one's deviation if there are few:
            # Student's t with a prior variance std² that counts as two values.
            a = 0.5 * (self.count + 1)
            b = std**2 + 0.5 * self.squares
            same = t.logpdf(value, 2 * a, self.mean, np.sqrt(b / a * (1 + 1 / self.count)))
            other = norm.logpdf(value, self.mean, abs(self.mean) + std)
            if np.log(CHANGED) + other > same:
                return False
        self.count += 1
        off = value - self.mean
        self.mean += off / self.count
        self.squares += off * (value - self.mean)
        return True


class Sizes:
    """The sizes of causes and known effects over successive diagnoses, in constant memory."""

    def __init__(self) -> None:
        self._levels: dict[tuple[str, str | None, str], Level] = {}

    def changes(self, found: Mapping[str, Any]) -> list[str]:
        """Add the content of `diagnosis.json`; return in words which sizes have changed."""
        said = []
        for one in (*found["causes"], *found["known"]):
            for name, size in one["parameters"].items():
                value = size["value"]
                std = size["std"]
                if not isinstance(value, float) or not isinstance(std, float) or std <= 0.0:
                    continue
                level = self._levels.setdefault((one["effect"], one["joint"], name), Level())
                if not level.takes(value, std):
                    before = size_text(level.mean, level.std, size["unit"])
                    now = size_text(value, std, size["unit"])
                    said.append(
                        f"{name} of {effect_at(one['effect'], one['joint'])} changed from {before}"
                        f" to {now}"
                    )
        return said


def answering(
    robot: str | None,
    model: str,
    known: Sequence[str],
    refit: bool,
    effects_files: Sequence[str] = (),
) -> Callable[[Recording], dict[str, Any]]:
    """Return a function that diagnoses recordings in a separate process and returns the content of
    `diagnosis.json`.

    robot: file of the arm; that of the package if None; known: effects as text.

    Raises a RobotError or an EffectError if there is no such arm or effect.
    """
    arm = load_robot(robot)
    catalogue = Catalogue.default().with_files(effects_files)
    given = known_effects(known, arm, catalogue)
    question = Question(arm, model, refit=refit, given=given, catalogue=catalogue)
    return lambda recording: diagnose([recording], question).to_dict()
