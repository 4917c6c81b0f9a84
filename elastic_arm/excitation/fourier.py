"""Excitation as a finite Fourier series per joint, with a smooth start and stop, and its file.

    q_i(t) = q0_i + w(t) sum_k [ a_ik / (k omega) sin(k omega t) - b_ik / (k omega) cos(k omega t) ]

(J. Swevers et al., IEEE Trans. Robotics and Automation 13 (1997) 730), so that a and b are
amplitudes of velocity. The window w rises from 0 to 1 and falls back within `ramp` seconds at
either end by a polynomial whose first four derivatives vanish at its ends: the motion begins and
ends at q0 at rest, without a jump of acceleration, jerk or snap, and in between it is exactly
periodic.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.errors import ExcitationError
from elastic_arm.input_files import read_fields
from elastic_arm.output_files import write_result, yaml_text

SCHEMA = "elastic_arm/trajectory/1"
# Smooth step of degree 9: s(0) = 0, s(1) = 1, derivatives one to four zero at both.
_STEP = np.polynomial.Polynomial([0, 0, 0, 0, 0, 126, -420, 540, -315, 70])
_SPEED = _STEP.deriv()
_CURVATURE = _STEP.deriv(2)


@dataclass(frozen=True, eq=False)
class FourierTrajectory:
    """A periodic motion of n joints that starts and stops smoothly.

    An ExcitationError if the numbers make none.
    """

    omega: float  # base frequency, rad/s
    # a, b: (n, H) Velocity amplitudes of the sines' and cosines' harmonics 1 to H, rad/s
    a: Array
    b: Array
    q0: Array  # (n,) where the motion starts, stops and swings about, rad
    duration: float  # from rest to rest, s
    # length of the smooth start and of the smooth stop, s; 0 for a series that begins and ends in
    # full motion
    ramp: float = 0.0
    joints: tuple[str, ...] = ()  # names of the joints; empty where nobody has named them

    def __post_init__(self) -> None:
        for name, dimensions in (("a", 2), ("b", 2), ("q0", 1)):
            object.__setattr__(self, name, _numbers(getattr(self, name), dimensions, name))
        for name in ("omega", "duration", "ramp"):
            object.__setattr__(self, name, float(_numbers(getattr(self, name), 0, name)))
        object.__setattr__(self, "joints", tuple(str(name) for name in self.joints))
        require(self.a.shape[1] >= 1, "the series has no harmonics", "Give it at least one")
        require(
            self.a.shape == self.b.shape and len(self.a) == len(self.q0) > 0,
            f"a is {self.a.shape}, b is {self.b.shape} and q0 is {self.q0.shape}",
            "Give a and b one row per joint and one column per harmonic, and q0 one"
            " number per joint",
        )
        require(
            self.omega > 0.0, f"omega is {self.omega:g} rad/s", "Give a base frequency above zero"
        )
        require(self.ramp >= 0.0, f"ramp is {self.ramp:g} s", "Give zero or a positive time")
        require(
            self.duration > 2.0 * self.ramp,
            f"duration {self.duration:g} s leaves no time between two ramps of {self.ramp:g} s",
            "Give a longer duration or a shorter ramp",
        )
        require(
            len(self.joints) in (0, len(self.q0)),
            f"{len(self.joints)} joint names for {len(self.q0)} joints",
            "Name every joint once",
        )

    @classmethod
    def of_periods(
        cls,
        period: float,
        a: Array,
        b: Array,
        q0: Array,
        *,
        periods: float = 1.0,
        ramp: float,
        joints: Any = (),
    ) -> Self:
        """Make a trajectory of whole periods of `period` seconds between its ramps.

        There are `periods` of them.
        """
        require(period > 0.0, f"period is {period:g} s", "Give a time above zero")
        require(periods > 0.0, f"{periods:g} periods are requested", "Ask for at least one")
        return cls(
            2.0 * np.pi / period, a, b, q0, periods * period + 2.0 * ramp, ramp, tuple(joints)
        )

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.q0)

    @property
    def harmonics(self) -> int:
        """Number of harmonics H."""
        return self.a.shape[1]

    @property
    def period(self) -> float:
        """Of the series, s."""
        return float(2.0 * np.pi / self.omega)

    def evaluate(self, t: Array) -> tuple[Array, Array, Array]:
        """Return q, dq, ddq, each (N, n), at times t (N,).

        It is at rest outside [0, duration].

        Units are rad, rad/s and rad/s^2.
        """
        t = np.clip(np.atleast_1d(np.asarray(t, dtype=float)), 0.0, self.duration)
        p, dp, ddp = self._series(t)
        w, dw, ddw = (values[:, None] for values in self._window(t))
        return self.q0 + w * p, dw * p + w * dp, ddw * p + 2.0 * dw * dp + w * ddp

    def samples(self, count: int) -> Array:
        """Return `count` times (count,) evenly over one period.

        The end of the period is left out.
        """
        return self.ramp + self.period * np.arange(count) / count

    def scaled(self, factor: Array | float) -> Self:
        """Return the motion about q0 with amplitudes times `factor`, () or (n,)."""
        column = np.broadcast_to(factor, (self.n,))[:, None]
        return replace(self, a=self.a * column, b=self.b * column)

    def repeated(self, periods: float) -> Self:
        """Return the same motion with `periods` whole periods between its ramps."""
        return replace(self, duration=periods * self.period + 2.0 * self.ramp)

    def save(self, path: str | Path) -> None:
        """Write the trajectory as YAML that :func:`load_trajectory` reads back exactly."""
        content = {
            "schema": SCHEMA,
            "joints": list(self.joints),
            "omega": self.omega,
            "duration": self.duration,
            "ramp": self.ramp,
            **{name: getattr(self, name).tolist() for name in ("q0", "a", "b")},
        }
        write_result(path, yaml_text(content), ExcitationError, "Give a file in a writable folder")

    def _series(self, t: Array) -> tuple[Array, Array, Array]:
        frequency = self.omega * np.arange(1, self.harmonics + 1)
        phase = t[:, None] * frequency
        sine = np.sin(phase)
        cosine = np.cos(phase)
        p = sine @ (self.a / frequency).T - cosine @ (self.b / frequency).T
        dp = cosine @ self.a.T + sine @ self.b.T
        ddp = cosine @ (self.b * frequency).T - sine @ (self.a * frequency).T
        return p, dp, ddp

    def _window(self, t: Array) -> tuple[Array, Array, Array]:
        if self.ramp == 0.0:
            return np.ones_like(t), np.zeros_like(t), np.zeros_like(t)
        rising = t < 0.5 * self.duration
        s = np.clip(np.where(rising, t, self.duration - t) / self.ramp, 0.0, 1.0)
        sign = np.where(rising, 1.0, -1.0)
        return _STEP(s), sign * _SPEED(s) / self.ramp, _CURVATURE(s) / self.ramp**2


def load_trajectory(path: str | Path) -> FourierTrajectory:
    """Read a trajectory file.

    Raises
    ------
    ExcitationError
        If it cannot be read or is not a trajectory; names the field.
    """
    remedy = "Write trajectory files with `elastic-arm excite`."
    content = read_fields(path, ExcitationError, remedy)
    if content.get("schema") != SCHEMA:
        raise ExcitationError(f"{path}: is not a trajectory file (no 'schema: {SCHEMA}')", remedy)
    fields = {name: value for name, value in content.items() if name != "schema"}
    wanted = ("omega", "a", "b", "q0", "duration", "ramp")
    missing = [k for k in wanted if k not in fields]
    unknown = [k for k in fields if k not in (*wanted, "joints")]
    if missing or unknown:
        what = (
            f"misses {', '.join(missing)}"
            if missing
            else f"has the unknown field {', '.join(map(str, unknown))}"
        )
        raise ExcitationError(f"{path}: {what}", remedy)
    names = fields.get("joints") or []
    if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise ExcitationError(f"{path}: joints is not a list of names", remedy)
    fields["joints"] = tuple(names)
    if truths := [name for name in wanted if _holds_truth(fields[name])]:
        raise ExcitationError(
            f"{path}: {truths[0]} contains yes or no instead of numbers", "Give numbers."
        )
    try:
        return FourierTrajectory(**fields)
    except ExcitationError as error:
        raise ExcitationError(f"{path}: {error.problem}", error.remedy) from error


def _holds_truth(value: Any) -> bool:
    """Whether what YAML made of a field holds yes or no, which Python takes for 1 and 0."""
    return isinstance(value, bool) or (isinstance(value, list) and any(map(_holds_truth, value)))


def require(condition: bool, problem: str, remedy: str) -> None:
    """Raise an ExcitationError unless the condition holds."""
    if not condition:
        raise ExcitationError(problem, remedy)


def _numbers(values: Any, dimensions: int, what: str) -> Array:
    """Return `values` as a read-only float array with `dimensions` dimensions, all finite."""
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise ExcitationError(
            f"{what} is not made of numbers: {values!r}", "Give numbers"
        ) from error
    require(
        array.ndim == dimensions,
        f"{what} has {array.ndim} dimensions, not {dimensions}",
        "Correct its shape",
    )
    require(
        bool(np.isfinite(array).all()),
        f"{what} contains a number that is not finite",
        "Give finite numbers",
    )
    array.setflags(write=False)
    return array
