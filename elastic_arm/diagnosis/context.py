"""The data behind a diagnosis, kept for figures and follow-up steps."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics import Model
from elastic_arm.effects import EffectInstance
from elastic_arm.estimation.equation_sets import Place
from elastic_arm.estimation.observation import Observation
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.evidence.explanation import Explanation
from elastic_arm.evidence.linearisation import Linearisation


@dataclass(frozen=True)
class DiagnosisContext:
    """The validation data with the residuals before and after."""

    explanation: Explanation  # sets of causes with their posteriors, at the last linearisation
    judging: Linearisation  # the same linearisation of the recordings that judge
    # before, after: residuals (N', R) of each stretch of these
    before: Sequence[Array]
    after: Sequence[Array]
    alone: Sequence[
        Sequence[Array]
    ]  # residuals of each stretch with one cause alone added, by position in the causes
    # what the friction of the most probable set, known and found, adds to these residuals
    friction: Sequence[Array]
    regimes: Sequence[
        dict[str, float]
    ]  # (R,) share of each residual's power that follows each regime, before
    # known, unseen: what counted as part of the model, and known effects that act in no recorded
    # equation
    known: tuple[EffectInstance, ...]
    unseen: tuple[EffectInstance, ...]
    reasons: Mapping[Place, Sequence[str]]  # why each open residual is unexplained
    held_back: bool  # whether the last third of each recording judged

    @property
    def validate(self) -> WhitenedData:
        """The recordings that judge."""
        return self.judging.data

    def over_time(self, recording: int) -> tuple[Array, Array, Array]:
        """Return times (N') s from where a recording begins to judge, and its residuals (N', R)
        before and after."""
        own = [k for k, part in enumerate(self.validate.parts) if part.recording == recording]
        t = np.concatenate([self.validate.parts[k].stretch.t for k in own])
        before = np.concatenate([self.before[k] for k in own])
        after = np.concatenate([self.after[k] for k in own])
        return t, before, after

    @cached_property
    def found(self) -> Linearisation:
        """The recordings that judge, where the numbers were found."""
        settled = self.explanation.settled
        return self.judging if settled is self.explanation.linear else settled.judging

    @property
    def model(self) -> Model:
        """The arm at the numbers that were found."""
        return self.found.model

    @property
    def seen(self) -> tuple[Observation, ...]:
        """The recordings that judge, late channels moved back, torques without their gains."""
        return self.found.observed

    def moved(self, samples: int) -> tuple[Array, Array, Array]:
        """Return angles, rates and accelerations (at most about `samples`, n) of the recordings
        that judge, rad, s."""
        quiet = [part.stretch.quiet for part in self.validate.parts]
        every = max(1, sum(len(one.t) for one in quiet) // samples)
        q = np.concatenate([one.q[::every] for one in quiet])
        dq = np.concatenate([one.dq[::every] for one in quiet])
        ddq = np.concatenate([one.ddq[::every] for one in quiet])
        return q, dq, ddq
