"""What the catalogue lacks: general laws beside a hypothesis and in the place of its causes, and more than noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from elastic_arm.diagnosis.inference.estimated_hypothesis import EstimatedHypothesis
from elastic_arm.diagnosis.inference.faults import LargeImperfection
from elastic_arm.diagnosis.inference.final_estimates import FinalEstimates
from elastic_arm.diagnosis.inference.judgement import Judgement
from elastic_arm.diagnosis.inference.lack_of_fit import LackOfFit
from elastic_arm.diagnosis.inference.regimes import regime, shares
from elastic_arm.diagnosis.laws.comparison import LawComparison, LawFit
from elastic_arm.diagnosis.laws.lags import delays_for_filters, filters_for_delays
from elastic_arm.diagnosis.laws.loads import loads_for_offsets
from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis, Key, Rival
from elastic_arm.effects.library.friction import DRY
from elastic_arm.estimation.effect_columns import Feature


@dataclass(frozen=True)
class BetterLaws:
    """General laws that explain more than the hypothesis does, and where more is left than noise.

    Parameters
    ----------
    beside
        The one that explains most beside all causes; None where none is there beyond doubt.
    instead
        By key of the cause in whose place it explains more.
    approximated
        Keys of those causes that take at least half of what the law in their place takes.
    filters
        Low passes that could stand in the place of delays, by key of the delay, and delays in that of low passes.
    unlike_noise
        How many times the power of the sensors' noise is left, by row of the residuals, where that is too much.
    """

    beside: LawFit | None = None
    instead: Mapping[Key, LawFit] = field(default_factory=dict)
    approximated: frozenset[Key] = frozenset()
    filters: Mapping[Key, Rival] = field(default_factory=dict)
    unlike_noise: Mapping[int, float] = field(default_factory=dict)

    @property
    def all(self) -> list[LawFit]:
        """Each of them."""
        return [*self.instead.values(), *([self.beside] if self.beside else [])]

    def outweigh(self, judgement: Judgement, estimated: EstimatedHypothesis) -> bool:
        """Whether the one beside all causes explains more than they do, of a gap that does not show by size."""
        gained = judgement.log_likelihood + sum(fault.gain for fault in estimated.faults)
        return judgement.measure.name == "likelihood" and self.beside is not None and self.beside.gain > gained

    def refuted(self, faults: Sequence[LargeImperfection]) -> list[LargeImperfection]:
        """Return those faults in whose place one of them explains more."""
        return [fault for fault in faults if fault.feature.key in self.instead]


NO_LAWS = BetterLaws()


def better_laws(
    prepared: PreparedData, estimated: EstimatedHypothesis, unlike_noise: Mapping[int, float]
) -> BetterLaws:
    """Return the general laws that are there beyond doubt, and those that refute a cause.

    A cause is refuted where a law in its place is likelier by 2 % of its worth (`better`), many coefficients paid, and
    takes half of that worth (`taken`): what explains a torque of the wrist does not refute a tilt of the base. Dry
    friction, which every joint has, is refuted by a general form of friction only where it is not the larger part of
    that (`refined`): what changes a little with the angle is dry friction. A fault is refuted, with all others of its
    joint, where a law clearly explains more and the fault is ordinary beside.

    Parameters
    ----------
    prepared
        Data and regressors.
    estimated
        The causes with their parameters.
    unlike_noise
        As in the result.
    """
    detected, final = prepared.settings.significance.detected, estimated.final
    library = prepared.library if final is None else final.fit.found.library
    comparison = LawComparison(library, estimated.optimum, prepared.settings)
    filters = filters_for_delays(prepared, comparison, library.sets, estimated.faults)
    keys = {estimated.hypothesis.selected[k].feature.key for k in estimated.hypothesis.causes}
    found = [candidate for candidate in estimated.optimum if candidate.feature.key in keys and candidate.fixed]
    filters |= delays_for_filters(prepared, comparison, library.sets, found)
    loads = {} if final is None else loads_for_offsets(library.sets, estimated, final, prepared.settings.general_laws)
    beside = comparison.beside(range(prepared.model.n))
    if beside.gain <= 0.0:
        return BetterLaws(instead=loads, filters=filters, unlike_noise=unlike_noise)
    instead, approximated = _instead_of_causes(prepared, comparison, estimated.hypothesis)
    instead |= loads
    if beside.gain <= detected:
        return BetterLaws(None, instead, approximated, filters, unlike_noise)
    if final is not None:
        instead.update(_instead_of_faults(prepared, comparison, estimated.faults, final))
    return BetterLaws(beside, instead, approximated, filters, unlike_noise)


def _instead_of_causes(
    prepared: PreparedData, comparison: LawComparison, hypothesis: Hypothesis
) -> tuple[dict[Key, LawFit], frozenset[Key]]:
    """Return the general laws that refute causes, by key of the cause, and which causes take at least half of that."""
    settings = prepared.settings.general_laws
    found: dict[Key, LawFit] = {}
    approximated: set[Key] = set()
    for feature in (hypothesis.selected[k].feature for k in hypothesis.causes):
        worth = comparison.worth(feature.key)
        for law in comparison.instead_of(feature.key, _joints(prepared, feature)):
            # The columns of a large cause are a little off, which a law without a form makes up for.
            better = settings.refined if law.law.friction and feature.key[0] == DRY else settings.better
            if law.gain <= max(better * worth, 0.0):
                break
            # A law that leaves the cause its worth explains something else.
            if comparison.worth_beside(feature.key, law.law) < settings.taken * worth:
                found[feature.key] = law
                if worth > law.gain:
                    approximated.add(feature.key)
                break
    return found, frozenset(approximated)


def _instead_of_faults(
    prepared: PreparedData, comparison: LawComparison, faults: Sequence[LargeImperfection], final: FinalEstimates
) -> dict[Key, LawFit]:
    """Return the general laws that refute faults, by key of the fault: beside which it is ordinary."""
    found, detected = {}, prepared.settings.significance.detected
    for fault in faults:
        joints = _joints(prepared, fault.feature)
        together = [other.feature for other in faults if set(_joints(prepared, other.feature)) & set(joints)]
        wider = final.wider(together)
        for law in comparison.instead_of_numbers(wider, joints):
            if law.gain <= detected:
                break
            if final.is_gone(fault, *comparison.numbers_beside(law, wider)):
                found[fault.feature.key] = law
                break
    return found


def _joints(prepared: PreparedData, feature: Feature) -> Sequence[int]:
    names = list(prepared.model.robot.joint_names)
    return range(len(names)) if feature.joint is None else [names.index(feature.joint)]


def lacks_of_fit(prepared: PreparedData, laws: Sequence[LawFit]) -> list[LackOfFit]:
    """Return where general laws show most, and which regime their torques follow.

    Parameters
    ----------
    prepared
        Data and regressors.
    laws
        Those that are there.
    """
    settings, found = prepared.settings.regimes, []
    for fit in laws:
        sizes = np.sqrt(np.mean(np.concatenate(fit.torque) ** 2, axis=0))
        row = int(np.argmax(sizes))
        followed = shares(prepared.validation, fit.torque, row, prepared.gear_ratios(row), settings)
        found.append(LackOfFit(row, regime(followed, settings), fit.gain, float(sizes[row])))
    return found
