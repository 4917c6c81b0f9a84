"""Individual parameters out of the coefficients, as the paper leaves for later: physically consistent.

What the data leave open can only come from elsewhere. Here it comes from descriptions that are wrong by a known share,
the same for all models, so that what differs between the models is what they make of the data.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

from elastic_arm.dynamics import build_model
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.consistency.estimation import consistent
from elastic_arm.identification.least_squares import Fit
from elastic_arm.robot.description import Component, Inertia, Joint, Robot

SPREAD = 0.3
"""Standard deviation of the logarithm of each body's scale, and of each spring's and damper's."""


@dataclass(frozen=True)
class RecoveredParameters:
    """Errors of the individual parameters in percent (parameters,), medians over the guesses; `guess` those before.

    `medians` are those over the parameters, one a guess (guesses,).
    """

    names: tuple[str, ...]
    error: np.ndarray
    guess: np.ndarray
    medians: np.ndarray


def recover(fit: Fit, equations: BaseRegression, guesses: int, seed: int) -> RecoveredParameters:
    """Draw individual parameters from a fit with physical consistency, beginning at wrong descriptions."""
    model = equations.model
    rng = np.random.default_rng(seed)
    found, before = [], []
    for _ in range(guesses):
        guess = build_model(perturbed(model.robot, rng), model.name)
        wrong = BaseRegression(guess, ("q", "theta", "tau_m"), joints=equations.joints)
        with warnings.catch_warnings():
            # "Solution may be inaccurate": however accurate, it is scored against the truth.
            warnings.simplefilter("ignore", UserWarning)
            found.append(consistent(fit, wrong).Psi)
        before.append(wrong.nominal)
    true = equations.nominal
    there = np.flatnonzero(np.abs(true) > 0.0)
    after, prior = (100.0 * np.abs(np.array(rows)[:, there] / true[there] - 1.0) for rows in (found, before))
    return RecoveredParameters(
        tuple(equations.names[k] for k in there),
        np.median(after, axis=0),
        np.median(prior, axis=0),
        np.median(after, axis=1),
    )


def perturbed(robot: Robot, rng: np.random.Generator) -> Robot:
    """Return the arm with every body, spring and damper scaled at random; each body stays physically possible."""
    return robot.with_(joints=tuple(_perturbed_joint(joint, rng) for joint in robot.joints))


def _perturbed_joint(joint: Joint, rng: np.random.Generator) -> Joint:
    def factor() -> float:
        return float(np.exp(SPREAD * rng.standard_normal()))

    def scaled(solid: Component) -> Component:
        mass, inertia = factor(), factor()
        return replace(solid, mass=solid.mass * mass, ixx=solid.ixx * inertia, izz=solid.izz * inertia)

    body = joint.link
    link = Inertia(body.mass * factor(), body.com * np.exp(SPREAD * rng.standard_normal(3)), body.inertia * factor())
    t = joint.transmission
    if t is None:
        return replace(joint, link=link)
    drive = replace(
        t,
        rotor=scaled(t.rotor),
        wave_generator=scaled(t.wave_generator),
        spline=scaled(t.spline),
        stiffness=t.stiffness * factor(),
        damping=t.damping * factor(),
    )
    return replace(joint, link=link, transmission=drive)
