"""All parameters, physically consistent: what base parameters leave open is filled in as close to the nominal arm.

Every body's pseudo-inertia is positive definite (P. Wensing, S. Kim, J.-J. Slotine, IEEE Robotics and Automation
Letters 3 (2018) 60), so masses are positive and inertias belong to real mass distributions; solids of revolution stay
so; K, D and armatures are positive, and what no arm has below zero, such as friction, is not negative.
Distance to the nominal arm is the entropic divergence of the pseudo-inertias (T. Lee, P. Wensing, F. Park, IEEE Trans.
Robotics 36 (2020) 837), which does not depend on coordinates and units. The problem is convex and solved by Clarabel
through cvxpy.

How far the nominal is trusted is not tuned by hand: the relative error of the nominal that makes the recording most
probable (its evidence) is taken.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics.bodies import Body, inertial_parameters
from elastic_arm.dynamics.composition import ARMATURE, inertia_from
from elastic_arm.effects import EffectInstance
from elastic_arm.errors import IdentificationError
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.law_columns import joint_of_law
from elastic_arm.identification.least_squares import Fit, correlation
from elastic_arm.identification.result import Identification
from elastic_arm.identification.stream import Identifier
from elastic_arm.robot import Robot

Array = NDArray[np.float64]

# Relative errors of the nominal that are tried, and the one taken where the data do not say.
TRUST = np.geomspace(0.01, 2.0, 24)
# Pseudo-inertias of the nominal are kept this far from singular, relative to their largest eigenvalue.
THINNEST = 1e-6
# Data finer than this, relative to the nominal, bind like an equality; finer would only spoil the solver's numbers.
STIFFEST = 1e5
# Laws beyond the model have no nominal: their prior is this wide, times what the residual could explain.
LAW_WIDTH = 1e3


@dataclass(frozen=True)
class Consistent:
    """Physically consistent parameters.

    Parameters
    ----------
    Psi
        (P,) all parameters, laws beyond the model last.
    trust
        Relative error of the nominal that was taken for granted.
    misfit
        Rise of the weighted residual over the unconstrained fit, in units of its noise: root of the mean square.
    """

    Psi: Array
    trust: float
    misfit: float


@dataclass(frozen=True)
class _Chart:
    """Parameters near the nominal: Psi = Psi0 + G (x - x0), x dimensionless and x = x0 at the nominal.

    Parameters
    ----------
    pseudo
        Slices of x that hold the ten entries of a normalised pseudo-inertia.
    positive
        Indices of x that must be positive, each with its weight in the divergence.
    free
        Indices of x that may have either sign.
    bounds
        Of `free`, indices with the least value that each may have.
    """

    G: Array
    x0: Array
    Psi0: Array
    pseudo: tuple[slice, ...]
    positive: tuple[tuple[int, float], ...]
    free: tuple[int, ...]
    bounds: tuple[tuple[int, float], ...] = ()


def consistent(fit: Fit, equations: BaseRegression, correlated: float = 1.0, trust: float | None = None) -> Consistent:
    """Find the physically consistent parameters that fit best, close to the nominal where the data determine nothing.

    Parameters
    ----------
    fit, equations
        The unconstrained fit of the base parameters, and whose model and laws these are.
    correlated
        How many times larger the variances are than those of white errors, beyond what the fit's blocks show.
    trust
        Relative standard deviation of the nominal; the most probable one when None.

    Raises
    ------
    IdentificationError
        If the solver fails.
    """
    chart = _chart(equations)
    A, b = _data(fit, equations, chart, correlated)
    trust = trust or _most_probable_trust(A, b, chart)
    x = _solve(A, b, chart, trust)
    Psi = chart.Psi0 + chart.G @ (x - chart.x0)
    size = np.sqrt(np.mean((fit.weights * fit.noise) ** 2))
    apart = fit.factor[:-1, :-1] @ (equations.base.T @ Psi - fit.Psi)
    return Consistent(Psi, trust, float(np.linalg.norm(apart) / size / np.sqrt(max(fit.samples, 1))))


def description_covariance(equations: BaseRegression) -> Array:
    """Return the covariance (P, P) of all parameters for a description with relative errors of one; laws have none."""
    chart = _chart(equations)
    variance = _prior_shape(chart)
    variance[list(chart.free)] = 0.0
    return (chart.G * variance) @ chart.G.T


def correlation_of_errors(identifier: Identifier, repeats: bool) -> float:
    """Return how many times larger the variances are than those of white errors.

    What the model misses follows the motion: errors may be alike over half a period of it, and no longer. How far they
    are is measured by the scatter of long blocks, unless the motion repeats: its errors then do so too, from block to
    block, without scatter.
    """
    fit = identifier.fit()
    most = fit.samples / identifier.statistics.effective_samples
    return most if repeats else min(most, correlation(identifier.linear_blocks(), fit, most))


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
    """Add all parameters, physically consistent, and the arm that has them; where there are such.

    Parameters
    ----------
    result, identifier
        The identification so far, and the estimator that it came from.
    robot, effects
        The nominal arm, and laws beyond the model.
    trust, correlated
        See :func:`consistent`.
    described
        Joints whose laws beyond the model are put back to what the description has.
    """
    equations = identifier.equations
    try:
        found = consistent(identifier.fit(), equations, correlated, trust)
    except IdentificationError as error:
        return result.with_(notes=(*result.notes, f"no physically consistent arm: {error.problem}"))
    Psi = np.where([joint_of_law(name) in described for name in equations.names], equations.nominal, found.Psi)
    return result.with_(
        Psi=Psi,
        consistency={"trust": found.trust, "misfit": found.misfit, "correlation": correlated},
        identified=identified_robot(robot, equations, Psi, effects),
    )


def identified_robot(
    robot: Robot, equations: BaseRegression, Psi: Array, effects: Sequence[EffectInstance] = ()
) -> Robot:
    """Return the arm with these parameters, laws beyond the model among its effects.

    Parameters
    ----------
    robot
        The nominal arm.
    equations
        Whose parameters `Psi` are.
    Psi
        (P,) parameters of the model, then those of the laws.
    effects
        The laws beyond the model.
    """
    value = dict(zip(equations.names, Psi.tolist(), strict=True))
    for joint in robot.joints:
        changes: dict[str, object] = {"link": inertia_from(_link_alone(robot, equations, joint.name, value))}
        t = joint.transmission
        if joint.armature is not None:
            changes["armature"] = max(0.0, value[f"{joint.name}.{ARMATURE}"])  # of zero to the solver's tolerance
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
    kept = (entry for entry in robot.effects if (entry["effect"], entry.get("joint")) not in replaced)
    return robot.with_(effects=(*kept, *(_with_values(instance, robot, value) for instance in effects)))


def _with_values(instance: EffectInstance, robot: Robot, value: dict[str, float]) -> dict[str, object]:
    place = f"{instance.effect.id}:{instance.joint or robot.name}"
    found = {}
    for p in instance.effect.parameters:
        names = [f"{place}.{name}" for name in p.component_names]
        if names[0] in value:
            numbers = tuple(p.value_of(value[name]) for name in names)
            found[p.name] = numbers[0] if p.size == 1 else numbers
    return instance.with_parameters(**found).to_dict()


def _link_alone(robot: Robot, equations: BaseRegression, joint: str, value: dict[str, float]) -> Array:
    """Return the ten parameters of a joint's link, without the spline where the model folds that into it."""
    link_name = robot.joints[robot.joint_names.index(joint)].link_name
    body = next(b for b in equations.model.bodies.bodies if b.name == link_name)
    total = np.array([value[equations.names[k]] for k in body.parameters])
    return total - _folded(robot, equations, body)


