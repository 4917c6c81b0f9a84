"""Criteria for how well a motion determines the base parameters.

A criterion is a number to be minimised. It is computed from the base columns W of the regressor
over one period, with each row divided by the noise of its equation and each column by a `scale`,
its length over an ordinary motion. (Division by its own length would reward a joint that hardly
moves.)

``condition``  condition number of W: how far errors of one parameter leak into others.
``d_optimal``  -log10 det(W'W) / (2 B): mean logarithm of the parameters' standard deviations along
               the axes of their confidence ellipsoid.
``a_optimal``  log10 of the parameters' root mean square standard deviation, each in units of its
               scale.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from elastic_arm.arrays import Array, Indices
from elastic_arm.dynamics import Model
from elastic_arm.errors import ExcitationError
from elastic_arm.excitation.fourier import FourierTrajectory
from elastic_arm.excitation.limits import generalized

Criterion = Callable[[Array, Array], float]

# What stands for infinity where the columns are dependent: searches compare numbers.
WORST_CONDITION = 1e16
# Columns that differ less than this over ordinary motions cannot be told apart by a stiff arm:
# theta'' follows q''.
DISTINCT = 1e-4


def condition(W: Array, scale: Array) -> float:
    """Return the condition number of W (rows, B) with columns divided by `scale` (B,)."""
    singular = _singular(W, scale)
    return float(singular[0] / singular[-1])


def d_optimal(W: Array, scale: Array) -> float:
    """Return -log10 det(W'W) / (2 B) of the scaled W; the scale only shifts it."""
    singular = _singular(W, scale)
    return float(-np.log10(singular).mean())


def a_optimal(W: Array, scale: Array) -> float:
    """Return log10 of the root mean square of the parameters' standard deviations times `scale`."""
    singular = _singular(W, scale)
    return float(0.5 * np.log10(np.mean(singular**-2.0)))


CRITERIA: dict[str, Criterion] = {
    "condition": condition,
    "d_optimal": d_optimal,
    "a_optimal": a_optimal,
}


def find_criterion(name: str) -> Criterion:
    """Return the criterion of that name; an ExcitationError if there is none."""
    if name not in CRITERIA:
        raise ExcitationError(f"unknown criterion {name!r}", f"Use one of {', '.join(CRITERIA)}")
    return CRITERIA[name]


@dataclass(frozen=True, eq=False)
class BaseRegressor:
    """The base columns of a model's regressor (10) over one period of a motion."""

    model: Model  # whose regressor
    # of the base parameters (``BaseParameters.columns`` of the identification)
    columns: Sequence[int] | Indices
    # (dof,) standard deviation of each equation's error, by which its rows are divided, Nm; None:
    # all alike
    noise: Array | None = None
    samples: int = 150  # of the period
    # indices into `columns` of those that count; None: all. (One compiled regressor serves every
    # choice.)
    picked: Indices | None = None

    def __call__(self, trajectory: FourierTrajectory) -> Array:
        """Return W, (samples * dof, B)."""
        x, dx, ddx = elastic_motion(self.model, trajectory, self.samples)
        Phi = self.model.regressor(x, dx, ddx, columns=self.columns)
        if self.noise is not None:
            Phi = Phi / np.asarray(self.noise)[:, None]
        W = Phi.reshape(-1, Phi.shape[-1])
        return W if self.picked is None else W[:, self.picked]


def distinct_columns(W: Array) -> Indices:
    """Return the largest set of columns of W (rows, B) that can be distinguished.

    Sorted indices, (at most B,).

    A base column is one that *some* state separates from the others. Where that takes link and
    motor accelerations that differ by much, no motion of a stiff arm does.
    """
    scaled = W / np.maximum(np.linalg.norm(W, axis=0), np.finfo(float).tiny)
    _, R, order = scipy.linalg.qr(scaled, mode="economic", pivoting=True)
    return np.sort(order[np.abs(np.diag(R)) > DISTINCT])


def elastic_motion(
    model: Model, trajectory: FourierTrajectory, samples: int
) -> tuple[Array, Array, Array]:
    """Return x, dx, ddx (samples, dof) over one period when the links follow `trajectory`.

    The motors lead by the drives' deflection under the link side's torque. That torque is periodic
    and smooth, so its derivatives are those of its Fourier series.
    """
    motion = trajectory.evaluate(trajectory.samples(samples))
    x, dx, ddx = (generalized(model, values) for values in motion)
    if not model.robot.elastic:
        return x, dx, ddx
    n = model.n
    stiffness = np.array(
        [j.transmission.stiffness for j in model.robot.joints if j.transmission is not None]
    )
    lead = model.inverse_dynamics(x, dx, ddx)[:, :n] / stiffness
    spectrum = np.fft.rfft(lead, axis=0)
    turning = 1j * trajectory.omega * np.arange(len(spectrum))[:, None]
    for order, values in enumerate((x, dx, ddx)):
        values[:, n : 2 * n] += np.fft.irfft(turning**order * spectrum, samples, axis=0)
    return x, dx, ddx


def _singular(W: Array, scale: Array) -> Array:
    """Return the singular values of W with columns divided by `scale`, none near zero.

    They are those of its small triangular factor.
    """
    factor = np.linalg.qr(W / np.where(scale > 0.0, scale, 1.0), mode="r")
    values = np.linalg.svd(factor, compute_uv=False)
    return np.maximum(values, values[0] / WORST_CONDITION)
