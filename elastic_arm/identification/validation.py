"""The judgement on recordings that no fit has seen: the description holds what they refute until it
is no worse."""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics.composition import ARMATURE
from elastic_arm.dynamics.double_double import Pair, add, cholesky
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
# Mean log ratio of rms errors up to which a fit predicts as well as the description: one that is
# right already cannot be improved.
EQUAL = 0.01


@dataclass(frozen=True)
class HeldOut:
    """Motion that no fit has seen."""

    equations: BaseRegression  # In base parameters
    motions: Mapping[str, Sequence[Motion]]  # Runs of smoothed motion by recording

    @cached_property
    def _rows(self) -> dict[str, Array]:
        """Triangular factors (groups, B + 1, B + 1) of each recording's rows over the root of how
        many there are."""
        return self._factors(lambda motion: (self.equations.information(motion), len(motion)))

    @cached_property
    def _averages(self) -> dict[str, Array]:
        """The same of rows averaged over :data:`.accumulator.AVERAGED`."""
        return self._factors(lambda motion: averaged(self.equations, motion))

    def _factors(self, information: Callable[[Motion], tuple[Pair, int]]) -> dict[str, Array]:
        found = {}
        for source, motions in self.motions.items():
            sums, counts = zip(*map(information, motions), strict=True)
            # Rows that hold the friction of a joint that sticks are zero, and no errors.
            shares = [self.equations.counted(motion) / max(len(motion), 1) for motion in motions]
            size = np.sqrt(np.maximum(np.array(counts) @ np.array(shares), 1.0))
            found[source] = cholesky(functools.reduce(add, sums)) / size[:, None, None]
        return found

    def errors(
        self, Psi_base: Array, *, averages: bool = False
    ) -> dict[str, dict[str, dict[str, float]]]:
        """Return recording -> equation -> joint -> rms, Nm, of base parameters; that of averages is
        what judges an arm.

        Noise in accelerations is weighed by the inertias that predict, so that of two arms the one
        with less inertia would seem to be better by the rows themselves.
        """
        scale = self.equations.comparable(Psi_base)
        factors = self._averages if averages else self._rows
        return {
            source: self.equations.by_joint(scale * residual_norms(own, Psi_base))
            for source, own in factors.items()
        }

    @cached_property
    def nominal(self) -> dict[str, dict[str, dict[str, float]]]:
        """Errors of the description that judge."""
        return self.errors(self.equations.described, averages=True)

    def compared(self, Psi_base: Array) -> list[tuple[str, str, str, float, float]]:
        """Return recording, equation, joint and the errors of base parameters and of the
        description, Nm.

        Of equations that hold a torque, where there are such.
        """
        sides, equations = self.equations.sides, self.equations.equations
        torques = [side for side in sides if equations.equation(side).torque is not None] or sides
        return [
            (
                source,
                side,
                joint,
                max(error, 1e-300),
                max(self.nominal[source][side][joint], 1e-300),
            )
            for source, by_side in self.errors(Psi_base, averages=True).items()
            for side in torques
            for joint, error in by_side[side].items()
        ]

    def ratio(self, Psi_base: Array) -> float:
        """Return the mean log ratio of errors to those of the description; above 0 is worse."""
        return float(
            np.mean([np.log(error / described) for *_, error, described in self.compared(Psi_base)])
        )

    def chance(self, covariance: Array) -> float:
        """Return the mean log ratio of errors to those of a right description that one fit in a
        hundred exceeds."""
        expected = {
            source: self.equations.by_joint(
                np.einsum("gij,jk,gik->g", R[:, :, :-1], covariance, R[:, :, :-1])
            )
            for source, R in self._averages.items()
        }
        compared = self.compared(self.equations.described)
        return float(
            np.mean(
                [
                    0.5 * np.log1p(RARE * expected[s][side][j] / error**2)
                    for s, side, j, error, _ in compared
                ]
            )
        )

    def worse(self, Psi_base: Array) -> list[str]:
        """Return the joints that some recording shows to be predicted clearly worse than by the
        description."""
        compared = self.compared(Psi_base)
        return list(
            dict.fromkeys(
                joint for *_, joint, error, described in compared if error > WORSE * described
            )
        )


