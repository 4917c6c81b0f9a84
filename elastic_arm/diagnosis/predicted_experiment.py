"""A hypothetical experiment: the residuals that effects would cause, with noise of known size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics import Model
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.equation_sets import EquationSet
from elastic_arm.estimation.motion import Motion, completed
from elastic_arm.estimation.regressors import Signals
from elastic_arm.estimation.residuals import SLOWEST, raw_residuals
from elastic_arm.estimation.whitening import NoiseModel, WhitenedData
from elastic_arm.excitation import FourierTrajectory


@dataclass(frozen=True)
class ExperimentConditions:
    """The conditions that a new recording would share with an existing one."""

    model: Model  # the nominal model
    layout: EquationSet  # usable equations
    noise: NoiseModel  # of the channels, propagated to the equations
    cutoff: float  # Hz
    acceleration_cutoff: float  # Hz, up to which accelerations are motion rather than noise

    @staticmethod
    def of(model: Model, data: WhitenedData) -> ExperimentConditions:
        """Return the conditions of the longest stretch of a data set."""
        part = max(data.parts, key=lambda p: len(p.stretch.t))
        return ExperimentConditions(
            model, data.layout, part.noise, data.band.cutoff, part.signals.cutoff
        )


class PredictedExperiment:
    """A trajectory as it would be recorded, without noise.

    trajectory: motion of the motors; the links follow through the stiffness of the drives.
    """

    def __init__(
        self, conditions: ExperimentConditions, trajectory: FourierTrajectory, rate: float
    ) -> None:
        self._conditions = conditions
        model = conditions.model
        self._rate = min(rate, conditions.noise.rate)
        t = np.arange(0.0, trajectory.duration, 1.0 / self._rate)
        theta, dtheta, ddtheta = trajectory.evaluate(t)
        motion = completed(Motion(t, theta=theta, dtheta=dtheta, ddtheta=ddtheta), model)
        # Without motor torque, the residual of the motor is the whole motor torque.
        motion.tau_m[:] = -raw_residuals(model, motion)[:, 2 * model.n :]
        still = np.full(model.n, SLOWEST)
        self._signals = Signals.of(
            motion,
            (still, still),
            elastic=model.robot.elastic,
            cutoff=conditions.acceleration_cutoff,
        )

    def white(self, feature: Feature, searched: Sequence[float]) -> Array:
        """Return a feature's columns (rows, k), with white noise of variance one in each row; null
        outside the band."""
        conditions = self._conditions
        rows = conditions.layout.combine(feature.columns(self._signals, searched))
        # Most laws act in few residuals.
        acting = np.any(rows.any(axis=0), axis=1)
        f = np.fft.rfftfreq(len(rows), 1.0 / self._rate)
        inside = f <= conditions.cutoff
        spectrum = (
            conditions.noise.whitener(f[inside])[:, :, acting]
            @ np.fft.rfft(rows[:, acting], axis=0)[inside]
        )
        # Parseval, with both signs of every f except 0; the noise is that of one sample of the
        # recording.
        spectrum *= np.sqrt(2.0 / len(rows) * conditions.noise.rate / self._rate)
        spectrum[0] /= np.sqrt(2.0)
        flat = spectrum.reshape(-1, spectrum.shape[2])
        return np.vstack([flat.real, flat.imag])
