"""Judge what a recording determines: before a fit, from the motion alone, and after it."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from elastic_arm.arrays import Array, Indices, Mask
from elastic_arm.estimation.motion import Motion
from elastic_arm.formatting import rounded
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.least_squares import Blocks, Fit
from elastic_arm.identification.triangular import triangular

# A parameter is determined well below the first, poorly below the second relative standard
# deviation, else not at all.
WELL = 0.05
POORLY = 0.5
# Independent equations that a good excitation gives for each parameter.
ROWS_PER_PARAMETER = 1.0
# Share of parameters that a good excitation may leave undetermined.
POOR_SHARE = 0.25
# Torque noise taken for granted before a fit, Nm (torque sensors of this class; a fit estimates its
# own).
TORQUE_NOISE = 0.26
# Errors that filters and the motion colour are judged by no less than so many seconds and so many
# swings of the motion.
SHORTEST_SECONDS = 2.0
SHORTEST_PERIODS = 2.0
# Columns at unit length that are so close to dependent leave the numbers to rounding.
HOPELESS = 1e12
# Numbers that no arm has below zero: springs, friction, inertias about axes.
NEVER_NEGATIVE = re.compile(
    r"(^[^:]*\.(K|D|m|Izz)|(viscous|coulomb)_friction:\S+\.(coefficient|torque))$"
)
# Deviations below zero from which on a number that no arm has below zero shows that the model lacks
# something.
SURE = 3.0
# Of the quickest joint's rms speed; what is below trembles, or is noise.
STANDS = 0.01
# Laws that are one and the same constant where a joint never reverses: its dry friction and the
# zero of its torque.
CONSTANT = re.compile(r"^(?:coulomb_friction|(?:joint|motor)_torque_offset):(\S+)\.")
# A parameter takes part in an undetermined direction from this share on.
TAKES_PART = 0.3


@dataclass(frozen=True)
class Excitation:
    """The parameters that the motion of a recording can determine, judged before a fit."""

    condition: float  # Condition number of the equilibrated columns
    # (B,) expected standard deviation over natural scale, for white torque noise of 0.26 Nm
    relative_std: Array
    weakest: tuple[str, ...]  # Base parameters that take part in the least determined direction
    # Whether parameters from this recording should not be trusted beyond its own kind of motion
    poor: bool
    reasons: tuple[str, ...]  # Why, in words
    one_way: tuple[str, ...] = ()  # Joints that turn in one direction only
    # Base parameters whose expected standard deviations are above half of their usual size
    undetermined: tuple[str, ...] = ()


@dataclass
class MotionStatistics:
    """Running sums of a motion: typical frequency and independent samples."""

    samples: int = 0
    seconds: float = 0.0
    speed: Array | float = 0.0  # (n,) sum of squares
    acceleration: Array | float = 0.0  # (n,) sum of squares
    forward: Array | float = 0.0  # (n,) sum of squared speeds in the positive direction
    stuck: Array | float = 0.0  # (n,) samples at which a joint sticks, where the motion states it

    def add(self, motion: Motion) -> None:
        """Add a run of motion."""
        dq, ddq = (
            (motion.dq, motion.ddq) if motion.dq is not None else (motion.dtheta, motion.ddtheta)
        )
        if dq is None or ddq is None or not len(motion):
            return
        self.samples += motion.every * len(motion)
        self.seconds += float(motion.t[-1] - motion.t[0]) * len(motion) / max(len(motion) - 1, 1)
        self.speed = self.speed + motion.every * np.sum(dq**2, axis=0)
        self.forward = self.forward + motion.every * np.sum(np.maximum(dq, 0.0) ** 2, axis=0)
        self.acceleration = self.acceleration + motion.every * np.sum(ddq**2, axis=0)
        if motion.stuck is not None:
            self.stuck = self.stuck + motion.every * np.sum(motion.stuck, axis=0)

    @property
    def frequency(self) -> float:
        """Typical frequency of the motion, Hz, of the fastest joint."""
        if not self.samples or not np.any(self.speed):
            return 0.0
        speed = np.atleast_1d(self.speed)
        acceleration = np.atleast_1d(self.acceleration)
        moves = speed > STANDS**2 * speed.max()
        return float(np.sqrt(np.max(acceleration[moves] / speed[moves])) / (2 * np.pi))

    @property
    def one_way(self) -> Indices:
        """Joints that move in only one direction."""
        speed = np.atleast_1d(self.speed)
        forward = np.atleast_1d(self.forward)
        return np.flatnonzero(np.minimum(forward, speed - forward) < STANDS**2 * speed)

    @property
    def effective_samples(self) -> float:
        """Number of independent samples: two per period of the typical frequency (Nyquist)."""
        return max(2.0 * self.frequency * self.seconds, 1.0)


def natural_scales(equations: BaseRegression) -> Array:
    """Return the expected size (B,) of each base parameter.

    It is the nominal value or, if that is small by coincidence, the usual size for its body: the
    largest first moment or moment of inertia. Laws beyond the model have none (NaN).
    """
    own = np.abs(equations.nominal)
    sizes = own.copy()
    groups: dict[tuple[str, str], list[int]] = {}
    for k, name in enumerate(equations.names):
        body, _, kind = name.rpartition(".")
        groups.setdefault((body, kind[0] if kind[0] in "mI" and kind != "m" else kind), []).append(
            k
        )
    for members in groups.values():
        sizes[members] = np.max(own[members])
    base = equations.base
    scale = np.maximum(np.abs(equations.described), sizes[base.columns])
    return np.where(scale > 0, scale, np.nan)


def excitation(
    blocks: Blocks, equations: BaseRegression, statistics: MotionStatistics
) -> Excitation:
    """Judge the motion of a recording, without its torques.

    Effects that the model lacks (friction, ripple, elasticity) follow the motion and do not average
    out as noise does. Errors of samples closer than half a period of the motion therefore count as
    one.
    """
    r = blocks.total()[..., :-1]
    crowding = np.sqrt(max(blocks.samples / statistics.effective_samples, 1.0))
    whole = triangular(r.reshape(-1, r.shape[-1]) / (TORQUE_NOISE * crowding))
    size = np.linalg.norm(whole, axis=0)
    _, s, vt = np.linalg.svd(whole / np.where(size > 0, size, 1.0), full_matrices=False)
    condition = float(s[0] / s[-1]) if s[-1] > 0 else float("inf")
    scales = natural_scales(equations)
    with np.errstate(divide="ignore", over="ignore"):
        spread = np.sqrt(np.sum((vt / np.maximum(s, 1e-300)[:, None]) ** 2, axis=0))
        relative = np.where(size > 0, spread / size, np.inf) / scales
    names = equations.base.names
    weakest = tuple(names[k] for k in np.flatnonzero(np.abs(vt[-1]) > TAKES_PART).tolist())
    reasons = _reasons(
        statistics, int(equations.equations.live.sum()), relative[np.isfinite(scales)], len(names)
    )
    one_way = tuple(equations.joints[j] for j in statistics.one_way.tolist())
    beyond = np.isfinite(scales) & ~(relative <= POORLY)
    undetermined = tuple(names[k] for k in np.flatnonzero(beyond).tolist())
    return Excitation(condition, relative, weakest, bool(reasons), reasons, one_way, undetermined)


def _reasons(
    statistics: MotionStatistics, groups: int, relative: Array, parameters: int
) -> tuple[str, ...]:
    """Return why the excitation is poor; empty if it is not."""
    reasons = []
    if statistics.seconds < max(
        SHORTEST_SECONDS, SHORTEST_PERIODS / max(statistics.frequency, 1e-9)
    ):
        reasons.append(
            f"{statistics.seconds:.2g} s of motion are too short to estimate the errors:"
            " standard deviations may be several times too small"
        )
    rows = statistics.effective_samples * groups
    if rows < ROWS_PER_PARAMETER * parameters:
        reasons.append(
            f"the motion has few independent samples: {statistics.seconds:.3g} s at"
            f" {statistics.frequency:.2g} Hz give about {rows:.0f} independent equations"
            f" for {parameters} parameters"
        )
    bad = np.count_nonzero(~(relative <= POORLY))
    if bad > POOR_SHARE * len(relative):
        reasons.append(
            f"with {TORQUE_NOISE:g} Nm of noise, {bad} of the arm's {len(relative)} base"
            f" parameters have standard deviations above {POORLY:.0%} of their usual size"
        )
    return tuple(reasons)


def verdicts(relative_std: Array) -> tuple[str, ...]:
    """Return "well", "poorly" or "not" for each relative standard deviation."""
    return tuple(_verdict(std) for std in relative_std)


def _verdict(relative_std: float) -> str:
    if relative_std <= WELL:
        return "well"
    return "poorly" if relative_std <= POORLY else "not"


def relative_std(equations: BaseRegression, Psi_base: Array, std: Array) -> Array:
    """Return standard deviations relative to the natural scale.

    For laws beyond the model they are relative to the estimate. For numbers that cannot be
    negative, the smaller of both counts, because noise in the regressor reduces their estimates
    (:mod:`.errors_in_variables`) and their standard deviations.
    """
    scale = natural_scales(equations)
    own = np.maximum(np.abs(Psi_base), 1e-300)
    scale = np.where(
        np.isfinite(scale), np.where(_positive(equations), np.fmin(scale, own), scale), own
    )
    return std / scale


def directions(undetermined: Array, names: Sequence[str]) -> tuple[str, ...]:
    """Name the combinations of base parameters that the data do not determine."""
    found = []
    for direction in undetermined:
        taking_part = np.flatnonzero(np.abs(direction) > TAKES_PART).tolist()
        found.append(" ".join(f"{direction[k]:+.2f} ({names[k]})" for k in taking_part))
    return tuple(found)


def impossible(equations: BaseRegression, Psi: Array) -> Mask:
    """Return which base parameters (B,) are negative although all their parts are positive."""
    return (Psi < 0) & _positive(equations)


def _positive(equations: BaseRegression) -> Mask:
    """Return which base parameters (B,) are sums of numbers that cannot be negative."""
    never = np.array([NEVER_NEGATIVE.search(name) is not None for name in equations.names])
    return np.array(
        [bool(np.all(row >= 0) and np.all(never[row != 0])) for row in equations.base.T]
    )


def checked(
    words: Sequence[str], fit: Fit, equations: BaseRegression, one_way: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return the verdicts, corrected for impossible and indistinct parameters.

    An impossible parameter is "not" determined. None is "well" determined if the fit is
    ill-conditioned, or if it contains a constant of a joint that never reverses.
    """
    wrong = impossible(equations, fit.Psi)
    with_constants = equations.base.T[:, _constants(equations, one_way)] != 0.0
    hopeless = (fit.condition > HOPELESS) | with_constants.any(axis=1)
    found = []
    for word, bad, doubted in zip(words, wrong.tolist(), hopeless.tolist(), strict=True):
        at_best = "poorly" if doubted and word == "well" else word
        found.append("not" if bad else at_best)
    return tuple(found)


