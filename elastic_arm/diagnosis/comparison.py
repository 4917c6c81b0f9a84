"""A real and a simulated recording of the same commands: which effects are in one and not in the other.

Both are diagnosed against one model. The effects found in either are then fitted on each of them, so that an effect is
compared by its size, not by whether a search listed it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from elastic_arm.diagnosis.context import DiagnosisContext
from elastic_arm.diagnosis.inference.across_recordings import compared, refitted
from elastic_arm.diagnosis.estimates import Agreement, RecordingEstimate, differs
from elastic_arm.diagnosis.answer import diagnose
from elastic_arm.diagnosis.question import Question
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.diagnosis.texts.values import estimates_text
from elastic_arm.errors import DiagnosisError
from elastic_arm.recording import Recording
from elastic_arm.recording.inspection.differences import RecordingDifference

# Of an effect's larger size: with less of it a recording counts as without. A simulation has hardly any noise, so that
# rounding and time steps show there as effects; convention.
LEAST = 0.05


@dataclass(frozen=True)
class ComparedEffect:
    """An effect in a real and in a simulated recording.

    Parameters
    ----------
    agreement
        Its sizes in both, and whether they are the same.
    where
        "real", "simulated", "both", or "neither" where no recording by itself is certain of it.
    """

    agreement: Agreement
    where: str

    @property
    def sizes(self) -> tuple[RecordingEstimate, RecordingEstimate]:
        """In the real and in the simulated recording."""
        real, simulated = self.agreement.findings
        return real, simulated


@dataclass(frozen=True)
class SimulationComparison:
    """A real and a simulated recording of the same commands.

    Parameters
    ----------
    simulated
        Where the simulated recording came from.
    difference
        Channel by channel, without a model.
    effects
        Those found in either, most important first.
    """

    simulated: str
    difference: RecordingDifference
    effects: tuple[ComparedEffect, ...]

    def rows(self) -> list[list[str]]:
        """Return effect, place, in which recording, and its size in the real and in the simulated one, as text."""
        words = {"real": "the real one alone", "simulated": "the simulated one alone", "neither": "none for certain"}
        rows = []
        for one in self.effects:
            both = "both, alike" if one.agreement.agrees else "both, not alike"
            sizes = [estimates_text(finding.parameters) or "no free size" for finding in one.sizes]
            place = one.agreement.joint or "whole arm"
            rows.append([one.agreement.effect.replace("_", " "), place, words.get(one.where, both), *sizes])
        return rows

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {
            "simulated": self.simulated,
            **self.difference.to_dict(),
            "effects": [{"where": one.where, **one.agreement.to_dict()} for one in self.effects],
        }


def compare(
    found: Diagnosis, simulated: Recording, question: Question, difference: RecordingDifference
) -> SimulationComparison:
    """Diagnose a simulated recording as the real one was, and compare the effects of both.

    Parameters
    ----------
    found
        The diagnosis of the real recording.
    simulated
        A recording of the same commands, made by any simulator.
    question
        Of the diagnosis.
    difference
        Of the two recordings, without a model.

    Raises
    ------
    DiagnosisError
        If the simulated recording allows no diagnosis, or holds other channels.
    """
    effects = compared_effects(found, diagnose([simulated], question))
    return SimulationComparison(simulated.source, difference, effects)


def compared_effects(real: Diagnosis, simulated: Diagnosis) -> tuple[ComparedEffect, ...]:
    """Fit the effects found in either recording on each of them.

    Parameters
    ----------
    real, simulated
        Diagnoses of the two against the same model.

    Raises
    ------
    DiagnosisError
        If the two recordings do not hold the same channels.
    """
    a, b = real.context, simulated.context
    if a is None or b is None:
        return ()
    if a.validate.layout.sides != b.validate.layout.sides:
        raise DiagnosisError("the recordings do not hold the same channels", "Record the same topics of both")
    found = {candidate.feature.key: candidate for candidate in (*b.selected, *a.selected)}
    order = [candidate.feature.key for candidate in (*a.selected, *b.selected)]
    # The tilt of an arm that is mounted otherwise is a known effect of it as mounted: it is not compared.
    given = {candidate.feature.key for candidate in (*a.given, *b.given)}
    effects = [found[key] for key in dict.fromkeys(order) if key not in given]
    everything = [*a.given, *effects]
    sizes = [refitted(context, _all(context), everything)[len(a.given) :] for context in (a, b)]
    return tuple(
        ComparedEffect(compared(candidate.feature, pair, a.settings.agreement), _where(candidate, pair, a))
        for candidate, *pair in zip(effects, *sizes, strict=True)
    )


def _all(context: DiagnosisContext) -> list[Any]:
    return [observation for part in context.seen for observation in part]


def _where(candidate: Candidate, findings: Sequence[RecordingEstimate], context: DiagnosisContext) -> str:
    settings = context.settings
    sizes = [_size(candidate, finding) for finding in findings]
    there = [
        finding.gain > settings.significance.detected
        and differs(dict(finding.parameters), candidate, settings.judgement.level)
        and size >= LEAST * max(sizes)
        for finding, size in zip(findings, sizes, strict=True)
    ]
    if all(there):
        return "both"
    return "real" if there[0] else "simulated" if there[1] else "neither"


def _size(candidate: Candidate, finding: RecordingEstimate) -> float:
    """Return how far an effect is from none, in the units of its size."""
    effect = candidate.feature.effect
    parts = [
        np.ravel(finding.parameters[name].value) - (effect.parameter(name).neutral or 0.0)
        for name in effect.magnitude
        if name in finding.parameters
    ]
    return float(np.linalg.norm(np.concatenate(parts))) if parts else 1.0
