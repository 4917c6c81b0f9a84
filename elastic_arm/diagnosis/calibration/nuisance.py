"""Nuisance parameters: what is ordinarily imperfect in a description and its sensors, each with a Gaussian prior.

The residuals r are linear in small changes of them, r = r_0 + N nu with nu ~ N(0, diag(std^2)). Marginalised, they turn
the Gram matrix of all columns into its Schur complement, so that every comparison of hypotheses accounts for them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.priors import Priors
from elastic_arm.diagnosis.settings import RefitSettings
from elastic_arm.dynamics.bodies import TENSOR
from elastic_arm.effects.model import SensorEffect
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.motion import Motion
from elastic_arm.robot import Joint, Robot

Array = NDArray[np.float64]

LEAST_SCALE = 1e-9  # numerical; of roots of sums of squares of torques and accelerations
ZERO_AS_MOUNTED = 1e-3  # rad; of a link encoder that was never compared with the motor's under a known torque
PRESLIDING = "presliding"  # how gradually dry friction changes its sign: no number of the arm or of a sensor


@dataclass(frozen=True)
class NuisanceParameter:
    """One number that may differ from what the description states.

    Parameters
    ----------
    what
        Which, e.g. "link_mass"; the id of an effect for what an effect's file states.
    joint
        Of the joint, or of the link behind it.
    unit
        "1" for a ratio.
    prior_std
        Of its deviation from the description.
    neutral
        Its value as described: 1 for a ratio, else 0.
    feature
        The effect of a sensor or of warming friction; None for a number of the arm.
    error
        The effect of a number of the arm that is off; None where the catalogue has none.
    limit
        Largest believable deviation, in standard deviations of the prior; infinite where none is known.
    speeds
        Of presliding alone: widths, rad/s, of the two sign functions between which friction turns over, or the width
        within which it does so early or late.
    side
        Of presliding alone: "link" or "motor", on which friction turns over.
    curve
        Half waves k of what a sensor's error in proportion to time does beside, L sin(k pi t / L) instead of t; 0 for
        the error itself.
    widened
        How much wider than of an ordinary sensor the prior is: of one that was found to be faulty.
    recording
        Number of the recording in which alone it acts: by how much a zero is another one there than in the first; None
        of what is the same in all.
    """

    what: str
    joint: str
    unit: str
    prior_std: float
    neutral: float
    feature: Feature | None = None
    error: Feature | None = None
    limit: float = np.inf
    speeds: tuple[float, ...] | None = None
    side: str = ""
    curve: int = 0
    widened: float = 1.0
    recording: int | None = None

    @property
    def cause(self) -> Feature | None:
        """The effect under which it is reported where it is beyond ordinary.

        None of what is no number by itself, or is another one in each recording.
        """
        return None if self.curve or self.recording is not None else self.feature or self.error

    @property
    def is_number(self) -> bool:
        """Whether it is a number of the arm or of a sensor, and not a detail of how a law is met."""
        return not (self.curve or self.what.startswith(PRESLIDING))

    @property
    def is_torque_gain(self) -> bool:
        """Whether it scales what a torque channel reads."""
        return self.unit == "1" and self.feature is not None and self.feature.read_torque is not None

    @property
    def ordinary_std(self) -> float:
        """Standard deviation of its prior over ordinary arms."""
        return self.prior_std / self.widened

    def of_fault(self, factor: float) -> NuisanceParameter:
        """Return it with a prior wider by a factor: a sensor that is beyond ordinary may be off by any amount."""
        return replace(
            self, prior_std=factor * self.prior_std, limit=self.limit / factor, widened=factor * self.widened
        )

    def is_ordinary(self, deviation: float, std: float, settings: RefitSettings) -> bool:
        """Whether it may be as little off as on ordinary arms.

        Both the estimate and what the recording alone determines have to lie beyond the prior.

        Parameters
        ----------
        deviation, std
            From the description, and its standard deviation, with the prior.
        settings
            How far beyond the prior.
        """
        if self.neutral == 1.0 and deviation <= -1.0:
            return False  # a ratio below zero, however uncertain
        held = self._distance(deviation, std)[0] <= settings.beyond_ordinary * self.ordinary_std
        return bool(held or self.distance(*self.without_prior(deviation, std)) <= settings.beyond_ordinary)

    def is_beyond(self, alone: float, uncertain: float, settings: RefitSettings) -> bool:
        """Whether the recording alone shows it beyond ordinary, though a narrow prior may hold the estimate back.

        Parameters
        ----------
        alone, uncertain
            Deviation and standard deviation :meth:`without_prior`.
        settings
            How far beyond the prior, and how certainly off at all.
        """
        clear = abs(alone) > 2.0 * settings.certain * uncertain
        return bool(clear and self.distance(alone, uncertain) > settings.beyond_ordinary)

    def distance(self, alone: float, uncertain: float) -> float:
        """Return how far from what is described a recording finds it, in deviations of what is expected of that.

        Of an ordinary arm an estimate scatters by the prior and by its own standard deviation.

        Parameters
        ----------
        alone, uncertain
            Deviation and standard deviation :meth:`without_prior`.
        """
        off, std = self._distance(alone, uncertain)
        return off / float(np.hypot(self.ordinary_std, std))

    def _distance(self, deviation: float, std: float) -> tuple[float, float]:
        """Return how far off it is, and how uncertain that is; of ratios below one by logarithms: they are positive."""
        if self.neutral != 1.0 or deviation > 0.0:
            return abs(deviation), std
        ratio = max(1.0 + deviation, std)
        return abs(float(np.log(ratio))), std / ratio

    def without_prior(self, deviation: float, std: float) -> tuple[float, float]:
        """Return the deviation and standard deviation that the recording alone determines.

        Of Gaussians that is the posterior divided by the prior, with precision 1/s² - 1/p².

        Parameters
        ----------
        deviation, std
            From the description, and its standard deviation, with the prior.
        """
        left = max(1.0 - (std / self.prior_std) ** 2, 1e-12)
        return deviation / left, float(std / np.sqrt(left))

    @property
    def is_inertial(self) -> bool:
        """Whether the residuals are linear in it whatever its size: a mass, a centre of mass, an inertia."""
        return self.feature is None and self.what.startswith(("link_", "rotor_", "spline_"))

    @property
    def is_of_link(self) -> bool:
        """Whether it is an inertial number of a link."""
        return self.is_inertial and self.what.startswith("link_")

    @property
    def is_of_inertia(self) -> bool:
        """Whether it is an entry of a link's inertia beside its mass."""
        return self.is_inertial and self.what.startswith("link_inertia_")

    @property
    def is_described(self) -> bool:
        """Whether it is a number of the arm that the description states: not a motor inertia that it leaves out."""
        return self.feature is None and self.is_number and not (self.what == "rotor_inertia" and self.neutral == 0.0)

    @property
    def is_sensor(self) -> bool:
        """Whether it is the error of a sensor's reading: a gain, an offset, a zero."""
        return self.feature is not None and isinstance(self.feature.effect, SensorEffect) and not self.is_lag

    @property
    def is_lag(self) -> bool:
        """Whether it is how late a channel is."""
        return self.feature is not None and "channels" in self.feature.choices

    @property
    def is_gain(self) -> bool:
        """Whether it is the gain of a torque channel."""
        return self.feature is not None and self.neutral == 1.0 and self.feature.read_torque is not None

    @property
    def channel(self) -> str | None:
        """The channel whose lag or gain it is; None of anything else."""
        if self.feature is None:
            return None
        if self.is_lag:
            (channel,) = self.feature.choices["channels"]
            return str(channel)
        return self.feature.read_torque if self.is_gain else None

    @property
    def moves_model(self) -> bool:
        """Whether residuals are made anew at its value: of the arm's numbers, of lags and of gains, not of offsets."""
        if self.feature is not None:
            return self.is_lag or self.is_gain
        return not self.what.startswith(PRESLIDING)


