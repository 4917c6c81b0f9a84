"""A body that a link carries and its description lacks, such as a tool at the flange.

    z = R (Psi - described) + noise of one,    Psi - described = T e + T_link b
    e ~ N(0, s² S),    b ~ N(0, B)

R and z are the recording's equations in base parameters, without what no description states. e are
errors of the description as a whole, of a relative size s by its kind, and b the ten parameters of
a body of any mass within reach of the link's frame. Which link carries one follows from the
evidence, summed over kinds and masses, and from the odds that an arm has an effect.
"""

from itertools import product

import numpy as np
from scipy.special import logsumexp
from scipy.stats import norm

from elastic_arm.arrays import Array
from elastic_arm.effects.library.masses import PAYLOAD
from elastic_arm.evidence.priors import ODDS, SCALES, TRUST, Priors
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.chart import chart_of
from elastic_arm.identification.consistent import unit_equations
from elastic_arm.identification.least_squares import Fit
from elastic_arm.identification.regularisation import description_errors
from elastic_arm.identification.result import Carried
from elastic_arm.robot import Robot
from elastic_arm.robot.kinematics import lumped

LARGEST = PAYLOAD.parameter("mass").high  # kg
REACH = 0.15  # m; of what is mounted on a link, from the origin of its frame: an ordinary tool's
# Standard deviations of mass, moments and inertias of a body of the largest mass.
SIZES = LARGEST * np.repeat([1.0, REACH, REACH**2], [1, 3, 6])


def carried_of(fit: Fit, equations: BaseRegression, correlated: float = 1.0) -> Carried | None:
    """Return what a link most probably carries beyond its description; None where it is more
    probable that none does.

    correlated: by what the variances of the recording's errors exceed those of white ones.
    """
    R, z = _equations(fit, equations, correlated)
    own, of_own = description_errors(equations)
    spread = np.zeros((R.shape[1],) * 2)
    spread[np.ix_(own, own)] = of_own
    links = [joint.link_name for joint in equations.model.robot.joints]
    bodies = [one for one in equations.model.bodies.bodies if one.name in links]
    columns = {one.name: R @ equations.base.T[:, list(one.parameters)] for one in bodies}
    kinds = [(kind.factor * Priors().mass, kind.prior) for kind in TRUST.values()]
    noises = [np.eye(len(z)) + error**2 * R @ spread @ R.T for error, _ in kinds]
    none = logsumexp(
        [
            np.log(prior) + _log_evidence(z, noise)
            for (_, prior), noise in zip(kinds, noises, strict=True)
        ]
    )
    found, others = {}, []
    for (name, column), scale, k in product(columns.items(), SCALES.tolist(), range(len(kinds))):
        of_body = (column * (scale * SIZES) ** 2) @ column.T
        odds = ODDS / len(columns) / len(SCALES) * kinds[k][1]
        mean, covariance = _body(z, column, noises[k], scale)
        # Of the prior of a mass, which is symmetric, a body has the positive half. What the other
        # half explains is no body, and where the mass is not determined that is as probable.
        sure = mean[0] / np.sqrt(covariance[0, 0])
        evidence = np.log(odds) + _log_evidence(z, noises[k] + of_body)
        found[name, scale, k] = np.log(2.0) + norm.logcdf(sure) + evidence
        others.append(np.log(2.0) + norm.logcdf(-sure) + evidence)
    whole = logsumexp([none, *others, *found.values()])
    link = max(columns, key=lambda name: logsumexp([v for at, v in found.items() if at[0] == name]))
    of_link = {at: value for at, value in found.items() if at[0] == link}
    probability = float(np.exp(logsumexp(list(of_link.values())) - whole))
    if probability <= 0.5:
        return None
    _, scale, k = max(of_link, key=lambda at: of_link[at])
    mean, covariance = _body(z, columns[link], noises[k], scale)
    return Carried(
        link,
        float(mean[0]),
        float(np.sqrt(covariance[0, 0])),
        tuple((mean[1:4] / mean[0]).tolist()),
        probability,
        link == links[-1],
    )


def with_carried(robot: Robot, carried: Carried | None) -> Robot:
    """Return the arm with what a link carries as part of the link."""
    if carried is None:
        return robot
    (joint,) = (one for one in robot.joints if one.link_name == carried.link)
    return robot.with_joint(joint.name, link=lumped([joint.link, carried.body]))


def _equations(fit: Fit, equations: BaseRegression, correlated: float) -> tuple[Array, Array]:
    """Return R, z of base parameters less the described ones; what no description states, as
    friction and motor inertia, is projected out."""
    rows, right = unit_equations(fit, correlated)
    chart = chart_of(equations)
    unstated = rows @ equations.base.T @ chart.G[:, chart.free + chart.held]
    left, _, _ = np.linalg.svd(unstated)
    rest = left[:, np.linalg.matrix_rank(unstated) :].T
    return rest @ rows, rest @ (right - rows @ equations.described)


def _log_evidence(z: Array, covariance: Array) -> float:
    _, size = np.linalg.slogdet(covariance)
    return float(-0.5 * (size + z @ np.linalg.solve(covariance, z)))


def _body(z: Array, column: Array, noise: Array, scale: float) -> tuple[Array, Array]:
    """Return the ten parameters of a body, and their covariance."""
    prior = np.diag((scale * SIZES) ** 2)
    pulled = prior @ column.T @ np.linalg.inv(noise + column @ prior @ column.T)
    return pulled @ z, prior - pulled @ column @ prior
