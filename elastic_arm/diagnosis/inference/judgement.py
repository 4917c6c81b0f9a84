"""The judgement of a hypothesis: causes that fail the conditions of docs/contract.md are left out, worst first."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from elastic_arm.diagnosis.bootstrap import lower_bound
from elastic_arm.diagnosis.inference.estimates import ParameterEstimate
from elastic_arm.diagnosis.inference.faults import LargeImperfection, faults_beside, is_large
from elastic_arm.diagnosis.inference.gap_metric import GapMeasure, gap_measure
from elastic_arm.diagnosis.inference.lack_of_fit import LackOfFitTest
from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis, Key, misfit
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.diagnosis.selection.stepwise import StepwiseSearch
from elastic_arm.diagnosis.texts.notes import small_effect_note
from elastic_arm.effects.parameters import Role


@dataclass(frozen=True)
class Judgement:
    """The causes that passed.

    Parameters
    ----------
    hypothesis
        What is left of the hypothesis of the search.
    measure
        What the gap is measured by.
    test
        Finds what candidates leave.
    log_likelihood
        Held-out log-likelihood that the causes gain, nats.
    notes
        Ordinary imperfections, and effects too small to be causes.
    faults
        Sensors that are further off than ordinary ones.
    minor
        Keys of the causes that are less than the least share of the gap.
    """

    hypothesis: Hypothesis
    measure: GapMeasure
    test: LackOfFitTest
    log_likelihood: float
    notes: tuple[str, ...]
    faults: tuple[LargeImperfection, ...] = ()
    minor: frozenset[Key] = frozenset()


def judge(prepared: PreparedData, hypothesis: Hypothesis, impossible: Mapping[Key, str] | None = None) -> Judgement:
    """Keep the causes that pass: large enough, present in every resample, different from no effect.

    Parameters
    ----------
    prepared
        Data and regressors.
    hypothesis
        Of the search.
    impossible
        Notes on causes, by key, that have impossible numbers beside everything else.
    """
    ratios = [prepared.gear_ratios(joint) for joint in range(prepared.model.n)]
    test = LackOfFitTest(prepared.library, ratios, prepared.settings)
    hypothesis, notes = without_ordinary(prepared, hypothesis)
    faults = faults_beside(prepared, hypothesis.selected)
    faults, measure = _measured(prepared, hypothesis, test, faults)
    # An effect of the arm is not small because a sensor is far off, too, or the whole arm lies on its side.
    beside = gap_measure(prepared, hypothesis, test, mounted=True) if faults or prepared.mounting else measure
    kept, more_notes = eliminate(prepared, hypothesis, beside, impossible)
    kept = StepwiseSearch(prepared.library, kept.baseline, prepared.settings, prepared.sizes).simplified(kept)
    if len(kept.selected) < len(hypothesis.selected):
        counted, faults = faults, faults_beside(prepared, kept.selected)
        # What is a fault beside false causes alone is no part of the gap.
        if not kept.causes or (counted and not faults):
            faults, measure = _measured(prepared, kept, test, faults)
    gained = gain(prepared, kept.selected, kept.baseline)
    minor = frozenset(
        kept.selected[k].feature.key
        for k in kept.causes
        if kept.selected[k].feature.effect.parameters
        and beside.contribution(kept.selected, k) < prepared.settings.judgement.least_shrink
    )
    return Judgement(kept, measure, test, gained, (*notes, *more_notes), faults, minor)


def _measured(
    prepared: PreparedData, hypothesis: Hypothesis, test: LackOfFitTest, faults: Sequence[LargeImperfection]
) -> tuple[tuple[LargeImperfection, ...], GapMeasure]:
    """Return the faults that show, and what the gap is measured by.

    Of a gap that no residual shows, what is beyond ordinary is a cause where the likelihood shows it.

    Parameters
    ----------
    prepared
        Data and regressors.
    hypothesis
        The causes.
    test
        Finds what candidates leave.
    faults
        Nuisance parameters beyond ordinary.
    """
    measure, detected = gap_measure(prepared, hypothesis, test, faults), prepared.settings.significance.detected
    shown = tuple(fault for fault in faults if measure.name == "excess" or fault.gain > detected)
    return shown, measure if len(shown) == len(faults) else gap_measure(prepared, hypothesis, test, shown)


def measured_beside(
    prepared: PreparedData,
    judgement: Judgement,
    faults: Sequence[LargeImperfection],
    refuted: Sequence[LargeImperfection],
) -> Judgement:
    """Return the judgement with the gap that these faults make, those that were left at last.

    Parameters
    ----------
    prepared
        Data and regressors.
    judgement
        Of the causes.
    faults
        Nuisance parameters beyond ordinary, as they came out beside the causes.
    refuted
        Those of them that a general law refutes.
    """
    if not (faults or judgement.faults):
        return judgement
    measure = gap_measure(prepared, judgement.hypothesis, judgement.test, faults, refuted)
    return replace(judgement, measure=measure, faults=tuple(faults))


def gain(prepared: PreparedData, selected: Sequence[Candidate], without: Sequence[Candidate]) -> float:
    """Return the held-out log-likelihood, nats, that candidates gain over others.

    Parameters
    ----------
    prepared
        Data and regressors.
    selected, without
        The two sets of candidates.
    """
    return prepared.library.held_out(selected) - prepared.library.held_out(without)


def without_ordinary(prepared: PreparedData, hypothesis: Hypothesis) -> tuple[Hypothesis, list[str]]:
    """Count what every real arm has, such as lags of a sample, as part of the model, and return notes on it."""
    if all(hypothesis.selected[k].feature.effect.ordinary is None for k in hypothesis.causes):
        return hypothesis, []
    estimated = prepared.estimates.parameters(hypothesis.selected)
    ordinary = [k for k in hypothesis.causes if _as_on_ordinary_arms(prepared, hypothesis.selected[k], estimated[k])]
    large = [k for k in ordinary if matters(prepared, hypothesis, k)]
    # Beside one of the arm that matters, one of a joint is its difference from it.
    found = [k for k in ordinary if not any(_overlap(hypothesis, k, other) for other in large)]
    order = [*range(hypothesis.given), *found, *(k for k in hypothesis.causes if k not in found)]
    moved = {order.index(k): v for k, v in hypothesis.rivals.items() if k not in found}
    notes = [_ordinary_note(hypothesis.selected[k], estimated[k]) for k in found]
    selected = [hypothesis.selected[k] for k in order]
    return Hypothesis(selected, hypothesis.given + len(found), moved, hypothesis.beyond), notes


def _as_on_ordinary_arms(prepared: PreparedData, candidate: Candidate, values: Mapping[str, ParameterEstimate]) -> bool:
    """Whether there is no more of an effect, within its uncertainty, than every real arm has."""
    effect = candidate.feature.effect
    if effect.ordinary is None or effect.ordinary.parameter not in values:
        return False
    found, neutral = values[effect.ordinary.parameter], effect.parameter(effect.ordinary.parameter).neutral or 0.0
    margin = prepared.settings.judgement.ordinary_deviations * (found.std or 0.0)
    return bool(abs(found.value - neutral) <= effect.ordinary.most(prepared.rate) + margin)


def _overlap(hypothesis: Hypothesis, k: int, other: int) -> bool:
    """Whether two candidates are the same effect on a common joint."""
    one, two = hypothesis.selected[k].feature, hypothesis.selected[other].feature
    return one.effect.id == two.effect.id and (one.joint == two.joint or None in (one.joint, two.joint))


def matters(prepared: PreparedData, hypothesis: Hypothesis, k: int) -> bool:
    """Whether what every real arm has changes a residual by a good part of the torque of its joint.

    A link encoder a sample late turns a stiff drive into a soft one: its deflection is what the lag makes of it.

    Parameters
    ----------
    prepared
        Data and regressors.
    hypothesis
        That holds it.
    k
        Its position.
    """
    candidate, data = hypothesis.selected[k], prepared.validation
    beta = prepared.library.coefficients(hypothesis.selected)[k]
    columns = data.plain(candidate.feature, candidate.searched or ())
    power = np.mean(np.concatenate([part @ beta for part in columns]) ** 2, axis=0)
    return is_large(prepared, np.asarray(np.sqrt(power)))


def _ordinary_note(candidate: Candidate, values: Mapping[str, ParameterEstimate]) -> str:
    ordinary = candidate.feature.effect.ordinary
    assert ordinary is not None
    numbers = {name: estimate.value for name, estimate in values.items()}
    return ordinary.note({**numbers, **candidate.feature.choices}, candidate.feature.joint or "all joints")


def eliminate(
    prepared: PreparedData, hypothesis: Hypothesis, measure: GapMeasure, known: Mapping[Key, str] | None = None
) -> tuple[Hypothesis, list[str]]:
    """Leave out causes that do not pass, worst first, and return notes on those too small.

    In the place of one with an impossible number goes an effect that is known to be confused with it: friction that
    bends at no speed reached is Coulomb friction.

    Parameters
    ----------
    prepared
        Data and regressors.
    hypothesis
        To judge.
    measure
        What the gap is measured by.
    known
        Notes on causes, by key, whose numbers are known to be impossible.
    """
    notes: list[str] = []
    refused = set(known or ())
    while hypothesis.causes:
        keys = {k: hypothesis.selected[k].feature.key for k in hypothesis.causes}
        shares = {k: measure.contribution(hypothesis.selected, k) for k in hypothesis.causes}
        failed = {k: share for k, share in shares.items() if not passes(prepared, hypothesis, k, share, measure)}
        failed = failed or {k: 0.0 for k in insignificant(prepared, hypothesis) if k in hypothesis.causes}
        outside = [] if failed else outside_their_ranges(prepared, hypothesis)
        impossible = dict(known or {})
        if not failed and not outside:
            impossible |= prepared.sizes.notes(hypothesis, prepared.estimates.parameters(hypothesis.selected))
        unlikely = {} if failed else {k: shares[k] for k, key in keys.items() if k in outside or key in impossible}
        failed = failed or unlikely
        if not failed:
            break
        worst = min(failed, key=lambda k: failed[k])
        if worst in unlikely:
            refused.add(keys[worst])
            other = in_its_place(prepared, hypothesis, worst, refused)
            if other is not None:
                hypothesis = other
                continue
            notes += [impossible[keys[worst]]] if keys[worst] in impossible else []
        if failed[worst] > 0.0 and is_small_effect(prepared, hypothesis, worst, failed[worst], measure):
            feature, least = hypothesis.selected[worst].feature, prepared.settings.judgement.least_shrink
            notes.append(small_effect_note(feature, failed[worst], least))
        hypothesis = hypothesis.drop(worst)
    return hypothesis, notes


def in_its_place(prepared: PreparedData, hypothesis: Hypothesis, k: int, refused: Collection[Key]) -> Hypothesis | None:
    """Return the hypothesis with what cause k is known to be confused with; None where nothing is worth it.

    Parameters
    ----------
    prepared
        Data and regressors.
    hypothesis, k
        That holds the cause, and its position.
    refused
        Keys of effects that are not to be taken.
    """
    search = StepwiseSearch(prepared.library, hypothesis.baseline, prepared.settings, prepared.sizes)
    return search.replaced(hypothesis, k, refused)


def passes(prepared: PreparedData, hypothesis: Hypothesis, k: int, share: float, measure: GapMeasure) -> bool:
    """Whether a cause is large enough, and makes the residual smaller in the resamples of both data sets.

    Parameters
    ----------
    prepared
        Data and regressors.
    hypothesis
        That holds it.
    k
        Its position.
    share
        What it takes off the gap beside the others.
    measure
        What the gap is measured by.
    """
    settings, library = prepared.settings, prepared.library
    without = hypothesis.without(k)
    if not hypothesis.selected[k].feature.effect.parameters:
        worth = settings.search.least_gain * misfit(library, hypothesis.selected)
        return gain(prepared, hypothesis.selected, without) > worth
    if share < settings.judgement.least_shrink and not is_minor(prepared, hypothesis, k, share, measure):
        return False
    if hypothesis.selected[k].feature.key in hypothesis.beyond:
        return True
    # What acts in few moments has few blocks that show it: then those of the fit's own motion count too, fitted on
    # the validation data. And a cause that only some of the recordings have is one on the validation data alone.
    on_fit, on_validation = library.falls(without, hypothesis.selected)
    resampling = settings.resampling
    bounds = [
        lower_bound(falls, resampling, resampling.fall_seed)
        for falls in (on_validation, np.append(on_fit, on_validation))
    ]
    return max(bounds) > 0.0


def is_minor(prepared: PreparedData, hypothesis: Hypothesis, k: int, share: float, measure: GapMeasure) -> bool:
    """Whether a cause too small by itself is there beyond doubt, and something would be missing without it.

    A simulator needs all terms of a friction law, and the friction of every joint, not the largest ones alone. And
    without what makes a good part of a joint's own gap, that joint stays unexplained: of a wrist beside a shoulder that
    is less than any share of the whole.

    Parameters
    ----------
    prepared
        Data and regressors.
    hypothesis
        That holds it.
    k
        Its position.
    share
        What it takes off the gap beside the others.
    measure
        What the gap is measured by.
    """
    if not is_small_effect(prepared, hypothesis, k, share, measure):
        return False
    feature, others = hypothesis.selected[k].feature, [candidate.feature for candidate in hypothesis.without(k)]
    if feature.effect.is_friction and any(
        other.effect.is_friction and (other.joint == feature.joint or other.effect.id == feature.effect.id)
        for other in others
    ):
        return True
    return measure.place_contribution(hypothesis.selected, k) >= prepared.settings.judgement.place_explained


def insignificant(prepared: PreparedData, hypothesis: Hypothesis) -> list[int]:
    """Return the candidates whose parameters may be no effect: each, and where there are several, together.

    Beside nuisance parameters also those that are smaller than any that an engineer would look for.
    """
    failed = prepared.estimates.insignificant(hypothesis.selected)
    if len(prepared.library.nuisance):
        estimated = prepared.estimates.parameters(hypothesis.selected)
        failed |= {k for k, c in enumerate(hypothesis.selected) if _is_tiny(c, estimated[k])}
    return sorted(failed)


def _is_tiny(candidate: Candidate, values: Mapping[str, ParameterEstimate]) -> bool:
    """Whether all sizes of an effect are below their ranges."""
    effect = candidate.feature.effect
    sizes = [effect.parameter(name) for name in effect.magnitude]
    small = [p for p in sizes if p.size == 1 and p.neutral == 0.0 and p.low > 0.0 and p.name in values]
    return bool(sizes) and len(small) == len(sizes) and all(abs(values[p.name].value) < p.low for p in small)


def outside_their_ranges(prepared: PreparedData, hypothesis: Hypothesis) -> list[int]:
    """Return the causes with a searched number outside its range, none where there are no nuisance parameters.

    Beside those such an effect stands in for a detail that neither the model nor they describe, or for another effect.
    """
    if not len(prepared.library.nuisance):
        return []
    settings, found = prepared.settings.judgement, []
    for k in hypothesis.causes:
        effect, values = hypothesis.selected[k].feature.effect, prepared.estimates.parameters(hypothesis.selected)[k]
        searched = [p for p in effect.parameters if p.role is Role.SEARCHED and p.size == 1 and p.name in values]
        if any(not p.is_within(values[p.name].value, settings.beyond_range) for p in searched):
            found.append(k)
    return found


def is_small_effect(prepared: PreparedData, hypothesis: Hypothesis, k: int, share: float, measure: GapMeasure) -> bool:
    """Whether an effect is there beyond doubt and yet too small a part of the gap to be a cause.

    Parameters
    ----------
    prepared
        Data and regressors.
    hypothesis
        That holds it.
    k
        Its position.
    share
        What it takes off the gap beside the others.
    measure
        What the gap is measured by.
    """
    # To a large gap elsewhere, nuisance parameters that move with the effect may add more than it takes away.
    helps = share > 0.0 or measure.place_contribution(hypothesis.selected, k) > 0.0
    if share >= prepared.settings.judgement.least_shrink or not helps:
        return False
    worth = prepared.settings.significance.detected * misfit(prepared.library, hypothesis.selected)
    return gain(prepared, hypothesis.selected, hypothesis.without(k)) > worth
