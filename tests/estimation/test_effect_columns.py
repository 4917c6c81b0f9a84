"""Columns of a candidate effect: what its law adds, phases, internal states, and coefficients back
to parameters."""

from typing import Any

import casadi as ca
import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS, EffectInstance, SymbolicMotion, parse
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect_set import EffectSet
from elastic_arm.effects.parameters import Role
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.motion import CompletedMotion, completed
from elastic_arm.estimation.regressors import INPUTS, CompiledColumns, Signals, Term
from elastic_arm.robot import load_robot
from tests.helpers.smooth_motion import smooth_motion

ROBOT = load_robot(None)
MODEL = build_model(ROBOT, "mod3")
EQUATIONS = ArmEquations(ROBOT, "mod3")
STANDSTILL = (np.full(3, 1e-3), np.full(3, 1e-3))


def motion() -> CompletedMotion:
    return completed(smooth_motion(MODEL, samples=200), MODEL)


def contribution(instance: EffectInstance, signals: Signals) -> np.ndarray:
    """What the law itself adds to the residuals, by CasADi's own evaluation (N, 3 n)."""
    sizes = {"x": 6, "dx": 6, "ddx": 6, "progress": 1, "elapsed": 1, "loaded": 1}
    symbols = {name: ca.SX.sym(name, sizes.get(name, 3)) for name in INPUTS}
    signs = {"link": symbols.pop("sign_link"), "motor": symbols.pop("sign_motor")}
    motion = SymbolicMotion(EQUATIONS, **symbols, sign=lambda side, i: signs[side][i])
    effects = EffectSet([instance], ROBOT)
    total, _ = effects.contribution(motion)
    rows = ca.vertcat(total.link, total.drive, total.motor)
    function = ca.Function(
        "law", [*symbols.values(), *signs.values(), effects.p, EQUATIONS.Psi], [rows]
    )
    arrays = [values.T for values in signals.arrays]
    N = len(signals.t)
    return np.array(
        function(
            *arrays, np.tile(effects.numbers()[:, None], N), np.tile(EQUATIONS.nominal[:, None], N)
        )
    ).T


def feature(instance: EffectInstance) -> Feature:
    choices = {c.name: instance.parameters[c.name] for c in instance.effect.choices}
    return Feature(instance.effect, instance.joint, choices, EQUATIONS)


@pytest.mark.parametrize(
    "text",
    [
        "viscous_friction:joint_2:coefficient=3,side=motor",
        "coulomb_friction:joint_1:torque=5,side=link",
        "joint_torque_offset:joint_3:offset=2",
        "motor_torque_offset:joint_1:offset=3",
    ],
)
def test_a_column_times_its_coefficient_is_what_the_law_adds(text: str) -> None:
    """For effects that are linear in their parameter the column is the law per unit."""
    instance = parse(text, ROBOT)
    signals = Signals.of(motion(), STANDSTILL)
    (p,) = (p for p in instance.effect.parameters if p.role is Role.LINEAR)
    coefficient: Any = instance.parameters[p.name]
    column = feature(instance).columns(signals)[:, :, 0]
    expected = contribution(instance, signals)
    np.testing.assert_allclose(coefficient * column, expected, atol=1e-9 * np.abs(expected).max())


def test_a_sine_and_a_cosine_column_make_every_phase() -> None:
    """An amplitude and a phase are found from two columns, and give the law back."""
    instance = parse("torque_ripple:joint_2:amplitude=2,order=2,phase=0.7", ROBOT)
    signals = Signals.of(motion(), STANDSTILL)
    own = feature(instance)
    columns = own.columns(signals, [2.0])
    coefficients = 2.0 * np.cos(0.7), 2.0 * np.sin(0.7)
    expected = contribution(instance, signals)
    np.testing.assert_allclose(columns @ coefficients, expected, atol=1e-9 * np.abs(expected).max())
    found = own.parameters(coefficients, [2.0])
    assert found["amplitude"] == pytest.approx(2.0) and found["phase"] == pytest.approx(0.7)


def test_internal_states_run_from_zero_and_settle() -> None:
    """Under a steady motion hysteresis settles at its limit, in the direction of the motion."""
    effect = EFFECTS["hysteresis"]
    own = next(
        feature(instance) for instance in effect.candidates(ROBOT) if instance.joint == "joint_1"
    )
    signals = Signals.of(motion(), STANDSTILL)
    searched = [float(np.sqrt(p.low * p.high)) for p in own.searched]
    columns = own.columns(signals, searched)
    assert (
        columns[0, :, 0] == pytest.approx(0.0, abs=1e-12)
        and np.isfinite(columns).all()
        and columns.any()
    )


def test_both_engines_give_the_same_columns() -> None:
    """Identification's engine (numbers of the arm as arguments) and the diagnosis's agree to
    rounding."""
    instance = parse("payload:mass=5,position=0/0/0.1", ROBOT)
    linear = [p for p in instance.effect.parameters if p.role is Role.LINEAR]
    points = [{p.name: instance.parameters[p.name] for p in instance.effect.parameters}]
    terms = [Term(instance.effect, [ROBOT.n - 1], {}, linear, points)]
    signals = Signals.of(motion(), STANDSTILL)
    one, other = (CompiledColumns(terms, EQUATIONS, engine)(signals) for engine in ("numpy", None))
    np.testing.assert_allclose(one, other, atol=1e-10 * np.abs(one).max())
