"""The result of a diagnosis: verdict, gap, causes, numbers and notes.

none:       no cause, nothing unexplained
explained:  causes, nothing unexplained
unknown:    a residual that keeps power, a nonparametric law, or an event
"""

from __future__ import annotations

from collections.abc import Iterator, Set
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from elastic_arm.diagnosis.causes import Causes
from elastic_arm.diagnosis.changes import changes_between
from elastic_arm.diagnosis.confirmation import TWO
from elastic_arm.diagnosis.confirmed_set import Confirmed
from elastic_arm.diagnosis.context import DiagnosisContext
from elastic_arm.diagnosis.decomposition import Decomposition, Unknown
from elastic_arm.diagnosis.estimates import ParameterEstimate, estimated, mounted_body
from elastic_arm.diagnosis.far_numbers import beyond
from elastic_arm.diagnosis.gap import Gap
from elastic_arm.diagnosis.regimes import shares
from elastic_arm.diagnosis.result import (
    Diagnosis,
    Imperfection,
    ResidualSizes,
    UnexplainedResidual,
    plain,
)
from elastic_arm.diagnosis.unknown_effects import UnknownEffects, gear_ratios
from elastic_arm.diagnosis.words import (
    REPEATED_MOTION,
    UNFINISHED,
    event_notes,
    law_note,
    mounted_note,
    ringing_notes,
    shape_note,
    unnamed_note,
)
from elastic_arm.effects import EffectInstance
from elastic_arm.estimation.equation_sets import Place
from elastic_arm.evidence.terms.unnamed import UnnamedTerm
from elastic_arm.identification.batch.identify import resonances
from elastic_arm.identification.verdict import SURE

Known = tuple[EffectInstance, dict[str, ParameterEstimate]]  # a known effect with its sizes


def diagnosis_of(confirmed: Confirmed) -> Diagnosis:
    """Return the diagnosis of the confirmed set."""
    return _Outcome(confirmed.parts, Causes(confirmed, UnknownEffects(confirmed.parts))).diagnosis()


