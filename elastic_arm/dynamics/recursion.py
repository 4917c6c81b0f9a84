"""The one derivation: Newton-Euler over a tree of bodies, for any kind of scalar.

A vector is a list of three scalars, which may be floats, CasADi SX or SymPy expressions: the
numbers and the printed S of (8) come from the same lines. Constant zeros and ones are skipped, so
that expressions stay as small as by hand.

Source: R. Featherstone, Rigid Body Dynamics Algorithms, ch. 5 (recursive Newton-Euler); spins after
L. Sciavicco and B. Siciliano's treatment of rotors as bodies on the link that carries them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from elastic_arm.dynamics.bodies import GROUND, Bodies, Frame

Scalar = Any
Vec = list[Scalar]


@dataclass(frozen=True)
class Trig:
    """Sine and cosine of the scalars at hand."""

    sin: Callable[[Scalar], Scalar]
    cos: Callable[[Scalar], Scalar]


@dataclass
class _FrameMotion:
    """Of a frame, in its own axes: angular velocity and acceleration, acceleration of its origin
    less gravity.

    `turn` is cosine and sine of a revolute joint, `slide` the travel of a prismatic one.
    """

    w: Vec
    dw: Vec
    a: Vec
    turn: tuple[Scalar, Scalar] = (1.0, 0.0)
    slide: Vec = field(default_factory=lambda: [0.0, 0.0, 0.0])


@dataclass
class _Wrench:
    """Force, and moment about a frame's origin."""

    f: Vec = field(default_factory=lambda: [0.0, 0.0, 0.0])
    n: Vec = field(default_factory=lambda: [0.0, 0.0, 0.0])

    def add(self, f: Vec, n: Vec) -> None:
        self.f = _add(self.f, f)
        self.n = _add(self.n, n)


def inverse_dynamics(
    bodies: Bodies,
    x: Sequence[Scalar],
    dx: Sequence[Scalar],
    ddx: Sequence[Scalar],
    Psi: Sequence[Scalar],
    trig: Trig,
    gravity: Sequence[Scalar] | None = None,
) -> list[Scalar]:
    """Generalized forces, the left side of (1) without springs: M ddx + c + g.

    x, dx, ddx: generalized coordinates and derivatives, `bodies.dof` scalars each; gravity: of the
    base frame, m/s^2; that of `bodies` when None.
    """
    weight = bodies.gravity if gravity is None else gravity
    motions = _outward(bodies, x, dx, ddx, [-1.0 * g for g in weight], trig)
    wrenches = [_Wrench() for _ in bodies.frames]
    inertias = frame_inertias(bodies, Psi)
    for motion, wrench, inertia in zip(motions, wrenches, inertias, strict=True):
        if inertia is not None:
            wrench.add(*_newton_euler(motion, inertia))
    forces: list[Scalar] = [0.0] * bodies.dof
    for spin in bodies.spins:
        speed = _sum([_times(ratio, dx[k]) for k, ratio in spin.gears])
        acceleration = _sum([_times(ratio, ddx[k]) for k, ratio in spin.gears])
        h = Psi[spin.parameter] * speed
        dh = Psi[spin.parameter] * acceleration
        along = dh
        if spin.frame != GROUND:
            motion = motions[spin.frame]
            u = list(spin.axis)
            wrenches[spin.frame].add([0.0] * 3, _add(_scale(u, dh), _cross(_scale(motion.w, h), u)))
            along = along + Psi[spin.parameter] * _dot(u, motion.dw)
        for k, ratio in spin.gears:
            forces[k] = forces[k] + _times(ratio, along)
    return _inward(bodies, motions, wrenches, forces)


def spring_forces(
    bodies: Bodies, x: Sequence[Scalar], dx: Sequence[Scalar], Psi: Sequence[Scalar]
) -> list[Scalar]:
    """K (q - theta) + D (dq - dtheta) on the link side of (1).

    The opposite acts on the motor side; bearings likewise.
    """
    forces: list[Scalar] = [0.0] * bodies.dof
    for s in bodies.springs:
        d = x[s.coordinate]
        dd = dx[s.coordinate]
        if s.against is not None:
            d = d - x[s.against]
            dd = dd - dx[s.against]
        force = Psi[s.stiffness] * d + Psi[s.damping] * dd
        forces[s.coordinate] = forces[s.coordinate] + force
        if s.against is not None:
            forces[s.against] = forces[s.against] - force
    return forces


