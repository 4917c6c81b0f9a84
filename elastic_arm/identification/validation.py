"""Judge an identified arm on recordings that no fit has seen, and pull a fit that they refute
towards the description."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics.composition import ARMATURE
from elastic_arm.effects import EffectInstance
from elastic_arm.estimation.motion import Motion
from elastic_arm.identification.accumulator import averaged
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.consistent import with_consistency
from elastic_arm.identification.deviations import residual_norms
from elastic_arm.identification.regularisation import (
    DOUBT,
    WIDTHS,
    described_width,
    description_error,
    law_sizes,
    prior_of,
)
from elastic_arm.identification.result import Identification
from elastic_arm.identification.stream import Identifier
from elastic_arm.identification.triangular import triangular
from elastic_arm.robot import Robot

# Relative errors of the description that are tried where held-out motion refutes a fit: errors of a
# model that does not hold may be many times the noise.
PULLED = (*WIDTHS, 1e-2, 1e-3, 1e-4, 1e-5)
HELD_OUT = "the held-out recordings"
ALIKE = (
    f"the description predicts {HELD_OUT} as well as the fit within its standard"
    " deviations and may stay unchanged"
)
# Relative errors of the description that the consistent arm may still take it for, where it
# predicts badly.
TRUSTS = (0.3, 0.1, 0.03, 0.01)
# Ratio of rms errors from which a joint is predicted worse than by the description.
WORSE = 1.1
RARE = 6.6  # times its mean, a square of one normal deviation is once in a hundred
TINY = 1e-300  # Nm, for logarithms of errors that are zero
# Mean log ratio of rms errors up to which a fit predicts as well as the description: one that is
# right already cannot be improved.
EQUAL = 0.01


class Comparison(NamedTuple):
    """Errors of an arm and of the description at one equation of one joint, in one recording."""

    source: str
    side: str  # of the equation
    joint: str
    error: float  # rms, Nm
    described: float  # rms of the description, Nm

    @property
    def worse(self) -> bool:
        """Whether the arm predicts clearly worse than the description."""
        return self.error > WORSE * self.described


@dataclass(frozen=True)
class HeldOut:
    """Motion that no fit has seen."""

    equations: BaseRegression  # In base parameters
    motions: Mapping[str, Sequence[Motion]]  # Runs of smoothed motion by recording

    @cached_property
    def _rows(self) -> dict[str, Array]:
        """Triangular factors (groups, B + 1, B + 1) of the rows of each recording, divided by the
        square root of their number."""
        return self._factors(lambda motion: (self.equations.information(motion), len(motion)))

    @cached_property
    def _averages(self) -> dict[str, Array]:
        """The same of rows averaged over :data:`.accumulator.AVERAGED`."""
        return self._factors(lambda motion: averaged(self.equations, motion))

    def _factors(self, information: Callable[[Motion], tuple[Array, int]]) -> dict[str, Array]:
        found = {}
        for source, motions in self.motions.items():
            factors, counts = zip(*map(information, motions), strict=True)
            # Rows that hold the friction of a joint that sticks are zero, and no errors.
            shares = [self.equations.counted(motion) / max(len(motion), 1) for motion in motions]
            size = np.sqrt(np.maximum(np.array(counts) @ np.array(shares), 1.0))
            found[source] = triangular(np.concatenate(factors, axis=1)) / size[:, None, None]
        return found

    def errors(
        self, Psi_base: Array, *, averages: bool = False
    ) -> dict[str, dict[str, dict[str, float]]]:
        """Return recording -> equation -> joint -> rms, Nm, of base parameters.

        An arm is judged by the averaged rows: noise in accelerations is weighted by the predicting
        inertias, so that without averaging the arm with less inertia would seem better.
        """
        scale = self.equations.comparable(Psi_base)
        factors = self._averages if averages else self._rows
        return {
            source: self.equations.by_joint(scale * residual_norms(own, Psi_base))
            for source, own in factors.items()
        }

    @cached_property
    def nominal(self) -> dict[str, dict[str, dict[str, float]]]:
        """The errors of the description that serve for the judgement."""
        return self.errors(self.equations.described, averages=True)

    def compared(self, Psi_base: Array) -> list[Comparison]:
        """Compare base parameters with the description in the equations that contain a torque.

        If no equation contains one, all are compared.
        """
        sides = self.equations.sides
        equations = self.equations.equations
        torques = [side for side in sides if equations.equation(side).torque is not None] or sides
        found = []
        for source, by_side in self.errors(Psi_base, averages=True).items():
            for side in torques:
                for joint, error in by_side[side].items():
                    described = self.nominal[source][side][joint]
                    found.append(
                        Comparison(source, side, joint, max(error, TINY), max(described, TINY))
                    )
        return found

    def ratio(self, Psi_base: Array) -> float:
        """Return the mean log ratio between the errors and those of the description; positive is
        worse."""
        ratios = [np.log(one.error / one.described) for one in self.compared(Psi_base)]
        return float(np.mean(ratios))

    def chance(self, covariance: Array) -> float:
        """Return the mean log ratio that one correct fit in a hundred exceeds.

        The ratio is that of its errors to those of a correct description.
        """
        expected = {}
        for source, R in self._averages.items():
            regressor = R[:, :, :-1]
            power = np.einsum("gij,jk,gik->g", regressor, covariance, regressor)
            expected[source] = self.equations.by_joint(power)
        ratios = []
        for one in self.compared(self.equations.described):
            share = expected[one.source][one.side][one.joint] / one.error**2
            ratios.append(0.5 * np.log1p(RARE * share))
        return float(np.mean(ratios))

    def worse(self, Psi_base: Array) -> list[str]:
        """Return the joints that are clearly worse than described in at least one recording."""
        return list(dict.fromkeys(one.joint for one in self.compared(Psi_base) if one.worse))


def validated(
    result: Identification,
    identifier: Identifier,
    robot: Robot,
    effects: Sequence[EffectInstance],
    held_out: HeldOut,
    correlated: float = 1.0,
) -> Identification:
    """Add the errors on held-out recordings.

    A fit that they refute is pulled towards the description until it is no longer worse.
    """
    # Otherwise each prior takes a search of its own: too long for a single joint.
    linear = not held_out.equations.summed
    if held_out.ratio(result.Psi_base) > EQUAL or (linear and held_out.worse(result.Psi_base)):
        result = _pulled(result, identifier, held_out, correlated)
    if result.Psi is not None:
        consistent = partial(
            with_consistency, result, identifier, robot, effects, correlated=correlated
        )
        result = _consistent_or_none(result, consistent, held_out)
    equations = held_out.equations
    arms = {"nominal": equations.described, "identified": result.Psi_base}
    if result.Psi is not None:
        arms["consistent"] = equations.base.T @ result.Psi
    found: dict[str, dict[str, dict[str, dict[str, float]]]] = {}
    for arm, Psi in arms.items():
        for source, errors in held_out.errors(Psi).items():
            found.setdefault(source, {})[arm] = errors
    return result.with_(validation=found, notes=(*result.notes, *_worse_notes(result, held_out)))


def _worse_notes(result: Identification, held_out: HeldOut) -> list[str]:
    """Return a note for each recording that the result predicts worse than the description."""
    worse: dict[str, list[str]] = {}
    for one in held_out.compared(result.Psi_base):
        if one.worse:
            unit = result.units.at(one.joint, "Nm")
            size = f"{one.error:.3g} against {one.described:.3g} {unit}"
            worse.setdefault(one.source, []).append(f"{one.joint} ({one.side}: {size})")
    return [
        f"the prediction of {source} is worse than that of the description: {', '.join(at)}"
        for source, at in worse.items()
    ]


class _Try(NamedTuple):
    """A fit with the description as prior."""

    width: float  # relative, of the prior
    result: Identification
    worse: int  # joints that are predicted worse than by the description
    ratio: float  # :meth:`HeldOut.ratio`


def _tries(
    result: Identification, identifier: Identifier, held_out: HeldOut, correlated: float
) -> list[_Try]:
    """Fit with each width of the prior."""
    error = description_error(identifier.fit(), held_out.equations, DOUBT)
    laws = law_sizes(identifier.linear_blocks(), held_out.equations)
    found = []
    for width in PULLED:
        prior = prior_of(held_out.equations, width, error, laws, correlated)
        own = identifier.estimate(result.recordings, result.derivatives, identifier.fit(prior))
        worse = len(held_out.worse(own.Psi_base))
        found.append(_Try(width, own, worse, held_out.ratio(own.Psi_base)))
    return found


def _pulled(
    result: Identification, identifier: Identifier, held_out: HeldOut, correlated: float
) -> Identification:
    """Return the result with the prior on the description that predicts held-out motion best.

    A fit that is better than the description on average is kept, unless a prior reduces the number
    of joints that are worse.
    """
    tries = _tries(result, identifier, held_out, correlated)
    now = held_out.ratio(result.Psi_base)
    worse = held_out.worse(result.Psi_base)
    if now <= EQUAL:
        best = min(tries, key=lambda one: (one.worse, one.ratio))
        if best.worse >= len(worse) or best.ratio > now + EQUAL:
            return result
        said = f"the fit predicts {', '.join(worse)} worse than the description does"
        return _with_prior(result, best, said)

    best = min(tries, key=lambda one: one.ratio)
    alike = not worse and now <= held_out.chance(result.covariance)
    said = ALIKE if alike else f"the fit predicts {HELD_OUT} worse than the description does"
    if best.ratio < now:
        result = _with_prior(result, best, said)
    else:
        result = result.with_(notes=(*result.notes, said))
    if best.ratio > EQUAL and not alike:
        useless = "no fit near the description improves on it: do not use the identified numbers"
        result = result.with_(notes=(*result.notes, useless))
    return result


def _with_prior(result: Identification, best: _Try, why: str) -> Identification:
    return result.with_(
        estimates=best.result.estimates,
        covariance=best.result.covariance,
        noise=best.result.noise,
        notes=(*result.notes, why, described_width(best.width, HELD_OUT)),
    )


def _consistent_or_none(
    result: Identification, consistent: Callable[..., Identification], held_out: HeldOut
) -> Identification:
    """Return the result with a consistent arm that predicts no joint worse on held-out motion, or
    without one.

    If necessary, the description is trusted more; the laws of the joints in question, and the motor
    inertia of a rigid arm, then stay as described.
    """
    T = held_out.equations.base.T
    worst: list[str] = []
    for trust in (None, *TRUSTS):
        tried = result if trust is None else consistent(trust)
        if tried.Psi is None:
            continue
        worse = held_out.worse(T @ tried.Psi)
        if not worse and held_out.ratio(T @ tried.Psi) <= 0.0:
            return tried
        worst = worst or worse
        if not worse:
            continue
        tried = consistent(trust, described=worse)
        if tried.Psi is None or held_out.worse(T @ tried.Psi):
            continue
        if held_out.ratio(T @ tried.Psi) <= 0.0:
            kept = _described(worse, held_out.equations)
            return tried.with_(notes=(*tried.notes, kept))
    said = "robot.yaml is not written"
    if ALIKE not in result.notes:
        where = f" at {', '.join(worst)}" if worst else ""
        reason = f"the consistent arm predicts {HELD_OUT} worse than the description{where}"
        said = f"{reason}: {said}"
    return result.with_(identified=None, notes=(*result.notes, said))


def _described(joints: Sequence[str], equations: BaseRegression) -> str:
    motors = any(f"{joint}.{ARMATURE}" in equations.names for joint in joints)
    what = "effects and the motor inertia" if motors else "effects"
    return (
        f"robot.yaml keeps the described {what} of {', '.join(joints)}: with the"
        " identified ones, the prediction of the held-out recordings is worse"
    )
