"""Uncertain numbers of the arm and of its sensors, and where they act."""

from dataclasses import dataclass

import numpy as np

from elastic_arm.estimation.effect_columns import Feature

# Of a joint's controller, as ratios to the stated ones: all its gains alike, and that of speeds
# beside the others.
GAINS = SCALE, RATIO = "torque_scale", "kd"
PRESLIDING = (
    "presliding"  # how gradually dry friction changes its sign: no number of the arm or of a sensor
)


@dataclass(frozen=True)
class Number:
    """One number that may differ from what the description states."""

    what: str  # which, e.g. "link_mass"; the id of an effect for what an effect's file states.
    joint: str  # of the joint, or of the link behind it
    unit: str  # "1" for a ratio
    prior_std: float  # of its deviation from the description
    neutral: float  # its value as described: 1 for a ratio, else 0
    feature: Feature | None = (
        None  # the effect of a sensor or of warming friction; None for a number of the arm
    )
    # largest deviation about which the model is made, in standard deviations of the prior
    error: Feature | None = (
        None  # the effect of a number of the arm that is off; None where the catalogue has none
    )
    limit: float = np.inf
    # of presliding alone: widths, rad/s, of the two sign functions between which friction turns
    # over, or the width within which it does so early or late
    speeds: tuple[float, ...] | None = None
    side: str = ""  # of presliding alone: "link" or "motor", on which friction turns over
    # number of the recording in which alone it acts: by how much a zero is another one there than
    # in the first; None of what is the same in all
    recording: int | None = None

    @property
    def is_logarithmic(self) -> bool:
        """Whether its logarithm has the prior: a drive is half as stiff as it is stated as easily
        as twice."""
        return self.what in ("stiffness", "damping", *GAINS)

    def value(self, x: float) -> float:
        """Return the number at x standard deviations of its prior."""
        if self.is_logarithmic:
            return self.neutral * float(np.exp(x * self.prior_std))
        return self.neutral + float(x) * self.prior_std

    def slope(self, x: float) -> float:
        """Return by how much it changes there with one standard deviation."""
        return self.prior_std * (self.value(x) if self.is_logarithmic else 1.0)

    @property
    def cause(self) -> Feature | None:
        """The effect as which it is reported where it is far off; None of what is another one in
        each recording."""
        return None if self.recording is not None else self.feature or self.error

    @property
    def kind(self) -> str:
        """Whose number it is: of the "arm", of a "sensor" or controller, the "zero" of a torque
        channel, or a "detail" of how a law is met."""
        if not self.is_number:
            return "detail"
        if self.feature is None:
            return "sensor" if self.what in GAINS else "arm"
        of_torque = bool(self.feature.sensed & {"tau_J", "tau_m"})
        return "zero" if of_torque and self.feature.effect.set_at_start else "sensor"

    @property
    def is_number(self) -> bool:
        """Whether it is a number of the arm or of a sensor, and not a detail of how a law is
        met."""
        return not self.what.startswith(PRESLIDING)

    @property
    def is_torque_gain(self) -> bool:
        """Whether it scales what a torque channel reads."""
        return (
            self.unit == "1" and self.feature is not None and self.feature.read_torque is not None
        )

    @property
    def is_inertial(self) -> bool:
        """Whether the residuals are linear in it whatever its size: a mass, a centre of mass, an
        inertia."""
        return self.feature is None and self.what.startswith(("link_", "rotor_", "spline_"))

    @property
    def is_of_link(self) -> bool:
        """Whether it is an inertial number of a link."""
        return self.is_inertial and self.what.startswith("link_")

    @property
    def is_lag(self) -> bool:
        """Whether it is how late a channel is."""
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
        """The channel whose lag or gain it is; None of anything else."""
        if self.feature is None:
            return None
        if self.is_lag:
            (channel,) = self.feature.choices.get("channels", ("command",))
            return str(channel)
        return self.feature.read_torque if self.is_gain else None

    @property
    def moves_model(self) -> bool:
        """Whether residuals are made anew at its value: of the arm's numbers, of lags and of gains,
        not of offsets."""
        if self.feature is not None:
            return self.is_lag or self.is_gain
        return self.is_number