def energy(
    bodies: Bodies, x: Sequence[Scalar], dx: Sequence[Scalar], Psi: Sequence[Scalar], trig: Trig
) -> tuple[Scalar, Scalar]:
    """Kinetic and potential energy.

    The latter counts springs, and gravity from the ground frame's origin.
    """
    kinetic: Scalar = 0.0
    potential: Scalar = 0.0
    angular: list[Vec] = []
    carried: list[tuple[Vec, Vec, Vec, Scalar]] = []
    root = ([0.0] * 3, [0.0] * 3, list(bodies.gravity), bodies.base_height)
    for frame, inertia in zip(bodies.frames, frame_inertias(bodies, Psi), strict=True):
        w, v, g, height = _carry_energy(
            frame, root if frame.parent == GROUND else carried[frame.parent], x, dx, trig
        )
        carried.append((w, v, g, height))
        angular.append(w)
        if inertia is not None:
            m, h, tensor = inertia
            kinetic = (
                kinetic
                + 0.5 * (m * _dot(v, v) + _dot(w, _tensor_times(tensor, w)))
                + _dot(v, _cross(w, h))
            )
            potential = potential - (m * height + _dot(g, h))
    for spin in bodies.spins:
        speed = _sum([_times(r, dx[k]) for k, r in spin.gears])
        along = 0.0 if spin.frame == GROUND else _dot(list(spin.axis), angular[spin.frame])
        kinetic = kinetic + Psi[spin.parameter] * speed * (0.5 * speed + along)
    for s in bodies.springs:
        d = x[s.coordinate] if s.against is None else x[s.coordinate] - x[s.against]
        potential = potential + 0.5 * Psi[s.stiffness] * d * d
    return kinetic, potential


def frame_inertias(bodies: Bodies, Psi: Sequence[Scalar]) -> list[tuple[Scalar, Vec, Vec] | None]:
    """Mass, first moment and tensor of all that rests in each frame.

    About its origin; the tensor is xx xy xz yy yz zz.
    """
    sums: list[Vec | None] = [None] * len(bodies.frames)
    for body in bodies.bodies:
        if body.frame == GROUND:
            continue
        ten = _matrix_times(body.inertia_map, [Psi[k] for k in body.parameters])
        known = sums[body.frame]
        sums[body.frame] = ten if known is None else _add(known, ten)
    return [None if s is None else (s[0], s[1:4], s[4:]) for s in sums]


def _outward(
    bodies: Bodies,
    x: Sequence[Scalar],
    dx: Sequence[Scalar],
    ddx: Sequence[Scalar],
    a0: Vec,
    trig: Trig,
) -> list[_FrameMotion]:
    """Motion of every frame, from the base outward."""
    motions: list[_FrameMotion] = []
    base = _FrameMotion([0.0] * 3, [0.0] * 3, a0)
    for frame in bodies.frames:
        up = base if frame.parent == GROUND else motions[frame.parent]
        rotation = frame.before[:3, :3].T
        a = _add(up.a, _point_acceleration(up.w, up.dw, frame.before[:3, 3]))
        w = _matrix_times(rotation, up.w)
        dw = _matrix_times(rotation, up.dw)
        a = _matrix_times(rotation, a)
        k = frame.coordinate
        if frame.slides:
            a = _slid(_FrameMotion(w, dw, a), frame.axis, (x[k], dx[k], ddx[k]))
            turn = (1.0, 0.0)
        else:
            turn = trig.cos(x[k]), trig.sin(x[k])
            w, dw, a = _turned(_FrameMotion(w, dw, a), frame.axis, turn, (dx[k], ddx[k]))
        a = _add(a, _point_acceleration(w, dw, frame.after[:3, 3]))
        w = _matrix_times(frame.after[:3, :3].T, w)
        dw = _matrix_times(frame.after[:3, :3].T, dw)
        a = _matrix_times(frame.after[:3, :3].T, a)
        motions.append(
            _FrameMotion(w, dw, a, turn, _along(frame.axis, x[k] if frame.slides else 0.0))
        )
    return motions


