"""Sets of terms: what one more would gain, which set a search ends with, and where nonlinear
numbers come out."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elastic_arm.arrays import Array
from elastic_arm.effects.parameters import Parameter, Role
from elastic_arm.evidence.explanation import weighted
from elastic_arm.evidence.fit import LinearModel
from elastic_arm.evidence.nonlinear import refined
from elastic_arm.evidence.priors import SIZES
from elastic_arm.evidence.screen import Screen
from elastic_arm.evidence.search import ALL, SIMPLE, Search
from elastic_arm.evidence.terms.effect import EffectTerm, moved, tangent_term
from elastic_arm.evidence.terms.law import LawTerm
from elastic_arm.evidence.terms.number import NumberTerm
from elastic_arm.evidence.terms.share import ShareTerm
from elastic_arm.evidence.terms.term import Term
from tests.evidence.made_up import HARMONICS, model, quiet, term

ROWS = 4 * HARMONICS
RNG = np.random.default_rng(5)
COLUMNS = RNG.standard_normal((ROWS, 6))
N = RNG.standard_normal((ROWS, 2))
ODDS = 6.0


def search(data: LinearModel, terms: Sequence[Term]) -> Search:
    """Return a search among terms that have no nonlinear numbers."""
    # of one recording
    linear: Any = SimpleNamespace(problem=SimpleNamespace(observed=((None,), ())), which=0)
    return Search(linear, data, [Screen(data.grams, terms)])


def test_a_terms_price_and_gain_add_up_to_the_score() -> None:
    """A set scores its evidence less the prior odds of each term: adding one costs exactly its
    price."""
    y, X = quiet(RNG), term("one", COLUMNS[:, 0])
    free, dear = (model(y, N).fit([replace(X, odds=odds)]) for odds in (0.0, ODDS))
    assert dear.found.evidence == pytest.approx(free.found.evidence)
    assert free.score - dear.score == pytest.approx(ODDS)


def test_what_a_screen_foresees_is_what_the_fit_gains() -> None:
    """At the noise of the fit the gain of every kind of term is what its proposal adds to the
    score, to rounding."""
    data = model(quiet(RNG) + 0.3 * COLUMNS[:, 0], N)
    terms = [
        term("one", COLUMNS[:, 1], 0.4, odds=3.0),
        term("several", COLUMNS[:, 1:4], np.array([0.2, 1.0, 3.0]), odds=5.0),
        term("bounded", COLUMNS[:, 4], 0.5, low=np.zeros(1), odds=2.0),
        term("known", COLUMNS[:, :0], offset=0.1 * COLUMNS[:, 5], odds=1.0),
    ]
    screen, beside = Screen(data.grams, terms), term("beside", COLUMNS[:, 0], 2.0)
    for first in (data.fit([]), data.fit([beside])):
        assert (first.found.v == 1.0).all()
        gains = screen.gains(first)
        each = [data.fit([*first.terms, screen.term(k)]) for k in range(len(terms))]
        assert all((fit.found.v == 1.0).all() for fit in each)
        np.testing.assert_allclose(gains, [fit.score - first.score for fit in each], atol=1e-6)


def test_what_explains_itself_by_what_is_there_gains_nothing() -> None:
    """A column within those of the numbers takes nothing off the noise, however large its size
    could be."""
    y = quiet(RNG) + 40.0 * RNG.standard_normal(ROWS) * (np.arange(ROWS) < ROWS // 2)
    data = model(y, N)
    near = N @ [1.0, -1.0] + 1e-4 * COLUMNS[:, 0]
    screen, nothing = Screen(data.grams, [term("near", near, 1e4)]), data.fit([])
    assert screen.gains(nothing)[0] < 3.0


def test_terms_that_could_stand_for_one_another_are_related() -> None:
    """Of three terms only the one that resembles the one in the fit is related to it."""
    beside = term("beside", COLUMNS[:, 0])
    terms = [
        term("alike", COLUMNS[:, 0] + COLUMNS[:, 1]),
        term("other", COLUMNS[:, 2]),
        term("third", COLUMNS[:, 3]),
    ]
    data = model(RNG.standard_normal(ROWS) + COLUMNS[:, 0], N)
    assert Screen(data.grams, terms).related(data.fit([beside]), beside) == {0}


def test_a_size_on_another_scale_gains_what_is_foreseen() -> None:
    """The gain of another scale of a prior is the difference of the scores, to rounding."""
    data, fits = model(quiet(RNG) + 2.0 * COLUMNS[:, 0], N), {}
    for scale in (1.0, 0.1, 0.01):
        (t,) = data.fit([term("one", COLUMNS[:, :2], 30.0).scaled(scale)]).optional
        fits[scale] = data.fit([t])
    (t,) = fits[1.0].optional
    for scale in (0.1, 0.01):
        assert fits[1.0].gain_of_scale(t, scale) == pytest.approx(
            fits[scale].score - fits[1.0].score, abs=1e-6
        )


def test_a_set_without_an_effect_has_no_share_of_it_in_the_numbers() -> None:
    """Without the effect that acts in a gain's column, a set scores as if the column had been made
    without it; a gain that is far off has no more of it than an ordinary one."""
    effect = term("friction", COLUMNS[:, 0], 3.0)
    share = ShareTerm(effect.key, COLUMNS[:, [1]], np.zeros(1), numbers=(1,))
    y, other = quiet(RNG) + 0.5 * N[:, 1], term("other", COLUMNS[:, 2])
    moves = np.array([[0.0], [1.0]])

    def gain(columns: Array) -> Term:
        return NumberTerm(("gain", None, ()), columns @ moves, np.array([3.0]), along=moves)

    with_share = N + COLUMNS[:, [1]] * [0.0, 1.0]
    acting, without = model(y, with_share, shares=(share,)), model(y, N)
    assert acting.fit([other]).score == pytest.approx(without.fit([other]).score, abs=1e-6)
    assert acting.fit([gain(with_share)]).score == pytest.approx(
        without.fit([gain(N)]).score, abs=1e-6
    )
    assert acting.fit([effect]).score != pytest.approx(without.fit([effect]).score, abs=1e-3)
    for far in (other, other), (gain(with_share), gain(N)):
        gains = [
            Screen(data.grams, [one]).gains(data.fit([]))[0]
            for data, one in zip((acting, without), far, strict=True)
        ]
        assert gains[0] == pytest.approx(gains[1], abs=1e-6)


def test_terms_without_a_share_are_screened_again() -> None:
    """A second screen of a gain that lacks the share of an effect gives what the first one gave."""
    share = ShareTerm(
        term("friction", COLUMNS[:, 0]).key, COLUMNS[:, [1]], np.zeros(1), numbers=(1,)
    )
    data = model(quiet(RNG) + 0.5 * N[:, 1], N + COLUMNS[:, [1]] * [0.0, 1.0], shares=(share,))
    moves = np.array([[0.0], [1.0]])
    gain = NumberTerm(("gain", None, ()), data.N @ moves, np.array([3.0]), along=moves)
    nothing = data.fit([])
    gains = [Screen(data.grams, [gain]).gains(nothing)[0] for _ in range(3)]
    assert gains[1:] == pytest.approx([gains[0]] * 2)


def test_a_law_without_a_form_is_screened_over_its_sizes() -> None:
    """Its gain is that of the mean likelihood over the sizes it may have, the likeliest of which is
    proposed."""
    data = model(quiet(RNG) + 0.2 * COLUMNS[:, :4] @ [0.4, -0.3, 0.5, 0.2], N)
    law = LawTerm(("law", "0", ("motor", "its speed")), COLUMNS[:, :4], np.ones(4), odds=2.0)
    screen, nothing = Screen(data.grams, [law]), data.fit([])
    scores = np.array([data.fit([law.at_size(float(a))]).score - nothing.score for a in SIZES])
    (gain,) = screen.gains(nothing)
    assert gain == pytest.approx(np.logaddexp.reduce(scores), abs=1e-6)
    assert screen.term(0).std[0] == SIZES[np.argmax(scores)]


def test_the_terms_that_act_are_found_and_in_noise_none() -> None:
    """Two of six act: those two, each with its size within 4 deviations, at a probability near 1;
    in noise nothing."""
    terms = [term(f"t{k}", COLUMNS[:, k], odds=ODDS) for k in range(6)]
    noise = RNG.standard_normal(ROWS)
    for true in ({}, {1: 0.8, 4: -0.5}):
        found = search(model(noise + sum(b * COLUMNS[:, k] for k, b in true.items()), N), terms)
        best = found.run()
        assert {key[0] for key in best.keys} == {f"t{k}" for k in true}
        (p, likeliest), *_ = weighted([*found.met.values()])
        assert likeliest is best and p > 0.95
        for t in best.optional:
            std = float(np.sqrt(best.covariance(t)[0, 0]))
            assert abs(best.beta(t)[0] - true[int(t.key[0][1:])]) < 4.0 * std


def test_two_terms_take_the_place_of_one_that_resembles_their_sum() -> None:
    """A column near the sum of two comes first, and does not stay."""
    twin = COLUMNS[:, 0] + COLUMNS[:, 1] + 0.5 * COLUMNS[:, 5]
    terms = [
        *(term(f"t{k}", COLUMNS[:, k], odds=ODDS) for k in range(4)),
        term("sum", twin, odds=ODDS),
    ]
    best = search(model(RNG.standard_normal(ROWS) + COLUMNS[:, 0] + COLUMNS[:, 1]), terms).run()
    assert {key[0] for key in best.keys} == {"t0", "t1"}


def test_equal_columns_share_their_probability() -> None:
    """Of two terms with one column each has half of it, and what one set gives up the other has."""
    terms = [term(name, COLUMNS[:, 2], odds=ODDS) for name in ("a", "b")]
    found = search(model(RNG.standard_normal(ROWS) + COLUMNS[:, 2]), terms)
    found.run()
    sets = weighted([*found.met.values()])
    likely = {fit.optional[0].key[0]: p for p, fit in sets if len(fit.optional) == 1}
    assert likely["a"] == pytest.approx(0.5, abs=0.01) and likely["b"] == pytest.approx(
        0.5, abs=0.01
    )


class Bump:
    """A made-up effect: size times exp(-(w/s)²) of a speed w, with s to be searched."""

    key = ("bump", "joint", ())
    joint, phase, fixed, count = "joint", None, False, 1
    linear = (Parameter("torque", "1", 0.1, 10.0, neutral=0.0),)
    searched = (Parameter("speed", "rad/s", 0.01, 1.0, role=Role.SEARCHED),)
    bends = False
    quadratic = False


def bumps(true: float, seed: int, start: float) -> tuple[Any, LinearModel, Term]:
    """Return a linearisation, data that hold a bump of a width, and the term of one at another
    width."""
    w = np.linspace(-0.5, 0.5, ROWS)
    columns = lambda feature, theta: np.exp(-((w / theta[0]) ** 2))[:, None]  # noqa: E731
    bump: Any = Bump()
    problem = SimpleNamespace(largest_at=lambda joint: 10.0, observed=((None,), ()))
    allowed = lambda feature: list(feature.searched)  # noqa: E731
    linear: Any = SimpleNamespace(
        columns_at=lambda feature, points: np.hstack([columns(feature, one) for one in points]),
        problem=problem,
        allowed=allowed,
        which=0,
    )
    data = model(
        3.0 * columns(bump, [true])[:, 0] + np.random.default_rng(seed).standard_normal(ROWS), N
    )
    return (
        linear,
        data,
        EffectTerm(
            bump.key,
            columns(bump, [start]),
            np.array([10.0]),
            feature=bump,
            theta=(start,),
        ),
    )


@pytest.mark.parametrize("true", [0.05, 0.3])
def test_a_nonlinear_number_comes_out_within_its_deviation(true: float) -> None:
    """From the middle of its range the width of a bump is found, and is as uncertain as it comes
    out."""
    errors = []
    for seed in range(20):
        linear, data, start = bumps(true, seed, 0.1)
        found, fit = refined(linear, data, start, [], data.fit([]), scan=True)
        width = moved(Bump.searched[0], found.theta[0], float(fit.beta(found)[1]))
        errors.append(np.log(width / true) / np.sqrt(fit.covariance(found)[1, 1]))
    assert np.abs(errors).max() < 4.0 and 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.6


def test_a_nonlinear_number_is_looked_for_again() -> None:
    """A width that was found beside other terms, far off, is looked for over all its range once
    they are gone."""
    linear, data, start = bumps(0.04, 1, 0.2)
    there = tangent_term(linear, start, (0.2,), 1.0)
    found = Search(linear, data, [Screen(data.grams, [])]).run([there])
    assert found.optional[0].theta[0] == pytest.approx(0.04, rel=0.3)
    assert found.score > data.fit([there]).score + 10.0


def test_a_set_that_is_less_probable_at_its_own_linearisation_is_not_taken() -> None:
    """The search ends with the next best set, and probabilities count the first by its score
    elsewhere."""
    data = model(quiet(RNG) + 0.5 * COLUMNS[:, 0], N)
    twin = term("twin", COLUMNS[:, 0] + 0.1 * COLUMNS[:, 1], odds=2.0)
    free = search(data, [term("one", COLUMNS[:, 0], odds=2.0), twin])
    first = free.run()
    again = replace(free, met={}, own_scores={first.keys: data.fit(()).score - 50.0})
    second = again.run()
    assert {k[0] for k in first.keys} == {"one"} and {k[0] for k in second.keys} == {"twin"}
    sets = weighted([*again.met.values()])
    assert sum(p for p, fit in sets if first.keys <= fit.keys) < 1e-6


def test_a_search_by_all_moves_uses_each_of_them() -> None:
    data = model(quiet(RNG))
    assert len(search(data, [term("one", COLUMNS[:, 0])]).moves) == ALL


def test_each_move_finds_what_only_it_can() -> None:
    """From a set that one move improves, that move yields the better set."""
    one, third = term("one", COLUMNS[:, 0], odds=ODDS), term("third", COLUMNS[:, 2], odds=ODDS)
    other = term("other", COLUMNS[:, 1] + 0.5 * COLUMNS[:, 0], odds=ODDS)
    twin = term("twin", COLUMNS[:, 0] + 0.3 * COLUMNS[:, 3], odds=ODDS)
    both = term("both", one.columns[:, 0] + other.columns[:, 0], odds=ODDS)
    quietly = np.random.default_rng(3).standard_normal(ROWS)
    data, pair = model(quietly + 2.0 * COLUMNS[:, 0], N), model(quietly + both.columns[:, 0], N)
    wide = one.scaled(1.0)
    small = model(quietly + 1e-2 * COLUMNS[:, 0], N)
    for data_, terms, start, move, expected in (
        (data, [one, other], [], Search._added, {"one"}),
        (data, [one, other], [one, other], Search._dropped, {"one"}),
        (data, [one, twin], [twin], Search._exchanged, {"one"}),
        (pair, [one, other, both], [one, other], Search._two_for_one, {"both"}),
        (pair, [one, other, both, third], [both], Search._one_for_two, {"one", "other"}),
    ):
        found = search(data_, terms)
        sets = {frozenset(key[0] for key in fit.keys): fit for fit in move(found, data_.fit(start))}
        assert frozenset(expected) in sets, move.__name__
    (scaled,) = search(small, [wide])._rescaled(small.fit([wide]))
    assert scaled.optional[0].scale < 0.1 and scaled.score > small.fit([wide]).score


def test_exchanges_at_different_places_are_one_step() -> None:
    """Two wrong terms, each beside its right one, are exchanged together."""
    right = [term(name, COLUMNS[:, k], odds=ODDS) for k, name in enumerate(("a", "b"))]
    wrong = [
        term(f"not {one.key[0]}", one.columns[:, 0] + 0.1 * COLUMNS[:, 2 + k], odds=ODDS)
        for k, one in enumerate(right)
    ]
    data = model(quiet(np.random.default_rng(4)) + 2.0 * COLUMNS[:, 0] + 2.0 * COLUMNS[:, 1], N)
    found = search(data, [*right, *wrong])
    best = found.run(wrong, moves=SIMPLE)
    assert {key[0] for key in best.keys} == {"a", "b"}
    assert len(found.path) == 2


def test_alternatives_are_not_taken_together() -> None:
    """Of two terms of which each explains what a third one in the set does not need, one goes: they
    gain together little more than alone."""
    one, twin = term("one", COLUMNS[:, 0], odds=ODDS), term("twin", COLUMNS[:, 0], odds=ODDS)
    data = model(quiet(np.random.default_rng(4)) + 2.0 * COLUMNS[:, 0], N)
    found = search(data, [one, twin])
    start = data.fit([one, twin])
    dropped = [data.fit([one]), data.fit([twin])]
    assert min(fit.score for fit in dropped) > start.score + 1.0
    best = found._together(start, dropped[0], dropped[1])
    assert len(best.optional) == 1