def _folded(robot: Robot, equations: BaseRegression, body: Body) -> Array:
    """Return what the nominal body has beyond the link itself: the folded spline of mod1, else nothing."""
    link = next(j.link for j in robot.joints if j.link_name == body.name)
    own = inertial_parameters(link.mass, link.com, link.inertia)
    return equations.nominal[list(body.parameters)] - own


def pseudo_inertia(ten: Array) -> Array:
    """Return the pseudo-inertia (4, 4) of a body's ten parameters about its frame's origin."""
    m, mx, my, mz, xx, xy, xz, yy, yz, zz = ten
    half = 0.5 * (xx + yy + zz)
    return np.array([[half - xx, -xy, -xz, mx], [-xy, half - yy, -yz, my], [-xz, -yz, half - zz, mz], [mx, my, mz, m]])


_PAIRS = ((0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3))
_UNIT = [float(i == j) for i, j in _PAIRS]  # coordinates of the unit matrix: of the nominal body


def _chart(equations: BaseRegression) -> _Chart:
    """Put parameters into coordinates in which the nominal is x0 and every step of size one is as bold."""
    names, robot = equations.names, equations.model.robot
    links = {joint.link_name for joint in robot.joints}
    columns, Psi0 = list[Array](), equations.nominal.copy()
    x0, pseudo = list[float](), list[slice]()
    positive, free = list[tuple[int, float]](), list[int]()
    bounds, seen = list[tuple[int, float]](), set[int]()
    least = {column.name: column.least for column in equations.columns}
    for body in equations.model.bodies.bodies:
        index = list(body.parameters)
        if seen & set(index):
            continue
        seen |= set(index)
        if body.name in links:
            nominal = equations.nominal[index] - _folded(robot, equations, body)
            pseudo.append(slice(len(x0), len(x0) + 10))
            own, moments = _link_chart(nominal), np.linalg.eigvalsh(pseudo_inertia(nominal))
            if moments[0] < THINNEST * moments[-1]:  # A point counts as thick as its chart, to become thinner.
                Psi0[index] += own @ _UNIT - nominal
            columns += _embedded(own, index, len(names))
            x0 += _UNIT
        else:
            first = len(x0)
            columns += _embedded(_solid_chart(equations.nominal[index]), index, len(names))
            x0 += [1.0, 1.0, 1.0]
            positive += [(first, 1.0), (first + 1, 2.0), (first + 2, 1.0)]
    for k, name in enumerate(names):
        if k in seen:
            continue
        physical = name.rpartition(".")[2] in ("K", "D", ARMATURE)
        spring = physical and equations.nominal[k] > 0
        positive += [(len(x0), 1.0)] if spring else []
        free += [] if spring else [len(x0)]
        lowest = max(least.get(name, -np.inf), 0.0 if physical or equations.nominal[k] > 0 else -np.inf)
        bounds += [(len(x0), lowest - float(equations.nominal[k]))] if not spring and np.isfinite(lowest) else []
        columns += _embedded(np.array([[equations.nominal[k] if spring else 1.0]]), [k], len(names))
        x0.append(1.0 if spring else 0.0)
    return _Chart(
        np.array(columns).T,
        np.array(x0),
        Psi0,
        tuple(pseudo),
        tuple(positive),
        tuple(free),
        tuple(bounds),
    )


