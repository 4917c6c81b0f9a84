"""The stepwise search and its library, on columns made up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from elastic_arm.diagnosis.selection.gram_fits import BorderedFits, EachFit, FurtherColumns
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis, Rival, misfit
from elastic_arm.diagnosis.selection.marginalisation import NuisanceColumns
from elastic_arm.diagnosis.selection.plausible_hypothesis import plausible
from elastic_arm.diagnosis.selection.ranking import Rankings
from elastic_arm.diagnosis.selection.refine import refine
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.selection.stepwise import StepwiseSearch
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.effects.parameters import Parameter, Role

Array = NDArray[np.float64]
SETTINGS = DiagnosisSettings()
ROWS = 600
COEFFICIENT = Parameter("coefficient", "1", -10.0, 10.0, neutral=0.0)


class Whitened:
    """White noise, and the named columns of made-up effects with some coefficients."""

    def __init__(self, seed: int, added: dict[str, float]) -> None:
        rng = np.random.default_rng(seed)
        self.columns = {name: rng.standard_normal(ROWS) for name in ("one", "two", "three")}
        self.columns["both"], self.columns["null"] = self.columns["one"] + self.columns["two"], np.zeros(ROWS)
        noise = rng.standard_normal(ROWS)
        self.white = noise + sum(size * self.columns[name] for name, size in added.items())
        self.blocks = np.arange(ROWS) // 20
        self.freedom = float(ROWS)
        self.phase = np.linspace(0.0, 40.0, ROWS)

    def plain(self, feature: Any, searched: Sequence[float]) -> Array:
        return feature.column(self, searched)

    def whiten(self, column: Array) -> Array:
        return column[:, None]

    def in_time(self, white: Array) -> Array:
        return white


class Rounded(Whitened):
    """The same with other rounding of every row."""

    def __init__(self, seed: int, added: dict[str, float], rounding: int) -> None:
        super().__init__(seed, added)
        self.rng = np.random.default_rng(rounding)
        self.white = self.white * self._rounding()

    def _rounding(self) -> Array:
        return 1.0 + 1e-13 * self.rng.standard_normal(ROWS)

    def whiten(self, column: Array) -> Array:
        return (column * self._rounding())[:, None]


def feature(name: str, **changed: Any) -> Any:
    """A feature with one linear parameter and one column."""
    own = {"key": (name, None, ()), "linear": (COEFFICIENT,), "searched": (), "fixed": False, "phase": None}
    own |= {"choices": {}, "quadratic": False}
    effect = SimpleNamespace(
        id=name,
        parameters=(COEFFICIENT,),
        confusions=(),
        friction=False,
        scales_friction=False,
        regressor=None,
    )
    column = lambda data, searched: data.columns[name]  # noqa: E731
    return SimpleNamespace(**{**own, "effect": effect, "joint": None, "column": column, **changed})


def library_of(added: dict[str, float], *names: str) -> tuple[RegressorLibrary, list[Candidate]]:
    data: Any = [Whitened(seed, added) for seed in (1, 2)]
    library = RegressorLibrary(*data, SETTINGS.candidates)
    candidates = [library.add(feature(name), ()) for name in names]
    library.candidates.extend(candidates)
    library.close()
    return library, candidates


def found(added: dict[str, float], *names: str, settings: DiagnosisSettings = SETTINGS) -> list[str]:
    library, _ = library_of(added, *names)
    return [c.feature.effect.id for c in StepwiseSearch(library, (), settings).run().selected]


@pytest.mark.parametrize("fixed", [False, True])
def test_further_candidates_are_judged_as_one_by_one(fixed: bool) -> None:
    """Block elimination gives each further candidate what its own fit gives, of repeated columns too."""
    library, (one, two, both) = library_of({"one": 1.0, "two": 0.3}, "one", "two", "both")
    three = library.add(feature("three"), (), fixed=fixed)
    library.close()
    null = library.add(feature("null"), ())
    library.close()
    for base in ([], [one], [one, three], [one, two, both]):
        further = [c for c in (two, both, three, null) if c not in base]
        alone = [library.held_out([*base, c]) for c in further]
        scores, _ = library.held_out_each(base, unbounded(base), [alike([c], k) for k, c in enumerate(further)])
        assert scores == pytest.approx(alone, rel=1e-9, abs=1e-9)
        for c in further:
            fit, expected = fitted_beside(library, base, c), library.coefficients([*base, c])
            off = np.abs(fit.base[:, 0] - np.concatenate([*expected[:-1], np.zeros(0)]))
            assert np.all(off <= fit.base_errors[:, 0] + 1e-12) and np.isfinite(fit.base_errors).all()
            assert np.abs(fit.further[0] - expected[-1]) <= fit.further_errors[0] + 1e-12
    repeated = fitted_beside(library, [one, two], both)
    assert np.isinf(repeated.base_errors).all() and np.isinf(repeated.further_errors).all()


def fitted_beside(library: RegressorLibrary, base: Sequence[Candidate], further: Candidate) -> EachFit:
    numbers = [c.columns.start for c in base]
    free = np.array([not c.fixed for c in base], dtype=bool)
    fits = BorderedFits(library._gram(0), np.array(numbers, dtype=int), free)
    return fits.with_each(further.index[None], np.array([further.fixed]))


def unbounded(candidates: Sequence[Candidate]) -> Any:
    return np.array([[-np.inf], [np.inf]]) + np.zeros(len(candidates))


def alike(candidates: Sequence[Candidate], first: int) -> FurtherColumns:
    """Choices of one candidate each, all of one column, numbered from `first` on."""
    columns, fixed = np.array([c.index for c in candidates]), np.array([candidates[0].fixed])
    members = np.arange(first, first + len(candidates))
    return FurtherColumns(members, columns, fixed, unbounded(members)[:, :, None])


def test_what_no_effect_can_have_is_left_out_of_the_ranking() -> None:
    """A set whose effect of one sign comes out with the other is ruled out before anything else is asked of it."""
    library, _ = library_of({"one": -1.0}, "two")
    positive = Parameter("size", "1", 0.1, 10.0, neutral=0.0)
    one = library.add(feature("one", linear=(positive,)), ())
    library.candidates.append(one)
    library.close()
    prices = {c.feature.key: 0.0 for c in library.candidates}
    rankings = Rankings(library, library.candidates[:1], prices, 0, 1.2)
    assert [trial for *_, trial in rankings.trials((one,), possible=True)] == []
    assert [trial for *_, trial in rankings.trials((one,), possible=False)] == [[one, library.candidates[0]]]
    assert not plausible(library, [one, library.candidates[0]], SETTINGS.search)


def test_coefficients_are_those_of_least_squares() -> None:
    """The library's Gram matrices give what a solver gives with the columns themselves."""
    library, candidates = library_of({"one": 1.0}, "one", "two", "three")
    columns = np.stack([library.sets[0].columns[n] for n in ("one", "two", "three")], axis=1)  # type: ignore[attr-defined]
    expected = np.linalg.lstsq(columns, library.sets[0].white, rcond=None)[0]
    np.testing.assert_allclose(np.concatenate(library.coefficients(candidates)), expected, rtol=1e-9)


