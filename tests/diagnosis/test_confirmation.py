"""What the recordings that judge gain by a cause, on made-up regressions and simulated arms."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from elastic_arm.diagnosis.answer import _explained
from elastic_arm.diagnosis.causes import Causes
from elastic_arm.diagnosis.confirmation import (
    Confirmation,
    Share,
    has_size,
    held_out,
    taking_over,
)
from elastic_arm.diagnosis.confirmed_set import _taken_out
from elastic_arm.diagnosis.decomposition import Decomposition
from elastic_arm.diagnosis.preparation import prepare
from elastic_arm.diagnosis.question import Question
from elastic_arm.evidence.explanation import Explanation, weighted
from elastic_arm.evidence.fit import Fit
from elastic_arm.evidence.watch import Watch
from tests.evidence.made_up import HARMONICS, Array, model, term
from tests.helpers.gap_recordings import ROBOT, motions, record

ROWS = 4 * HARMONICS


def fits(amplitude_judging: float) -> tuple[Fit, Fit]:
    """Return the fits with and without a law whose size in the judging half is this, and 3 in the
    fitted half."""
    rng = np.random.default_rng(3)
    column = rng.standard_normal(ROWS)
    fitted = np.arange(ROWS) % (2 * HARMONICS) < HARMONICS
    size = np.where(fitted, 3.0, amplitude_judging)
    y = 0.5 * rng.standard_normal(ROWS) + size * column
    data = model(y, fitted_rows=fitted)
    return data.fit([term("law", column, 10.0)]), data.fit([])


def test_a_law_of_both_recordings_gains_on_those_that_judge() -> None:
    with_it, without = fits(3.0)
    assert held_out(with_it) - held_out(without) > 20.0


def test_a_law_that_fits_one_recording_loses_on_the_other() -> None:
    with_it, without = fits(-3.0)
    gain = held_out(with_it) - held_out(without)
    assert gain < 0.0
    assert not Confirmation(gain, None).confirms


def test_another_set_may_be_the_most_probable_one_without_a_refused_cause() -> None:
    """A law that is probable only beside the refused cause leaves together with it: otherwise it
    and the law that replaces it are both causes, and the corrected arm has twice the friction."""
    rng = np.random.default_rng(4)
    law, other, rest = rng.standard_normal((3, ROWS))
    rest *= 0.3
    data = model(law + rest + 0.1 * rng.standard_normal(ROWS), fitted_rows=np.ones(ROWS, bool))
    true = term("true", law, 10.0)
    similar = term("similar", law + other, 10.0)
    refused = term("refused", rest - other, 10.0)
    best = data.fit([similar, refused])
    sets = weighted([best, data.fit([true])])
    assert sets[0][1] is best
    explanation = Explanation(None, None, best, (), sets)
    less = _taken_out(Decomposition(None, explanation, None), refused).explanation
    assert less.best.keys == {true.key}
    assert less.best is less.sets[0][1]


def test_a_cause_removes_some_of_the_gap() -> None:
    """A law that gains likelihood and leaves the gap as it is, alone and beside others, explains
    what is left by chance; one that others can replace removes it alone."""
    nothing = Share(-0.04, 0.01)
    assert not Confirmation(2000.0, Share(1e-5, 1e-5), nothing).confirms
    assert Confirmation(2000.0, Share(1e-5, 1e-5), Share(0.98, 0.01)).confirms
    assert Confirmation(2000.0, Share(0.3, 0.1), nothing).confirms
    assert Confirmation(2000.0, None).confirms


def test_a_share_within_two_deviations_of_none_is_none() -> None:
    """A change of what is left changes the power of a gap by chance."""
    assert not Confirmation(10.0, Share(0.15, 0.1), Share(-0.3, 0.1)).confirms
    assert Confirmation(10.0, Share(0.25, 0.1), Share(-0.3, 0.1)).confirms


def test_sizes_are_those_of_the_fitted_recordings() -> None:
    """The judging rows count in the choice of a set, and not in the size that is quoted."""
    with_it, _ = fits(1.0)
    sized = with_it.model.of_fitted(with_it)
    (of_all,), (own,) = with_it.optional, sized.optional
    assert abs(float(sized.beta(own)[0]) - 3.0) < 0.2
    assert float(with_it.beta(of_all)[0]) < 2.8


def test_a_size_within_two_deviations_of_none_is_none() -> None:
    rng = np.random.default_rng(4)
    columns = rng.standard_normal((ROWS, 2))
    data = model(rng.standard_normal(ROWS) + columns[:, 0])
    present, absent = term("present", columns[:, 0], 3.0), term("absent", 1e-2 * columns[:, 1], 3.0)
    fit = data.fit([present, absent])
    assert has_size(fit, fit.optional[0])
    assert not has_size(fit, fit.optional[1])


def test_a_size_that_no_arm_can_have_is_none() -> None:
    """Friction that drives, or a mass below zero, fits something else."""
    rng = np.random.default_rng(5)
    column = rng.standard_normal(ROWS)
    data = model(rng.standard_normal(ROWS) - column)
    either = term("either sign", column, 3.0)
    positive = replace(either, low=np.zeros(1))
    assert has_size(data.fit([either]), either)
    assert not has_size(data.fit([positive]), positive)


def test_a_friction_curve_that_stands_for_a_cause_is_compared_by_its_price() -> None:
    """A curve that is bent once predicts as well as viscous friction: that is confirmed if the set
    is more probable with it."""
    none = Share(0.0, 0.1)
    assert Confirmation(-14.0, none, none, lead=144.0).confirms
    assert not Confirmation(-14.0, none, none, lead=0.3).confirms
    assert not Confirmation(-14.0, none, none, has_size=False, lead=144.0).confirms


def test_numbers_take_over_that_are_far_off_without_a_cause_alone() -> None:
    beside = np.array([0.5, 4.0, -1.0, 0.0])
    without = np.array([3.5, 5.0, -2.0, -9.0])
    assert taking_over(beside, without, np.array([3.0, 3.0, 3.0, 10.0])).tolist() == [0]
    assert taking_over(beside, without, np.full(4, 3.0)).tolist() == [0, 3]


def test_what_is_not_confirmed_is_no_alternative() -> None:
    """A number that could be ordinary by the judging recordings adds nothing to a cause."""
    kd = ("velocity_gain", "servo")
    scale = ("torque_constant", "servo")
    beliefs = SimpleNamespace(
        likely_in_best={kd}, sets=[(0.9, "one"), (0.1, "best")],
        likely_in=lambda fit: {scale} if fit == "one" else {kd},
    )  # fmt: skip
    for accepted, wanted in ((True, [(0.9, {scale})]), (False, [])):
        confirmed = SimpleNamespace(accepts=lambda name, known=accepted: known)
        causes = SimpleNamespace(beliefs=beliefs, confirmed=confirmed)
        assert list(Causes._sets_without(causes, kd)) == wanted  # type: ignore[arg-type]


def test_what_stands_for_a_refused_cause_in_another_set_is_confirmed_next() -> None:
    """Of the sets that remain, the one with the other effect explains the recordings, and it keeps
    the correction of its score. The rest of the best set is another one of them."""
    rng = np.random.default_rng(6)
    columns = rng.standard_normal((ROWS, 2))
    alike = columns[:, 0] + 0.1 * rng.standard_normal(ROWS)
    y = 0.5 * rng.standard_normal(ROWS) + columns @ [3.0, 3.0]
    data = model(y)
    refused, other = term("refused", columns[:, 0], 3.0), term("other", alike, 3.0)
    beside = term("beside", columns[:, 1], 3.0)
    best = data.fit([refused, beside])
    second = replace(data.fit([other, beside]), correction=2.0)
    nothing: Any = None
    explanation = Explanation(nothing, nothing, best, [best], weighted([best, second]))
    left = _taken_out(Decomposition(nothing, explanation, nothing), refused).explanation
    assert left.best.keys == second.keys
    assert left.best.score == second.score
    assert [fit.keys for _, fit in left.sets] == [second.keys, data.fit([beside]).keys]
    assert left.sets[0][0] > 0.99


def test_stated_friction_is_taken_from_a_gap_once() -> None:
    """The residuals of the description lack it already: taken out again, it would be most of the
    gap beside which a cause counts."""
    stated = {"effect": "coulomb_friction", "joint": "joint_2", "parameters": {"torque": 6.0}}
    question = Question(ROBOT.with_(effects=(stated,)), effects=())
    of_arm = "coulomb_friction:joint_2:torque=6"
    fitted, judging = (record(one, of_arm, seed=k) for k, one in enumerate(motions()))
    parts = _explained(prepare([fitted], [judging], question), question, Watch())
    assert _size(parts.friction_added) > 10.0 * _size(parts.before)
    assert _size(parts.usual_added) < 0.1 * _size(parts.before)


def _size(stretches: Sequence[Array]) -> float:
    return float(np.sqrt(sum(np.sum(np.square(y)) for y in stretches)))
