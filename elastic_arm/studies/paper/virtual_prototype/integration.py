"""Integration of the prototype: Runge-Kutta's method of fourth order, the division of time, and the linear solution."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg.lapack import dposv

RUNGE_KUTTA_REACH = 2.78  # of |eigenvalue| times step, on the real axis
RECORD_RATE = 1000.0


def runge_kutta(
    acceleration: Callable[[int, np.ndarray], np.ndarray], half: int, state: np.ndarray, first: np.ndarray, h: float
) -> np.ndarray:
    """Take one classical fourth-order step of u'' = acceleration(number of the half step, (u, u')).

    Returns
    -------
    state
        u and u' at the end of the step (2, m).
    """
    # Position and velocity are advanced together: a step costs as much in calls of NumPy as in arithmetic.
    rates = np.empty((4, *state.shape))
    one, two, three, four = rates
    one[0], one[1] = state[1], first
    for k, (rate, known, reach) in enumerate(((two, one, 0.5 * h), (three, two, 0.5 * h), (four, three, h))):
        at = reach * known
        at += state
        rate[0], rate[1] = at[1], acceleration(half + 1 + k // 2, at)
    rates[1:3] *= 2.0
    change = one + two
    change += three
    change += four
    change *= h / 6.0
    change += state
    return change


def solve(mass: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Solve with a symmetric positive definite matrix; LAPACK itself, as this is most of a small step's overhead."""
    solution: np.ndarray = dposv(mass, force)[1]
    return solution


def dividing_step(step: float, rate: float = RECORD_RATE) -> float:
    """Return the largest step, at most `step`, of which a whole number makes one sample, s."""
    return 1.0 / (rate * max(1, int(np.ceil(1.0 / (rate * step) - 1e-9))))


def division(duration: float, step: float, rate: float) -> tuple[int, int, float]:
    """Divide a time into steps of which a whole number makes one sample.

    Returns
    -------
    steps, stride, step
        Number of steps, steps a sample, and the step, s.
    """
    stride = round(1.0 / (rate * dividing_step(step, rate)))
    steps = stride * round(duration * rate)
    return steps, stride, duration / steps
