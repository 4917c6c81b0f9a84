"""All parameters, physically consistent: what base parameters leave open is filled in as close to
the nominal arm.

    min |A (x - x0) - b|² / 2 + sum [tr X - log det X - 4] / trust² over bodies,    X > 0

in the coordinates of :mod:`.chart`. Every body's pseudo-inertia X, over the nominal's, is positive
definite, and what no arm has below zero, such as friction, is not negative. Distance to the nominal
is the entropic divergence (T. Lee, P. Wensing, F. Park, IEEE Trans. Robotics 36 (2020) 837), which
does not depend on coordinates and units. The problem is convex and solved by Clarabel through
cvxpy. The trust is the relative error of the nominal that makes the recording most probable (its
evidence).
"""

import warnings
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from elastic_arm.arrays import Array, rms
from elastic_arm.dynamics.composition import ARMATURE, inertia_from
from elastic_arm.effects import EffectInstance
from elastic_arm.errors import IdentificationError, RobotError
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.chart import PAIRS, Chart, chart_of, folded
from elastic_arm.identification.deviations import inflation
from elastic_arm.identification.law_columns import joint_of_law
from elastic_arm.identification.least_squares import Fit, correlation
from elastic_arm.identification.result import Carried, Identification
from elastic_arm.identification.stream import Identifier
from elastic_arm.robot import Robot

# Relative errors of the nominal that are tried, and the one taken where the data do not say.
TRUST = np.geomspace(0.01, 2.0, 24)
# Laws beyond the model have no nominal: the standard deviation of their prior, but of those that
# the chart holds.
LAW_WIDTH = 1e3
TOLERANCE = 1e-7  # of the solver, in the unit of what has a bound (Nm, Nm s/rad)
INEXACT = (
    "physically consistent arm: the convex solver came close to its tolerance but did not reach it"
)
# Data finer than this, relative to the nominal, bind like an equality; finer would only spoil the
# solver's numbers.
STIFFEST = 1e5
# A link's mass over the described one, beyond which something else is at work. Of eight real arms
# of right signs, some of their masses guessed, links came out at 0.12 to 4.1 times; of three with
# torques of the wrong sign at 0.02 and 39.
ODD = (0.1, 5.0)
# Of the mass of all links: lighter ones hardly load a joint, whatever their description has;
# convention.
LIGHT = 0.02


@dataclass(frozen=True)
class Consistent:
    """Physically consistent parameters."""

    Psi: Array  # (P,) all parameters, laws beyond the model last
    trust: float  # Relative error of the nominal that was taken for granted
    # rise of the weighted residual over the unconstrained fit, in units of its noise: root of the
    # mean square
    misfit: float
    exact: bool = True  # Whether the solver met its tolerance


def consistent(
    fit: Fit,
    equations: BaseRegression,
    correlated: float = 1.0,
    trust: float | None = None,
    carried: Carried | None = None,
) -> Consistent:
    """Find the physically consistent parameters that fit best.

    They stay close to the nominal where the data determine nothing.

    carried: what a link carries beyond its description, which is part of the nominal then.

    Raises an IdentificationError if the solver fails.
    """
    chart = chart_of(equations, carried)
    A, b = _data(fit, equations, chart, correlated)
    trust = trust or _most_probable_trust(A, b, chart)
    x, exact = _solve(A, b, chart, trust)
    Psi = chart.Psi0 + chart.G @ (x - chart.x0)
    size = rms(fit.weights * fit.noise, None)
    apart = fit.factor[:-1, :-1] @ (equations.base.T @ Psi - fit.Psi)
    return Consistent(
        Psi, trust, float(np.linalg.norm(apart) / size / np.sqrt(max(fit.samples, 1))), exact
    )


def description_covariance(equations: BaseRegression) -> Array:
    """Return the covariance (P, P) of a description with relative errors of one.

    Laws have none.
    """
    chart = chart_of(equations)
    variance = chart.variances()
    variance[chart.free + chart.held] = 0.0
    return (chart.G * variance) @ chart.G.T


def correlation_of_errors(identifier: Identifier, repeats: bool) -> float:
    """Return how many times larger the variances are than those of white errors.

    What the model misses follows the motion: errors may be alike over half a period of it, and no
    longer. How far they are is measured by the scatter of long blocks, unless the motion repeats:
    its errors then do so too, from block to block, without scatter.
    """
    fit = identifier.fit()
    # Averages may be fewer than half periods of the quickest joint: none is less than one error.
    most = max(fit.samples / identifier.statistics.effective_samples, 1.0)
    return (
        most if repeats else min(most, max(correlation(identifier.linear_blocks(), fit, most), 1.0))
    )