def _turned(
    up: _FrameMotion, axis: int, turn: tuple[Scalar, Scalar], rates: tuple[Scalar, Scalar]
) -> tuple[Vec, Vec, Vec]:
    """Motion of a frame that turns about an axis, from that of the frame it turns in."""
    w = _turn_back(up.w, axis, turn)
    dw = _turn_back(up.dw, axis, turn)
    a = _turn_back(up.a, axis, turn)
    rate, acceleration = rates
    j = (axis + 1) % 3
    k = (axis + 2) % 3
    dw[j] = dw[j] + w[k] * rate
    dw[k] = dw[k] - w[j] * rate
    dw[axis] = dw[axis] + acceleration
    w[axis] = w[axis] + rate
    return w, dw, a


def _slid(up: _FrameMotion, axis: int, travel: tuple[Scalar, Scalar, Scalar]) -> Vec:
    """Acceleration of the origin of a frame that slides along an axis: with the frame, of Coriolis,
    and its own."""
    position, rate, acceleration = (_along(axis, value) for value in travel)
    a = _add(up.a, _point_acceleration(up.w, up.dw, position))
    return _add(_add(a, _scale(_cross(up.w, rate), 2.0)), acceleration)


def _along(axis: int, value: Scalar) -> Vec:
    return [value if k == axis else 0.0 for k in range(3)]


def _newton_euler(motion: _FrameMotion, inertia: tuple[Scalar, Vec, Vec]) -> tuple[Vec, Vec]:
    """Force and moment about the frame's origin that move what rests in a frame."""
    m, h, tensor = inertia
    w = motion.w
    dw = motion.dw
    a = motion.a
    f = _add(_scale(a, m), _point_acceleration(w, dw, h))
    n = [_dot(row, tensor) for row in _tensor_regressor(w, dw)]
    return f, _add(n, _cross(h, a))


def _inward(
    bodies: Bodies, motions: list[_FrameMotion], wrenches: list[_Wrench], forces: list[Scalar]
) -> list[Scalar]:
    """Hand every frame's wrench to its parent, and the part about its axis, or along it, to its
    coordinate."""
    for frame, motion, wrench in reversed(list(zip(bodies.frames, motions, wrenches, strict=True))):
        f, n = _through(frame.after, wrench.f, wrench.n)
        forces[frame.coordinate] = forces[frame.coordinate] + (f if frame.slides else n)[frame.axis]
        if frame.parent != GROUND:
            if frame.slides:
                n = _add(n, _cross(motion.slide, f))
            else:
                f = _turn(f, frame.axis, motion.turn)
                n = _turn(n, frame.axis, motion.turn)
            wrenches[frame.parent].add(*_through(frame.before, f, n))
    return forces


def _carry_energy(
    frame: Frame,
    up: tuple[Vec, Vec, Vec, Scalar],
    x: Sequence[Scalar],
    dx: Sequence[Scalar],
    trig: Trig,
) -> tuple[Vec, Vec, Vec, Scalar]:
    """Angular velocity, velocity, gravity and g . position of a frame, from its parent's."""
    w, v, g, height = up
    for placement, turning in ((frame.before, True), (frame.after, False)):
        p = list(placement[:3, 3])
        v = _add(v, _cross(w, p))
        height = height + _dot(g, p)
        w = _matrix_times(placement[:3, :3].T, w)
        v = _matrix_times(placement[:3, :3].T, v)
        g = _matrix_times(placement[:3, :3].T, g)
        if turning and frame.slides:
            p = _along(frame.axis, x[frame.coordinate])
            v = _add(v, _cross(w, p))
            height = height + _dot(g, p)
            v[frame.axis] = v[frame.axis] + dx[frame.coordinate]
        elif turning:
            turn = trig.cos(x[frame.coordinate]), trig.sin(x[frame.coordinate])
            w = _turn_back(w, frame.axis, turn)
            v = _turn_back(v, frame.axis, turn)
            g = _turn_back(g, frame.axis, turn)
            w[frame.axis] = w[frame.axis] + dx[frame.coordinate]
    return w, v, g, height


def _is(value: Scalar, number: float) -> bool:
    """Return whether a scalar is this very constant; symbols never are."""
    return isinstance(value, int | float) and value == number


def _times(a: Scalar, b: Scalar) -> Scalar:
    if _is(a, 0.0) or _is(b, 0.0):
        return 0.0
    if _is(a, 1.0):
        return b
    if _is(b, 1.0):
        return a
    if _is(a, -1.0):
        return -b
    if _is(b, -1.0):
        return -a
    return a * b


