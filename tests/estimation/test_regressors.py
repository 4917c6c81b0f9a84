"""From effects to columns: derivatives of the laws, phases, internal states, and both engines alike."""

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS, EffectInstance, parse
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.effects.parameters import Role
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.motion import CompletedMotion, completed
from elastic_arm.estimation.regressors import CompiledColumns, Signals, Term
from elastic_arm.robot import load_robot
from tests.helpers.smooth_motion import smooth_motion

ROBOT = load_robot(None)
MODEL = build_model(ROBOT, "mod3")
EQUATIONS = ArmEquations(ROBOT, "mod3")
STANDSTILL = (np.full(3, 1e-3), np.full(3, 1e-3))


def motion() -> CompletedMotion:
    return completed(smooth_motion(MODEL, samples=200), MODEL)


def feature(instance: EffectInstance) -> Feature:
    choices = {c.name: instance.parameters[c.name] for c in instance.effect.choices}
    return Feature(instance.effect, instance.joint, choices, EQUATIONS)


def test_internal_states_run_from_zero_and_settle() -> None:
    """Under a steady motion hysteresis settles at its limit, in the direction of the motion."""
    effect = EFFECTS["hysteresis"]
    own = next(feature(instance) for instance in effect.candidates(ROBOT) if instance.joint == "joint_1")
    signals = Signals.of(motion(), STANDSTILL)
    searched = [float(np.sqrt(p.low * p.high)) for p in own.searched]
    columns = own.columns(signals, searched)
    assert columns[0, :, 0] == pytest.approx(0.0, abs=1e-12) and np.isfinite(columns).all() and columns.any()


def test_both_engines_give_the_same_columns() -> None:
    """Identification's engine (numbers of the arm as arguments) and the diagnosis's agree to rounding."""
    instance = parse("payload:mass=5,position=0/0/0.1", ROBOT)
    linear = [p for p in instance.effect.parameters if p.role is Role.LINEAR]
    points = [{p.name: instance.parameters[p.name] for p in instance.effect.parameters}]
    terms = [Term(instance.effect, [ROBOT.n - 1], {}, linear, points)]
    signals = Signals.of(motion(), STANDSTILL)
    one, other = (CompiledColumns(terms, EQUATIONS, engine)(signals) for engine in ("numpy", None))
    np.testing.assert_allclose(one, other, atol=1e-10 * np.abs(one).max())