def with_consistency(
    result: Identification,
    identifier: Identifier,
    robot: Robot,
    effects: Sequence[EffectInstance] = (),
    trust: float | None = None,
    *,
    correlated: float = 1.0,
    described: Collection[str] = (),
) -> Identification:
    """Add all parameters, physically consistent, and the arm that has them, if any."""
    equations = identifier.equations
    try:
        found = consistent(identifier.fit(), equations, correlated, trust, result.carried)
        motors = {f"{joint}.{ARMATURE}" for joint in described}
        back = [joint_of_law(name) in described or name in motors for name in equations.names]
        Psi = np.where(back, equations.nominal, found.Psi)
        # Numbers of very different size may leave a body outside of what one can be by more than
        # rounding.
        identified = identified_robot(robot, equations, Psi, effects)
    except (IdentificationError, RobotError) as error:
        return result.with_(notes=(*result.notes, f"no physically consistent arm: {error.problem}"))
    notes = [note for note in result.notes if note != INEXACT]
    if not found.exact:
        notes.append(INEXACT)
    return result.with_(
        Psi=Psi,
        notes=tuple(notes),
        consistency={"trust": found.trust, "misfit": found.misfit, "correlation": correlated},
        identified=identified,
    )


def _data(
    fit: Fit, equations: BaseRegression, chart: Chart, correlated: float
) -> tuple[Array, Array]:
    """Return A, b: the recording gives A (x - x0) = b with unit noise."""
    rows, right = unit_equations(fit, correlated)
    T = equations.base.T
    A = rows @ T @ chart.G
    b = right - rows @ (T @ chart.Psi0)
    u, s, vt = np.linalg.svd(A, full_matrices=False)
    kept = s > 1e-12 * s[0]
    softened = np.minimum(s, STIFFEST)[kept] / s[kept]
    return softened[:, None] * s[kept][:, None] * vt[kept], softened * (u[:, kept].T @ b)


def unit_equations(fit: Fit, correlated: float) -> tuple[Array, Array]:
    """Return R, r: the recording gives R Psi = r of base parameters with unit noise.

    Errors are coloured: their effect on the estimate is larger than white ones' by a factor known
    from the blocks, or from longer ones.
    """
    excess = np.sqrt(max(1.0, inflation(fit.covariance, fit.white_covariance), correlated))
    # Ordinary least squares has weights of one: its rows are still in Nm.
    size = rms(fit.weights * fit.noise, None)
    scaled = fit.factor[:-1, :] / (excess * size)
    return scaled[:, :-1], scaled[:, -1]


def _most_probable_trust(A: Array, b: Array, chart: Chart) -> float:
    """Return the relative error of the nominal under which b is most probable (type II maximum
    likelihood)."""
    shape = chart.variances()
    law = np.zeros(len(shape))
    law[chart.free] = LAW_WIDTH**2
    law[chart.held] = 1.0
    own = np.where(law > 0, 0.0, shape)

    def evidence(trust: float) -> float:
        covariance = np.eye(len(b)) + (A * (trust**2 * own + law)) @ A.T
        return float(-np.linalg.slogdet(covariance)[1] - b @ np.linalg.solve(covariance, b))

    return float(max(TRUST, key=evidence))


def _solve(A: Array, b: Array, chart: Chart, trust: float) -> tuple[Array, bool]:
    """Return x, and whether the solver met its tolerance."""
    # Takes a second to import, and nothing else needs it.
    import cvxpy as cp

    x = cp.Variable(len(chart.x0))
    # Whole matrices and vectors: CVXPY takes its time for each expression, not for its size.
    full = np.zeros((16, len(PAIRS)))  # of a symmetric matrix, row by row, from its pairs
    for k, (i, j) in enumerate(PAIRS):
        full[4 * i + j, k] = 1.0
        full[4 * j + i, k] = 1.0
    divergence: list[cp.Expression] = []
    for piece in chart.pseudo:
        X = cp.reshape(full @ x[piece], (4, 4), order="C")
        divergence.append(cp.trace(X) - cp.log_det(X) - 4)
    if chart.positive:
        numbers, weights = zip(*chart.positive, strict=True)
        divergence.append(np.array(weights) @ (x[list(numbers)] - cp.log(x[list(numbers)]) - 1))
    cost = cp.sum_squares(A @ (x - chart.x0) - b) / 2 + cp.sum(divergence) / trust**2
    for places, width in ((chart.free, LAW_WIDTH), (chart.held, 1.0)):
        if places:
            cost = cost + cp.sum_squares(x[places]) / (2 * width**2)
    bounded = [k for k, _ in chart.bounds]
    least = np.array([value for _, value in chart.bounds])
    problem = cp.Problem(cp.Minimize(cost), [x[bounded] >= least] if bounded else [])
    try:
        with warnings.catch_warnings():
            # That the solver missed its tolerance is told from its status.
            warnings.simplefilter("ignore", UserWarning)
            problem.solve(solver=cp.CLARABEL)
    except cp.SolverError:  # whose words are about other solvers and their options
        raise IdentificationError(
            "the convex solver failed, because the numbers differ too much in size",
            "Check the recording with bag check",
        ) from None
    if x.value is None:
        raise IdentificationError(
            f"the convex solver found no solution ({problem.status})", "Record a richer motion."
        )
    solution: Array = np.array(x.value, dtype=float)
    # The solver meets a bound to its tolerance: friction of 1e-10 Nm, or -1e-10 Nm, is none.
    solution[bounded] = np.where(solution[bounded] - least < TOLERANCE, least, solution[bounded])
    return solution, problem.status == cp.OPTIMAL


