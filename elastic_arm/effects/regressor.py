"""The interface of an effect's own regressor, for laws that need more than the motion of one
sample.

Most effects do not need one: the derivative of the law is their column. If the torque of an effect
follows from the whole recording (tilts that oscillate, a filtered state), the file of the effect
computes it for all samples at once.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.effects.arm_equations import ArmEquations

Made = TypeVar("Made")


class Once:
    """Keeps what regressors make of the motion alone.

    They are evaluated at many values of an effect's parameters.
    """

    def __init__(self) -> None:
        self._made: dict[str, Any] = {}

    def __call__(self, what: str, make: Callable[[], Made]) -> Made:
        """Return what goes by a name, made when it is first asked for."""
        if what not in self._made:
            self._made[what] = make()
        return self._made[what]


@dataclass(frozen=True)
class MotionSignals:
    """The motion of a recording, or of a part of it, at its rate."""

    t: Array  # (N,) s
    # (N, …) each, by name: x, dx, ddx, tau_J, tau_m, dtau_J, dtau_m, sign_link, sign_motor and more
    values: Mapping[str, Array]
    cutoff: float = np.inf  # Hz up to which accelerations are motion rather than noise
    predicted: bool = (
        False  # whether torques are those that the model predicts instead of the recorded ones
    )
    # variances (n,) of a sample's white noise of the recorded torques, Nm², by name
    torque_noise: Mapping[str, Array] = field(default_factory=dict)
    # (N, n) Nm, tau_J and tau_m as predicted, and tau_J where it is "clear" of noise; empty where
    # nobody asked
    model_torques: Mapping[str, Array] = field(default_factory=dict)
    # what is made of these signals alone
    once: Once = field(default_factory=Once, init=False, repr=False, compare=False)


class Regressor(Protocol):
    """What an effect adds to the residuals of one arm."""

    @property
    def acts(self) -> bool:
        """Whether the arm has what the effect acts in."""

    def residuals(self, signals: MotionSignals, values: Mapping[str, Any]) -> Array:
        """Return the torques (N, 3 n) added to link, drive and motor residuals."""


RegressorOf = Callable[[ArmEquations], Regressor]