def test_columns_that_are_added_beside_other_candidates_are_in_the_library_itself() -> None:
    """A library and what it is beside candidates hold the same columns, whichever of the two they were added to."""
    library, (one,) = library_of({"one": 1.0, "two": 0.3}, "one")
    beside = library.calibrated_beside([one])
    two, three = beside.add(feature("two"), ()), beside.add(feature("three"), ())
    beside.close()
    again = library.add(feature("three"), ())
    library.close()
    assert library.count == beside.count == 5
    assert library.held_out([one, two, again]) == pytest.approx(beside.held_out([one, two, three]), rel=1e-12)


def test_the_effects_that_are_there_are_selected() -> None:
    """Two of three effects act: those two are found, and in noise nothing is."""
    assert set(found({"one": 0.6, "three": -0.5}, "one", "two", "three")) == {"one", "three"}
    assert found({}, "one", "two", "three") == []


def test_a_single_wrong_effect_gives_way_to_two_right_ones() -> None:
    """A column that is the sum of two does part of the work of both; the two it stands for replace it."""
    assert set(found({"one": 1.0, "two": 0.3}, "both", "one", "two")) in ({"one", "two"}, {"both", "one"})


def test_rounding_does_not_choose_among_sets_that_span_the_same() -> None:
    """Of three columns any two are as good: the first one is taken beside the best, with any rounding of rows."""
    for rounding in range(10):
        data: Any = [Rounded(seed, {"one": 1.0, "two": 0.3}, rounding) for seed in (1, 2)]
        library = RegressorLibrary(*data, SETTINGS.candidates)
        library.candidates.extend(library.add(feature(name), ()) for name in ("both", "two", "one"))
        library.close()
        hypothesis = StepwiseSearch(library, (), SETTINGS).run()
        assert [c.feature.effect.id for c in hypothesis.selected] == ["one", "both"]