def nuisance_parameters(
    robot: Robot,
    features: Iterable[Feature],
    rate: float,
    priors: Priors,
    settings: RefitSettings,
    motor_inertias: Array | None = None,
    turning: Array | None = None,
    sides: Sequence[str] = ("link", "motor"),
) -> tuple[NuisanceParameter, ...]:
    """Return the numbers of an arm and of its sensors that have a prior.

    Parameters
    ----------
    robot
        The description.
    features
        Effects of sensors and of the arm's numbers at every place; sensors' without a prior in their file are left out.
    rate
        Hz, of the recordings.
    priors
        Of the arm's numbers, and those of sensors that differ from their files.
    settings
        What is believable, and the speeds of presliding.
    motor_inertias
        (n,) kg m^2, standard deviations of motor inertias that the description does not state; they have no nuisance
        parameter when None.
    turning
        (n,) speeds within which dry friction was found to turn over, rad/s; None where they were not looked for.
    sides
        Of the equations: with one of them alone, how friction turns over is the same on both sides of a drive.
    """
    found: list[NuisanceParameter] = []
    features = tuple(features)
    errors = {(feature.effect.number, feature.joint): feature for feature in features if feature.effect.number}
    for j, joint in enumerate(robot.joints):
        stds = {"link_mass": ("1", priors.mass, 1.0)}
        stds |= {f"link_com_{axis}": ("m", priors.centre_of_mass, 0.0) for axis in "xyz"}
        for a, b in TENSOR:
            std = priors.inertia if a == b else priors.product_of_inertia
            stds[f"link_inertia_{'xyz'[a]}{'xyz'[b]}"] = ("1", std, 0.0)
        if joint.transmission is not None:
            stds |= {"rotor_inertia": ("1", priors.rotor, 1.0), "spline_inertia_ratio": ("1", priors.rotor, 1.0)}
            stds |= {"stiffness": ("1", priors.stiffness, 1.0), "damping": ("1", priors.damping, 1.0)}
        if joint.armature:
            stds |= {"rotor_inertia": ("1", priors.rotor, 1.0)}
        elif joint.armature is not None and motor_inertias is not None:
            unit = "kg" if joint.prismatic else "kg m^2"
            stds |= {"rotor_inertia": (unit, float(motor_inertias[j]), 0.0)}
        for what, (unit, std, neutral) in stds.items():
            limit = settings.largest_scale / std if what == "stiffness" else np.inf
            error = errors.get((what, joint.name))
            found.append(NuisanceParameter(what, joint.name, unit, std, neutral, error=error, limit=limit))
        found += _turnovers(joint, 0.0 if turning is None else float(turning[j]), priors, settings, sides)
    for feature in features:
        chosen = _single_choices(feature)
        if feature.effect.prior is None or feature.joint is None or chosen is None:
            continue
        parameter = feature.linear[0]
        std = priors.sensors.get(feature.effect.id, feature.effect.prior(rate))
        limit = settings.largest_ratio / std if parameter.unit == "1" else np.inf
        what = "_".join([feature.effect.id, *chosen])
        neutral = parameter.neutral or 0.0
        found.append(
            NuisanceParameter(what, feature.joint, feature.unit(parameter), std, neutral, feature, limit=limit)
        )
    return tuple(found)