@dataclass(frozen=True)
class _Outcome:
    """The parts of the result."""

    parts: Decomposition
    causes: Causes

    def diagnosis(self) -> Diagnosis:
        """Return the result."""
        prepared = self.parts.prepared
        problem = self.parts.problem
        before, after = self.parts.gaps
        share, interval = self._shrink()
        by_place = self.parts.by_place(self.parts.shrink.by_row)
        return Diagnosis(
            model=problem.model,
            robot=problem.robot.name,
            joints=problem.robot.joint_names,
            prismatic=tuple(problem.robot.units.prismatic),
            identify=prepared.sources[0],
            validate=prepared.sources[1],
            independent_motion=prepared.independent_motion,
            judged=prepared.judged,
            band=problem.band.cutoff,
            trust=self.parts.explanation.trust,
            verdict=self.verdict,
            noise=self._noise(),
            before=self._sizes(before),
            after=self._sizes(after),
            shrink=share,
            shrink_interval=interval,
            shrink_by_place={p: None if np.isnan(v) else v for p, v in by_place.items()},
            causes=tuple(cause for cause, _ in self.causes.found),
            not_confirmed=self.causes.not_confirmed(),
            unexplained=tuple(sorted(self._unexplained, key=lambda place: -place.rmse)),
            imperfections=self._imperfections(),
            made=prepared.made,
            of_duty=tuple(joint.name for joint in problem.robot.joints if joint.follows_duty),
            changes=changes_between(self.parts.explanation, problem),
            known=tuple(_known_as_written(known) for known in self._known),
            events=prepared.all_events,
            notes=tuple(self._notes()),
            context=self._context(),
        )

    @cached_property
    def verdict(self) -> str:
        """The verdict."""
        if self._unexplained:
            return "unknown"
        return "explained" if self.causes.found else "none"

    @cached_property
    def _unexplained(self) -> list[UnexplainedResidual]:
        """The open residuals, and the events."""
        events = [
            UnexplainedResidual(event.joint, event.side, "event", event.rmse)
            for event in self.parts.prepared.all_events
        ]
        return [*self.causes.unknown.residuals(), *events]

    def _shrink(self) -> tuple[float | None, tuple[float, float] | None]:
        """Return the reduction of the gap and its 95 % interval."""
        found = self.parts.shrink
        share = found.share
        if share is None and self.causes.found:
            share = self._whitened_share()
        if self.verdict == "none" or share is None:
            return None if self.verdict == "none" else share, None
        return share, found.interval or (share, share)

    def _whitened_share(self) -> float:
        """Return the removed share of the whitened power over the noise, for a gap that no single
        octave shows."""
        fit = self.parts.fit
        count = fit.model.bands.n
        first = float(np.sum(np.maximum(fit.model.fit(()).found.left - count, 0.0)))
        left = float(np.sum(np.maximum(fit.found.left - count, 0.0)))
        return 1.0 - left / first if first else 0.0

    # -- by joint and side

    def _sizes(self, gap: Gap) -> ResidualSizes:
        """Return RMS values and peaks of a gap."""
        return ResidualSizes(self.parts.by_place(gap.rmse), self.parts.by_place(gap.peak))

    def _noise(self) -> dict[Place, float]:
        """Return the RMS values of the sensors' noise."""
        return self.parts.by_place(np.sqrt(self.parts.gaps[0].noise.sum(axis=1)))

    # -- numbers and known effects

    def _imperfections(self) -> tuple[Imperfection, ...]:
        """Return the estimate of each number."""
        problem = self.parts.problem
        fit = self.parts.fit
        stds = np.sqrt(np.maximum(np.diag(fit.number_covariance), 0.0))
        off = beyond(fit, self.parts.explanation.linear.values, problem.numbers) > 0.5
        sources = problem.sources
        found = []
        each = zip(problem.numbers, self.parts.numbers, stds, off, strict=True)
        for number, value, std, is_off in each:
            if number.is_number:
                found.append(
                    Imperfection(
                        number.what,
                        number.joint,
                        number.unit,
                        number.value(value),
                        float(std * number.slope(value)),
                        number.prior_std,
                        not bool(is_off),
                        None if number.recording is None else sources[number.recording],
                        number.neutral,
                    )
                )
        return tuple(found)

    @cached_property
    def _known(self) -> list[Known]:
        """The known effects with their sizes."""
        values = self.parts.explanation.linear.values
        numbers = self.parts.problem.numbers
        found = []
        for term in self.parts.known_terms:
            parameters, instance = estimated(self.parts.fit, term, numbers, values)
            found.append((instance, parameters))
        return found

    # -- notes and context

    def _notes(self) -> Iterator[str]:
        """Yield notes on the search, nonparametric laws, open residuals, events, ringing joints and
        the data."""
        prepared = self.parts.prepared
        unknown = self.causes.unknown
        if not self.parts.explanation.is_whole:
            yield UNFINISHED
        yield from (self._unknown_note(term) for _, term in unknown.laws)
        yield from (shape_note(*self.parts.places[row]) for row in unknown.open_rows)
        yield from event_notes(prepared.all_events)
        yield from self._ringing_notes()
        yield from self._mounted_notes()
        yield from prepared.notes
        if not prepared.independent_motion:
            yield REPEATED_MOTION

    def _unknown_note(self, term: Unknown) -> str:
        joint = self.parts.problem.robot.joint_names[term.place[0]]
        if isinstance(term, UnnamedTerm):
            return unnamed_note(joint, term.feature.effect.id)
        return law_note(joint, term.law)

    def _ringing_notes(self) -> Iterator[str]:
        """Yield notes on joints of a rigid arm whose residuals oscillate."""
        problem = self.parts.problem
        left = self._joints_left()
        if not left or problem.robot.elastic:
            return
        pieces = [observation.pieces for observation in problem.observed[0]]
        found = resonances(problem.robot, problem.model, pieces)
        of_left = {joint: frequency for joint, frequency in found.items() if joint in left}
        # A servo swings on its gain, but the torque of a recorded duty is that of the motor alone.
        driven = {joint.name for joint in problem.robot.joints if joint.follows_duty}
        commanded = [name for name in self.parts.prepared.made if name not in driven]
        yield from ringing_notes(of_left, commanded)

    def _mounted_notes(self) -> Iterator[str]:
        """Yield the body that a last link heavier than described may carry."""
        last = self.parts.problem.robot.joints[-1]
        for cause, _ in self.causes.found:
            if cause.instance.effect.number != "link_mass" or cause.joint != last.name:
                continue
            ratio = cause.parameters["mass"]
            if ratio.value - 1.0 > TWO * ratio.std:
                shift = cause.parameters["com"].value
                mass, place = mounted_body(last.link, ratio.value, shift)
                yield mounted_note(last.name, mass, place)

    def _joints_left(self) -> Set[str]:
        """Return the joints with residuals well above their noise after the correction."""
        noise = self._noise()
        left = self.parts.by_place(self.parts.gaps[1].rmse)
        return {place[0] for place, size in left.items() if size > SURE * noise[place]}

    def _context(self) -> DiagnosisContext:
        """Return the data for predictions, figures and proposals of motions."""
        parts = self.parts
        data = parts.linear.data
        before = parts.before
        rows = range(len(parts.places))
        return DiagnosisContext(
            explanation=parts.explanation,
            judging=parts.linear,
            before=before,
            after=parts.after,
            alone=[alone for _, alone in self.causes.found],
            friction=parts.friction_added,
            regimes=[shares(data, before, row, gear_ratios(parts, row)) for row in rows],
            known=tuple(instance for instance, _ in self._known),
            unseen=parts.prepared.unseen,
            reasons=self.causes.unknown.reasons,
            held_back=parts.problem.held_back,
        )


def _known_as_written(known: Known) -> dict[str, object]:
    """Return a known effect as in `diagnosis.json`."""
    instance, parameters = known
    return {
        "effect": instance.effect.id,
        "joint": instance.joint,
        "sides": list(instance.sides),
        "parameters": plain(parameters),
    }
