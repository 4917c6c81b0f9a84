"""What a diagnosis does with faint gaps: structure that no cause explains, and causes that are judged together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from elastic_arm.codegen import recursion
from elastic_arm.diagnosis.inference import judgement
from elastic_arm.diagnosis.inference.estimates import ParameterEstimate, certain, differs, estimates
from elastic_arm.diagnosis.inference.excess import ResidualStatistics, band_of_largest_excess, select_band
from elastic_arm.diagnosis.inference.judgement import is_small_effect
from elastic_arm.diagnosis.inference.lack_of_fit import lack_of_fit
from elastic_arm.diagnosis.result import Alternative, Cause
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis
from elastic_arm.diagnosis.selection.marginalisation import NuisanceColumns
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.diagnosis.texts.notes import small_effect_note
from elastic_arm.effects import parse
from elastic_arm.effects.parameters import Parameter, Role
from elastic_arm.estimation.regressors import Signals
from elastic_arm.robot import load_robot
from tests.helpers.moved_joints import COUNT, JOINT, MOTOR, SENSOR, Moved, Torque

Array = NDArray[np.float64]


# --- structure that no cause explains

SETTINGS = DiagnosisSettings()
DETECTED, CLEAR = SETTINGS.significance.detected, SETTINGS.significance.clear
WORTH, LEVEL = SETTINGS.judgement.least_shrink, SETTINGS.judgement.level
RATIOS = [(121.0, 363.0)] * 2


def library_with(torque: Torque, sides: dict[str, float]) -> RegressorLibrary:
    data: Any = [Moved(seed, torque, sides) for seed in (1, 2)]
    library = RegressorLibrary(*data, SETTINGS.candidates)
    library.add(cause_of(nothing), ())  # the matrices are made with the first column
    library.close()
    return library


def cause_of(law: Torque) -> Any:
    return SimpleNamespace(law=law)


def nothing(signals: Signals) -> Array:
    return np.zeros(COUNT)


def velocity(signals: Signals) -> Array:
    """Velocity of motor 2."""
    return signals.values["dx"][:, 2 + JOINT]


def drag(signals: Signals) -> Array:
    """A torque that grows with the square of the velocity."""
    w = velocity(signals)
    return np.asarray(0.3 * w * np.abs(w))


def viscous(library: RegressorLibrary) -> Candidate:
    candidate = library.add(cause_of(velocity), ())
    library.close()
    return candidate


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_has_no_structure(seed: int) -> None:
    """Of all regimes at all places none comes near what counts as detected."""
    data: Any = [Moved(10 * seed + k, nothing, {}) for k in (1, 2)]
    library = RegressorLibrary(*data, SETTINGS.candidates)
    library.add(cause_of(nothing), ())
    library.close()
    assert lack_of_fit(library, [], RATIOS, SETTINGS)[0].gain < 0.6 * DETECTED


@pytest.mark.parametrize(
    ("regime", "shape"),
    [
        ("rotor_angle", lambda s: np.sin(363.0 * s.values["x"][:, 2 + JOINT] + 0.4)),
        ("velocity_reversal", lambda s: s.values["sign_motor"][:, JOINT]),
    ],
)
def test_what_is_too_faint_to_stand_out_is_found_by_what_it_follows(regime: str, shape: Torque) -> None:
    """A torque that adds some hundredths to a residual's power is placed, named and sized by its regime."""
    library = library_with(lambda s: 0.09 * shape(s), {"motor": 1.0})
    added = float(np.mean(library.sets[1].added ** 2))  # type: ignore[attr-defined]
    assert added < 0.06 * (SENSOR**2 + MOTOR**2)
    found = lack_of_fit(library, [], RATIOS, SETTINGS)[0]
    assert (found.row, found.regime) == (2 * 2 + JOINT, regime)
    assert found.gain > DETECTED
    assert found.rmse == pytest.approx(np.sqrt(added), rel=0.35)


