"""A body that a link carries and its description lacks, such as a tool at the flange.

    z = R (Psi - described) + noise of one,    Psi - described = T e + T_link b
    e ~ N(0, s² S),    b ~ N(0, B)

R and z are the recording's equations in base parameters, without what no description states. e are
errors of the description as a whole, of a relative size s by its kind, and b the ten parameters of
a body of any mass within reach of the link's frame. Which link carries one follows from the
evidence, summed over kinds and masses, and from the odds that an arm has an effect: half of them
are the last link's, as what arms carry is mostly at the flange.
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

MASS = Priors().mass  # ordinary relative error of a described mass
LARGEST = PAYLOAD.parameter("mass").high  # kg
REACH = 0.15  # m; of what is mounted on a link, from the origin of its frame: an ordinary tool's
# Standard deviations of mass, moments and inertias of a body of the largest mass.
SIZES = LARGEST * np.repeat([1.0, REACH, REACH**2], [1, 3, 6])


def carried_of(fit: Fit, equations: BaseRegression, correlated: float = 1.0) -> Carried | None:
    """Return the body that a link most probably carries in addition to its description; None if
    there is probably none.

    correlated: ratio of the variances of the recording's errors to those of white errors.
    """
    R, z = _equations(fit, equations, correlated)
    own, of_own = description_errors(equations)
    spread = np.zeros((R.shape[1],) * 2)
    spread[np.ix_(own, own)] = of_own
    links = [joint.link_name for joint in equations.model.robot.joints]
    bodies = [one for one in equations.model.bodies.bodies if one.name in links]
    shares = {link: 0.5 / max(len(links) - 1, 1) for link in links[:-1]} | {links[-1]: 0.5}
    without = []
    others = []
    found: dict[str, list[tuple[float, Array, Array]]] = {link: [] for link in links}
    for kind in TRUST.values():
        described = (kind.factor * MASS) ** 2 * spread
        noise = np.eye(len(z)) + R @ described @ R.T
        root = np.linalg.cholesky(noise)
        rest = np.linalg.solve(root, z)
        known = np.log(kind.prior) - np.log(np.diag(root)).sum() - 0.5 * rest @ rest
        without.append(known)
        for body, scale in product(bodies, SCALES.tolist()):
            columns = np.linalg.solve(root, R @ equations.base.T[:, list(body.parameters)])
            gain, mean, covariance = _with_body(columns, rest, scale * SIZES)
            odds = np.log(ODDS * shares[body.name] / len(SCALES))
            # Of the prior of a mass, which is symmetric, a body has the positive half. What the
            # other half explains is no body, and where the mass is not determined that is as
            # probable.
            sure = mean[0] / np.sqrt(covariance[0, 0])
            whole = np.log(2.0) + odds + known + gain
            found[body.name].append((whole + norm.logcdf(sure), mean, covariance))
            others.append(whole + norm.logcdf(-sure))
    evidence = {}
    for name, fits in found.items():
        evidence[name] = logsumexp([value for value, *_ in fits])
    link = max(evidence, key=lambda name: evidence[name])
    every = logsumexp([*without, *others, *evidence.values()])
    probability = float(np.exp(evidence[link] - every))
    if probability <= 0.5:
        return None
    _, mean, covariance = max(found[link], key=lambda one: one[0])
    return Carried(
        link,
        float(mean[0]),
        float(np.sqrt(covariance[0, 0])),
        tuple((mean[1:4] / mean[0]).tolist()),
        probability,
        link == links[-1],
    )


def _with_body(columns: Array, rest: Array, sizes: Array) -> tuple[float, Array, Array]:
    """Return by how much a body increases the log-evidence of the remainder, with unit noise, its
    most probable parameters, and their covariance."""
    information = np.eye(len(sizes)) + (columns * sizes).T @ (columns * sizes)
    right = (columns * sizes).T @ rest
    covariance = np.linalg.inv(information)
    mean = covariance @ right
    gain = 0.5 * (right @ mean - np.linalg.slogdet(information)[1])
    return float(gain), sizes * mean, covariance * np.outer(sizes, sizes)


def with_carried(robot: Robot, carried: Carried | None) -> Robot:
    """Return the arm with the carried body as part of the link."""
    if carried is None:
        return robot
    (joint,) = (one for one in robot.joints if one.link_name == carried.link)
    return robot.with_joint(joint.name, link=lumped([joint.link, carried.body]))


def _equations(fit: Fit, equations: BaseRegression, correlated: float) -> tuple[Array, Array]:
    """Return R, z of base parameters minus the described ones; parameters that no description
    states, such as friction and motor inertia, are projected out."""
    rows, right = unit_equations(fit, correlated)
    chart = chart_of(equations)
    unstated = rows @ equations.base.T @ chart.G[:, chart.free + chart.held]
    left, _, _ = np.linalg.svd(unstated)
    # NumPy 1 has no rank of a matrix without columns.
    rank = int(np.linalg.matrix_rank(unstated)) if unstated.size else 0
    rest = left[:, rank:].T
    return rest @ rows, rest @ (right - rows @ equations.described)
