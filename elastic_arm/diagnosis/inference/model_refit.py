"""The model's own parameters from the recording, so that what remains of the gap is structure.

A nominal model of a real arm is wrong in every number. What the recording determines of Psi is fitted; what it does not
stays nominal.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.settings import RefitSettings
from elastic_arm.dynamics import Model, build_model
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.equations import EquationSet
from elastic_arm.estimation.motion import CompletedMotion
from elastic_arm.estimation.observation import Observation
from elastic_arm.estimation.whitening import WhitenedData

Array = NDArray[np.float64]


def refitted(
    model: Model, observations: Sequence[Observation], layout: EquationSet, band: Band, settings: RefitSettings
) -> Model:
    """Return the model with Psi fitted to whitened residuals of the observations, from the nominal values.

    A ridge regression: what the recording does not determine stays near its nominal value.

    Parameters
    ----------
    model
        The nominal model.
    observations
        Of the identification recordings.
    layout, band
        Usable equations, and where they are compared.
    settings
        Prior of the nominal values.
    """
    data = WhitenedData(model, observations, layout, band)
    columns = []
    for part in data.parts:
        full = _columns(model, part.stretch.quiet)
        rows = layout.combine(full)
        flat = band.apply(rows.reshape(len(rows), -1))[part.stretch.kept]
        columns.append(flat.reshape(len(flat), layout.rows, -1))
    white = data.whiten(columns)
    # Relative changes of parameters of a kind count alike.
    scale = np.maximum(np.abs(model.Psi), 1e-3 * np.abs(model.Psi).max())
    u, s, vt = np.linalg.svd(white * scale, full_matrices=False)
    projected = u.T @ data.white
    left = float(data.white @ data.white - projected @ projected)
    misfit = max(1.0, left / max(1.0, data.freedom - len(s)))
    # What is left beyond noise is coloured: fewer rows are independent than there are.
    weight = misfit * min(misfit, settings.most_discount) / settings.nominal_error**2
    change = scale * (vt.T @ (s * projected / (s**2 + weight)))
    fitted = build_model(model.robot, model.name)
    fitted.Psi = model.Psi + change
    return fitted


def _columns(model: Model, motion: CompletedMotion) -> Array:
    """Derivative (N, 3 n, P) of link, drive and motor residual by Psi, with the sign of what the arm has more."""
    n, N = model.n, len(motion)
    if not model.robot.elastic:
        link = model.regressor(motion.q, motion.dq, motion.ddq)
        return np.concatenate([link, np.zeros((N, 2 * n, link.shape[2]))], axis=1)
    x, dx, ddx = (motion.coordinates(rate) for rate in ("", "d", "dd"))
    phi = model.regressor(x, dx, ddx)
    drive = np.zeros((N, n, phi.shape[2]))
    for i, spring in enumerate(s for s in model.bodies.springs if s.against is not None):
        drive[:, i, spring.stiffness] = motion.theta[:, i] - motion.q[:, i]
        drive[:, i, spring.damping] = motion.dtheta[:, i] - motion.dq[:, i]
        # The sensor's torque stands where the spring's stood.
        phi[:, :, [spring.stiffness, spring.damping]] = 0.0
    return np.concatenate([phi[:, :n], drive, phi[:, n : 2 * n]], axis=1)
