"""Fig. 5 and more: (10)-(13) for each model on the motion of the prototype, and the sources of the
errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import spearmanr

from elastic_arm.arrays import Array, Indices, rms
from elastic_arm.dynamics import build_model
from elastic_arm.estimation.motion import Motion
from elastic_arm.excitation import ExcitationResult, MotionLimits, Shape, optimise
from elastic_arm.excitation.criteria import distinct_columns
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.least_squares import Fit, fit
from elastic_arm.identification.stream import Accumulator
from elastic_arm.robot.description import Robot
from elastic_arm.studies.paper.virtual_prototype.prototype import PrototypeRun

PAPER_STRIDE = 100  # of the 1 kHz samples: the paper's 10 Hz
NOTHING = 1e-12  # kg and kg m^2
# the paper's 0-20 %, 21-50 %, 51-100 %, read as rounded percentages
LOW = 20.5
MID = 50.5


@dataclass(frozen=True)
class ErrorShares:
    """Percentages of the coefficients whose relative error is low, mid, high.

    `beyond` 100 % is a part of high.
    """

    low: float
    mid: float
    high: float
    beyond: float


def shares(error: Array) -> ErrorShares:
    """Sort relative errors (coefficients,), in percent, into the paper's categories."""
    size = np.abs(error)
    low = size < LOW
    mid = (size >= LOW) & (size < MID)
    beyond = size > 100.0
    return ErrorShares(*(100.0 * float(part.mean()) for part in (low, mid, ~(low | mid), beyond)))


class CoefficientFit:
    """One model's regression (10) in base parameters.

    The truth is the description's in the same combinations.
    """

    def __init__(self, robot: Robot, model: str) -> None:
        self.model = build_model(robot, model)
        self.equations = BaseRegression(
            self.model, ("q", "theta", "tau_m"), joints=robot.joint_names
        )
        base = self.equations.base
        self.names = base.names
        self.true = base.T @ self.equations.nominal
        self.estimable = int(np.count_nonzero(np.abs(base.T).max(axis=0) > 0.0))

    def fit(self, motion: Motion) -> Fit:
        """Fit the base parameters."""
        data = Accumulator(self.equations)
        data.add(motion)
        return fit(data.snapshot(), 0.0)

    def with_noise(
        self, motion: Motion, std: float, seeds: int, rng: np.random.Generator
    ) -> list[Fit]:
        """Return fits with independent Gaussian noise of `std` Nm on every measured torque."""
        assert motion.tau_m is not None
        torque = motion.tau_m
        noisy = (
            replace(motion, tau_m=torque + std * rng.standard_normal(torque.shape))
            for _ in range(seeds)
        )
        return [self.fit(one) for one in noisy]

    def percent(self, estimate: Array) -> Array:
        """Return Psi_err of (13), in percent."""
        return 100.0 * (estimate - self.true) / self.true

    def percent_unfolded(self, estimate: Array) -> Array | None:
        """Return Psi_err where splines are no part of the true links, or None.

        None where the model has them as bodies.
        """
        if self.model.name != "mod1":
            return None
        true = self.equations.base.T @ build_model(_without_splines(self.model.robot), "mod1").Psi
        return 100.0 * (estimate - true) / true

    def full(self, estimate: Array) -> Array:
        """Return a whole Psi (P,) that predicts as the estimate does.

        Zero wherever the equations cannot see.
        """
        Psi = np.zeros(len(self.equations.names))
        Psi[self.equations.base.columns] = estimate
        return Psi


def _without_splines(robot: Robot) -> Robot:
    """Return the arm with splines of next to no mass: a description knows none without any."""
    joints = []
    for joint in robot.joints:
        t = joint.transmission
        assert t is not None
        spline = replace(t.spline, mass=NOTHING, ixx=NOTHING, izz=NOTHING)
        joints.append(replace(joint, transmission=replace(t, spline=spline)))
    return robot.with_(joints=tuple(joints))


def merged_error(found: Fit, true: Array, kept: Indices) -> Array:
    """Return Psi_err (K,) of the coefficients `kept`, the others merged into them.

    As the data's columns depend on them.

    Base parameters are what *some* state separates. Where no ordinary motion does, as at high
    ratios, (11) is blown up along that direction; a numerical rank decision would have merged such
    columns, and this does.
    """
    R = found.factor[:, :-1]
    z = found.factor[:, -1]
    lost = np.setdiff1d(np.arange(len(true)), kept)
    scale = np.linalg.norm(R[:, kept], axis=0)
    solution = (
        np.linalg.lstsq(R[:, kept] / scale, np.column_stack([R[:, lost], z]), rcond=None)[0]
        / scale[:, None]
    )
    expected = true[kept] + solution[:, :-1] @ true[lost]
    return 100.0 * (solution[:, -1] - expected) / expected