def validated(
    result: Identification,
    identifier: Identifier,
    robot: Robot,
    effects: Sequence[EffectInstance],
    held_out: HeldOut,
    correlated: float = 1.0,
) -> Identification:
    """Add the errors on held-out recordings; what they refute is pulled to the description until it
    is no worse."""
    linear = (
        not held_out.equations.summed
    )  # Else each prior takes a search of its own: too long for a single joint.
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
    tables = {arm: held_out.errors(Psi) for arm, Psi in arms.items()}
    found = {
        source: {arm: table[source] for arm, table in tables.items()} for source in held_out.motions
    }
    worse: dict[str, list[str]] = {}
    for source, side, joint, error, described in held_out.compared(result.Psi_base):
        if error > WORSE * described:
            size = f"{error:.3g} against {described:.3g} {result.units.at(joint, 'Nm')}"
            worse.setdefault(source, []).append(f"{joint} ({side}: {size})")
    notes = [
        f"the prediction of {source} is worse than that of the description: {', '.join(at)}"
        for source, at in worse.items()
    ]
    return result.with_(validation=found, notes=(*result.notes, *notes))


def _pulled(
    result: Identification, identifier: Identifier, held_out: HeldOut, correlated: float
) -> Identification:
    """Return the result with the description as the prior that predicts held-out motion best, joint
    by joint first.

    A fit that is better than the description on the whole stays as it is, unless fewer joints are
    worse with the prior.
    """
    tries, error = [], description_error(identifier.fit(), held_out.equations, DOUBT)
    laws = law_sizes(identifier.linear_blocks(), held_out.equations)
    for width in PULLED:
        prior = prior_of(held_out.equations, width, error, laws, correlated)
        own = identifier.estimate(result.recordings, result.derivatives, identifier.fit(prior))
        tries.append((len(held_out.worse(own.Psi_base)), held_out.ratio(own.Psi_base), width, own))
    now, worse = held_out.ratio(result.Psi_base), held_out.worse(result.Psi_base)
    refuted = now > EQUAL
    if refuted:
        _, ratio, width, best = min(tries, key=lambda each: each[1])
        alike = not worse and now <= held_out.chance(result.covariance)
        better, said = (
            ratio < now,
            [ALIKE if alike else f"the fit predicts {HELD_OUT} worse than the description does"],
        )
    else:
        count, ratio, width, best = min(tries, key=lambda each: each[:2])
        better, said = count < len(worse) and ratio <= now + EQUAL, list[str]()
    if better:
        said += (
            []
            if refuted
            else [f"the fit predicts {', '.join(worse)} worse than the description does"]
        )
        said.append(described_width(width, HELD_OUT))
        result = result.with_(
            estimates=best.estimates, covariance=best.covariance, noise=best.noise
        )
    if refuted and not alike and ratio > EQUAL:
        said.append("no fit near the description improves on it: do not use the identified numbers")
    return result.with_(notes=(*result.notes, *said))


def _consistent_or_none(
    result: Identification, consistent: Callable[..., Identification], held_out: HeldOut
) -> Identification:
    """Return the result with a consistent arm that predicts no joint worse on held-out motion, or
    none.

    Where it does, the description is trusted more; laws of the joints in question, and their motor
    inertia where the arm is taken for rigid, stay as described.
    """
    T, worst = held_out.equations.base.T, list[str]()
    kept: list[str] = []
    for trust in (None, *TRUSTS):
        tried = result if trust is None else consistent(trust)
        for last in (False, True):
            if tried.Psi is None:
                break
            worse = held_out.worse(T @ tried.Psi)
            if not worse and held_out.ratio(T @ tried.Psi) <= 0.0:
                return (
                    tried.with_(notes=(*tried.notes, _described(kept, held_out.equations)))
                    if last
                    else tried
                )
            worst = worst or worse
            if last or not worse:
                break
            kept = worse
            tried = consistent(trust, described=kept)
    where = f" at {', '.join(worst)}" if worst else ""
    said = (
        []
        if ALIKE in result.notes
        else [f"the consistent arm predicts {HELD_OUT} worse than the description{where}"]
    )
    return result.with_(
        identified=None, notes=(*result.notes, ": ".join([*said, "robot.yaml is not written"]))
    )


def _described(joints: Sequence[str], equations: BaseRegression) -> str:
    motors = any(f"{joint}.{ARMATURE}" in equations.names for joint in joints)
    what = "effects and the motor inertia" if motors else "effects"
    return (
        f"robot.yaml keeps the described {what} of {', '.join(joints)}: with the"
        " identified ones, the prediction of the held-out recordings is worse"
    )