def test_a_value_that_changes_nothing_stays() -> None:
    """Beside a constant, a spring of any rest angle explains as much: no other angle is chosen by rounding."""
    rest = Parameter("rest", "rad", -3.2, 3.2, role=Role.SEARCHED)
    for rounding in range(10):
        data: Any = [Rounded(seed, {"one": 0.6, "two": 0.6}, rounding) for seed in (1, 2)]
        spring = feature(
            "spring", searched=(rest,), column=lambda data, v: data.columns["one"] - v[0] * data.columns["two"]
        )
        library = RegressorLibrary(*data, SETTINGS.candidates)
        constant, start = library.add(feature("two"), ()), library.add(spring, (0.8,))
        library.close()
        assert refine(library, [constant, start], start, SETTINGS.refinement) is start
        assert refine(library, [start], start, SETTINGS.refinement) is not start


def test_a_candidate_must_gain_what_is_asked() -> None:
    """An effect of 0.2 standard deviations gains some 20 nats: enough for 12, too little for 100."""
    dear = replace(SETTINGS, search=replace(SETTINGS.search, least_gain=100.0))
    assert found({"one": 0.25}, "one", "two") == ["one"]
    assert found({"one": 0.25}, "one", "two", settings=dear) == []


def test_a_law_of_more_numbers_that_is_the_causes_own_is_no_rival() -> None:
    """Named as confused and the very column of the cause, it is no other explanation; of as few numbers it is one."""
    for searched, count in (((COEFFICIENT,), 0), ((), 1)):
        library, _ = library_of({"one": 0.5}, "one")
        twin = feature("twin", searched=searched, column=lambda data, _: data.columns["one"])
        twin.effect.confusions = (SimpleNamespace(effect="one"),)
        library.candidates.append(library.add(twin, (3.0,) * len(searched)))
        library.close()
        settings = replace(SETTINGS, search=replace(SETTINGS.search, refinements=0))
        hypothesis = StepwiseSearch(library, (), settings).run()
        assert sum(len(rivals) for rivals in hypothesis.rivals.values()) == count


def test_rivals_are_what_nearly_explains_as_much() -> None:
    """An effect with nearly the same column is a rival, one with an independent column is not."""
    library, _ = library_of({"one": 0.5}, "one", "three")
    twin = feature("twin", column=lambda data, _: data.columns["one"] + 0.05 * data.columns["two"])
    library.candidates.append(library.add(twin, ()))
    library.close()
    hypothesis = StepwiseSearch(library, (), SETTINGS).run()
    assert len(hypothesis.selected) == 1
    assert {r.candidate.feature.effect.id for r in hypothesis.rivals[0]} <= {"one", "twin"}
    assert hypothesis.rivals[0][0].odds > 1e-3