def odd_masses(described: Robot, identified: Robot) -> list[str]:
    """Return in words which links of the identified arm have masses far from the described ones."""
    links = [
        (old.link_name, old.link.mass, new.link.mass)
        for old, new in zip(described.joints, identified.joints, strict=True)
    ]
    least = LIGHT * sum(old for _, old, _ in links)
    odd = [
        f"{name} has {new:.3g} kg ({old:.3g} kg described)"
        for name, old, new in links
        if old > 0.0 and max(old, new) > least and not ODD[0] < new / old < ODD[1]
    ]
    if not odd:
        return []
    wrong = "real links do not have such masses: they compensate for something that the model lacks"
    check = "check signs and units of the torques, the mounting of the arm (base) and its payload"
    return [f"robot.yaml: {', '.join(odd)}: {wrong}; {check}"]


def identified_robot(
    robot: Robot, equations: BaseRegression, Psi: Array, effects: Sequence[EffectInstance] = ()
) -> Robot:
    """Return the arm with these parameters, laws beyond the model among its effects."""
    value = dict(zip(equations.names, Psi.tolist(), strict=True))
    for joint in robot.joints:
        changes: dict[str, object] = {
            "link": inertia_from(_link_alone(robot, equations, joint.name, value))
        }
        t = joint.transmission
        if joint.armature is not None:
            # of zero to the solver's tolerance
            changes["armature"] = max(0.0, value[f"{joint.name}.{ARMATURE}"])
        if t is not None:
            solids = {
                what: replace(
                    component,
                    mass=value[f"{joint.name}.{what}.m"],
                    ixx=value[f"{joint.name}.{what}.Ixx"],
                    izz=value[f"{joint.name}.{what}.Izz"],
                )
                for what, (component, _) in t.components.items()
                if f"{joint.name}.{what}.m" in value
            }
            springs = {"stiffness": value[f"{joint.name}.K"], "damping": value[f"{joint.name}.D"]}
            changes["transmission"] = replace(t, **solids, **springs)  # type: ignore[arg-type]
        robot = robot.with_joint(joint.name, **changes)
    replaced = {(instance.effect.id, instance.joint) for instance in effects}
    kept = (
        entry for entry in robot.effects if (entry["effect"], entry.get("joint")) not in replaced
    )
    return robot.with_(
        effects=(*kept, *(_with_values(instance, robot, value) for instance in effects))
    )


def _with_values(
    instance: EffectInstance, robot: Robot, value: dict[str, float]
) -> dict[str, object]:
    place = f"{instance.effect.id}:{instance.joint or robot.name}"
    found = {}
    for p in instance.effect.parameters:
        names = [f"{place}.{name}" for name in p.component_names]
        if names[0] in value:
            numbers = tuple(p.value_of(value[name]) for name in names)
            found[p.name] = numbers[0] if p.size == 1 else numbers
    return instance.with_parameters(**found).to_dict()


def _link_alone(
    robot: Robot, equations: BaseRegression, joint: str, value: dict[str, float]
) -> Array:
    """Return the ten parameters of a joint's link, without the spline where the model folds that
    into it."""
    link_name = robot.joints[robot.joint_names.index(joint)].link_name
    body = next(b for b in equations.model.bodies.bodies if b.name == link_name)
    total = np.array([value[equations.names[k]] for k in body.parameters])
    return total - folded(robot, equations, body)
