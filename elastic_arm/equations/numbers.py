"""Uncertain numbers of the arm and of its sensors, and where they act."""

from dataclasses import dataclass

import numpy as np

from elastic_arm.estimation.effect_columns import Feature

# Gains of a joint's controller, as ratios to the stated ones: the common scale, and that of the
# velocity gain relative to it.
GAINS = SCALE, RATIO = "torque_scale", "kd"
# the distance in which dry friction changes its sign: not a number of the arm or of a sensor
PRESLIDING = "presliding"


@dataclass(frozen=True)
class Number:
    """One number that may differ from its described value."""

    what: str  # e.g. "link_mass"; the id of an effect for a number of its file
    joint: str  # the joint, or that in front of the link
    unit: str  # "1" for a ratio
    prior_std: float  # standard deviation from the description
    neutral: float  # its value as described: 1 for a ratio, else 0
    # the effect of a sensor or of warming friction; None for a number of the arm
    feature: Feature | None = None
    # the effect that reports a far-off number of the arm; None if the catalogue has none
    error: Feature | None = None
    # largest deviation at which the model is linearised, in prior standard deviations
    limit: float = np.inf
    # only for presliding: widths, rad/s, of the two sign functions between which friction changes
    # its sign, or the width within which it changes early or late
    speeds: tuple[float, ...] | None = None
    side: str = ""  # only for presliding: "link" or "motor"
    # only for a zero that differs from that in the first recording: the number of its recording
    recording: int | None = None

    @property
    def is_logarithmic(self) -> bool:
        """Whether its logarithm has the Gaussian prior: half and twice the described stiffness are
        equally probable."""
        return self.what in ("stiffness", "damping", *GAINS)

    def value(self, x: float) -> float:
        """Return the number at x standard deviations of its prior."""
        if self.is_logarithmic:
            return self.neutral * float(np.exp(x * self.prior_std))
        return self.neutral + float(x) * self.prior_std

    def slope(self, x: float) -> float:
        """Return its change by one prior standard deviation at x."""
        return self.prior_std * (self.value(x) if self.is_logarithmic else 1.0)

    @property
    def cause(self) -> Feature | None:
        """The effect that reports it if it is far off; None for a number of one recording."""
        return None if self.recording is not None else self.feature or self.error

    @property
    def kind(self) -> str:
        """Its kind: a number of the "arm", of a "sensor" or controller, the "zero" of a torque
        channel, or a "detail" of a law."""
        if not self.is_number:
            return "detail"
        if self.feature is None:
            return "sensor" if self.what in GAINS else "arm"
        of_torque = bool(self.feature.sensed & {"tau_J", "tau_m"})
        return "zero" if of_torque and self.feature.effect.set_at_start else "sensor"

    @property
    def is_number(self) -> bool:
        """Whether it is a number of the arm or of a sensor, and not a detail of a law."""
        return not self.what.startswith(PRESLIDING)

    @property
    def is_torque_gain(self) -> bool:
        """Whether it is a factor on a torque channel."""
        return (
            self.unit == "1" and self.feature is not None and self.feature.read_torque is not None
        )

    @property
    def is_inertial(self) -> bool:
        """Whether the residuals are linear in it at any size: a mass, a centre of mass, an
        inertia."""
        return self.feature is None and self.what.startswith(("link_", "rotor_", "spline_"))

    @property
    def is_of_link(self) -> bool:
        """Whether it is an inertial number of a link."""
        return self.is_inertial and self.what.startswith("link_")

    @property
    def is_lag(self) -> bool:
        """Whether it is the lag of a channel."""
        return self.feature is not None and self.unit == "s"

    @property
    def is_gain(self) -> bool:
        """Whether it is the gain of a torque channel."""
        return (
            self.feature is not None
            and self.neutral == 1.0
            and self.feature.read_torque is not None
        )

    @property
    def channel(self) -> str | None:
        """The channel of a lag or gain; None for any other number."""
        if self.feature is None:
            return None
        if self.is_lag:
            (channel,) = self.feature.choices.get("channels", ("command",))
            return str(channel)
        return self.feature.read_torque if self.is_gain else None

    @property
    def moves_model(self) -> bool:
        """Whether the residuals are recomputed at its value: for numbers of the arm, lags and
        gains, but not for offsets."""
        if self.feature is not None:
            return self.is_lag or self.is_gain
        return self.is_number
