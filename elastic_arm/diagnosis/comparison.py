"""Comparison of a real and a simulated recording of the same commands.

Both are diagnosed against one model. The effects found in either recording are compared by
probability and size.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from elastic_arm.diagnosis.answer import diagnose
from elastic_arm.diagnosis.estimates import ParameterEstimate, estimated
from elastic_arm.diagnosis.question import Question
from elastic_arm.diagnosis.result import Diagnosis, plain
from elastic_arm.diagnosis.words import estimates_text, probability_text
from elastic_arm.errors import DiagnosisError
from elastic_arm.evidence.fit import Fit
from elastic_arm.evidence.priors import LISTED
from elastic_arm.recording import Recording
from elastic_arm.recording.inspection.differences import RecordingDifference

# standard deviations within which two sizes agree (contract: a size within two is zero)
ALIKE = 2.0
Name = tuple[str, str | None]  # effect and joint


@dataclass(frozen=True)
class SizeFound:
    """An effect in one recording: its probability, and its size if any scored set contains it."""

    probability: float
    parameters: Mapping[str, ParameterEstimate]

    @property
    def there(self) -> bool:
        """Whether it is more probable than not."""
        return self.probability > 0.5

    def text(self) -> str:
        """Return size and probability in words."""
        size = estimates_text(self.parameters) if self.probability >= LISTED else ""
        return (
            f"{size} ({probability_text(self.probability)})"
            if size
            else probability_text(self.probability)
        )


@dataclass(frozen=True)
class ComparedEffect:
    """An effect in a real and in a simulated recording."""

    effect: str
    joint: str | None
    real: SizeFound
    simulated: SizeFound

    @property
    def where(self) -> str:
        """The recording with the effect: "real", "simulated" or "both"."""
        if self.real.there and self.simulated.there:
            return "both"
        return "real" if self.real.there else "simulated"

    @property
    def agrees(self) -> bool | None:
        """Whether its sizes in both recordings agree; None if only one of them has it."""
        if self.where != "both":
            return None
        pairs = [(e, self.simulated.parameters[name]) for name, e in self.real.parameters.items()]
        return all(_apart(a, b) <= ALIKE for a, b in pairs)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        findings = {"real": self.real, "simulated": self.simulated}
        return {
            "effect": self.effect,
            "joint": self.joint,
            "where": self.where,
            "agrees": self.agrees,
            **{
                name: {
                    "confidence": float(f"{f.probability:.7g}"),
                    "parameters": plain(f.parameters),
                }
                for name, f in findings.items()
            },
        }


@dataclass(frozen=True)
class SimulationComparison:
    """A real and a simulated recording of the same commands."""

    simulated: str  # where the simulated recording came from
    difference: RecordingDifference  # channel by channel, without a model
    effects: tuple[ComparedEffect, ...]  # effects of either recording, most important first

    def rows(self) -> list[list[str]]:
        """Return effect, place, recording, and the sizes in the real and the simulated recording as
        text."""
        words = {"real": "the real recording only", "simulated": "the simulated recording only"}
        return [
            [
                one.effect.replace("_", " "),
                one.joint or "whole arm",
                words.get(one.where, "both, same size" if one.agrees else "both, different sizes"),
                one.real.text(),
                one.simulated.text(),
            ]
            for one in self.effects
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        effects = [one.to_dict() for one in self.effects]
        return {"simulated": self.simulated, **self.difference.to_dict(), "effects": effects}


def compare(
    real: Diagnosis, simulated: Recording, question: Question, difference: RecordingDifference
) -> SimulationComparison:
    """Diagnose a simulated recording as the real one was, and compare the effects of both.

    Parameters
    ----------
    real
        The diagnosis of the real recording.
    simulated
        A recording of the same commands from any simulator.
    question
        The question of the diagnosis.
    difference
        The difference of the two recordings, without a model.

    Raises
    ------
    DiagnosisError
        If the simulated recording allows no diagnosis, or has other channels.
    """
    other = diagnose([simulated], question)
    if set(other.before.rmse) != set(real.before.rmse):
        raise DiagnosisError(
            "the recordings contain different channels", "Record the same topics in both"
        )
    names = dict.fromkeys(
        (cause.effect, cause.joint) for found in (real, other) for cause in found.causes
    )
    effects = tuple(
        ComparedEffect(*name, _finding(real, name), _finding(other, name)) for name in names
    )
    return SimulationComparison(simulated.source, difference, effects)


def _finding(found: Diagnosis, name: Name) -> SizeFound:
    for cause in found.causes:
        if (cause.effect, cause.joint) == name:
            return SizeFound(cause.confidence, cause.parameters)
    assert found.context is not None
    explanation = found.context.explanation
    sets: list[Fit] = []
    for keys, fit in explanation.search.met.items():
        if any(key[:2] == name for key in keys):
            sets.append(fit)
    if not sets:
        return SizeFound(0.0, {})
    fit = max(sets, key=lambda one: one.score)
    term = next(t for t in fit.optional if t.key[:2] == name)
    parameters, _ = estimated(
        fit, term, explanation.linear.problem.numbers, explanation.linear.values
    )
    return SizeFound(explanation.probability(lambda key: key[:2] == name), parameters)


def _apart(one: ParameterEstimate, other: ParameterEstimate) -> float:
    """Return the largest distance of two estimates, in standard deviations; zero if a deviation is
    unknown."""
    if not np.any(one.std) or not np.any(other.std):
        return 0.0
    difference = np.subtract(one.value, other.value)
    std = np.hypot(np.asarray(one.std, dtype=float), np.asarray(other.std, dtype=float))
    return float(np.nanmax(np.abs(difference) / std, initial=0.0))