def test_two_laws_that_need_each_other_give_way_to_two_simpler_ones() -> None:
    """Curves whose bends cancel each other are two straight laws, though neither is worth an exchange alone."""
    bent = {
        name: feature(name, joint="joint_1", searched=(COEFFICIENT,), column=lambda data, searched, k=k: _bent(data, k))
        for k, name in enumerate(("first", "second"))
    }
    for curve, straight in zip(bent.values(), ("one", "two"), strict=True):
        curve.effect.confusions = (SimpleNamespace(effect=straight),)
    data: Any = [Whitened(seed, {"one": 5.0, "two": 5.0}) for seed in (1, 2)]
    for one in data:
        one.white = one.white + 2.0 * np.sin(one.phase)
    library = RegressorLibrary(*data, SETTINGS.candidates)
    straight_laws = [library.add(feature(name, joint="joint_1"), ()) for name in ("one", "two")]
    chosen = [library.add(curve, (1.0,)) for curve in bent.values()]
    library.candidates.extend((*straight_laws, *chosen))
    library.close()
    search = StepwiseSearch(library, [], SETTINGS)
    found = search.simplified(Hypothesis(chosen))
    assert [candidate.feature.key[0] for candidate in found.selected] == ["one", "two"]


def test_a_simpler_effect_leaves_every_other_cause_with_values() -> None:
    """A payload at a stale place counts by a whole neighbourhood beside the simpler effect: it is searched there."""
    place = Parameter("place", "m", -2.0, 2.0, role=Role.SEARCHED, size=2)
    load = feature(
        "load",
        joint="joint_1",
        searched=(place,),
        column=lambda data, at: data.columns["two"] + at[0] * data.columns["three"] + at[1] * np.cos(data.phase),
    )
    curve = feature("curve", joint="joint_1", searched=(COEFFICIENT,), column=lambda data, _: _bent(data, 0))
    curve.effect.confusions = (SimpleNamespace(effect="one"),)
    data: Any = [Whitened(seed, {"one": 5.0, "two": 2.0, "three": 1.0}) for seed in (1, 2)]
    for one in data:
        # What no cause explains, else the likelihood alone decides.
        one.white = one.white + 2.0 * np.sin(one.phase)
    library = RegressorLibrary(*data, SETTINGS.candidates)
    straight, anywhere = library.add(feature("one", joint="joint_1"), ()), library.add(load, None)
    chosen = [library.add(load, (-1.5, 1.0)), library.add(curve, (1.0,))]
    library.candidates.extend((straight, anywhere, *chosen))
    library.close()
    found = StepwiseSearch(library, [], SETTINGS).simplified(Hypothesis(chosen))
    assert [candidate.feature.key[0] for candidate in found.selected] == ["load", "one"]
    assert found.selected[0].searched == pytest.approx((0.5, 0.0), abs=0.15)


def _bent(data: Any, k: int) -> Array:
    """Columns one and two, with a bend of which the two have opposite ones."""
    return np.asarray(data.columns[("one", "two")[k]] + (3.0 - 6.0 * k) * data.columns["three"])


def test_the_misfit_of_a_complete_hypothesis_is_one() -> None:
    """Whitened noise has unit mean square; an effect left out adds its power."""
    library, candidates = library_of({"one": 2.0}, "one")
    assert misfit(library, candidates) == pytest.approx(1.0, abs=0.1)
    assert misfit(library, []) == pytest.approx(5.0, rel=0.15)


def test_a_friction_that_drives_is_not_plausible() -> None:
    """A parameter that cannot be negative makes a hypothesis with a negative coefficient implausible."""
    size = Parameter("size", "Nm", 0.1, 10.0, neutral=0.0)
    for coefficient, expected in ((1.0, True), (-1.0, False)):
        library, _ = library_of({"one": coefficient}, "two")
        candidate = library.add(feature("one", linear=(size,)), ())
        library.close()
        assert plausible(library, [candidate], SETTINGS.search) == expected


@pytest.mark.parametrize(("size", "possible"), [(-0.05, True), (-1.0, False)])
def test_a_known_effect_that_is_nothing_refuses_no_cause(size: float, possible: bool) -> None:
    """Known friction of a joint without any comes out with either sign: causes are found beside it all the same.

    Clearly below zero it refuses what makes it so.
    """
    positive = Parameter("size", "Nm", 0.1, 10.0, neutral=0.0)
    library, (cause,) = library_of({"one": size, "two": 2.0}, "two")
    known = library.add(feature("one", linear=(positive,)), ())
    library.candidates[:] = [known, cause]
    library.close()
    assert float(library.fit(0, [known, cause])[0]) < 0.0
    assert plausible(library, [known, cause], SETTINGS.search, given=[known]) == possible
    found = StepwiseSearch(library, [known], SETTINGS).best()
    assert (cause in found.selected) == possible