def _plus(a: Scalar, b: Scalar) -> Scalar:
    if _is(a, 0.0):
        return b
    return a if _is(b, 0.0) else a + b


def _sum(terms: Sequence[Scalar]) -> Scalar:
    total: Scalar = 0.0
    for term in terms:
        total = _plus(total, term)
    return total


def _add(a: Sequence[Scalar], b: Sequence[Scalar]) -> Vec:
    return [_plus(x, y) for x, y in zip(a, b, strict=True)]


def _scale(v: Vec, s: Scalar) -> Vec:
    return [_times(x, s) for x in v]


def _dot(a: Vec, b: Vec) -> Scalar:
    return _sum([_times(x, y) for x, y in zip(a, b, strict=True)])


def _cross(a: Vec, b: Sequence[Scalar]) -> Vec:
    def entry(j: int, k: int) -> Scalar:
        return _plus(_times(a[j], b[k]), _times(-1.0, _times(a[k], b[j])))

    return [entry(1, 2), entry(2, 0), entry(0, 1)]


def _matrix_times(matrix: np.ndarray, v: Vec) -> Vec:
    return [_sum([_times(float(c), x) for c, x in zip(row, v, strict=True)]) for row in matrix]


def _tensor_times(tensor: Vec, v: Vec) -> Vec:
    xx, xy, xz, yy, yz, zz = tensor
    return [_dot([xx, xy, xz], v), _dot([xy, yy, yz], v), _dot([xz, yz, zz], v)]


def _minus(a: Scalar, b: Scalar) -> Scalar:
    return _plus(a, _times(-1.0, b))


def _tensor_regressor(w: Vec, dw: Vec) -> list[Vec]:
    """I dw + w x I w as a matrix times the six of I: its products of w are shared by all that a
    frame carries."""
    x, y, z = w
    xx = _times(x, x)
    yy = _times(y, y)
    zz = _times(z, z)
    xy = _times(x, y)
    xz = _times(x, z)
    yz = _times(y, z)
    return [
        [dw[0], _minus(dw[1], xz), _plus(dw[2], xy), _times(-1.0, yz), _minus(yy, zz), yz],
        [xz, _plus(dw[0], yz), _minus(zz, xx), dw[1], _minus(dw[2], xy), _times(-1.0, xz)],
        [_times(-1.0, xy), _minus(xx, yy), _minus(dw[0], yz), xy, _plus(dw[1], xz), dw[2]],
    ]


def _point_acceleration(w: Vec, dw: Vec, p: Sequence[Scalar] | np.ndarray) -> Vec:
    """dw x p + w x (w x p), as ([dw] + w wT - |w|^2) p: the matrix is shared by all points of a
    body."""
    point = [float(c) for c in p] if isinstance(p, np.ndarray) else list(p)
    xx, yy, zz = (_times(c, c) for c in w)
    xy = _times(w[0], w[1])
    xz = _times(w[0], w[2])
    yz = _times(w[1], w[2])
    rows = [
        [_times(-1.0, _plus(yy, zz)), _minus(xy, dw[2]), _plus(xz, dw[1])],
        [_plus(xy, dw[2]), _times(-1.0, _plus(xx, zz)), _minus(yz, dw[0])],
        [_minus(xz, dw[1]), _plus(yz, dw[0]), _times(-1.0, _plus(xx, yy))],
    ]
    return [_dot(row, point) for row in rows]


def _turn(v: Vec, axis: int, turn: tuple[Scalar, Scalar]) -> Vec:
    """Rotate about a coordinate axis by the angle of (cos, sin) `turn`."""
    c, s = turn
    j = (axis + 1) % 3
    k = (axis + 2) % 3
    result = list(v)
    result[j] = _plus(_times(c, v[j]), _times(-1.0, _times(s, v[k])))
    result[k] = _plus(_times(s, v[j]), _times(c, v[k]))
    return result


def _turn_back(v: Vec, axis: int, turn: tuple[Scalar, Scalar]) -> Vec:
    c, s = turn
    return _turn(v, axis, (c, _times(-1.0, s)))


def _through(placement: np.ndarray, f: Vec, n: Vec) -> tuple[Vec, Vec]:
    """Express a wrench of a placed frame in the frame it is placed in."""
    f = _matrix_times(placement[:3, :3], f)
    n = _matrix_times(placement[:3, :3], n)
    return f, _add(n, _cross([float(c) for c in placement[:3, 3]], f))