def _embedded(columns: Array, index: list[int], P: int) -> list[Array]:
    wide = np.zeros((columns.shape[1], P))
    wide[:, index] = columns.T
    return list(wide)


def _link_chart(nominal: Array) -> Array:
    """Return (10, 10): entries of the normalised pseudo-inertia X -> parameters, J = L X L', J0 = L L'."""
    values, vectors = np.linalg.eigh(pseudo_inertia(nominal))
    L = vectors * np.sqrt(np.maximum(values, THINNEST * values[-1]))
    columns = []
    for i, j in _PAIRS:
        unit = np.zeros((4, 4))
        unit[i, j] = unit[j, i] = 1.0
        J = L @ unit @ L.T
        trace = np.trace(J[:3, :3])
        inertia = trace * np.eye(3) - J[:3, :3]
        tensor = [inertia[p] for p in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))]
        columns.append([J[3, 3], J[0, 3], J[1, 3], J[2, 3], *tensor])
    return np.array(columns).T


def _solid_chart(nominal: Array) -> Array:
    """Return (4, 3): mass, radial and axial second moment over their nominal -> m, mz, Ixx, Izz; mz stays."""
    mass, _, xx, zz = nominal
    radial, axial = 0.5 * zz, max(xx - 0.5 * zz, THINNEST * xx)
    # Izz = 2 radial, Ixx = radial + axial.
    return np.array([[mass, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, radial, axial], [0.0, 2.0 * radial, 0.0]])


