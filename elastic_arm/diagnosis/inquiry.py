"""From columns to answer: search for causes, judge them as the contract asks, and put the result in words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.context import DiagnosisContext
from elastic_arm.diagnosis.format import estimates_text, separated_by
from elastic_arm.diagnosis.inference import excess as shrinking
from elastic_arm.diagnosis.inference.estimates import ParameterEstimate, certain, differs, estimates, polish, several
from elastic_arm.diagnosis.inference.gap_metric import DETECTED, Excess, Likelihood, Measure
from elastic_arm.diagnosis.inference.lack_of_fit import LackOfFit, lack_of_fit
from elastic_arm.diagnosis.inference.regimes import regime, shares
from elastic_arm.diagnosis.result import Alternative, Cause, Diagnosis, ResidualSizes, UnexplainedResidual
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.selection.stepwise import ENOUGH, Hypothesis, Rival, Search, misfit
from elastic_arm.dynamics import Model
from elastic_arm.effects import Effect, EffectInstance
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.observation import Observation

Array = NDArray[np.float64]
Seen = tuple[tuple[Observation, ...], tuple[Observation, ...]]

WORTH = 0.01  # of the whole gap: less is no cause
EXPLAINED = 0.1  # of the excess may be left whatever it looks like
MAINLY = 0.1  # of what a cause does: less in a residual is not what it is judged by
TRACED = 0.1  # of the strongest structure's log-likelihood: fainter ones are its reflections in other residuals
LISTED = 0.01  # alternatives less probable than this are not worth a line


class Inquiry:
    """Search, judgement and wording for one library of columns."""

    def __init__(
        self, model: Model, library: RegressorLibrary, given: list[Candidate], seen: Seen, *, held_back: bool
    ) -> None:
        self.model, self.library, self.judge, self.given, self.seen = model, library, library.sets[1], given, seen
        self.rate = max(o.rate for o in seen[0])
        self.held_back = held_back
        self.notes: list[str] = []
        self._structures: dict[tuple[Candidate, ...], list[LackOfFit]] = {}

    def answer(
        self, *, identify: tuple[str, ...], validate: tuple[str, ...], independent_motion: bool, notes: Iterable[str]
    ) -> Diagnosis:
        """Return the diagnosis."""
        explanation = self._searched()
        measure = self._measure(explanation)
        judged = self._judged(explanation, measure)
        # What is measured before any cause is measured as it was while causes were sought.
        baseline = judged.selected[: judged.given]
        log_likelihood = self._gained(judged.selected, baseline)
        explanation = self._polished(judged)
        selected = explanation.selected
        if len(selected) == len(baseline):
            measure = self._measure(judged)
        estimated = estimates(self.library, selected)
        self._say_known(selected, estimated)
        causes, found_as = self._causes(explanation, estimated, measure)
        shrink, interval = measure.share(selected)
        stands_out = measure.stands_out(selected)
        traces = [] if stands_out else self._traces(selected)
        verdict = self._verdict(shrink, explanation, unexplained=stands_out or bool(traces))
        if verdict == "unknown":
            causes = [cause.less_sure(max(shrink, 0.0)) for cause in causes]
        before_values, after_values = self._left(baseline), self._left(selected)
        before, after = measure.before, shrinking.figures(self.judge, after_values, measure.before.band)
        regimes = tuple(shares(self.judge, before_values, row, self._ratios(row)) for row in range(len(before.rmse)))
        if not independent_motion:
            self.notes.append("The validation data repeat the motion of the fit: it is not an independent motion.")
        return Diagnosis(
            model=self.model.name,
            robot=self.model.robot.name,
            joints=self.model.robot.joint_names,
            identify=identify,
            validate=validate,
            independent_motion=independent_motion,
            band=before.band,
            verdict=verdict,
            noise=dict(zip(self._places(), before.noise.tolist(), strict=True)),
            before=self._size(before),
            after=self._size(after),
            shrink=None if verdict == "none" else shrink,
            shrink_interval=None if verdict == "none" else interval,
            measured_by=measure.name,
            log_likelihood=log_likelihood,
            causes=tuple(causes),
            unexplained=tuple(self._unexplained(before, after, after_values, traces)) if verdict == "unknown" else (),
            notes=(*notes, *self.notes),
            ladder=self._ladder(measure, selected[: explanation.given], [candidate for candidate, _, _ in found_as]),
            context=DiagnosisContext(
                model=self.model,
                validate=self.judge,
                before=before_values,
                after=after_values,
                selected=tuple(candidate for candidate, _, _ in found_as),
                alone=tuple(alone for _, _, alone in found_as),
                regimes=regimes,
                library=self.library,
                seen=self.seen,
                held_back=self.held_back,
                given=tuple(selected[: explanation.given]),
                known=self._actives(selected[: explanation.given]),
                rivals=tuple(tuple(r.candidate for r in rivals) for _, rivals, _ in found_as),
            ),
        )

    def _searched(self) -> Hypothesis:
        """Return the best explanation of what stands out of the noise by size, or at least by likelihood."""
        search = Search(self.library, self.given)
        by_size = shrinking.select_band(shrinking.statistics_in_bands(self.judge, self._left(self.given)))
        if by_size is None and search.strongest() <= DETECTED:
            return Hypothesis(list(self.given), len(self.given))
        return self._without_ordinary(search.run())

    def _measure(self, explanation: Hypothesis) -> Measure:
        """Return what the gap is measured by: residuals where any stands out by its size, else likelihood."""
        baseline = explanation.selected[: explanation.given]
        tried = shrinking.statistics_in_bands(self.judge, self._left(baseline))
        shown = self._rows(explanation)
        if shrinking.select_band(tried) is not None:
            marked = self._marked(tried, explanation, shown)
            by_size = shrinking.select_band(marked, shown)
            assert by_size is not None  # marking takes nothing away
            return Excess(self.library, by_size, marked)
        traces = self._traces(baseline)
        before = shrinking.band_of_largest_excess(tried, traces[0].row) if traces else tried[0]
        left = max((trace.gain for trace in self._traces(explanation.selected)), default=0.0)
        return Likelihood(self.library, before, baseline, explanation.selected, left)

    def _marked(
        self, tried: Sequence[shrinking.ResidualStatistics], explanation: Hypothesis, shown: Sequence[NDArray[np.bool_]]
    ) -> list[shrinking.ResidualStatistics]:
        """Count residuals in which causes show and that they make smaller as significant, even if not by size alone."""
        selected = explanation.selected
        given = selected[: explanation.given]
        if not shown or self._gained(selected, given) < DETECTED:
            return list(tried)
        after = shrinking.statistics_in_bands(self.judge, self._left(selected))
        somewhere = np.any(shown, axis=0)
        return [b.of(b.significant | (somewhere & shrinking.improved(b, a))) for b, a in zip(tried, after, strict=True)]

    def _rows(self, explanation: Hypothesis) -> list[NDArray[np.bool_]]:
        """Return the residuals (R,) in which each cause shows most."""
        selected, found = explanation.selected, []
        left = self._left(selected)
        for k in range(explanation.given, len(selected)):
            without = self._left([*selected[:k], *selected[k + 1 :]])
            power = sum(np.sum((a - b) ** 2, axis=0) for a, b in zip(without, left, strict=True))
            found.append(power > MAINLY * np.sum(power))
        return found

    def _traces(self, selected: Sequence[Candidate]) -> list[LackOfFit]:
        """Return what the remainder follows where it is not noise, be it too faint to show by its size."""
        key = tuple(selected)
        if key not in self._structures:
            ratios = [self._ratios(joint) for joint in range(self.model.n)]
            self._structures[key] = lack_of_fit(self.library, selected, ratios)
        found = self._structures[key]
        return [structure for structure in found if structure.gain > max(DETECTED, TRACED * found[0].gain)]

    def _polished(self, explanation: Hypothesis) -> Hypothesis:
        return Hypothesis(polish(self.library, explanation.selected), explanation.given, explanation.rivals)

    def _gained(self, selected: Sequence[Candidate], without: Sequence[Candidate]) -> float:
        return self.library.held_out(selected) - self.library.held_out(without)

    def _left(self, selected: Sequence[Candidate]) -> list[Array]:
        return shrinking.remaining(self.judge, selected, self.library.fit(0, selected))

    def _without_ordinary(self, explanation: Hypothesis) -> Hypothesis:
        """Count what every real arm has, such as lags of a sample, as part of the model: it is no cause."""
        estimated = estimates(self.library, polish(self.library, explanation.selected))
        ordinary_ones, causes = [], []
        for k in range(explanation.given, len(explanation.selected)):
            candidate, values = explanation.selected[k], estimated[k]
            ordinary = candidate.feature.effect.ordinary
            if ordinary is not None and self._is_ordinary(candidate.feature.effect, values):
                numbers = {name: estimate.value for name, estimate in values.items()}
                place = candidate.feature.joint or "all joints"
                self.notes.append(ordinary.note({**numbers, **candidate.feature.choices}, place))
                ordinary_ones.append(k)
            else:
                causes.append(k)
        order = [*range(explanation.given), *ordinary_ones, *causes]
        moved = {order.index(k): v for k, v in explanation.rivals.items() if k in causes}
        return Hypothesis([explanation.selected[k] for k in order], explanation.given + len(ordinary_ones), moved)

    def _is_ordinary(self, effect: Effect, values: Mapping[str, ParameterEstimate]) -> bool:
        """Whether there is no more of an effect, to two standard deviations, than any real arm has."""
        if effect.ordinary is None or effect.ordinary.parameter not in values:
            return False
        found, neutral = values[effect.ordinary.parameter], effect.parameter(effect.ordinary.parameter).neutral or 0.0
        return bool(abs(found.value - neutral) <= effect.ordinary.most(self.rate) + 2 * (found.std or 0.0))

    def _judged(self, explanation: Hypothesis, measure: Measure) -> Hypothesis:
        """Leave out, worst first, causes that do not pass the contract's conditions."""
        selected, rivals = list(explanation.selected), dict(explanation.rivals)
        while len(selected) > explanation.given:
            shares = {}
            for k in range(explanation.given, len(selected)):
                without = selected[:k] + selected[k + 1 :]
                share = measure.contribution(selected, k)
                if not self._worthy(selected, without, k, share):
                    shares[k] = share
            if not shares:
                shares = {k: 0.0 for k in self._doubtful(selected) if k >= explanation.given}
            if not shares:
                break
            worst = min(shares, key=lambda k: shares[k])
            self._mention(selected, worst, shares[worst])
            selected.pop(worst)
            rivals = {k - (k > worst): v for k, v in rivals.items() if k != worst}
        return Hypothesis(selected, explanation.given, rivals)

    def _doubtful(self, selected: Sequence[Candidate]) -> list[int]:
        """Return which candidates may as well be no effect: each, and where there are several numbers, together."""
        polished = polish(self.library, selected)
        estimated = estimates(self.library, polished)
        doubtful = [k for k, candidate in enumerate(selected) if not differs(estimated[k], candidate)]
        together = certain(self.library, polished) if doubtful else []
        return [k for k in doubtful if not (several(estimated[k]) and together[k])]

    def _say_known(self, selected: Sequence[Candidate], estimated: Sequence[dict[str, ParameterEstimate]]) -> None:
        """Note what the effects that count as part of the model came out as: only their kind was given."""
        for candidate, values in list(zip(selected, estimated, strict=True))[: len(self.given)]:
            fitted = f", fitted with {estimates_text(values)}" if values else ""
            self.notes.append(f"Known: {_of_place(candidate.feature)}{fitted}.")

    def _mention(self, selected: Sequence[Candidate], k: int, share: float) -> None:
        """Note an effect that is there without doubt and yet too small a part of the gap to be a cause."""
        without = [*selected[:k], *selected[k + 1 :]]
        gain = self._gained(selected, without)
        if 0.0 < share < WORTH and gain > DETECTED * misfit(self.library, selected):
            self.notes.append(
                f"{_of_place(selected[k].feature)} shows as well, {share:.2%} of the gap: "
                f"less than {WORTH:.0%} is no cause."
            )

    def _worthy(self, selected: Sequence[Candidate], without: Sequence[Candidate], k: int, share: float) -> bool:
        if not selected[k].feature.effect.parameters:
            return self._gained(selected, without) > ENOUGH * misfit(self.library, selected)
        if share < WORTH:
            return False
        # What acts in few moments has few blocks that say so: then those of the fit's own motion speak too, fitted on
        # the validation data. And a cause that only some of the recordings have is one on the validation data alone.
        on_fit, on_validation = self.library.falls(without, selected)
        return max(shrinking.lowest(on_validation), shrinking.lowest(np.append(on_fit, on_validation))) > 0.0

    def _causes(
        self, explanation: Hypothesis, estimated: Sequence[dict[str, ParameterEstimate]], measure: Measure
    ) -> tuple[list[Cause], list[tuple[Candidate, list[Rival], list[Array]]]]:
        """Return the causes, most important first, and each candidate with its rivals and what it leaves alone."""
        selected = explanation.selected
        if len(selected) == explanation.given:
            return [], []
        coefficients = self._coefficients(selected)
        found = []
        for k in range(explanation.given, len(selected)):
            candidate, rivals = selected[k], explanation.rivals.get(k, [])
            alone = [*selected[: explanation.given], candidate]
            cause = self._cause(candidate, estimated[k], measure.share(alone)[0], rivals, coefficients[k])
            found.append((cause, (candidate, rivals, self._left(alone))))
        found.sort(key=lambda item: -item[0].shrink)
        return [cause for cause, _ in found], [as_candidate for _, as_candidate in found]

    def _coefficients(self, selected: Sequence[Candidate]) -> list[list[float]]:
        """Return the coefficients of each candidate's columns."""
        beta, found, first = self.library.fit(0, selected), [], 0
        for candidate in selected:
            size = candidate.columns.stop - candidate.columns.start
            found.append([float(v) for v in beta[first : first + size]])
            first += size
        return found

    def _ladder(self, measure: Measure, baseline: list[Candidate], causes: list[Candidate]) -> tuple[float, ...]:
        """Return how far the gap shrinks with the first cause, the first two, and so on."""
        return tuple(measure.share([*baseline, *causes[: k + 1]])[0] for k in range(len(causes)))

    def _cause(
        self,
        candidate: Candidate,
        estimate: dict[str, ParameterEstimate],
        share: float,
        rivals: list[Rival],
        coefficients: list[float],
    ) -> Cause:
        feature = candidate.feature
        confidence = 1.0 / (1.0 + sum(r.odds for r in rivals))
        alternatives = tuple(
            Alternative(
                r.candidate.feature.effect.id,
                r.candidate.feature.joint,
                r.odds * confidence,
                separated_by(feature.effect, r.candidate.feature.effect, feature.joint, r.candidate.feature.joint),
            )
            for r in rivals
            if r.odds * confidence >= LISTED
        )
        return Cause(
            feature.effect.id,
            feature.joint,
            tuple(side for side in feature.sides if side in self.library.sets[0].layout.sides) or feature.sides,
            feature.effect.regime,
            estimate,
            share,
            confidence,
            alternatives,
            feature.active(coefficients, candidate.searched or ()),
        )

    def _actives(self, selected: Sequence[Candidate]) -> tuple[EffectInstance, ...]:
        """Return the selected as the simulator takes them."""
        coefficients = self._coefficients(selected)
        return tuple(e.feature.active(c, e.searched or ()) for e, c in zip(selected, coefficients, strict=True))

    def _verdict(self, shrink: float, explanation: Hypothesis, *, unexplained: bool) -> str:
        """Say whether the causes explain the gap.

        Where the gap is faint, the excess that is left is known to a part of it only: then it must look like noise.
        """
        caused = len(explanation.selected) > explanation.given
        if caused and shrink >= 1.0 - EXPLAINED:
            return "explained"
        if unexplained:
            return "unknown"
        return "explained" if caused else "none"

    def _unexplained(
        self,
        before: shrinking.ResidualStatistics,
        after: shrinking.ResidualStatistics,
        values: Sequence[Array],
        traces: Sequence[LackOfFit],
    ) -> list[UnexplainedResidual]:
        places = self._places()
        if traces:
            return [UnexplainedResidual(*places[trace.row], trace.regime, trace.rmse) for trace in traces]
        total = before.excess[before.significant].sum()
        rows = [int(r) for r in np.argsort(-after.excess) if before.significant[r] and after.excess[r] > WORTH * total]
        return [
            UnexplainedResidual(
                joint, side, regime(shares(self.judge, values, r, self._ratios(r))), float(after.rmse[r])
            )
            for r in rows
            for joint, side in [places[r]]
        ]

    def _places(self) -> list[tuple[str, str]]:
        return [(joint, side) for side in self.judge.layout.sides for joint in self.model.robot.joint_names]

    def _size(self, figures: shrinking.ResidualStatistics) -> ResidualSizes:
        places = self._places()
        return ResidualSizes(
            dict(zip(places, figures.rmse.tolist(), strict=True)), dict(zip(places, figures.peak.tolist(), strict=True))
        )

    def _ratios(self, row: int) -> tuple[float, float]:
        gear = self.model.robot.joints[row % self.model.n].transmission
        return (gear.harmonic_drive_ratio, gear.r_tot) if gear else (1.0, 1.0)


def _of_place(feature: Feature) -> str:
    return f"{feature.effect.id} of {feature.joint or 'the whole arm'}"
