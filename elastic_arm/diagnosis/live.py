"""The diagnosis while the arm moves: where at short intervals, which now and then, over the samples of the last while.

The node that publishes `/gap` feeds a :class:`Window` and hands its recordings to a :class:`LiveDiagnosis`, which runs
in a process of its own; there is no physics in the node.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm, t

from elastic_arm.arrays import Array
from elastic_arm.diagnosis.answer import diagnose
from elastic_arm.diagnosis.common_equations import common_band
from elastic_arm.diagnosis.preprocessing import usable
from elastic_arm.diagnosis.question import Question
from elastic_arm.diagnosis.result import Diagnosis, ResidualSizes
from elastic_arm.diagnosis.words import effect_at, size_text
from elastic_arm.dynamics import build_model
from elastic_arm.effects import Catalogue
from elastic_arm.effects.text import known_effects
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.band import LowPass
from elastic_arm.estimation.equations import EquationSet
from elastic_arm.estimation.observation import observe
from elastic_arm.estimation.residuals import residuals
from elastic_arm.estimation.whitening import noise_models
from elastic_arm.evidence.priors import CHANGED
from elastic_arm.recording import Recording, Samples, Side
from elastic_arm.recording.sides import SAMPLED
from elastic_arm.robot import load_robot

# Samples kept at most, whatever their stamps; bounds the memory.
CAPACITY = 200_000


class Window:
    """The samples of the last while, in bounded memory.

    length: s; of 15 s, two thirds are fitted and the last third judges; currents: the torque channels that are
    currents times a torque constant.
    """

    def __init__(
        self, joints: Sequence[str], length: float = 15.0, source: str = "live", currents: Sequence[str] = ()
    ) -> None:
        self.joints, self.length, self.source, self.currents = tuple(joints), length, source, tuple(currents)
        self._batches: deque[Samples] = deque()

    def add(self, samples: Samples) -> None:
        """Take samples; when the clock was set back, or other channels come than before, those before are forgotten."""
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
        """Forget all samples."""
        self._batches.clear()

    @property
    def seconds(self) -> float:
        """From the first to the last sample kept."""
        if not self._batches:
            return 0.0
        return float(self._batches[-1].stamp_ns[-1] - self._batches[0].stamp_ns[0]) * 1e-9

    @property
    def full(self) -> bool:
        """Whether as much is there as is kept."""
        return self.seconds > 0.95 * self.length

    def recording(self, last: float | None = None) -> Recording:
        """Return the last seconds (or all that is kept) as a recording.

        Raises a DiagnosisError if there is nothing.
        """
        if not self._batches:
            raise DiagnosisError("no samples yet", "Start the arm, or look for it on /joint_states and /motor_states")
        stamps = np.concatenate([batch.stamp_ns for batch in self._batches])
        first = 0 if last is None else int(np.searchsorted(stamps, stamps[-1] - round(last * 1e9)))
        channels: dict[str, dict[str, Array]] = {}
        for name in self._batches[0].recorded():
            side, channel = SAMPLED[name]
            values = np.concatenate([getattr(batch, name) for batch in self._batches])[first:]
            channels.setdefault(side, {})[channel] = values
        sides: dict[str, Any] = {side: Side(stamps[first:], **own) for side, own in channels.items()}
        return Recording(self.joints, **sides, source=self.source, currents=self.currents)


@dataclass(frozen=True)
class ResidualLevels:
    """How large each residual is, and its noise, Nm, by joint and side; a missing equation is missing here."""

    size: ResidualSizes
    noise: dict[tuple[str, str], float]


class LiveDiagnosis:
    """Diagnoses of an arm that moves."""

    def __init__(self, question: Question) -> None:
        self.question = question
        self._model = build_model(question.robot, question.model)

    @staticmethod
    def of(
        robot: str | None, model: str, known: Sequence[str], refit: bool, effects_files: Sequence[str] = ()
    ) -> LiveDiagnosis:
        """Make one from a file (the package's arm where None), and known effects as text.

        Raises a RobotError or an EffectError if there is no such arm or effect.
        """
        arm = load_robot(robot)
        catalogue = Catalogue.default().with_files(effects_files)
        given = known_effects(known, arm, catalogue)
        return LiveDiagnosis(Question(arm, model, refit=refit, given=given, catalogue=catalogue))

    def where(self, recording: Recording) -> ResidualLevels:
        """Measure the residuals of a stretch of a few seconds against the model: cheap, and fits nothing.

        With `refit`, the model is that of the last diagnosis.

        Raises a DiagnosisError if there is too little motion.
        """
        model = self._model
        observation = observe(usable(recording.select(self.question.robot.joint_names)))
        layout = EquationSet.of(observation.pieces[0], model)
        band = common_band(layout, model, observation.rate)
        stretches = residuals(model, observation, layout, band)
        if not stretches:
            raise DiagnosisError("too little motion is left after filtering", "Wait some seconds")
        values = np.concatenate([stretch.values for stretch in stretches])
        (model_noise,) = noise_models(model, observation, layout, band, (0.0,))
        noise = model_noise.std(LowPass(band.cutoff, band.kept_rate))
        places = layout.places(model.robot.joint_names)

        def named(numbers: Array) -> dict[tuple[str, str], float]:
            return dict(zip(places, numbers[layout.live].tolist(), strict=True))

        rmse, peak = np.sqrt(np.mean(values**2, axis=0)), np.abs(values).max(axis=0)
        return ResidualLevels(ResidualSizes(named(rmse), named(peak)), named(noise))

    def diagnose(self, recording: Recording) -> Diagnosis:
        """Diagnose a window.

        Raises
        ------
        ElasticArmError
            If it is too short, or holds no motion yet.
        """
        found = diagnose([recording], self.question)
        if self.question.refit and found.context is not None:
            self._model = found.context.model
        return found


@dataclass
class Level:
    """A size over the diagnoses so far: values that differ by their deviation and by how windows differ (Welford)."""

    count: int = 0
    mean: float = 0.0
    squares: float = 0.0

    @property
    def std(self) -> float:
        """Standard deviation of a value."""
        return float(np.sqrt(self.squares / max(self.count - 1, 1)))

    def takes(self, value: float, std: float) -> bool:
        """Take a value, or say that it is likelier another size: any up to twice as large."""
        if self.count:
            # Values spread as those before, or as this one's deviation where there are few: Student's t, by a prior
            # variance std² that counts for two values.
            a, b = 0.5 * (self.count + 1), std**2 + 0.5 * self.squares
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
    """The sizes of causes and known effects from diagnosis to diagnosis, in constant memory."""

    def __init__(self) -> None:
        self._levels: dict[tuple[str, str | None, str], Level] = {}

    def changes(self, found: Mapping[str, Any]) -> list[str]:
        """Take the content of `diagnosis.json`; return in words which sizes are not what they were before."""
        said = []
        for one in (*found["causes"], *found["known"]):
            for name, size in one["parameters"].items():
                value, std = size["value"], size["std"]
                if not isinstance(value, float) or not isinstance(std, float) or std <= 0.0:
                    continue
                level = self._levels.setdefault((one["effect"], one["joint"], name), Level())
                if not level.takes(value, std):
                    before, now = (size_text(v, s, size["unit"]) for v, s in ((level.mean, level.std), (value, std)))
                    said.append(f"{name} of {effect_at(one['effect'], one['joint'])} changed from {before} to {now}")
        return said


def answering(
    robot: str | None, model: str, known: Sequence[str], refit: bool, effects_files: Sequence[str] = ()
) -> Callable[[tuple[str, Recording]], Any]:
    """Return what answers ("where", recording) and ("diagnosis", recording) in a process of its own.

    The one answer is a :class:`ResidualLevels`, the other the content of `diagnosis.json`; arguments are those of
    :meth:`LiveDiagnosis.of`.
    """
    live = LiveDiagnosis.of(robot, model, known, refit, effects_files)

    def answer(question: tuple[str, Recording]) -> Any:
        what, recording = question
        return live.where(recording) if what == "where" else live.diagnose(recording).to_dict()

    return answer
