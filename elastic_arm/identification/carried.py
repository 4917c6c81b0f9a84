"""Bodies that links carry and their descriptions lack, such as a tool at the flange.

    z = R (Psi - described) + noise of one,    Psi - described = T e + T_link b
    e ~ N(0, s² S),    b ~ N(0, B)

R and z are the equations of the recording in base parameters, without parameters that no
description states. e are errors of the description, of a relative size s by the kind of trust, and
b the ten parameters of a body of any mass within reach of the link's frame. The evidence, summed
over kinds and masses, and the prior odds of an effect decide which link carries a body. Half of the
odds belong to the last link, because most loads are at the flange.
"""

from itertools import product
from typing import NamedTuple

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
REACH = 0.15  # m, distance of an ordinary tool from the origin of the link's frame
# Standard deviations of mass, moments and inertias of a body of the largest mass.
SIZES = LARGEST * np.repeat([1.0, REACH, REACH**2], [1, 3, 6])


class _Body(NamedTuple):
    """A body on a link, of one scale and under one kind of trust."""

    link: str
    evidence: float  # ln of its prior odds times the likelihood of the recording, nats
    mean: Array  # (10,) its parameters
    covariance: Array  # (10, 10)


class _Hypotheses(NamedTuple):
    """All explanations of the differences from the description, with their evidence, nats."""

    bodies: list[_Body]
    impossible: list[float]  # the same bodies with a negative mass
    without: list[float]  # no body, for each kind of trust


def carried_of(fit: Fit, equations: BaseRegression, correlated: float = 1.0) -> Carried | None:
    """Return the body that a link most probably carries in addition to its description; None if
    there is probably none.

    correlated: ratio of the variances of the recording's errors to those of white errors.
    """
    links = [joint.link_name for joint in equations.model.robot.joints]
    hypotheses = _hypotheses(fit, equations, correlated, links)
    evidence = {}
    for name in links:
        of_link = [one.evidence for one in hypotheses.bodies if one.link == name]
        evidence[name] = logsumexp(of_link)
    link = max(evidence, key=lambda name: evidence[name])
    every = logsumexp([*hypotheses.without, *hypotheses.impossible, *evidence.values()])
    probability = float(np.exp(evidence[link] - every))
    if probability <= 0.5:
        return None
    candidates = [one for one in hypotheses.bodies if one.link == link]
    _, _, mean, covariance = max(candidates, key=lambda one: one.evidence)
    return Carried(
        link,
        float(mean[0]),
        float(np.sqrt(covariance[0, 0])),
        tuple((mean[1:4] / mean[0]).tolist()),
        probability,
        link == links[-1],
    )


def _hypotheses(
    fit: Fit, equations: BaseRegression, correlated: float, links: list[str]
) -> _Hypotheses:
    """Return the evidence of all bodies on all links, and of none."""
    R, z = _equations(fit, equations, correlated)
    own, of_own = description_errors(equations)
    spread = np.zeros((R.shape[1],) * 2)
    spread[np.ix_(own, own)] = of_own
    bodies = [one for one in equations.model.bodies.bodies if one.name in links]
    shares = {link: 0.5 / max(len(links) - 1, 1) for link in links[:-1]} | {links[-1]: 0.5}
    found = _Hypotheses([], [], [])
    for kind in TRUST.values():
        described = (kind.factor * MASS) ** 2 * spread
        root = np.linalg.cholesky(np.eye(len(z)) + R @ described @ R.T)
        rest = np.linalg.solve(root, z)
        without = np.log(kind.prior) - np.log(np.diag(root)).sum() - 0.5 * rest @ rest
        found.without.append(without)
        for body, scale in product(bodies, SCALES.tolist()):
            columns = np.linalg.solve(root, R @ equations.base.T[:, list(body.parameters)])
            gain, mean, covariance = _with_body(columns, rest, scale * SIZES)
            odds = np.log(ODDS * shares[body.name] / len(SCALES))
            # The prior of a mass is symmetric, but a body has only its positive half. The negative
            # half explains something else, as probably as a body if the mass is not determined.
            deviations = mean[0] / np.sqrt(covariance[0, 0])
            both = np.log(2.0) + odds + without + gain
            evidence = both + norm.logcdf(deviations)
            found.bodies.append(_Body(body.name, evidence, mean, covariance))
            found.impossible.append(both + norm.logcdf(-deviations))
    return found


def _with_body(columns: Array, rest: Array, sizes: Array) -> tuple[float, Array, Array]:
    """Return the increase of the log-evidence by a body, its mean parameters, and their covariance.

    columns: of the body's parameters; rest: remainder with unit noise; sizes: prior standard
    deviations.
    """
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
    """Return R, z of the base parameters minus the described ones.

    Parameters that no description states, such as friction and motor inertia, are projected out.
    """
    rows, right = unit_equations(fit, correlated)
    chart = chart_of(equations)
    unstated = rows @ equations.base.T @ chart.G[:, chart.free + chart.held]
    left, _, _ = np.linalg.svd(unstated)
    # NumPy 1 has no rank of a matrix without columns.
    rank = int(np.linalg.matrix_rank(unstated)) if unstated.size else 0
    rest = left[:, rank:].T
    return rest @ rows, rest @ (right - rows @ equations.described)
