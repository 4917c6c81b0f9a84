"""Coordinates of all parameters in which physical consistency is a convex condition, with the
description as centre.

The ten parameters of a link become its pseudo-inertia, normalised by that of the description, which
is positive definite if a mass distribution has these parameters (P. Wensing, S. Kim, J.-J. Slotine,
IEEE Robotics and Automation Letters 3 (2018) 60). Solids of revolution have positive moments; K, D
and armatures are positive or not negative; laws beyond the model have bounds.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics.bodies import Body, inertial_parameters, pseudo_inertia
from elastic_arm.dynamics.composition import ARMATURE
from elastic_arm.identification.base_regression import BaseRegression, Column
from elastic_arm.identification.result import Carried
from elastic_arm.robot import Robot

# Pseudo-inertias of the nominal are kept this far from singular, relative to their largest
# eigenvalue.
THINNEST = 1e-6
# Entries of a symmetric matrix (4, 4), in the order of their coordinates.
PAIRS = ((0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3))
_UNIT = [float(i == j) for i, j in PAIRS]  # coordinates of the unit matrix: of the nominal body


@dataclass
class Chart:
    """Parameters near the nominal ones: Psi = Psi0 + G (x - x0), x without unit."""

    Psi0: Array
    columns: list[Array] = field(default_factory=list)  # of G
    start: list[float] = field(default_factory=list)  # x0
    # of x: the ten entries of a normalised pseudo-inertia
    pseudo: list[slice] = field(default_factory=list)
    # indices of x that must be positive, each with its weight in the divergence
    positive: list[tuple[int, float]] = field(default_factory=list)
    free: list[int] = field(default_factory=list)  # indices of x that may have either sign
    # of `free`, with the least value of each
    bounds: list[tuple[int, float]] = field(default_factory=list)
    # indices of x that are parameters of laws over what is ordinary of them; errors of sensors are
    # free
    held: list[int] = field(default_factory=list)

    @functools.cached_property
    def G(self) -> Array:
        """(P, k) the parameters by the coordinates."""
        return np.array(self.columns).T

    @functools.cached_property
    def x0(self) -> Array:
        """(k,) the nominal arm."""
        return np.array(self.start)

    def variances(self) -> Array:
        """Return the variances of x that correspond to the divergence at a trust of one."""
        variance = np.ones(len(self.x0))
        for piece in self.pseudo:
            # Off the diagonal an entry of X counts twice in the trace of X².
            variance[piece] = [1.0 if i == j else 0.5 for i, j in PAIRS]
        for k, weight in self.positive:
            variance[k] = 1.0 / weight
        return variance

    def add_link(self, index: list[int], nominal: Array) -> None:
        """Add a link; `nominal` contains its ten parameters without the body merged into it."""
        self.pseudo.append(slice(len(self.start), len(self.start) + 10))
        own = _link_chart(nominal)
        moments = np.linalg.eigvalsh(pseudo_inertia(nominal))
        # A point counts as thick as its chart, to become thinner.
        if moments[0] < THINNEST * moments[-1]:
            self.Psi0[index] += own @ _UNIT - nominal
        self._add(own, index, _UNIT)

    def add_solid(self, index: list[int], nominal: Array) -> None:
        """Add a solid of revolution: its mass, and its radial and axial moments."""
        first = len(self.start)
        self._add(_solid_chart(nominal), index, (1.0, 1.0, 1.0))
        self.positive += [(first, 1.0), (first + 1, 2.0), (first + 2, 1.0)]

    def add_number(self, k: int, nominal: float, law: Column | None, *, physical: bool) -> None:
        """Add parameter k, relative to its nominal or its ordinary value.

        It is constant if neither is stated.
        """
        place = len(self.start)
        relative = physical and nominal > 0
        # Where masses have to be positive, the zeros of sensors have more to take up than is
        # ordinary.
        ordinary = None if law is None or law.sensor else law.ordinary
        self._add(
            np.array([[nominal if relative else ordinary or 1.0]]), [k], (1.0 if relative else 0.0,)
        )
        if relative:
            self.positive.append((place, 1.0))
            return
        if ordinary:
            self.held.append(place)
            return
        self.free.append(place)
        least = -np.inf if law is None else law.least
        lowest = max(least, 0.0 if physical or nominal > 0 else -np.inf)
        if np.isfinite(lowest):
            self.bounds.append((place, lowest - nominal))

    def _add(self, columns: Array, index: list[int], start: Sequence[float]) -> None:
        wide = np.zeros((columns.shape[1], len(self.Psi0)))
        wide[:, index] = columns.T
        self.columns += list(wide)
        self.start += start


def chart_of(equations: BaseRegression, carried: Carried | None = None) -> Chart:
    """Return coordinates in which x0 is the nominal arm and every step of size one is equally
    large.

    carried: a body that belongs to its link, in addition to the description.
    """
    names = equations.names
    nominal = equations.nominal
    robot = equations.model.robot
    links = {joint.link_name for joint in robot.joints}
    seen = set[int]()
    found = Chart(nominal.copy())
    for body in equations.model.bodies.bodies:
        index = list(body.parameters)
        if seen & set(index):
            continue
        seen |= set(index)
        if body.name in links:
            more = np.zeros(10)
            if carried is not None and carried.link == body.name:
                more = inertial_parameters(carried.body)
            found.Psi0[index] += more
            found.add_link(index, nominal[index] - folded(robot, equations, body) + more)
        else:
            found.add_solid(index, nominal[index])
    laws = {column.name: column for column in equations.columns}
    for k, name in enumerate(names):
        if k not in seen:
            physical = name.rpartition(".")[2] in ("K", "D", ARMATURE)
            found.add_number(k, float(nominal[k]), laws.get(name), physical=physical)
    return found


def folded(robot: Robot, equations: BaseRegression, body: Body) -> Array:
    """Return the additional nominal body of the link: the spline in mod1, otherwise nothing."""
    link = next(j.link for j in robot.joints if j.link_name == body.name)
    own = inertial_parameters(link)
    return equations.nominal[list(body.parameters)] - own


def _link_chart(nominal: Array) -> Array:
    """Return (10, 10): entries of the normalised pseudo-inertia X -> parameters, J = L X L', J0 = L
    L'."""
    values, vectors = np.linalg.eigh(pseudo_inertia(nominal))
    L = vectors * np.sqrt(np.maximum(values, THINNEST * values[-1]))
    columns = []
    for i, j in PAIRS:
        unit = np.zeros((4, 4))
        unit[i, j] = unit[j, i] = 1.0
        J = L @ unit @ L.T
        trace = np.trace(J[:3, :3])
        inertia = trace * np.eye(3) - J[:3, :3]
        tensor = [inertia[p] for p in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))]
        columns.append([J[3, 3], J[0, 3], J[1, 3], J[2, 3], *tensor])
    return np.array(columns).T


def _solid_chart(nominal: Array) -> Array:
    """Return (4, 3): mass, radial and axial second moment relative to nominal -> m, mz, Ixx, Izz;
    mz is constant."""
    mass, _, xx, zz = nominal
    radial = 0.5 * zz
    axial = max(xx - 0.5 * zz, THINNEST * xx)
    # Izz = 2 radial, Ixx = radial + axial.
    return np.array(
        [[mass, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, radial, axial], [0.0, 2.0 * radial, 0.0]]
    )
