"""Dry friction of a real joint: it changes its sign within a distance, and its curve bends.

    F' = F + F_d [sum_k c_k (z_k - s) + z S + A]
    dz_k/dq = (1 - z_k sign(dq)) / d_k                                             (Dahl 1968)
    z = s + sum_k c_k (z_k - s)
    S = sum_i s_i f_i(|w|) + s_load l + s_time x + s_bend (3 x² - 1) / 2
    A = sum_i a_i g_i(|w|)

F is the torque of the friction laws at one side of a joint, F_d the size of its part with the sign
s of the velocity w, and c_k >= 0 the share of F_d that changes its sign within the distance d_k.
Without c_k, friction that changes late would be mistaken for a delay or a low pass of the torque.

z is the smoothed sign. The curve S bends with the speed, with the torque of the joint
l = |tau_J| / max |tau_J| minus its mean, and with the time x, from -1 at the beginning of a
recording to 1 at its end; A is the difference of the curve between both directions. f_i and g_i are
the first eigenfunctions of a Gaussian process over the logarithm of the speed (Matern 5/2). The dry
and viscous parts are removed from each shape of S, and the mean, a zero of the torque, from g_i.
Lubricant, seals, bearings and temperature bend the curve; without S and A, each bend would appear
as another law of friction.

The dry and viscous parts of a shape are determined in the whitened rows (:meth:`Curve.less`).
Slow rows have the most information, because the noise of the encoders grows with the frequency:
shapes without a viscous part in the samples have nearly all of it in the slow rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.estimation.regressors import Entries, Signals
from elastic_arm.estimation.turnover import FrictionPlace, late_signs, turned_over
from elastic_arm.estimation.whitening import Part, WhitenedData
from elastic_arm.robot import Robot

DECADES = 2.0  # of speed below the fastest, over which the curve bends
LENGTH = 1.5  # of the kernel, in natural logarithms of the speed
FUNCTIONS = 5  # of S; further ones have a hundredth of the variance together
OF_DIRECTION = 2  # of A
GRID = 64  # speeds at which the kernel is evaluated; numerical
BENDS = FUNCTIONS + 3  # coefficients of S
SHAPES = BENDS + OF_DIRECTION  # coefficients of S and A
LAWS = 2  # dry and viscous friction


def places_of_friction(acting: Sequence[ActingEffect]) -> list[FrictionPlace]:
    """Return the places at which effects make friction."""
    features = [effect.feature for effect in acting if effect.feature.effect.friction]
    places = (FrictionPlace(str(one.joint), side) for one in features for side in one.sides)
    return list(dict.fromkeys(places))


def turnover_columns(
    data: WhitenedData, robot: Robot, acting: Sequence[ActingEffect], place: FrictionPlace
) -> list[Array]:
    """Return the columns (N', R, K) Nm of each stretch, one for each c_k. None at all where no
    friction has the sign of the velocity.

    acting: effects that act, of which the friction at the place is meant.
    """
    dry = _dry(data, acting, place)
    if not dry:
        return []
    found = []
    for part, size in zip(data.parts, dry, strict=True):
        late = late_signs(part.signals, place, robot.joint_names.index(place.joint))
        found.append(_in_band(data, part, robot, place, late * size))
    return data.weighted(found, in_place=True)


def curve_columns(
    data: WhitenedData,
    robot: Robot,
    acting: Sequence[ActingEffect],
    place: FrictionPlace,
    turned: Array,
    curve: Curve,
) -> list[Array]:
    """Return the columns (N', R, SHAPES + LAWS) Nm of each stretch: of S, from which dry and
    viscous friction are not removed yet, of A, and of dry and viscous friction. None at all where
    no friction has the sign of the velocity.

    turned: c_k (K,) by which z is made; curve: that of all recordings.
    """
    dry = _dry(data, acting, place)
    if not dry:
        return []
    speeds, loads = _speeds_and_loads(data, robot, place)
    found = []
    for part, size, w, load in zip(data.parts, dry, speeds, loads, strict=True):
        z = turned_over(part.signals, place, robot.joint_names.index(place.joint), turned)
        x = 2.0 * part.signals.values["progress"][:, 0]
        bends, sides = curve.shapes(w, load, x)
        laws = np.array([np.ones_like(w), w])
        values = np.vstack([z * bends, sides, z * laws])
        found.append(_in_band(data, part, robot, place, values * size))
    return data.weighted(found, in_place=True)


def _in_band(
    data: WhitenedData, part: Part, robot: Robot, place: FrictionPlace, values: Array
) -> Array:
    """Return columns (N', R, k) within the band of torques (k, N) Nm at a place."""
    j = robot.joint_names.index(place.joint)
    row = 2 * robot.n + j if place.side == "motor" else j
    k = len(values)
    return data.in_band(part, Entries(values.T, np.full(k, row), np.arange(k), (3 * robot.n, k)))


def curve_over(data: WhitenedData, robot: Robot, place: FrictionPlace) -> Curve:
    """Return the curve of a place over the speeds and loads of recordings."""
    speeds, loads = _speeds_and_loads(data, robot, place)
    return Curve.over(np.concatenate(speeds), np.concatenate(loads))


def _speeds_and_loads(
    data: WhitenedData, robot: Robot, place: FrictionPlace
) -> tuple[list[Array], list[Array]]:
    """Return |speeds| (N,) rad/s and |tau_J| (N,) Nm of each stretch."""
    j = robot.joint_names.index(place.joint)
    k = robot.n + j if robot.elastic and place.side == "motor" else j
    speeds = [np.abs(part.signals.values["dx"][:, k]) for part in data.parts]
    loads = [np.abs(part.signals.values["tau_J"][:, j]) for part in data.parts]
    return speeds, loads


class Curve(NamedTuple):
    """What the curve of a joint may be over the speeds and loads of its recordings."""

    fastest: float  # rad/s
    heaviest: float  # Nm
    means: Array  # (OF_DIRECTION, 1) of the functions of A
    load: float  # mean of |tau_J| / max |tau_J|
    plain: Array  # (LAWS, BENDS) dry and viscous friction in each shape of S

    @staticmethod
    def over(w: Array, load: Array) -> Curve:
        """Return that of samples of all recordings: speeds (N,) rad/s and loads (N,) Nm, >= 0."""
        fastest = float(w.max())
        heaviest = float(load.max()) or 1.0
        means = functions_of_speed(w, fastest)[:OF_DIRECTION].mean(axis=1, keepdims=True)
        mean_load = float(load.mean()) / heaviest
        return Curve(fastest, heaviest, means, mean_load, np.zeros((LAWS, BENDS)))

    def of_rows(self, white: Array) -> Curve:
        """Return it with the dry and viscous friction that its shapes have in whitened columns
        (rows, SHAPES + LAWS)."""
        bends = white[:, :BENDS]
        laws = white[:, -LAWS:]
        plain = np.asarray(np.linalg.lstsq(laws, bends)[0], dtype=float)
        return self._replace(plain=plain)

    def less(self, columns: Array) -> Array:
        """Return columns (…, SHAPES) less dry and viscous friction, of such with the laws
        (…, SHAPES + LAWS)."""
        found = columns[..., :-LAWS].copy(order="K")
        found[..., :BENDS] -= columns[..., -LAWS:] @ self.plain
        return found

    def shapes(self, w: Array, load: Array, x: Array) -> tuple[Array, Array]:
        """Return the shapes of S (BENDS, N), with what of them is dry and viscous friction, and of
        A (OF_DIRECTION, N) at speeds (N,) rad/s, loads (N,) Nm and times (N,)."""
        phi = functions_of_speed(w, self.fastest)
        bends = np.array([*phi, load / self.heaviest - self.load, x, 1.5 * x**2 - 0.5])
        return bends, phi[:OF_DIRECTION] - self.means


def functions_of_speed(w: Array, fastest: float) -> Array:
    """Return phi_i (FUNCTIONS, N) at speeds (N,) rad/s, up to the fastest of all recordings."""
    grid, functions = _functions()
    lowest = np.exp(grid[0])
    u = np.log(np.maximum(w / fastest, lowest))
    return np.array([np.interp(u, grid, one) for one in functions])


@lru_cache(maxsize=1)
def _functions() -> tuple[Array, Array]:
    """Return logarithms of speeds (GRID,), up to the fastest, and the functions (FUNCTIONS, GRID)
    there; the sum of their squares is about one."""
    grid = np.linspace(-DECADES * np.log(10.0), 0.0, GRID)
    s = np.sqrt(5.0) * np.abs(grid[:, None] - grid) / LENGTH
    kernel = (1.0 + s + s**2 / 3.0) * np.exp(-s)
    e, U = np.linalg.eigh(kernel)
    largest = slice(-1, -1 - FUNCTIONS, -1)
    return grid, (U[:, largest] * np.sqrt(e[largest])).T


def _dry(data: WhitenedData, acting: Sequence[ActingEffect], place: FrictionPlace) -> list[Array]:
    """Return the magnitude (N,) Nm of what has the sign of the velocity in the friction at a place,
    for each stretch; none at all where nothing has it."""
    found = []
    for part in data.parts:
        found.append(np.sum([_dry_of(effect, part.signals, place) for effect in acting], axis=0))
    return found if any(one.any() for one in found) else []


def _dry_of(effect: ActingEffect, signals: Signals, place: FrictionPlace) -> Array:
    """Return the magnitude (N,) Nm of what has the sign of the velocity in the friction that an
    effect makes at a place."""
    feature = effect.feature
    acts = feature.effect.friction and feature.joint == place.joint
    if not acts or place.side not in feature.sides:
        return np.zeros(len(signals.t))
    at_once = replace(effect, turned=None)
    moving, resting = (_one_way(at_once, signals, place.side, sign) for sign in (1.0, 0.0))
    j = feature.equations.robot.joint_names.index(place.joint)
    return (moving - resting)[:, j]


def _one_way(effect: ActingEffect, signals: Signals, side: str, sign: float) -> Array:
    """Return the friction (N, n) Nm at the magnitudes of the velocities, with one sign."""
    signs = np.full_like(signals.values["sign_motor"], sign)
    forward = {"dx": np.abs(signals.values["dx"]), "sign_link": signs, "sign_motor": signs}
    of_joint, of_motor, *_ = effect.torques(replace(signals, values={**signals.values, **forward}))
    return of_joint if side == "link" else of_motor - of_joint
