"""Named laws beside laws without a form: the right one stands, a wrong one does not, and noise follows neither."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from elastic_arm.diagnosis.laws.better_laws import _instead_of_causes
from elastic_arm.diagnosis.laws.comparison import LawComparison
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis
from elastic_arm.diagnosis.selection.marginalisation import NuisanceColumns
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.estimation.regressors import Signals
from tests.helpers.moved_joints import COUNT, JOINT, Moved, Torque

Array = NDArray[np.float64]

SETTINGS = DiagnosisSettings()
DETECTED = SETTINGS.significance.detected
JOINTS = range(2)


def speed(signals: Signals) -> Array:
    """Velocity of motor 2."""
    return signals.values["dx"][:, 2 + JOINT]


def sign(signals: Signals) -> Array:
    """Direction of motor 2."""
    return np.asarray(signals.values["sign_motor"][:, JOINT])


def stribeck(signals: Signals) -> Array:
    """Friction that dies out above 0.5 rad/s."""
    return np.asarray(np.exp(-((speed(signals) / 0.5) ** 2)) * signals.values["sign_motor"][:, JOINT])


def drag(signals: Signals) -> Array:
    """A torque that grows with the square of the speed."""
    return np.asarray(speed(signals) * np.abs(speed(signals)))


def cogging(signals: Signals) -> Array:
    """A torque that repeats over the angle of link 2, and is no sine."""
    return np.asarray(np.tanh(4.0 * np.sin(10.0 * signals.values["x"][:, JOINT])))


def nothing(signals: Signals) -> Array:
    return np.zeros(COUNT)


def moved(seed: int, torque: Torque, side: str = "motor") -> list[Any]:
    return [Moved(10 * seed + k, torque, {side: 1.0}) for k in (1, 2)]


def compared(data: Sequence[Any], *laws: Torque) -> tuple[LawComparison, list[Candidate]]:
    """Return the comparison of a hypothesis of laws on motor 2, and its candidates."""
    library = RegressorLibrary(data[0], data[1], SETTINGS.candidates)
    features: list[Any] = [SimpleNamespace(law=law, joint=None, key=(law.__name__, None, ())) for law in laws]
    selected = [library.add(feature, ()) for feature in features]
    library.add(SimpleNamespace(law=nothing, key=("nothing", None, ())), ())  # type: ignore[arg-type]
    library.close()
    return LawComparison(library, selected, SETTINGS), selected


@pytest.mark.parametrize("seed", range(4))
def test_noise_follows_no_general_law(seed: int) -> None:
    """Of all laws of all joints the likeliest is less likely than none: its coefficients cost more than they gain."""
    comparison, _ = compared(moved(seed, nothing))
    assert comparison.beside(JOINTS).gain < 0.3 * DETECTED


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("size", [0.3, 3.0])
def test_the_right_law_beats_every_general_one(size: float, seed: int) -> None:
    """A law of one number leaves nothing, and in its place its own values without a form are less likely."""
    comparison, (named,) = compared(moved(seed, lambda s: size * stribeck(s)), stribeck)
    assert comparison.worth(named.feature.key) > DETECTED
    assert comparison.beside(JOINTS).gain < 0.3 * DETECTED
    assert next(comparison.instead_of(named.feature.key, JOINTS)).gain < 0.0


@pytest.mark.parametrize("seed", range(4))
def test_a_law_of_the_wrong_form_is_refuted_where_it_explains_nearly_all(seed: int) -> None:
    """Drag is viscous friction but for a few per cent; a function of the speed is likelier by more than its price."""
    comparison, (named,) = compared(moved(seed, lambda s: 0.6 * drag(s)), speed)
    found = next(comparison.instead_of(named.feature.key, JOINTS))
    assert found.gain > DETECTED
    assert (found.law.joint, found.law.side, found.law.argument) == (JOINT, "motor", "its speed")
    assert found.gain < 0.2 * comparison.worth(named.feature.key)


@pytest.mark.parametrize("seed", range(4))
def test_friction_that_also_changes_a_little_is_not_refuted(seed: int) -> None:
    """Dry friction of which a hundredth changes over time is dry friction, though a changing one is likelier."""
    prepared: Any = SimpleNamespace(settings=SETTINGS, model=SimpleNamespace(robot=SimpleNamespace(joint_names="ab")))
    share = lambda s: 1.0 + 0.05 * np.sin(20.0 * s.values["progress"][:, 0])  # noqa: E731
    nearly, (dry,) = compared(moved(seed, lambda s: 5.0 * share(s) * sign(s)), sign)
    drags, (viscous,) = compared(moved(seed, lambda s: 0.6 * drag(s)), speed)
    assert next(nearly.instead_of(dry.feature.key, JOINTS)).gain > DETECTED
    assert not _instead_of_causes(prepared, nearly, Hypothesis([dry]))[0]
    assert _instead_of_causes(prepared, drags, Hypothesis([viscous]))[0].keys() == {viscous.feature.key}


@pytest.mark.parametrize(("change", "refuted"), [(0.5, False), (3.0, True)])
def test_dry_friction_that_changes_much_is_refined_and_one_that_is_hardly_there_refuted(
    change: float, refuted: bool
) -> None:
    """Half as large again here and there it is dry friction; of another sign here and there it is none."""
    prepared: Any = SimpleNamespace(settings=SETTINGS, model=SimpleNamespace(robot=SimpleNamespace(joint_names="ab")))
    share = lambda s: 1.0 + change * np.sin(20.0 * s.values["progress"][:, 0])  # noqa: E731
    comparison, (dry,) = compared(moved(1, lambda s: 5.0 * share(s) * sign(s)), sign)
    key = ("coulomb_friction", None, ())
    law, worth = next(comparison.instead_of(dry.feature.key, JOINTS)), comparison.worth(dry.feature.key)
    assert law.law.friction and law.gain > SETTINGS.general_laws.better * worth
    left = comparison.worth_beside(dry.feature.key, law.law)
    named: Any = SimpleNamespace(
        worth=lambda _: worth, instead_of=lambda _, joints: [law], worth_beside=lambda _, law: left
    )
    feature: Any = SimpleNamespace(key=key, joint=None)
    hypothesis = Hypothesis([SimpleNamespace(feature=feature)])  # type: ignore[list-item]
    assert bool(_instead_of_causes(prepared, named, hypothesis)[0]) == refuted


@pytest.mark.parametrize("seed", range(4))
def test_a_law_that_explains_something_else_refutes_no_cause(seed: int) -> None:
    """A large torque over the angle is likelier than viscous friction, which keeps its worth beside that."""
    prepared: Any = SimpleNamespace(settings=SETTINGS, model=SimpleNamespace(robot=SimpleNamespace(joint_names="ab")))
    torque = lambda s: 0.2 * speed(s) + 2.0 * cogging(s)  # noqa: E731
    comparison, (viscous,) = compared(moved(seed, torque), speed)
    law, worth = next(comparison.instead_of(viscous.feature.key, JOINTS)), comparison.worth(viscous.feature.key)
    assert law.law.argument == "its angle" and law.gain > 0.0
    assert comparison.worth_beside(viscous.feature.key, law.law) > 0.9 * worth > DETECTED
    assert not _instead_of_causes(prepared, comparison, Hypothesis([viscous]))[0]


def test_what_no_cause_explains_is_placed_by_what_it_depends_on() -> None:
    """A torque over the angle is found at its joint and side, with its size."""
    data = moved(1, lambda s: 0.2 * cogging(s), "link")
    found = compared(data)[0].beside(JOINTS)
    assert found.gain > DETECTED
    assert (found.law.joint, found.law.side, found.law.argument) == (JOINT, "link", "its angle")
    row = JOINT  # of the link
    assert np.std(found.torque[0][:, row]) == pytest.approx(np.std(data[1].added), rel=0.3)


def test_a_number_of_the_arm_is_ordinary_again_beside_the_law_that_it_stood_in_for() -> None:
    """Loads of the other joint in a torque sensor bend its gain by many deviations; beside a general law they do not.

    The gain's prior is ten times that of an ordinary sensor, as a fault's is.
    """
    data: list[Any] = []
    for seed in (1, 2):
        one = Moved(seed, lambda s: 0.2 * s.values["tau_J"][:, 0], {"link": 1.0, "drive": 1.0, "motor": -1.0})
        data.append(one)
    width, ordinary = 10.0, 0.003
    white, plain = [], []
    for one in data:
        pattern = np.zeros((1, 6, 1))
        pattern[0, [JOINT, 2 + JOINT, 4 + JOINT], 0] = (1.0, 1.0, -1.0)
        column = pattern * one.parts[0].signals.values["tau_J"][:, JOINT, None, None] * ordinary * width
        white.append(one.whiten([column]))
        plain.append(column)
    nuisance = NuisanceColumns((white[0], white[1]), plain[1:], np.zeros(1), np.array([np.inf]), ("joint_2",))
    library = RegressorLibrary(data[0], data[1], SETTINGS.candidates, nuisance)
    library.add(SimpleNamespace(law=nothing, key=("nothing", None, ())), ())  # type: ignore[arg-type]
    library.close()
    assert abs(library.nuisance_values([])[0]) * width > 3.0
    comparison = LawComparison(library, [], SETTINGS)
    found, *others = comparison.instead_of_numbers({0: width}, [JOINT])
    assert found.gain > DETECTED and all(one.gain <= found.gain for one in others)
    assert (found.law.side, found.law.argument) == ("sensor", "the loads of other joints")
    value, std = (float(v[0]) * width for v in comparison.numbers_beside(found, {0: width}))
    assert abs(value) < 1.0
    assert std < 1.0
