"""Bearings that tilt: as a law without ringing, and as the tilts that a regressor estimates from
their moments.

The law adds nothing to the residuals of the locked arm, as the tilts are coordinates of their own.
What they do follows in steps: the moments about the tilting axes move the tilts against the
bearings' stiffness, damping and the arm's own inertia, and the tilts enter the equations of link
and motor. The first step takes the inertia for the same in all poses; each further one mends the
tilts by the moment that is missing then.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from elastic_arm.arrays import Array
from elastic_arm.dynamics import Model, build_model
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.law import (
    Contribution,
    Effect,
    Numbers,
    Plant,
    Scope,
    StructuralEffect,
    SymbolicMotion,
    searched,
)
from elastic_arm.effects.regressor import MotionSignals
from elastic_arm.errors import EffectError
from elastic_arm.robot import Robot

POSES = 40
# Above, in Hz, the moments hold more of the encoders' noise, twice differentiated, than of motion;
# the same noise is in the residuals, so they are smoothed further where accelerations are good up
# to a low frequency only. Each step lets through a part of what the steps before have not: after
# four, half passes at about twice this.
SMOOTH = 12.0
SMOOTHER = 0.6
PADDING = 0.5  # s mirrored at both ends, in which the tilts swing in
RATE = 250.0  # Hz, more than the motion that columns are made of holds
# of the frequency up to which moments are taken: there rounding is left of them (exp(-32));
# numerical
BEYOND = 8.0
STEPS = 4


def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """What the links feel when the bearings give way as springs, without ringing.

    The tilts follow the moment that the rigid arm puts on its bearings; their rates follow from
    those of the motion. Without the motion's third and fourth derivative about a tenth of the
    effect's power is missed. A simulated arm does not need this law: there the tilts are
    coordinates.
    """
    n = motion.n
    zero = ca.SX.zeros(2 * motion.n)
    _check(motion.robot)
    whole = ArmEquations(motion.robot, motion.equations.model_name, bearings=True)
    x = ca.SX.sym("x", 2 * n)
    dx = ca.SX.sym("dx", 2 * n)
    ddx = ca.SX.sym("ddx", 2 * n)
    dddx = ca.SX.sym("dddx", 2 * n)
    ddddx = ca.SX.sym("ddddx", 2 * n)

    def left_side(tilt: ca.SX, rate: ca.SX, acceleration: ca.SX) -> ca.SX:
        parts = ((x, tilt), (dx, rate), (ddx, acceleration))
        return whole.left_side(*(ca.vertcat(own, added) for own, added in parts))

    def rate_of(expression: ca.SX) -> ca.SX:
        pairs = ((x, dx), (dx, ddx), (ddx, dddx), (dddx, ddddx))
        return sum(
            (ca.jtimes(expression, known, rate) for known, rate in pairs), ca.SX.zeros(2 * n)
        )

    rigid = left_side(zero, zero, zero)
    tilt = -rigid[2 * n :] / (p["stiffness_scale"] * ca.repmat(_stiffness(motion.robot), 2, 1))
    rate = rate_of(tilt)
    rows = left_side(tilt, rate, rate_of(rate))[: 2 * n] - rigid[: 2 * n]
    known = ca.vertcat(x, dx, ddx, dddx, ddddx, whole.Psi)
    jerk = ca.SX.zeros(2 * n) + motion.dddx
    snap = ca.SX.zeros(2 * n) + motion.ddddx
    here = ca.vertcat(motion.x, motion.dx, motion.ddx, jerk, snap, ca.DM(whole.nominal))
    return motion.everywhere(ca.substitute(rows, known, here))


def _stiffness(robot: Robot) -> ca.DM:
    return ca.DM(
        [
            j.transmission.bearing.stiffness
            for j in robot.joints
            if j.transmission and j.transmission.bearing
        ]
    )


def _check(robot: Robot) -> None:
    """Refuse an arm without bearings."""
    for joint in robot.joints:
        if joint.transmission is None or joint.transmission.bearing is None:
            raise EffectError(
                f"{joint.name} of robot {robot.name} has no bearing",
                "Give its stiffness and damping in the arm file.",
            )


def change(plant: Plant, p: Numbers) -> Plant:
    """Free the tilts q_x, q_y, with the arm file's bearings times the scale."""
    _check(plant.robot)
    joints = []
    for joint in plant.robot.joints:
        gear = joint.transmission
        if gear is not None and gear.bearing is not None:
            bearing = replace(gear.bearing, stiffness=gear.bearing.stiffness * p["stiffness_scale"])
            joints.append(replace(joint, transmission=replace(gear, bearing=bearing)))
    return replace(plant, robot=plant.robot.with_(joints=tuple(joints)), bearings=True)