def test_an_error_of_a_torque_sensor_is_sought_in_its_three_equations_together() -> None:
    """What hides in the noise that three equations share shows by their common pattern, in no equation alone."""
    size = 0.06
    shared = {"link": 1.0, "drive": 1.0, "motor": -1.0}
    found = lack_of_fit(library_with(lambda s: size * s.values["sign_link"][:, JOINT], shared), [], RATIOS, SETTINGS)[0]
    assert found.gain > DETECTED
    assert (found.row, found.regime) == (JOINT, "velocity_reversal")  # said of the link's equation
    assert found.rmse == pytest.approx(size, rel=0.35)


def test_what_the_causes_explain_is_no_structure() -> None:
    """Viscous friction stands out where nothing explains it, and leaves nothing once it is a cause."""
    library = library_with(lambda s: 0.3 * velocity(s), {"motor": 1.0})
    assert lack_of_fit(library, [], RATIOS, SETTINGS)[0].gain > 5 * DETECTED
    candidate = viscous(library)
    assert float(library.fit(0, [candidate])[0]) == pytest.approx(0.3, rel=0.1)
    assert lack_of_fit(library, [candidate], RATIOS, SETTINGS)[0].gain < DETECTED


def test_beside_a_cause_the_rest_is_still_found() -> None:
    """Drag with the square of the speed is left over, and placed, where a fit has taken its linear part."""
    library = library_with(drag, {"motor": 1.0})
    found = lack_of_fit(library, [viscous(library)], RATIOS, SETTINGS)[0]
    assert found.row == 2 * 2 + JOINT
    assert found.gain > DETECTED


def test_what_is_left_beside_a_cause_is_no_larger_than_what_was_there() -> None:
    """The size stated for what a cause leaves is of the order of the torque that was added."""
    library = library_with(drag, {"motor": 1.0})
    found = lack_of_fit(library, [viscous(library)], RATIOS, SETTINGS)[0]
    assert found.rmse < 2.0 * float(np.sqrt(np.mean(library.sets[1].added ** 2)))  # type: ignore[attr-defined]


def test_the_error_of_a_nuisance_parameters_column_is_no_structure() -> None:
    """Where a nuisance parameter holds a shape but for 0.1 % of its squares, that rest is what linearisation leaves."""
    data: Any = [Moved(seed, nothing, {}) for seed in (1, 2)]
    columns = []
    for k, one in enumerate(data):
        shape = one.whiten(one.plain(cause_of(velocity), ()))[:, 0]
        error = np.random.default_rng(k).standard_normal(len(shape))
        error /= np.linalg.norm(error)
        columns.append((shape + 0.03 * np.linalg.norm(shape) * error)[:, None])
        one.white -= 10.0 * error
    white = (columns[0], columns[1])
    nuisance = NuisanceColumns(white, (), np.zeros(1), np.full(1, np.inf), ("joint_2",))
    library = RegressorLibrary(*data, SETTINGS.candidates, nuisance)
    library.add(cause_of(nothing), ())
    library.close()
    assert lack_of_fit(library, [], RATIOS, SETTINGS)[0].gain < 0.6 * DETECTED


# --- internal states of laws, with and without a compiler


