"""A regressor of an effect's own, for effects whose law over a sample's motion is not enough.

Most effects need none: the derivative of the law is their column. Where an effect's torque follows from the whole
recording (tilts that swing, a state that is filtered), the effect's file computes it over all samples at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol, TypeVar

from elastic_arm.arrays import Array
from elastic_arm.effects.equations import ArmEquations

Made = TypeVar("Made")


class Once:
    """Keeps what regressors make of the motion alone: they are asked at many values of an effect's parameters."""

    def __init__(self) -> None:
        self._made: dict[str, Any] = {}

    def __call__(self, what: str, make: Callable[[], Made]) -> Made:
        """Return what goes by a name, made when it is first asked for."""
        if what not in self._made:
            self._made[what] = make()
        found: Made = self._made[what]
        return found


class MotionSignals(Protocol):
    """The motion of a recording.

    `t` is (N,) s; `values` holds (N, dof) x, dx, ddx and (N, n) tau_J, tau_m, dtau_J, dtau_m, sign_link, sign_motor;
    `cutoff` is the frequency in Hz up to which accelerations are motion rather than noise. `predicted` states whether
    the torques are those that the model predicts instead of the recorded ones; `torque_noise` holds the variances (n,)
    of a sample's white noise of recorded torques, Nm², and `model_torques` the torques (N, n) that the model predicts,
    both by name. `once` keeps what is made of these signals alone.
    """

    @property
    def t(self) -> Array:
        """Times (N,), s."""

    @property
    def values(self) -> Mapping[str, Array]:
        """Signals (N, …) by name."""

    @property
    def cutoff(self) -> float:
        """Hz."""

    @property
    def predicted(self) -> bool:
        """Whether torques are the model's."""

    @property
    def torque_noise(self) -> Mapping[str, Array]:
        """Variances (n,) of recorded torques, Nm²."""

    @property
    def model_torques(self) -> Mapping[str, Array]:
        """Predicted torques (N, n), Nm."""

    @property
    def once(self) -> Once:
        """What was made of these signals."""


class Regressor(Protocol):
    """What an effect adds to the residuals of one arm."""

    @property
    def acts(self) -> bool:
        """Whether the arm has what the effect acts in."""

    def residuals(self, signals: MotionSignals, values: Mapping[str, Any]) -> Array:
        """Return the torques (N, 3 n) added to link, drive and motor residuals."""


RegressorOf = Callable[[ArmEquations], Regressor]
