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
    """The validation recordings with their residuals before and after."""

    explanation: Explanation  # sets of causes with their posteriors, at the last linearisation
    judging: Linearisation  # the same linearisation of the validation recordings
    # before, after: residuals (N', R) of each stretch of the validation recordings
    before: Sequence[Array]
    after: Sequence[Array]
    alone: Sequence[
        Sequence[Array]
    ]  # residuals of each stretch with one cause alone, in the order of the causes
    # contribution of known and found friction in the most probable set to these residuals
    friction: Sequence[Array]
    regimes: Sequence[
        dict[str, float]
    ]  # (R,) share of each residual's power that follows each regime, before
    # known, unseen: effects that are part of the model, and known effects that act in no recorded
    # equation
    known: tuple[EffectInstance, ...]
    unseen: tuple[EffectInstance, ...]
    reasons: Mapping[Place, Sequence[str]]  # why each open residual is unexplained
    held_back: bool  # whether the last third of each recording is the validation part

    @property
    def validate(self) -> WhitenedData:
        """The validation recordings."""
        return self.judging.data

    def over_time(self, recording: int) -> tuple[Array, Array, Array]:
        """Return times (N') from the start of the validation part of a recording, s, and its
        residuals (N', R) before and after."""
        own = [k for k, part in enumerate(self.validate.parts) if part.recording == recording]
        t = np.concatenate([self.validate.parts[k].stretch.t for k in own])
        before = np.concatenate([self.before[k] for k in own])
        after = np.concatenate([self.after[k] for k in own])
        return t, before, after

    @cached_property
    def found(self) -> Linearisation:
        """The validation recordings, linearised at the numbers that were found."""
        settled = self.explanation.settled
        return self.judging if settled is self.explanation.linear else settled.judging

    @property
    def model(self) -> Model:
        """The arm at the numbers that were found."""
        return self.found.model

    @property
    def seen(self) -> tuple[Observation, ...]:
        """The validation recordings without the lags of channels and the gains of torques."""
        return self.found.observed

    def moved(self, samples: int) -> tuple[Array, Array, Array]:
        """Return angles, rates and accelerations of the validation recordings, rad, s; about
        (`samples`, n) at most."""
        quiet = [part.stretch.quiet for part in self.validate.parts]
        every = max(1, sum(len(one.t) for one in quiet) // samples)
        q = np.concatenate([one.q[::every] for one in quiet])
        dq = np.concatenate([one.dq[::every] for one in quiet])
        ddq = np.concatenate([one.ddq[::every] for one in quiet])
        return q, dq, ddq