class TiltRegressor:
    """The bearings of all joints, with `stiffness_scale` times the stiffness of the arm file."""

    def __init__(self, equations: ArmEquations) -> None:
        self.equations = equations

    @property
    def acts(self) -> bool:
        """Whether the arm file describes bearings."""
        robot = self.equations.robot
        return all(
            joint.transmission is not None and joint.transmission.bearing for joint in robot.joints
        )

    @cached_property
    def _model(self) -> Model:
        return build_model(self.equations.robot, self.equations.model_name, bearings=True)

    @cached_property
    def _bearings(self) -> tuple[Array, Array]:
        gears = [joint.transmission for joint in self.equations.robot.joints]
        bearings = [gear.bearing for gear in gears if gear is not None and gear.bearing is not None]
        stiffness = np.array([bearing.stiffness for bearing in bearings * 2])
        damping = np.array([bearing.damping for bearing in bearings * 2])
        return stiffness, damping

    def residuals(self, signals: MotionSignals, values: Mapping[str, Any]) -> Array:
        """Return what the tilts add to the residuals, (N, 3 n)."""
        n = self.equations.robot.n
        scale = float(values["stiffness_scale"])
        thin = slice(None, None, max(1, int((1.0 / RATE) / (signals.t[1] - signals.t[0]))))
        t = signals.t[thin]
        motion = [signals.values[name][thin] for name in ("x", "dx", "ddx")]
        tilts = np.zeros((3, len(t), 2 * n))
        rest = moving = self._left_side(motion, tilts)
        swing = self._swing(t, motion[0], scale, min(SMOOTH, SMOOTHER * signals.cutoff))
        for _ in range(STEPS):
            missing = moving[:, 2 * n :] + (scale - 1.0) * self._bearings[0] * tilts[0]
            tilts = tilts + swing.driven(-missing)
            moving = self._left_side(motion, tilts)
        change = scipy.interpolate.CubicSpline(t, (moving - rest)[:, : 2 * n])(signals.t)
        return np.concatenate([change[:, :n], np.zeros((len(change), n)), change[:, n:]], axis=1)

    def _left_side(self, motion: Sequence[Array], tilts: Array) -> Array:
        return self._model.inverse_dynamics(
            *(np.hstack(pair) for pair in zip(motion, tilts, strict=True))
        )

    def _swing(self, t: Array, x: Array, scale: float, smooth: float) -> "Swing":
        """Return how the tilts follow moments at mean inertia, up to `smooth` Hz."""
        n = self.equations.robot.n
        stiffness, damping = self._bearings
        poses = x[:: max(1, len(x) // POSES)]
        inertia = self._model.mass_matrix(np.hstack([poses, np.zeros_like(poses)])).mean(axis=0)[
            2 * n :, 2 * n :
        ]
        return Swing.of(t, scale * stiffness, damping, inertia, smooth)


class Swing(NamedTuple):
    """Tilts by moments over frequency: s theta = theta' and M s theta' = m - D theta' - K theta, by
    the modes of this system.

        theta = V (s - poles)^-1 W m
    """

    padding: tuple[int, int]  # samples that are added before and after
    s: NDArray[np.complex128]  # (F,)
    smoothing: Array  # (F,) of the moments
    poles: NDArray[np.complex128]  # (4n, 1)
    # (4n, 2n), (2n, 4n): W and V
    into: NDArray[np.complex128]
    out: NDArray[np.complex128]

    @staticmethod
    def of(t: Array, stiffness: Array, damping: Array, inertia: Array, smooth: float) -> "Swing":
        """Return that of bearings (2n,) under an inertia (2n, 2n), at times t (N,)."""
        count = min(len(t) - 1, round(PADDING / (t[1] - t[0])))
        whole = scipy.fft.next_fast_len(len(t) + 2 * count, real=True)
        f = np.fft.rfftfreq(whole, t[1] - t[0])
        f = f[f <= BEYOND * smooth]
        tilts = len(inertia)
        mobility = np.linalg.inv(inertia)
        rates = np.hstack([np.zeros((tilts, tilts)), np.eye(tilts)])
        accelerations = np.hstack([-mobility * stiffness, -mobility * damping])
        poles, modes = np.linalg.eig(np.vstack([rates, accelerations]))
        return Swing(
            (count, whole - len(t) - count),
            2j * np.pi * f,
            np.exp(-0.5 * (f / smooth) ** 2),
            poles[:, None],
            np.linalg.inv(modes)[:, tilts:] @ mobility,
            modes[:tilts],
        )

    def driven(self, moment: Array) -> Array:
        """Return tilts and their first and second derivatives (3, N, 2n) under moments (N, 2n)."""
        padded = np.pad(moment.T, ((0, 0), self.padding), mode="reflect")
        spectrum = scipy.fft.rfft(padded)[:, : len(self.s)] * self.smoothing
        tilt = self.out @ ((self.into @ spectrum) / (self.s - self.poles))
        each = [tilt, tilt * self.s, tilt * self.s**2]
        found = scipy.fft.irfft(each, padded.shape[1])
        inside = slice(self.padding[0], self.padding[0] + len(moment))
        return found[:, :, inside].transpose(0, 2, 1)


EFFECT: Effect = StructuralEffect(
    id="bearing_compliance",
    formula="tilts q_ix, q_iy of every joint, bearing stiffness times the scale",
    description="The bearings of the joints are compliant about x and y; the model treats"
    " them as rigid.",
    plain="has compliant bearings, {stiffness_scale} times as stiff as described",
    signature=(
        "Link residuals of all joints that grow with the tilting moments and ring at the bearings'"
        " resonances."
    ),
    law=law,
    parameters=(
        searched(
            "stiffness_scale",
            "1",
            0.01,
            10.0,
            "true / arm file",
            default=1.0,
            above=0.0,
            inverse=True,
        ),
    ),
    scope=Scope.ARM,
    sides=("link",),
    regime="frequency",
    change=change,
    regressor=TiltRegressor,
)
