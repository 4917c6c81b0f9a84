"""Joints that yield behind the only encoder: an elastic drive, or play, where the description is
rigid.

The encoder sits on the motor; the link lies at q + d. Weight and inertia of all that hangs on it
act there, and what the joint transmits moves d: at each sample the link's own equation, with the
inertia it has in that pose.
"""

from collections.abc import Callable, Mapping
from functools import cache, cached_property, partial
from typing import Any

import casadi as ca
import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.codegen.recursion import Recursion
from elastic_arm.dynamics import Model, build_model
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.law import (
    Confusion,
    Contribution,
    Effect,
    Numbers,
    Plant,
    StructuralEffect,
    SymbolicMotion,
    searched,
)
from elastic_arm.effects.regressor import MotionSignals
from elastic_arm.errors import EffectError

DAMPING = 0.1  # damping ratio of the link on its drive: of gears 0.05 to 0.2
STOPPING = 0.02  # s, within which a link rests at the end of its play: as soft as MuJoCo's limits
STEPS = 8  # between two samples; numerical
SETTLING = (
    0.5  # s, for which the first sample is held before, as nobody knows how the link lay; numerical
)
SMALL = 1e-4  # rad, of the derivative of the load by the angle; numerical


def _nothing(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """Nothing at the angles of the encoder: what the joint adds follows in
    :class:`YieldingJoint`."""
    return motion.nothing()


def _change(plant: Plant, p: Numbers) -> Plant:
    raise EffectError(
        "a joint of an arm without transmissions cannot be elastic in the simulator",
        "Describe its drive: `transmission` with `stiffness`, and the effect backlash.",
    )


def _spring(d: Any, v: Any, free: Any, inertia: Any, h: Any, p: Any) -> Any:
    """Return the next rate of a link on a spring of stiffness p; implicit Euler."""
    w = ca.sqrt(p / inertia)
    return (v + h * (free - w**2 * d)) / (1.0 + 2.0 * h * DAMPING * w + (h * w) ** 2)


def _stopped(d: Any, v: Any, free: Any, inertia: Any, h: Any, p: Any) -> Any:
    """Return the next rate of a link in play p, at whose ends it comes to rest, pressed but not
    held.

    Critically damped, as what gears lose in an impact is not known.
    """
    side = ca.sign(d)
    T = STOPPING
    at_end = (v - h * (d - side * p) / T**2) / (1.0 + 2.0 * h / T + (h / T) ** 2)
    pressed = ca.logic_and(ca.fabs(d) >= p, side * ((at_end - v) / h - free) < 0.0)
    return ca.if_else(pressed, at_end, v + h * free)


@cache
def _recursion(rate: Callable[..., Any]) -> Recursion:
    """Return d, its rate, and its rate half a sample later, from load, inertia and slope now and a
    sample later."""
    z = ca.SX.sym("z", 3)
    now = ca.SX.sym("now", 6)
    p = ca.SX.sym("p", 2)
    d = z[0]
    v = z[1]
    half = z[2]
    h = p[1] / STEPS
    for k in range(STEPS):
        share = (k + 1) / STEPS
        load = (1.0 - share) * now[0] + share * now[3]
        inertia = (1.0 - share) * now[1] + share * now[4]
        slope = (1.0 - share) * now[2] + share * now[5]
        v = rate(d, v, -(load + slope * d) / inertia, inertia, h, p[0])
        d = d + h * v
        half = v if k == STEPS // 2 - 1 else half
    return Recursion(ca.Function("step", [z, now, p], [ca.vertcat(d, v, half)]))


class YieldingJoint:
    """What a joint adds to the residuals of an arm that is described as rigid.

    rate: next rate of the link, by :func:`_recursion`.
    """

    def __init__(self, rate: Callable[..., Any], equations: ArmEquations) -> None:
        self.equations = equations
        self._rate = rate

    @property
    def acts(self) -> bool:
        """Whether the arm is rigid as described, with controllers on the encoders.

        The encoders are the motors' then.
        """
        robot = self.equations.robot
        return not robot.elastic and all(joint.controller is not None for joint in robot.joints)

    @cached_property
    def _model(self) -> Model:
        return build_model(self.equations.robot, self.equations.model_name)

    def residuals(self, signals: MotionSignals, values: Mapping[str, Any]) -> Array:
        """Return what the link's motion behind the encoder adds to the residuals, (N, 3 n)."""
        (j,) = values["joints"]
        h = float(signals.t[1] - signals.t[0])
        model = self._model
        motor = float(self.equations.robot.joints[j].armature or 0.0)
        motion = [signals.values[name] for name in ("x", "dx", "ddx")]

        def moved(*by: Array | float) -> Array:
            """Return the left side (N, n) with the link moved, the motor as read."""
            there = [np.array(own) for own in motion]
            for own, d in zip(there, by, strict=True):
                own[:, j] += d
            found = np.array(model.inverse_dynamics(*there))
            found[:, j] -= motor * there[2][:, j]
            return found

        known: dict[Any, tuple[Array, Array, Array]] = signals.once("yielding joints at rest", dict)
        if self not in known:
            rigid = moved(0.0, 0.0, 0.0)
            inertia = np.maximum(model.mass_matrix(motion[0])[:, j, j] - motor, 1e-9)
            known[self] = rigid, inertia, (moved(SMALL, 0.0, 0.0) - rigid)[:, j] / SMALL
        rigid, inertia, slope = known[self]
        now = np.column_stack([rigid[:, j], inertia, slope])
        before = round(SETTLING / h)
        now = np.vstack([now[:1].repeat(before, axis=0), now, now[-1:]])
        pairs = np.hstack([now, np.vstack([now[1:], now[-1:]])])
        (size,) = (value for name, value in values.items() if name != "joints")
        d, rate, half = _recursion(self._rate).run(pairs, np.array([size, h]))[before:].T
        change = moved(d[:-1], rate[:-1], np.diff(half) / h) - rigid
        return np.hstack([change, np.zeros((len(change), 2 * change.shape[1]))])


BEHIND = (
    "A second encoder on the link, or a weight on the resting link: the motor"
    " encoder does not show it"
)

EFFECTS: tuple[Effect, ...] = (
    StructuralEffect(
        id="joint_elasticity",
        formula="link at q + d behind the encoder, J d'' + 0.2 sqrt(k J) d' + k d = -load",
        description="The joint is elastic behind its encoder, but described as rigid.",
        plain="is elastic behind its encoder with {stiffness}",
        signature=(
            "Torque at all joints where the link oscillates on its drive, and less"
            " inertia above that frequency."
        ),
        law=_nothing,
        change=_change,
        parameters=(searched("stiffness", "Nm/rad", 5.0, 5000.0, "k", above=0.0, inverse=True),),
        sides=("link",),
        regime="frequency",
        regressor=partial(YieldingJoint, _spring),
        confusions=(Confusion("joint_play", "the load seldom changes its sign", BEHIND),),
    ),
    StructuralEffect(
        id="joint_play",
        formula=(
            "link at q + d behind the encoder, free within |d| < b; at the ends it comes"
            " to rest within 20 ms"
        ),
        description="The joint has play behind its encoder, but is described as rigid.",
        plain="has {half_gap} of play to either side behind its encoder",
        signature=(
            "Torque is missing for a moment where the load of the joint changes its sign,"
            " then the link strikes."
        ),
        law=_nothing,
        change=_change,
        parameters=(
            searched("half_gap", "rad", 1e-3, 0.05, "b", neutral=0.0, least=0.0, tried=25),
        ),
        sides=("link",),
        regime="load",
        regressor=partial(YieldingJoint, _stopped),
        confusions=(Confusion("joint_elasticity", "the load seldom changes its sign", BEHIND),),
    ),
)
