"""Nonparametric laws: smooth functions of the quantities on which friction, springs, drive and
sensors of a joint depend.

    f(a) = sum_k gamma_k phi_k(a),   gamma ~ N(0, size² 1)

The columns phi span the range of the argument in all recordings, with one of two priors:

- rough: cubic splines whose coefficients are a random walk of second order (P-splines, Eilers and
  Marx 1996);
- smooth: a Gaussian process over the range r in [0, 1], K = 1 + M(|r - r'|) + 0.03² M(4 |r - r'|),
  with the Matern 5/2 kernel M(d) = (1 + s + s²/3) exp(-s), s = √5 d (Rasmussen and Williams 2006,
  equation 4.17).

A law of the catalogue has a fixed form. If the form is wrong, a nonparametric law explains more,
although each of its many coefficients has a price (:mod:`elastic_arm.evidence`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import block_diag
from scipy.signal import lfilter

from elastic_arm.arrays import Array, median_step
from elastic_arm.estimation.regressors import Signals
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.robot import Transmission

Argument = Callable[[Signals], Array]

# Numbers of cubic splines: each coefficient has its price, so that too many cost a few nats and no
# truth.
SPEEDS = 10  # over the root of a speed
TIMES = 12  # over the recording
PLACES = 16  # over an angle, of friction
ANGLES = 32  # over an angle, of a torque
LOADS = 12  # over a load
RELAXATIONS = (0.03, 0.1, 0.3, 1.0, 3.0)  # s; from a cycle of fast motion to a slow one
SHARED = {"link": 1.0, "drive": 1.0, "motor": -1.0}
WAVES = 6  # a turn
DEGREE = 3  # of the splines
MEAN = 30.0  # prior standard deviation of a law's mean over that of a spline; convention
# Of the second kernel of a smooth law.
FINER = 4.0  # inverse of its length
FINE_SHARE = 0.03  # its size
SMALL = (
    1e-8  # share of the largest eigenvalue of the kernel below which a shape is left out; numerical
)
ROUGH = "rough"
SMOOTH = "smooth"


@dataclass(frozen=True)
class GeneralLaw:
    """Functions of the motion whose sum with any coefficients is a law."""

    joint: int  # index of the joint on which it acts
    side: str  # "link", "drive", "motor", or "sensor" for what a torque sensor reads
    argument: str  # what it depends on, in words
    shapes: Callable[[Signals], Array]  # signals -> (N, k)
    mixed: Array  # (k, k') combinations of these that are its functions
    # whether it is a general form of friction: dry friction of one size is among its functions
    friction: bool = False
    smoothness: str = ROUGH  # prior of its functions

    def plain(self, data: WhitenedData) -> list[Array]:
        """Return its columns (N', R, k') in the band, one array a stretch; coefficients of 1 make
        about 1 Nm."""
        return [shapes @ self.mixed for shapes in self.plain_shapes(data)]

    def plain_shapes(self, data: WhitenedData) -> list[Array]:
        """Return the shapes that its columns are made of, (N', R, k)."""
        parts = [part.stretch.in_band(self.shapes(part.signals)) for part in data.parts]
        return placed(data, self.side, self.joint, parts)


def general_laws(
    sets: Sequence[WhitenedData], joint: int, gear: Transmission | None = None
) -> list[GeneralLaw]:
    """Return the general laws of a joint.

    sets: of the recordings: they span the functions' arguments; gear: its transmission: some laws
    repeat with its turns.
    """
    n = sets[0].layout.n
    sides = sets[0].layout.sides
    found = _laws_over_a_range(sets, joint)

    def add(side: str, argument: str, shapes: Argument, count: int) -> None:
        found.append(GeneralLaw(joint, side, argument, shapes, np.eye(count)))

    if "drive" in sides:
        remembered = _scaled(sets, _relaxed(_load(joint), RELAXATIONS))
        add("drive", "its earlier load", remembered, len(RELAXATIONS))
    elastic = sets[0].parts[0].signals.values["x"].shape[1] > n
    if gear is not None and elastic:
        for acting in ("drive", "motor"):
            for turn, ratio in (
                ("wave generator", gear.harmonic_drive_ratio),
                ("rotor", gear.r_tot),
            ):
                if acting in sides:
                    waves = _waves(_signal("x", n + joint), ratio)
                    add(acting, f"the angle within a turn of its {turn}", waves, 2 * WAVES)
    if n > 1:
        loads = _scaled(sets, _loads_but(joint))
        add("sensor", "the loads of other joints", loads, n - 1)
    return found


def _laws_over_a_range(sets: Sequence[WhitenedData], joint: int) -> list[GeneralLaw]:
    """Return the laws of a joint that are functions of one argument over its range, of each prior
    side by side."""
    n = sets[0].layout.n
    sides = sets[0].layout.sides
    load = _load(joint)
    found = []

    def over(argument: Argument, count: int) -> Argument:
        return _splines(sets, argument, count)

    def add(
        side: str, argument: str, shapes: Argument, *counts: int, friction: bool = False
    ) -> None:
        for smoothness, functions in PRIORS.items():
            mixed = block_diag(*(functions(count) for count in counts))
            found.append(GeneralLaw(joint, side, argument, shapes, mixed, friction, smoothness))

    for side in (side for side in ("link", "motor") if side in sides):
        first = n if side == "motor" and sets[0].parts[0].signals.values["x"].shape[1] > n else 0
        angle = _signal("x", first + joint)
        speed = _signal("dx", first + joint)
        sign = _signal(f"sign_{side}", joint)
        over_speed = _and_times(sign, over(_root(speed), SPEEDS))
        add(side, "its speed", over_speed, SPEEDS, SPEEDS, friction=True)
        over_angle = _times(sign, over(angle, PLACES))
        by_angle = "its direction, with a size that depends on its angle"
        add(side, by_angle, over_angle, PLACES, friction=True)
        over_load = _times(sign, over(load, PLACES))
        by_load = "its direction, with a size that depends on its load"
        add(side, by_load, over_load, PLACES, friction=True)
        over_time = _times(sign, over(_signal("progress", 0), TIMES))
        by_time = "its direction, with a size that depends on time"
        add(side, by_time, over_time, TIMES, friction=True)
        add(side, "its angle", over(angle, ANGLES), ANGLES)
    if "drive" in sides:
        add("drive", "its load", over(load, LOADS), LOADS)
    if "link" in sides or "drive" in sides:
        add("sensor", "its load", _but_linear(sets, load, over(load, LOADS)), LOADS)
    return found


def _signal(name: str, column: int) -> Argument:
    return lambda signals: np.asarray(signals.values[name][:, column])


def _load(joint: int) -> Argument:
    """Return the predicted torque (N,) in a joint, clear of the encoders' noise, which is in the
    residuals, too."""
    return lambda signals: np.asarray(signals.model_torques["clear"][:, joint])


def _loads_but(joint: int) -> Argument:
    return lambda signals: np.delete(signals.model_torques["clear"], joint, axis=1)


def _root(argument: Argument) -> Argument:
    """Return the root of a magnitude: friction bends most at low speed."""
    return lambda signals: np.sqrt(np.abs(argument(signals)))


def _waves(angle: Argument, ratio: float) -> Argument:
    """Return waves of a turn that is so many times an angle."""
    turns = np.arange(1, WAVES + 1) * ratio

    def shapes(signals: Signals) -> Array:
        phase = angle(signals)[:, None] * turns
        return np.hstack([np.sin(phase), np.cos(phase)])

    return shapes


def _times(factor: Argument, shapes: Argument) -> Argument:
    return lambda signals: factor(signals)[:, None] * shapes(signals)


def _and_times(factor: Argument, shapes: Argument) -> Argument:
    """Return shapes times a factor, and the shapes themselves."""

    def both(signals: Signals) -> Array:
        own = shapes(signals)
        return np.hstack([factor(signals)[:, None] * own, own])

    return both


def _scaled(sets: Sequence[WhitenedData], shapes: Argument) -> Argument:
    """Return torques that together have 1 Nm over all recordings."""
    values = np.concatenate([shapes(part.signals) for data in sets for part in data.parts])
    size = float(np.sqrt(np.mean(np.sum(values**2, axis=1)))) or 1.0
    return lambda signals: shapes(signals) / size


def _splines(sets: Sequence[WhitenedData], argument: Argument, count: int) -> Argument:
    """Return cubic B-splines over the range of an argument in all recordings.

    argument: signals -> (N,); count: number of splines.
    """
    values = np.concatenate([argument(part.signals) for data in sets for part in data.parts])
    low = float(values.min())
    high = float(values.max())
    high = max(high, low + 1e-9)
    step = (high - low) / (count - DEGREE)
    knots = low + step * np.arange(-DEGREE, count + 1)

    def shapes(signals: Signals) -> Array:
        within = np.clip(argument(signals), low, high)
        # The right end belongs to the last interval.
        local = BSpline.design_matrix(np.minimum(within, high - 1e-9 * step), knots, DEGREE)
        return local.toarray()

    return shapes


def _random_walk(count: int) -> Array:
    """Return coefficients (count, count + 1) of splines: random bends of unit size, and a mean with
    a wider prior."""
    walk = np.cumsum(np.cumsum(np.eye(count), axis=0), axis=0)
    walk -= walk.mean(axis=0)
    walk /= np.sqrt(np.mean(np.sum(walk**2, axis=1)))
    return np.hstack([walk, np.full((count, 1), MEAN)])


def _gaussian_process(count: int) -> Array:
    """Return coefficients (count, k) of splines whose products are the kernel of a smooth law,
    largest first."""
    r = np.linspace(0.0, 1.0, count)
    distance = np.abs(r[:, None] - r)
    kernel = 1.0 + _matern(distance) + FINE_SHARE**2 * _matern(FINER * distance)
    e, U = np.linalg.eigh(kernel)
    own = e > SMALL * e.max()
    return (U[:, own] * np.sqrt(e[own]))[:, ::-1]


def _matern(distance: Array) -> Array:
    """Return the Matern 5/2 kernel at distances in its length."""
    s = np.sqrt(5.0) * distance
    return (1.0 + s + s**2 / 3.0) * np.exp(-s)


# prior of the functions over a range, by name: count -> (count, k) combinations of splines
PRIORS = {ROUGH: _random_walk, SMOOTH: _gaussian_process}


def _but_linear(sets: Sequence[WhitenedData], argument: Argument, shapes: Argument) -> Argument:
    """Return functions without what is in proportion to their argument over all recordings.

    That part of what a sensor reads is its gain. Beside it a law that has it could take the load's
    signal off the gain's column and leave its noise, which is in the residuals.
    """
    parts = [part.signals for data in sets for part in data.parts]
    x = np.concatenate([argument(signals) for signals in parts])
    share = x @ np.concatenate([shapes(signals) for signals in parts]) / max(float(x @ x), 1e-300)
    return lambda signals: shapes(signals) - argument(signals)[:, None] * share


def _relaxed(load: Argument, constants: Sequence[float]) -> Argument:
    """Return a load behind first-order lags: what a drive that creeps or remembers follows.

    load: signals -> (N,) Nm.
    """

    def shapes(signals: Signals) -> Array:
        values = load(signals)
        step = median_step(signals.t)
        start = values[0]
        found = []
        for constant in constants:
            share = step / (constant + step)
            found.append(lfilter([share], [1.0, share - 1.0], values - start))
        return np.stack(found, axis=1)

    return shapes


def placed(data: WhitenedData, side: str, joint: int, shapes: Sequence[Array]) -> list[Array]:
    """Return shapes as columns (N', R, k) of the residuals in which a side of a joint shows,
    treated as those are.

    side: "link", "drive", "motor", or "sensor" for all that share a torque sensor; shapes: (N', k)
    of each stretch.
    """
    layout = data.layout
    columns = [np.zeros((thin.shape[1], layout.rows, len(thin))).T for thin in shapes]
    for name in layout.sides if side == "sensor" else (side,):
        sign = SHARED.get(name, 1.0) if side == "sensor" else 1.0
        for own, thin in zip(columns, shapes, strict=True):
            own[:, _row(data, name, joint)] = sign * thin
    return data.weighted(columns, in_place=True)


def _row(data: WhitenedData, side: str, joint: int) -> int:
    sides = data.layout.sides
    return (sides.index(side) if side in sides else 0) * data.layout.n + joint
