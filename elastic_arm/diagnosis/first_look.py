"""The first look at the recordings, before the search: where the gap is, and friction of the
drives.

    y = N nu + sum_j (X_j beta_j) + e

This is one linear fit at the description, with the numbers nu of arm and sensors within their
ordinary deviations, and viscous and dry friction beta_j of each joint. The result of the search
replaces it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from elastic_arm.diagnosis.decomposition import Decomposition
from elastic_arm.diagnosis.estimates import ParameterEstimate, estimated
from elastic_arm.estimation.equation_sets import Place
from elastic_arm.evidence.terms.effect import EffectTerm
from elastic_arm.formatting import JointUnits

Friction = Mapping[str, ParameterEstimate]  # parameters of one friction effect


@dataclass(frozen=True)
class FirstLook:
    """Residuals of all recordings by joint and side, Nm (N), and the friction of each joint.

    noise: RMS values of the sensors' noise; described, fitted: RMS residuals of the description
    and of the linear fit; friction: parameters by effect, for each joint and side.
    """

    joints: tuple[str, ...]
    units: JointUnits
    noise: Mapping[Place, float]
    described: Mapping[Place, float]
    fitted: Mapping[Place, float]
    friction: Mapping[Place, Mapping[str, Friction]]


def first_look(parts: Decomposition) -> FirstLook:
    """Return the first look from a decomposition of all recordings at the description."""
    problem = parts.problem
    before, after = parts.gaps
    friction: dict[Place, dict[str, Friction]] = {}
    values = parts.explanation.linear.values
    for term in parts.fit.terms:
        if isinstance(term, EffectTerm) and term.feature.effect.friction and term.feature.joint:
            found, instance = estimated(parts.fit, term, problem.numbers, values)
            place = term.feature.joint, ", ".join(instance.sides)
            friction.setdefault(place, {})[term.feature.effect.id] = found
    return FirstLook(
        joints=problem.robot.joint_names,
        units=problem.robot.units,
        noise=parts.by_place(np.sqrt(before.noise.sum(axis=1))),
        described=parts.by_place(before.rmse),
        fitted=parts.by_place(after.rmse),
        friction=friction,
    )