@pytest.mark.parametrize("samples", [1, 199, 200, 201, 450])
def test_internal_states_are_the_same_without_a_compiler(samples: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sample by sample the recursion is that written out by hand, over whole calls and parts of one, in either way."""
    z, a, c = ca.SX.sym("z", 2), ca.SX.sym("a", 3), ca.SX.sym("c", 2)
    after = ca.vertcat(c[0] * z[0] + a[0] - 0.1 * ca.fabs(a[1]) * z[0], c[1] * z[1] + z[0] * a[2])
    step = ca.Function("step", [z, a, c], [after])
    arguments, constants = np.random.default_rng(0).standard_normal((samples, 3)), np.array([0.9, 0.8])
    expected, now = [], np.zeros(2)
    for one in arguments:
        expected.append(now)
        first = constants[0] * now[0] + one[0] - 0.1 * abs(one[1]) * now[0]
        now = np.array([first, constants[1] * now[1] + now[0] * one[2]])
    compiled = recursion.Recursion(step).run(arguments, constants)
    monkeypatch.setattr("elastic_arm.codegen.compiler.find_compiler", lambda: None)
    plain = recursion.Recursion(step)
    assert plain._compiled is None
    for found in (compiled, plain.run(arguments, constants)):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


# --- the confidence of an incomplete explanation


def test_causes_of_an_incomplete_explanation_are_less_sure_and_nothing_else() -> None:
    """Confidences of cause and alternatives fall by the same share; what was found stays."""
    instance = parse("coulomb_friction:joint_2:torque=6", load_robot(None))
    others = (Alternative("viscous_friction", "joint_2", 0.2, "slow motion"), Alternative("backlash", None, 0.1, ""))
    size = {"torque": ParameterEstimate(6.0, 0.1, "Nm")}
    cause = Cause("coulomb_friction", "joint_2", ("motor",), "velocity_reversal", size, 0.5, 0.7, others, instance)
    less = cause.less_sure(0.25)
    assert less.confidence == pytest.approx(0.175)
    assert [a.confidence for a in less.alternatives] == pytest.approx([0.05, 0.025])
    unsure = [replace(a, confidence=b.confidence) for a, b in zip(less.alternatives, others, strict=True)]
    assert replace(less, confidence=0.7, alternatives=tuple(unsure)) == cause
    assert cause.less_sure(0.0).confidence == 0.0


# --- whether a cause's parameters together differ from no effect


class Laws:
    """Laws with known columns and white noise of variance one: what a library is to the judgement of parameters."""

    def __init__(self, y: Array, blocks: int = 40) -> None:
        self.y = y
        numbers = np.arange(len(y)) * blocks // len(y)
        self.sets = (SimpleNamespace(freedom=float(len(y)), white=y, blocks=numbers, in_time=lambda white: white),)

    def matrix(self, which: int, index: Sequence[int]) -> Array:
        assert (which, list(index)) == (0, [0])
        return self.y[:, None]

    def columns(self, which: int, feature: Any, values: Sequence[float]) -> Array:
        return np.asarray(feature.law(values))[:, None]

    def marginalised(self, columns: Array, *, residual: bool = False) -> Array:
        return columns


def candidate_of(law: Callable[[Sequence[float]], Array], values: Sequence[float], *parameters: Parameter) -> Any:
    effect = SimpleNamespace(parameters=parameters)
    feature = SimpleNamespace(law=law, searched=parameters, effect=effect, unit=lambda p: p.unit)
    return SimpleNamespace(feature=feature, searched=tuple(float(v) for v in values), fixed=True)


def test_parameters_that_are_not_determined_singly_may_be_certain_together() -> None:
    """Of two numbers that act nearly alike neither interval excludes no effect, and both together do."""
    rng = np.random.default_rng(1)
    common, apart = rng.standard_normal((2, 4000)) / np.sqrt(4000)
    columns = np.stack([common, common + 0.01 * apart], axis=1)
    both = (Parameter("one", "1", -100.0, 100.0, neutral=0.0), Parameter("two", "1", -100.0, 100.0, neutral=0.0))
    laws = Laws(10.0 * common + rng.standard_normal(4000))
    values = np.linalg.lstsq(columns, laws.y, rcond=None)[0]
    candidate = candidate_of(lambda p: columns @ np.asarray(p), values, *both)
    (estimate,) = estimates(laws, [candidate], SETTINGS.judgement)  # type: ignore[arg-type]
    assert not differs(estimate, candidate, LEVEL)
    assert certain(laws, [candidate], SETTINGS.judgement) == [True]  # type: ignore[arg-type]


def chance_of_being_certain(law: Callable[[Sequence[float]], Array], fit: Callable[[Array], Any], *p: Parameter) -> int:
    """Count of 200 recordings of noise alone in which the law's fitted parameters are called certain."""
    found = 0
    for seed in range(200):
        noise = np.random.default_rng([seed, 7]).standard_normal(400)
        found += certain(Laws(noise), [candidate_of(law, fit(noise), *p)], SETTINGS.judgement)[0]  # type: ignore[arg-type, list-item]
    return found


def test_noise_is_called_certain_as_seldom_as_stated() -> None:
    """Where there is no effect, five in a hundred fits of three numbers are beyond the 95 % of chance."""
    columns = np.random.default_rng(0).standard_normal((400, 3))
    numbers = [Parameter(name, "1", -10.0, 10.0, neutral=0.0) for name in "abc"]
    count = chance_of_being_certain(
        lambda p: columns @ np.asarray(p), lambda y: np.linalg.lstsq(columns, y, rcond=None)[0], *numbers
    )
    assert 2 <= count <= 21  # binomial, 200 of 0.05: beyond with probability 1e-3 on either side


def test_coloured_noise_is_seldom_called_certain() -> None:
    """Errors that stay alike for five samples make estimates five times as variable; blocks of ten see that."""
    columns = np.repeat(np.random.default_rng(0).standard_normal((80, 3)), 5, axis=0)
    numbers = [Parameter(name, "1", -10.0, 10.0, neutral=0.0) for name in "abc"]
    found = 0
    for seed in range(200):
        noise = np.repeat(np.random.default_rng([seed, 9]).standard_normal(80), 5)
        candidate = candidate_of(
            lambda p: columns @ np.asarray(p), np.linalg.lstsq(columns, noise, rcond=None)[0], *numbers
        )
        found += certain(Laws(noise), [candidate], SETTINGS.judgement)[0]  # type: ignore[arg-type]
    assert found <= 40  # as if white it would be about 130


def test_noise_is_called_certain_as_seldom_whatever_its_phase() -> None:
    """A law with amplitude and phase is no surer of noise than others: no effect is no amplitude, at any phase."""
    angle = np.linspace(0.0, 40.0, 400)
    waves = np.stack([np.sin(angle), np.cos(angle)], axis=1)

    def fit(y: Array) -> tuple[float, float]:
        sine, cosine = np.linalg.lstsq(waves, y, rcond=None)[0]
        return float(np.hypot(sine, cosine)), float(np.arctan2(cosine, sine))

    numbers = (
        Parameter("amplitude", "1", 1e-3, 10.0, neutral=0.0),
        Parameter("phase", "rad", -np.pi, np.pi, role=Role.PHASE),
    )
    assert chance_of_being_certain(lambda p: p[0] * np.sin(angle + p[1]), fit, *numbers) <= 21


def test_what_another_cause_can_do_makes_none_certain() -> None:
    """Two causes with the same column: whatever they explain together, neither is known to be there."""
    rng = np.random.default_rng(2)
    column = rng.standard_normal(400)
    laws = Laws(3.0 * column + rng.standard_normal(400))
    size = Parameter("size", "1", -10.0, 10.0, neutral=0.0)
    alike = [candidate_of(lambda p: p[0] * column, [1.5], size) for _ in range(2)]
    assert certain(laws, alike, SETTINGS.judgement) == [False, False]  # type: ignore[arg-type]
    assert certain(laws, [candidate_of(lambda p: p[0] * column, [3.0], size)], SETTINGS.judgement) == [True]  # type: ignore[arg-type]


# --- effects that are there and too small to be causes


@pytest.mark.parametrize(
    ("share", "place", "gain", "said"),
    [
        (0.5 * WORTH, 0.0, 2.0 * DETECTED, True),
        (2.0 * WORTH, 0.0, 2.0 * DETECTED, False),  # large enough: other reasons spoke against it
        (-0.5 * WORTH, 0.0, 2.0 * DETECTED, False),  # makes the gap larger
        (-0.5 * WORTH, 0.1, 2.0 * DETECTED, True),  # of its own joint it takes a part: another one's gap is larger
        (0.5 * WORTH, 0.0, 0.9 * DETECTED, False),  # may be chance
    ],
)
def test_what_is_there_and_less_than_a_hundredth_of_the_gap_is_mentioned(
    share: float, place: float, gain: float, said: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The note names effect, place and share; what may be chance, or is no small part, is not mentioned."""
    feature = SimpleNamespace(effect=SimpleNamespace(id="torque_ripple"), joint="joint_3")
    large, small = SimpleNamespace(gain=500.0), SimpleNamespace(feature=feature, gain=gain)
    library = SimpleNamespace(held_out=lambda selected: sum(e.gain for e in selected))
    prepared: Any = SimpleNamespace(settings=SETTINGS, library=library)
    monkeypatch.setattr(judgement, "misfit", lambda library, selected: 1.0)
    measure: Any = SimpleNamespace(place_contribution=lambda selected, k: place)
    assert is_small_effect(prepared, Hypothesis([large, small]), 1, share, measure) == said
    note = small_effect_note(feature, share, WORTH)  # type: ignore[arg-type]
    assert "torque_ripple of joint_3" in note and f"{share:.2%}" in note


# --- the band in which several causes are judged


def in_band(band: float, *excess: float) -> ResidualStatistics:
    """Return figures of residuals of unit noise, all of them significant, with this much excess (Nm²)."""
    power = np.array(excess)
    ones = np.ones(len(power))
    return ResidualStatistics(band, np.sqrt(1.0 + power), ones, ones, 1e6, np.ones((2, len(power))), power > 0.0)


def rows(*shown: bool) -> NDArray[np.bool_]:
    return np.array(shown)


def test_one_cause_is_judged_in_the_widest_band_that_is_clear() -> None:
    """Bands are given widest first; the first with an excess far above the noise's own uncertainty serves."""
    wide, middle, narrow = in_band(40.0, 0.5), in_band(10.0, 2.0 * CLEAR), in_band(2.5, 50.0 * CLEAR)
    assert select_band([wide, middle, narrow], SETTINGS.significance) is middle
    assert select_band([wide.of(rows(False))], SETTINGS.significance) is None


def test_a_band_must_be_clear_for_each_of_several_causes() -> None:
    """What is plain for one cause in a wide band and for the other in a narrow one is judged in the narrow one."""
    first, second = rows(True, False), rows(False, True)
    wide, narrow = in_band(40.0, 50.0 * CLEAR, 0.1), in_band(10.0, 5.0 * CLEAR, 5.0 * CLEAR)
    assert select_band([wide, narrow], SETTINGS.significance) is wide
    assert select_band([wide, narrow], SETTINGS.significance, [first]) is wide
    assert select_band([wide, narrow], SETTINGS.significance, [first, second]) is narrow


def test_where_no_band_is_clear_for_all_the_one_that_shows_most_causes_serves() -> None:
    """Three causes of which two show in one band and one in the other: the first, however strong the one may be."""
    each = [rows(True, False, False), rows(False, True, False), rows(False, False, True)]
    strong, many = in_band(40.0, 100.0 * CLEAR, 0.0, 0.0), in_band(10.0, 0.5, 0.5, 0.0)
    assert select_band([strong, many], SETTINGS.significance, each) is many


def test_a_trace_is_shown_in_the_band_where_it_stands_highest() -> None:
    """Only its own residual counts there, significant by size or not."""
    wide, narrow = in_band(40.0, 3.0, 0.1).of(rows(True, False)), in_band(10.0, 2.0, 0.4).of(rows(False, False))
    best = band_of_largest_excess([wide, narrow], 1)
    assert best.band == 10.0
    assert best.significant.tolist() == [False, True]
