"""Sets of candidates at their joint optimum, each set worked out once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from elastic_arm.diagnosis.inference.estimates import ParameterEstimate, certain, differs, estimates, polish, several
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.settings import JudgementSettings


class JointEstimates:
    """Polished candidates of a library, and their parameters: a judgement needs those of the same sets many times.

    Parameters
    ----------
    library
        Of all columns.
    settings
        Clearance of physical bounds, level of the tests.
    """

    def __init__(self, library: RegressorLibrary, settings: JudgementSettings) -> None:
        self._library, self._settings = library, settings
        self._polished: dict[tuple[Candidate, ...], list[Candidate]] = {}
        self._parameters: dict[tuple[Candidate, ...], list[dict[str, ParameterEstimate]]] = {}
        self._certain: dict[tuple[tuple[Candidate, ...], float], list[bool]] = {}

    def polished(self, selected: Sequence[Candidate]) -> list[Candidate]:
        """Return candidates with all parameters at the joint least-squares optimum."""
        key = tuple(selected)
        if key not in self._polished:
            self._polished[key] = polish(self._library, selected, self._settings)
        return self._polished[key]

    def parameters(self, selected: Sequence[Candidate]) -> list[dict[str, ParameterEstimate]]:
        """Return the parameters of the polished candidates with standard deviations."""
        key = tuple(selected)
        if key not in self._parameters:
            self._parameters[key] = estimates(self._library, self.polished(selected), self._settings)
        return self._parameters[key]

    def certain(self, selected: Sequence[Candidate], level: float | None = None) -> list[bool]:
        """Whether each polished candidate's parameters together differ from no effect at a level."""
        settings = self._settings if level is None else replace(self._settings, level=level)
        key = tuple(selected), settings.level
        if key not in self._certain:
            self._certain[key] = certain(self._library, self.polished(selected), settings)
        return self._certain[key]

    def insignificant(self, selected: Sequence[Candidate], level: float | None = None) -> set[int]:
        """Return the numbers of candidates that may be no effect: each parameter, and several of them together.

        Parameters
        ----------
        selected
            All candidates.
        level
            Of the tests; that of the settings where none is given.
        """
        found = self.parameters(selected)
        unsure = {k for k, one in enumerate(selected) if not differs(found[k], one, level or self._settings.level)}
        if not any(several(found[k]) for k in unsure):
            return unsure
        together = self.certain(selected, level)
        return {k for k in unsure if not (several(found[k]) and together[k])}