def _turnovers(
    joint: Joint, turning: float, priors: Priors, settings: RefitSettings, sides: Sequence[str]
) -> Iterator[NuisanceParameter]:
    """Yield how dry friction of a joint turns over on each side, from the speed (rad/s) at which that was found."""
    apart = joint.transmission is not None and {"link", "motor"} <= set(sides)
    for side in ("link", "motor") if apart else ("motor",):
        for k, speeds in enumerate(settings.presliding_speeds(turning)):
            what = f"{PRESLIDING}_{side}_{k}"
            yield NuisanceParameter(
                what, joint.name, joint.unit("Nm"), priors.presliding, 0.0, speeds=speeds, side=side
            )


def drift_curves(feature: Feature, mean_rate: float, settings: RefitSettings) -> list[NuisanceParameter]:
    """Return how a zero that drifts wanders beside its mean rate: as a random walk that ends where it does.

    Parameters
    ----------
    feature
        The drift.
    mean_rate
        Nm/s.
    settings
        How many half waves.
    """
    unit, size = feature.unit(feature.linear[0]), abs(mean_rate) * np.sqrt(2.0) / np.pi
    return [
        NuisanceParameter("drift_curve", str(feature.joint), unit, float(size / k), 0.0, feature, curve=k)
        for k in settings.drift_curves
    ]


def motor_inertia_scales(pieces: Sequence[Motion]) -> Array | None:
    """Return the motor inertias (n,) kg m^2 that alone would need all the motor torque; None where none was recorded.

    A description of links alone gives no idea of what their motors' inertia is: with gears it may be a hundred times
    that of a wrist.
    """
    squares: Array = np.zeros((2, 1))
    for piece in pieces:
        ddq = piece.ddq if piece.ddq is not None else piece.ddtheta
        if piece.tau_m is None or ddq is None:
            return None
        squares = squares + np.array([np.nansum(np.square(values), axis=0) for values in (piece.tau_m, ddq)])
    torque, acceleration = np.sqrt(squares)
    return np.asarray(np.maximum(torque, LEAST_SCALE) / np.maximum(acceleration, LEAST_SCALE))


def unreferenced(parameter: NuisanceParameter) -> NuisanceParameter:
    """Return it with the prior of an arm without joint torque sensors.

    Nothing has set the zeros of its two encoders by a known torque.
    """
    own, zero = parameter.feature, parameter.unit in ("rad", "m")
    if own is None or "q" not in own.sensed or not zero:
        return parameter
    return replace(parameter, prior_std=max(parameter.prior_std, ZERO_AS_MOUNTED))


def of_each_recording(
    parameters: Sequence[NuisanceParameter], count: int, share: float
) -> tuple[NuisanceParameter, ...]:
    """Return by how much the zeros of sensors are others in each recording than in the first.

    Parameters
    ----------
    parameters
        Those that all recordings have in common.
    count
        How many recordings there are.
    share
        Standard deviation over that of the zero itself.
    """
    zeros = [p for p in parameters if p.feature is not None and p.feature.effect.set_at_start]
    apart = [replace(p, what=f"{p.what}_difference", prior_std=share * p.prior_std) for p in zeros]
    return tuple(replace(p, recording=k) for k in range(1, count) for p in apart)


def _single_choices(feature: Feature) -> list[str] | None:
    """Return what was chosen of an effect's choices; None where several were made at once."""
    chosen = [(value,) if isinstance(value, str) else tuple(value) for value in feature.choices.values()]
    return None if any(len(values) > 1 for values in chosen) else [values[0] for values in chosen]