def _data(fit: Fit, equations: BaseRegression, chart: _Chart, correlated: float) -> tuple[Array, Array]:
    """Return A, b: the recording gives A (x - x0) = b with unit noise.

    Errors are coloured: their effect on the estimate is larger than white ones' by a factor known from the blocks, or
    from longer ones.
    """
    coloured = float(np.median(np.diag(fit.covariance) / np.diag(fit.white_covariance)))
    inflation = np.sqrt(max(1.0, coloured, correlated))
    # Ordinary least squares has weights of one: its rows are still in Nm.
    size = np.sqrt(np.mean((fit.weights * fit.noise) ** 2))
    scaled = fit.factor[:-1, :] / (inflation * size)
    T = equations.base.T
    A = scaled[:, :-1] @ T @ chart.G
    b = scaled[:, -1] - scaled[:, :-1] @ (T @ chart.Psi0)
    u, s, vt = np.linalg.svd(A, full_matrices=False)
    kept = s > 1e-12 * s[0]
    softened = np.minimum(s, STIFFEST)[kept] / s[kept]
    return softened[:, None] * s[kept][:, None] * vt[kept], softened * (u[:, kept].T @ b)


def _most_probable_trust(A: Array, b: Array, chart: _Chart) -> float:
    """Return the relative error of the nominal under which b is most probable (type II maximum likelihood)."""
    shape = _prior_shape(chart)
    law = np.zeros(len(shape))
    law[list(chart.free)] = LAW_WIDTH**2
    own = np.where(law > 0, 0.0, shape)

    def evidence(trust: float) -> float:
        covariance = np.eye(len(b)) + (A * (trust**2 * own + law)) @ A.T
        return float(-np.linalg.slogdet(covariance)[1] - b @ np.linalg.solve(covariance, b))

    return float(max(TRUST, key=evidence))


def _prior_shape(chart: _Chart) -> Array:
    """Return the variances of x that belong to the divergence at a trust of one."""
    variance = np.ones(len(chart.x0))
    for piece in chart.pseudo:
        # Off the diagonal an entry of X counts twice in the trace of X².
        variance[piece] = [1.0 if i == j else 0.5 for i, j in _PAIRS]
    for k, weight in chart.positive:
        variance[k] = 1.0 / weight
    return variance


def _solve(A: Array, b: Array, chart: _Chart, trust: float) -> Array:
    # Takes a second to import, and nothing else needs it.
    import cvxpy as cp

    x = cp.Variable(len(chart.x0))
    # Whole matrices and vectors: CVXPY takes its time for each expression, not for its size.
    full = np.array([[float({i, j} == set(pair)) for pair in _PAIRS] for i in range(4) for j in range(4)])
    divergence: list[cp.Expression] = []
    for piece in chart.pseudo:
        X = cp.reshape(full @ x[piece], (4, 4), order="C")
        divergence.append(cp.trace(X) - cp.log_det(X) - 4)
    if chart.positive:
        places, weights = zip(*chart.positive, strict=True)
        divergence.append(np.array(weights) @ (x[list(places)] - cp.log(x[list(places)]) - 1))
    cost = cp.sum_squares(A @ (x - chart.x0) - b) / 2 + cp.sum(divergence) / trust**2
    if chart.free:
        cost = cost + cp.sum_squares(x[list(chart.free)]) / (2 * LAW_WIDTH**2)
    bounded, least = [k for k, _ in chart.bounds], np.array([value for _, value in chart.bounds])
    problem = cp.Problem(cp.Minimize(cost), [x[bounded] >= least] if bounded else [])
    try:
        problem.solve(solver=cp.CLARABEL)
    except cp.SolverError as error:
        raise IdentificationError(f"the convex solver gave up: {error}", "Record a richer motion.") from None
    if x.value is None:
        raise IdentificationError(f"the convex solver found nothing ({problem.status})", "Record a richer motion.")
    solution: Array = np.asarray(x.value, dtype=float)
    return solution