def test_a_cause_is_found_beside_a_known_effect_that_predicts_the_other_recording_worse_than_nothing() -> None:
    """Friction that has changed between two recordings costs more likelihood than a cause brings."""
    data: Any = [Whitened(seed, {"one": size, "two": 1.0}) for seed, size in ((1, 2.0), (2, -2.0))]
    library = RegressorLibrary(*data, SETTINGS.candidates)
    known, cause, other = (library.add(feature(name), ()) for name in ("one", "two", "three"))
    library.candidates.extend((known, cause, other))
    library.close()
    assert library.held_out([known, cause]) < 0.0
    assert list(StepwiseSearch(library, [known], SETTINGS).best().selected) == [known, cause]


def test_what_nuisance_parameters_do_at_joints_of_known_effects_refuses_no_cause() -> None:
    """A number of joint a beyond what is believable refuses causes of a, not of b, though friction of a is known."""
    data: Any = [Whitened(seed, {"one": 4.0, "two": 1.0}) for seed in (1, 2)]
    white = (data[0].columns["one"][:, None], data[1].columns["one"][:, None])
    nuisance = NuisanceColumns(white, (), np.zeros(1), np.array([2.0]), ("a",))
    library = RegressorLibrary(*data, SETTINGS.candidates, nuisance)
    known, at_a, at_b = (
        library.add(feature(name, joint=joint), ()) for name, joint in (("three", "a"), ("two", "a"), ("two", "b"))
    )
    library.close()
    given, search = [known], SETTINGS.search
    assert plausible(library, [known, at_b], search, given=given)
    assert plausible(library, [replace(known), at_b], search, given=given)  # at other values of its parameters
    assert not plausible(library, [known, at_a], search, given=given)


def test_refinement_finds_a_nonlinear_parameter() -> None:
    """From the nearest value of the grid, the frequency of a wave is found to a thousandth."""
    rate = Parameter("rate", "1", 0.5, 4.0, role=Role.SEARCHED)
    wave = feature("wave", searched=(rate,), column=lambda data, searched: np.sin(searched[0] * data.phase))
    data: Any = [Whitened(seed, {}) for seed in (1, 2)]
    for one in data:
        one.white = one.white + 2.0 * np.sin(1.07 * one.phase)
    library = RegressorLibrary(*data, SETTINGS.candidates)
    start = library.add(wave, (1.05,))
    library.close()
    refined = refine(library, [start], start, SETTINGS.refinement)
    assert refined.searched is not None and refined.searched[0] == pytest.approx(1.07, rel=2e-3)


def test_rivals_follow_their_cause_when_another_is_dropped() -> None:
    """Without the first of two causes the second keeps its own rivals, at its new position."""
    rivals: Any = {1: [Rival("a", 0.1)], 2: [Rival("b", 0.2)]}  # type: ignore[arg-type]
    names: Any = ["known", "first", "second"]
    left = Hypothesis(names, 1, rivals).drop(1)
    assert (left.selected, left.baseline, list(left.causes)) == (["known", "second"], ["known"], [1])
    assert left.rivals[1][0].odds == 0.2


def test_what_another_joint_lacks_is_no_alternative() -> None:
    """An effect of another joint that gains as much beside a cause as in its place leaves the cause certain."""
    library, _ = library_of({"one": 1.0, "two": 2.0})
    apart = {"joint": "a", "key": ("one", "a", ())}, {"joint": "b", "key": ("two", "b", ())}
    cause, other = (library.add(feature(name, **own), ()) for name, own in zip(("one", "two"), apart, strict=True))
    library.candidates.extend((cause, other))
    library.close()
    search = StepwiseSearch(library, (), SETTINGS)
    (rivals,) = search.with_rivals(Hypothesis((cause,), 0)).rivals.values()
    assert all(rival.candidate is not other for rival in rivals)