@dataclass(frozen=True)
class CoefficientEstimate:
    """One model at one ratio; errors are in percent of the true coefficients (B,)."""

    model: str
    r_tot: float
    names: tuple[str, ...]
    estimable: int  # parameters
    true: Array
    estimate: Array
    error: Array  # as in the paper: 10 Hz, no noise
    # of mod1 against true coefficients without the splines it counts with the links
    unfolded_error: Array | None
    model_error: Array  # with the bushing locked
    noise_spread: Array  # standard deviation over seeds at 10 Hz, and at 1 kHz
    fast_noise_spread: Array
    merged_error: Array  # with what this motion cannot separate merged
    # Of each seed
    merged_noisy_shares: tuple[ErrorShares, ...]
    noisy_shares: tuple[ErrorShares, ...]
    fast_noisy_shares: tuple[ErrorShares, ...]
    torque: Array  # what each coefficient contributes to the equations, rms Nm
    residual: float  # rms Nm
    condition: float  # of F with columns of unit length
    Psi: Array

    @property
    def bushing_error(self) -> Array:
        """What the bushing adds to the model's own error, percent (B,)."""
        return self.error - self.model_error

    @property
    def shares(self) -> ErrorShares:
        """Fig. 5."""
        return shares(self.error)


def study(
    robot: Robot,
    model: str,
    r_tot: float,
    run: PrototypeRun,
    locked: PrototypeRun,
    *,
    noise: float,
    seeds: tuple[int, int],
    rng: np.random.Generator,
) -> CoefficientEstimate:
    """Identify one model from the prototype's run."""
    problem = CoefficientFit(robot, model)
    fast = motion_of(run)
    slow = fast[_ten_hertz(run)]
    slow_locked = motion_of(locked)[_ten_hertz(locked)]
    plain = problem.fit(slow)
    noisy = problem.with_noise(slow, noise, seeds[0], rng)
    fast_noisy = problem.with_noise(fast, noise, seeds[1], rng)
    kept = distinct_columns(plain.factor[:, :-1])
    rows = problem.equations.rows(slow)
    left = rows[:, :, -1] - rows[:, :, :-1] @ plain.Psi
    return CoefficientEstimate(
        model=model,
        r_tot=r_tot,
        names=problem.names,
        estimable=problem.estimable,
        true=problem.true,
        estimate=plain.Psi,
        error=problem.percent(plain.Psi),
        unfolded_error=problem.percent_unfolded(plain.Psi),
        model_error=problem.percent(problem.fit(slow_locked).Psi),
        noise_spread=problem.percent(np.array([one.Psi for one in noisy])).std(axis=0, ddof=1),
        fast_noise_spread=problem.percent(np.array([one.Psi for one in fast_noisy])).std(
            axis=0, ddof=1
        ),
        merged_error=merged_error(plain, problem.true, kept),
        merged_noisy_shares=tuple(shares(merged_error(one, problem.true, kept)) for one in noisy),
        noisy_shares=tuple(shares(problem.percent(one.Psi)) for one in noisy),
        fast_noisy_shares=tuple(shares(problem.percent(one.Psi)) for one in fast_noisy),
        torque=np.abs(problem.true) * np.sqrt((rows[:, :, :-1] ** 2).mean(axis=(0, 1))),
        residual=float(rms(left, None)),
        condition=plain.condition,
        Psi=problem.full(plain.Psi),
    )


def smallness(estimate: CoefficientEstimate) -> tuple[float, float]:
    """Return the rank correlation of a coefficient's error with its size and its torque.

    Spearman's; sizes are the true ones.

    Negative where the large errors belong to small coefficients. The size is in SI units whatever
    the kind, as the paper compares them; the torque is what the coefficient contributes to the
    equations, rms.
    """
    error = np.abs(estimate.error)
    size = spearmanr(np.abs(estimate.true), error).statistic
    return float(size), float(spearmanr(estimate.torque, error).statistic)


def motion_of(run: PrototypeRun) -> Motion:
    """Return a run as the identification's motion."""
    return Motion(
        t=run.t,
        q=run.q,
        dq=run.dq,
        ddq=run.ddq,
        theta=run.theta,
        dtheta=run.dtheta,
        ddtheta=run.ddtheta,
        tau_J=run.tau_J,
        tau_m=run.tau_m,
    )


def _ten_hertz(run: PrototypeRun) -> slice:
    """Return the paper's samples: 10 Hz, the last one left out, so that 10 s are 100 samples."""
    return slice(0, len(run.t) - 1, PAPER_STRIDE)


def mean_shares(many: Sequence[ErrorShares]) -> tuple[ErrorShares, ErrorShares]:
    """Return mean and standard deviation of shares over seeds."""
    table = np.array([(s.low, s.mid, s.high, s.beyond) for s in many])
    return ErrorShares(*map(float, table.mean(0))), ErrorShares(*map(float, table.std(0)))


SHAPE = Shape(harmonics=5, period=10.0, ramp=1.0)
"""The paper's duration of 10 s, between smooth ramps."""


def excite(robot: Robot, model: str, evaluations: int, random: int, seed: int) -> ExcitationResult:
    """Find the motion within limits whose regressor of `model` is conditioned best."""
    problem = CoefficientFit(robot, model)
    limits = MotionLimits.of(robot)
    columns = [int(c) for c in problem.equations.base.columns]
    rng = np.random.default_rng(seed)
    return optimise(
        problem.model, limits, columns, rng=rng, shape=SHAPE, evaluations=evaluations, random=random
    )