def _constants(equations: BaseRegression, joints: Sequence[str]) -> list[int]:
    """Return which parameters (P,) are constants if these joints never reverse."""
    matched = [CONSTANT.match(name) for name in equations.names]
    return [k for k, match in enumerate(matched) if match is not None and match[1] in joints]


def remarks(fit: Fit, equations: BaseRegression, one_way: Sequence[str] = ()) -> tuple[str, ...]:
    """Return in words which parameters were fixed, are impossible or inseparable, and lags and
    offsets of link encoders."""
    names = equations.base.names
    found = []
    if fit.fixed:
        kept = ", ".join(names[k] for k in fit.fixed)
        found.append(f"this recording does not determine {kept}: described values are kept")
    if constants := [equations.names[k] for k in _constants(equations, one_way)]:
        joints = ", ".join(
            dict.fromkeys(CONSTANT.sub(r"\1.", name).rpartition(".")[0] for name in constants)
        )
        why = "a zero of the torque and dry friction are the same constant there"
        found.append(
            f"{joints} turned in only one direction: {why}, and neither can be determined;"
            " record reversals as well"
        )
    # Not what is zero but for its uncertainty, as a law tried at a joint that does not have it.
    beyond = impossible(equations, fit.Psi) & (
        np.abs(fit.Psi) > SURE * np.sqrt(np.diag(fit.covariance))
    )
    below = [names[k] for k in np.flatnonzero(beyond).tolist()]
    if below:
        found.append(
            f"{', '.join(below)}: negative, which is physically impossible; the model"
            " lacks an effect there"
        )
    if fit.condition > HOPELESS:
        found.append(
            f"condition number {fit.condition:.1e}: this recording determines no parameter well"
        )
    return (*found, *_encoders(fit, equations))


def _encoders(fit: Fit, equations: BaseRegression) -> list[str]:
    """Return the significant lags and offsets of the link encoders."""
    if not equations.summed:
        return []
    place = {name: k for k, name in enumerate(equations.base.names)}
    found = []
    for j, (K, _) in zip(equations.wound, equations.drive_columns, strict=True):
        joint = equations.joints[j]
        parts = []
        for what, words, unit in (("delay", "lags by", "ms"), ("offset", "offset", "mrad")):
            k = place.get(f"link_encoder:{joint}.K_{what}")
            if k is not None and abs(fit.Psi[k]) > 5.0 * fit.std[k]:
                own = equations.model.robot.units.at(joint, unit)
                size = " ± ".join(
                    rounded(1e3 * fit.Psi[k] / fit.Psi[K], 1e3 * fit.std[k] / fit.Psi[K])
                )
                parts.append(f"{words} {size} {own}")
        if parts:
            found.append(
                f"link encoder of {joint} relative to the motor encoder: {', '.join(parts)}"
            )
    return found
