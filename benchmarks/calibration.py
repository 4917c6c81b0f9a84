"""Whether probabilities and sizes hold where the model does: simulation-based calibration (Talts et
al. 2018).

    python -m benchmarks.calibration [--draws 300] [--seed 1] [--out FILE.csv]

Draws of y = N nu + sum of X beta + e from the priors, at the linearisation of a recorded motion,
are searched by `evidence.search` as a diagnosis does. None, one or two terms act, as likely each;
laws that bend in their sizes are not drawn. By the prior these have weights of 1, 1/100 and
1/20000. The rank of a true size in its posterior, Phi((beta - mean) / deviation), is uniform where
deviations hold (Kolmogorov and Smirnov). What the model lacks, as effects of no catalogue, shows in
the challenge alone.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.stats import kstest, norm, truncnorm

from benchmarks.bench_diagnosis import arm_of
from elastic_arm.diagnosis import Question
from elastic_arm.diagnosis.preparation import prepare
from elastic_arm.dynamics import build_model
from elastic_arm.effects.parameters import Parameter
from elastic_arm.evidence.explanation import weighted
from elastic_arm.evidence.fit import LinearModel
from elastic_arm.evidence.gauss_newton import linear_model
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.priors import AS_BUILT, SCALES
from elastic_arm.evidence.relinearise import pool_of
from elastic_arm.evidence.screen import Screen
from elastic_arm.evidence.search import Search
from elastic_arm.evidence.terms.effect import EffectTerm, axis
from elastic_arm.evidence.terms.term import Term
from elastic_arm.excitation import MotionLimits, Shape, random_trajectories
from elastic_arm.sensors import Sensors
from elastic_arm.simulation import SimulationSettings, simulate

MOST = 2  # terms that act
WEIGHTS = (1.0, 1e-2, 5e-5)  # of the prior, of none, one and two terms
EDGES = (0.0, 0.1, 0.5, 0.9, 0.99, 1.01)


def motion_of(seconds: float = 20.0) -> Linearisation:
    """Return a recorded motion of the package's arm, described as it is."""
    robot = arm_of(3)
    rng = np.random.default_rng(0)
    motions = random_trajectories(
        build_model(robot), MotionLimits.of(robot), 2, rng=rng, shape=Shape(period=10.0, periods=2)
    )
    settings = SimulationSettings(sensors=Sensors.real())
    first, second = (simulate(robot, m, settings, duration=seconds, rng=rng) for m in motions)
    problem = prepare([first], [second], Question(robot)).problem
    return Linearisation(problem, np.zeros(len(problem.numbers)), ())


def drawn(
    linear: Linearisation, pool: Sequence[Term], rng: np.random.Generator
) -> tuple[Term, np.ndarray]:
    """Return a term of the pool, as likely as its prior has it, and its coefficients, from their
    priors."""
    can = [
        t
        for t in pool
        if t.offset is None and t.linear and not (np.isnan(t.theta).any() or t.feature.bends)
    ]
    odds = np.array([np.exp(-t.price) for t in can])
    term = can[rng.choice(len(can), p=odds / odds.sum())]
    std = term.std * float(rng.choice(SCALES))
    if isinstance(term, EffectTerm) and term.is_open:
        theta = [uniform(p, rng) for p in linear.allowed(term.feature)]
        term = replace(term, columns=linear.columns(term.feature, theta), theta=tuple(theta))
    return term, np.asarray(
        truncnorm.rvs(term.low / std, term.high / std, scale=std, size=len(std), random_state=rng)
    )


def uniform(number: Parameter, rng: np.random.Generator) -> float:
    """Return a value of a nonlinear number from its prior."""
    if number.integer:
        return float(rng.integers(int(np.ceil(number.low)), int(number.high) + 1))
    at = rng.uniform(*axis(number))
    return float(np.exp(at) if number.logarithmic else at)


def searched(
    model: LinearModel, linear: Linearisation, pool: Sequence[Term], rng: np.random.Generator
) -> tuple[int, list[tuple[float, bool, float]]]:
    """Return how many terms acted in one draw, and (confidence, whether it acts, rank of its size)
    of each effect."""
    count = int(rng.integers(MOST + 1))
    acting = [drawn(linear, pool, rng) for _ in range(count)]
    y = model.N @ rng.standard_normal(model.N.shape[1]) + rng.standard_normal(len(model.y))
    for term, size in acting:
        y += term.columns @ size
    own = replace(model, y=y)
    search = Search(linear, own, [Screen(own.grams, pool)])
    best = search.run()
    sets = weighted([*search.met.values()])
    found = []
    for name in {key[:2] for keys in search.met for key in keys}:
        truth = next(((t, size) for t, size in acting if t.key[:2] == name), None)
        said = next((t for t in best.optional if truth and t.key == truth[0].key), None)
        rank = np.nan
        if truth is not None and said is not None and said.linear == truth[0].linear:
            at = best.slices[said.ident].start + int(rng.integers(said.linear))
            off = truth[1][at - best.slices[said.ident].start] - best.found.x[at]
            rank = float(norm.cdf(off / np.sqrt(best.found.S[at, at])))
        confidence = sum(p for p, fit in sets if name in {key[:2] for key in fit.keys})
        found.append((confidence, truth is not None, rank))
    return count, found


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw, search, and print how often what is said is true."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--draws", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args(arguments)
    linear = motion_of()
    rng = np.random.default_rng(asked.seed)
    rows = []
    model = linear_model(linear, AS_BUILT)
    pool = pool_of(linear)
    for k in range(asked.draws):
        count, found = searched(model, linear, pool, rng)
        rows += [(k, count, *one) for one in found]
    weight = np.array([WEIGHTS[row[1]] for row in rows])
    said = np.array([row[2] for row in rows])
    true = np.array([row[3] for row in rows])
    print(f"{len(pool)} terms, {asked.draws} draws, seed {asked.seed}")
    for low, high in pairwise(EDGES):
        own = (said >= low) & (said < high)
        if own.any():
            n = int(own.sum())
            weights = weight[own]
            by_prior = (float(np.average(one[own], weights=weights)) for one in (said, true))
            print(
                "said {} to {}: {}/{} true; by the prior said {:.3f}, true {:.3f}".format(
                    low, high, true[own].sum(), n, *by_prior
                )
            )
    ranks = np.array([row[4] for row in rows if np.isfinite(row[4])])
    counts = np.histogram(ranks, 10, (0, 1))[0].tolist()
    p = kstest(ranks, "uniform").pvalue
    print(f"ranks of {len(ranks)} sizes in tenths: {counts}, p = {p:.3f}")
    if asked.out:
        with asked.out.open("w", newline="") as file:
            csv.writer(file).writerows([("draw", "terms", "said", "true", "rank"), *rows])


if __name__ == "__main__":
    main()
