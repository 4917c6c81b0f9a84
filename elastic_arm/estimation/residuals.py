"""The residuals of a recording: measured torques minus those of the model, three per joint.

Rows are ordered equation by equation: [link of all joints, drive of all joints, motor of all
joints].
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.interpolate import CubicSpline
from scipy.linalg import cho_factor, cho_solve
from scipy.ndimage import binary_dilation, binary_opening, find_objects, label
from scipy.sparse import csr_array

from elastic_arm.arrays import Array, Indices, Mask
from elastic_arm.dynamics import Model
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.equation_sets import DRIVE, LINK, MOTOR, EquationSet
from elastic_arm.estimation.motion import CompletedMotion, Loads, completed, drive_constants
from elastic_arm.estimation.observation import Observation
from elastic_arm.estimation.resampling import read_at
from elastic_arm.recording.standstill import STANDS

SLOWEST = 5e-4  # rad/s: slower than this a velocity has no sign, whatever the noise
# of a joint's highest speed, below which it sticks if it is as slow for as long as STICKING
SLOW = 0.005
UNTOLD = 3.0  # standard deviations of the noise within which a velocity is not told from none
STICKING = 0.01  # s; a reversal without sticking is shorter but for accelerations below 0.5 rad/s²
# Mean square of what is left where a joint sticks over that elsewhere, from which friction's law
# fails there. Convention: where the law holds, few rows that are noise give up to 2.4; true
# sticking gave 6.
FAILS = 4.0
NO_HOLES = np.empty((0, 2))
BESIDE = 16  # rows beside a time without a law that tell the noise within
JITTER = 1e-9  # share of that noise, numerical
AROUND = 0.03  # s before and after, in which the smoothed motion is none of either


def raw_residuals(model: Model, motion: CompletedMotion) -> Array:
    """Residuals (N, 3 n) Nm of completed motion at the recording's rate."""
    n = model.n
    if not model.robot.elastic:
        # A torque sensor at the joint does not feel the armature, which is in the motor's row.
        motor = armatures(model) * motion.ddq
        link = model.inverse_dynamics(motion.q, motion.dq, motion.ddq) - motor
        return np.hstack(
            [motion.tau_J - link, np.zeros_like(link), motion.tau_m - motion.tau_J - motor]
        )
    K, D = drive_constants(model)
    spring = K * (motion.theta - motion.q) + D * (motion.dtheta - motion.dq)
    left = model.inverse_dynamics(*(motion.coordinates(rate) for rate in ("", "d", "dd")))
    # The left side of (1) holds the spring in both rows; the residuals have the sensor's torque in
    # its place.
    link = motion.tau_J - (left[:, :n] + spring)
    motor = motion.tau_m - (left[:, n : 2 * n] - spring) - motion.tau_J
    return np.hstack([link, motion.tau_J - spring, motor])


def armatures(model: Model) -> Array:
    """Return the armatures (n,) kg m² of an arm without transmissions; zero if not stated."""
    found = np.zeros(model.n)
    for spin in model.bodies.spins:
        found[spin.gears[0][0]] += model.Psi[spin.parameter]
    return found


def predicted_torques(model: Model, motion: CompletedMotion) -> tuple[Array, Array]:
    """Return the joint and motor torques (N, n) Nm that the model predicts."""
    n = model.n
    raw = raw_residuals(model, motion)
    load = motion.tau_J - raw[:, :n]
    return load, motion.tau_m - motion.tau_J - raw[:, 2 * n :] + load


@dataclass(frozen=True)
class Stretch:
    """Residuals of one stretch without holes, in the band, at the kept rate."""

    t: Array  # (N',) s
    values: Array  # (N', R) Nm
    motion: CompletedMotion  # the completed motion at the recording's rate that they were made of
    quiet: CompletedMotion  # the same motion, smoothed further, for the columns of effects
    band: Band  # at the recording's rate
    kept: slice  # which of the rows that the band gives for the motion they are
    # samples of the motion at which torques were read, where that is not at all of them
    read: Indices | None = None

    def in_band(self, values: Array) -> Array:
        """Return columns (N, k) in the band, (N', k), where torques were known."""
        if self.read is not None and values.shape[1]:
            values = CubicSpline(self.read, values[self.read])(np.arange(len(values)))
        return np.asarray(self.band.apply(values)[self.kept])


def motion_noise(described: Model, recorded: Observation) -> list[Array]:
    """Return what the noise of the encoders, beyond the quiet motion, leaves in the residuals
    (N, 3 n) Nm of each stretch.

        d = y(described, motion) - y(described, quiet motion)

    described: the arm that makes it for all arms that are compared; recorded: the recording, with
    no channel moved in time.
    """
    found = []
    for piece, calm in zip(recorded.pieces, recorded.quiet, strict=True):
        motion = replace(piece, tau_J=calm.tau_J, tau_m=calm.tau_m)
        both = (raw_residuals(described, completed(one, described)) for one in (motion, calm))
        found.append(np.subtract(*both))
    return found


def residuals(
    model: Model,
    observation: Observation,
    equations: EquationSet,
    band: Band,
    loads: Loads | None = None,
    noise: Sequence[Array] | None = None,
) -> list[Stretch]:
    """Return the residuals of every stretch of a recording.

    loads: what loads the drives (N, n) Nm along a motion beside the model's own torques; noise:
    what the noise of the encoders leaves in the residuals of each stretch (:func:`motion_noise`).
    An arm with too little inertia makes less noise of accelerations; where arms are compared, it
    would explain a recording better by that. Then the quiet motion makes the residuals, and all
    have the same noise. None where nothing is compared: the motion makes the residuals.
    """
    stretches = []
    each = zip(observation.pieces, observation.quiet, strict=True)
    for k, (piece, calm) in enumerate(each):
        quiet = completed(calm, model, loads)
        if noise is None:
            motion = completed(piece, model, loads)
            raw = raw_residuals(model, motion)
        else:
            motion = completed(replace(calm, tau_J=piece.tau_J, tau_m=piece.tau_m), model, loads)
            raw = raw_residuals(model, motion) + noise[k]
        full = raw @ equations.transform.T
        t = band.times(motion.t)
        first, last = np.searchsorted(
            t, [motion.t[0] + observation.margin, motion.t[-1] - observation.margin]
        )
        kept = slice(int(first), int(last))
        read = None if observation.read is None else read_at(motion.t, observation.read)
        made = Stretch(t[kept], full, motion, quiet, band, kept, read)
        stretches.append(replace(made, values=made.in_band(full)))
    return [s for s in stretches if len(s.t) > band.kept_rate]


@dataclass(frozen=True)
class FreeTimes:
    """When a torque that no law states acts, and in which rows that is seen."""

    pieces: tuple[tuple[int, int], ...]  # first sample of each time, and the one after its last
    end: int  # sample before which they and what the band's filter reaches end
    rows: tuple[int, int]  # first row, and the one after the last, of those that the band gives
    step: float  # s between samples


@dataclass(frozen=True)
class FreeTorque:
    """What a torque that no law states can be in some rows of one residual."""

    row: int  # number of the residual
    instants: slice  # of the rows that the band's filter carries it to
    basis: Array | None = (
        None  # orthonormal (instants, m); None where it can be anything at all of these instants
    )
    # Rows beside these instants that hold no such torque, and (m, instants + beside) what they and
    # the instants estimate of the torque: least squares by the noise, which goes on from the rows
    # beside.
    beside: Indices = field(default_factory=lambda: np.zeros(0, dtype=int))
    estimate: Array | None = None


@dataclass(frozen=True)
class FreeTorques:
    """What is removed of the rows of a stretch: torques that no law states at certain times.

        y' = y - B (B' C^-1 B)^-1 B' C^-1 y

    B is what they can be, C the covariance of the row's noise.

    While a joint sticks, its dry friction takes any value. While an encoder hardly moves, it holds
    one code, and its error is no noise but one value, which turns up in the torques of spring and
    inertia. Where nothing was recorded, nothing is known, nor what acts during an event. Their
    prior variance is infinite: they are projected out of residuals and columns alike.
    """

    found: tuple[FreeTorque, ...] = ()  # all of them
    length: int = 0  # N' rows of the stretch
    # those worked out, by what they depend on beside the band, and their estimates by row and rows
    # beside, too
    bases: Mapping[FreeTimes, Array] = field(default_factory=dict, repr=False)
    estimates: Mapping[tuple[FreeTimes, int, bytes], Array] = field(
        default_factory=dict, repr=False
    )

    @classmethod
    def of(
        cls,
        stretch: Stretch,
        band: Band,
        layout: EquationSet,
        steps: Mapping[str, Array],
        holes: Array = NO_HOLES,
        events: Sequence[tuple[int, int, float, float]] = (),
        *,
        friction: bool,
        standing: Array,
        near: FreeTorques | None = None,
        noise: Array | None = None,
    ) -> FreeTorques:
        """Return what is removed of a stretch.

        band: its filter carries what happens at some time over to rows around; steps: "link",
        "motor" -> (n,) rad, steps of the encoders; holes: (k, 2) s, from when to when nothing was
        recorded; events: those of an :class:`.Observation`; friction: whether the friction of a
        joint that sticks is removed; standing: (n,) rad/s, below which a joint sticks; near: those
        of the same stretch with other numbers of the arm, in the same band: most bases are the
        same. Steps and standing are zero for joints that never move; noise: (lags, R)
        autocovariance of the rows' noise, None where it is white.
        """
        t = stretch.quiet.t
        dq = stretch.quiet.dq
        dtheta = stretch.quiet.dtheta
        link = _held(t, dq, band, steps["link"])
        motor = _held(t, dtheta, band, steps["motor"])
        stuck = motor | sticking(t, dtheta, standing) if friction else motor
        unknown = (np.searchsorted(holes[:, 0], t) > np.searchsorted(holes[:, 1], t))[:, None]
        times = {LINK: link | unknown, DRIVE: link | motor | unknown, MOTOR: stuck | unknown}
        for equation, joint, begin, end in events:
            times[equation][:, joint] |= (t >= begin) & (t <= end)
        known = {} if near is None else near.bases
        bases: dict[FreeTimes, Array] = {}
        courses = {
            part: [_courses(stretch, band, one, bases, known) for one in when.T]
            for part, when in times.items()
        }
        places = [
            (row, instants, one)
            for row, (equation, joint) in enumerate(layout.entries)
            for part, of_joints in courses.items()
            if equation.combination[part] != 0
            for instants, one in of_joints[joint]
        ]
        taken = np.zeros((len(stretch.t), layout.rows), dtype=bool)
        for row, instants, _ in places:
            taken[instants, row] = True
        noise = np.ones((1, layout.rows)) if noise is None else noise
        estimates = {}
        before = {} if near is None else near.estimates
        found = []
        for row, instants, one in places:
            if one is None:
                found.append(FreeTorque(row, instants))
                continue
            around = np.arange(
                max(instants.start - BESIDE, 0), min(instants.stop + BESIDE, len(taken))
            )
            beside = around[~taken[around, row]]
            key = one, row, beside.tobytes()
            estimates[key] = (
                before[key]
                if key in before
                else _estimate(bases[one], instants, beside, noise[:, row])
            )
            found.append(FreeTorque(row, instants, bases[one], beside, estimates[key]))
        return cls(tuple(found), len(stretch.t), bases, estimates)

    def is_same_as(self, other: FreeTorques) -> bool:
        """Whether it removes what other free torques remove; it has their arrays then."""
        if self.length != other.length or len(self.found) != len(other.found):
            return False
        pairs = list(zip(self.found, other.found, strict=True))
        places = all((a.row, a.instants) == (b.row, b.instants) for a, b in pairs)
        return places and all(a.basis is b.basis and a.estimate is b.estimate for a, b in pairs)

    def remove(self, values: Array, *, in_place: bool = False) -> Array:
        """Return residuals or columns (N', R, …) without them, perhaps in the same array."""
        if not self.found:
            return values
        out = values if in_place else values.copy(order="K")
        for row, stages in self._of_row.items():
            rows = out[:, row]
            for basis, estimate in stages if rows.any() else ():
                rows -= basis @ (estimate @ rows)
        return out

    def shares(self, count: int, rows: int, band: Band) -> Array:
        """Return the share (N', R) of noise power in the band that is left."""
        left = np.ones((count, rows))
        for free in self.found:
            # Of a basis in the band; the band holds fewer independent values than there are
            # instants.
            taken = 1.0 if free.basis is None else np.sum(free.basis**2, axis=1)
            left[free.instants, free.row] -= taken * band.kept_rate / (2.0 * band.cutoff)
        return np.maximum(left, 0.0)

    @cached_property
    def _of_row(self) -> dict[int, list[tuple[_Matrix, _Matrix]]]:
        """By row of the residuals, B (N', m) and (m, N') what estimates its coefficients, in turn.

        Torques that share no instant are removed at once: none acts in rows that estimate another.
        """
        by_row: dict[int, list[list[FreeTorque]]] = {}
        for free in self.found:
            stages = by_row.setdefault(free.row, [[]])
            if stages[-1] and free.instants.start < stages[-1][-1].instants.stop:
                stages.append([])
            stages[-1].append(free)
        return {
            row: [_operators(torques, self.length) for torques in stages]
            for row, stages in by_row.items()
        }


def _operators(torques: Sequence[FreeTorque], length: int) -> tuple[_Matrix, _Matrix]:
    """Return B (length, m) of several torques of one residual, and (m, length) their estimates."""
    bases: list[_Block] = []
    estimates: list[_Block] = []
    m = 0
    for free in torques:
        instants = np.arange(free.instants.start, free.instants.stop)
        whole = np.eye(len(instants))
        basis = whole if free.basis is None else free.basis
        estimate = whole if free.estimate is None else free.estimate
        columns = np.arange(m, m + basis.shape[1])
        bases.append((instants, columns, basis))
        estimates.append((columns, np.concatenate([instants, free.beside]), estimate))
        m += len(columns)
    return _matrix(bases, (length, m)), _matrix(estimates, (m, length))


_Block = tuple[Indices, Indices, Array]  # rows, columns, and what stands there
_Matrix: TypeAlias = csr_array | Array


def _matrix(blocks: Sequence[_Block], shape: tuple[int, int]) -> _Matrix:
    """Return a matrix of blocks: sparse where that takes less memory, and so less time."""
    entries = sum(own.size for *_, own in blocks)
    of_entry = np.dtype(float).itemsize + np.dtype(np.int32).itemsize
    if entries * of_entry < shape[0] * shape[1] * np.dtype(float).itemsize:
        return _sparse(blocks, shape)
    found = np.zeros(shape)
    for rows, columns, own in blocks:
        found[np.ix_(rows, columns)] = own
    return found


def _sparse(blocks: Sequence[_Block], shape: tuple[int, int]) -> csr_array:
    rows = [np.repeat(own, len(columns)) for own, columns, _ in blocks]
    columns = [np.tile(own, len(rows)) for rows, own, _ in blocks]
    values = [own.ravel() for *_, own in blocks]
    places = np.concatenate(rows), np.concatenate(columns)
    return csr_array((np.concatenate(values), places), shape=shape)


def standing_speed(fastest: Array | float, noise: Array | float) -> Array:
    """Return the speed (n,) rad/s below which joints stand.

    It follows from their fastest speed and the noise of the velocity.

    `noise` is a standard deviation. Where the sign of a velocity is not known, that of the dry
    friction is not.
    """
    return np.maximum(np.maximum(SLOW * fastest, STANDS), UNTOLD * noise)


def sticking(t: Array, velocity: Array, standing: Array, around: float = 0.0) -> Mask:
    """Return where joints stick, (N, n): slower than `standing` (n,) rad/s for as long as STICKING.

    t: (N,) s, at one rate, that of the recording: of fewer instants a reversal seems to last
    longer; velocity: (N, n) rad/s, of the motors where there are such.
    """
    if len(t) < 2:
        return np.zeros(velocity.shape, dtype=bool)
    stuck = _lasting(t, np.abs(velocity) < standing)
    count = round(around / (t[1] - t[0]))
    if not count:
        return stuck
    return np.stack(
        [
            binary_dilation(column, iterations=count) if column.any() else column
            for column in stuck.T
        ],
        1,
    )


def _held(t: Array, velocity: Array, band: Band, steps: Array) -> Mask:
    """Return where encoders hold one code for so long that the band shows it, (N, n)."""
    # At a constant speed the error is a sawtooth of one period a step.
    return _lasting(t, np.abs(velocity) < steps * band.cutoff)


def _lasting(t: Array, slow: Mask) -> Mask:
    """Return where joints are slow (N, n) for as long as STICKING."""
    length = np.ones(max(1, round(STICKING / (t[1] - t[0]))))
    return np.stack([binary_opening(column, length) for column in slow.T], axis=1)


def _courses(
    stretch: Stretch,
    band: Band,
    when: Mask,
    bases: dict[FreeTimes, Array],
    known: Mapping[FreeTimes, Array],
) -> list[tuple[slice, FreeTimes | None]]:
    """Return in which rows a torque at certain times (N,) shows, and of which times' basis it is.

    None where it can be anything: in rows that no other time reaches. when: (N,) the times; bases:
    orthonormal (instants, m) of other times of this stretch; those found are added.
    """
    step = float(stretch.quiet.t[1] - stretch.quiet.t[0])
    if not when.any():
        return []
    numbered, _ = label(binary_dilation(when, iterations=max(1, round(AROUND / step))))
    found = []
    for pieces, rows in _clusters(find_objects(numbered), band):
        first = max(rows.start, stretch.kept.start)
        last = min(rows.stop, stretch.kept.stop)
        if first >= last:
            continue
        times = None
        if pieces:
            end = min(max(band.samples(rows).stop, pieces[-1].stop), len(when))
            times = FreeTimes(
                tuple((piece.start, piece.stop) for piece in pieces), end, (first, last), step
            )
            if times not in bases:
                bases[times] = known[times] if times in known else _basis(times, band)
        found.append((slice(first - stretch.kept.start, last - stretch.kept.start), times))
    return found


def _basis(times: FreeTimes, band: Band) -> Array:
    pieces = [slice(*piece) for piece in times.pieces]
    reached = band.reached(pieces[0]).start
    start = band.samples(slice(reached, reached + 1)).start
    first, last = times.rows
    free = [_polynomials(times.end - start, start, piece, times.step, band) for piece in pieces]
    shown = band.apply(np.concatenate(free, axis=1))[first - reached : last - reached]
    left, singular, _ = np.linalg.svd(shown, False)
    # 0.02 of the strongest: courses of a torque that show less in the band are left in
    return np.asarray(left[:, singular > 0.02 * singular[0]])


def _estimate(basis: Array, rows: slice, beside: Indices, noise: Array) -> Array:
    """Return (m, rows + beside) what rows estimate of a torque that is in some of them.

    Noise of encoders grows with its frequency. Cut off at an instant it would be noise of all
    frequencies.

    basis: (rows, m) of the torque; noise: (lags,) autocovariance of the rows' noise.
    """
    instants = np.concatenate([np.arange(rows.start, rows.stop), beside])
    lags = np.abs(instants[:, None] - instants)
    covariance = np.where(lags < len(noise), noise[lags.clip(max=len(noise) - 1)], 0.0)
    covariance[np.diag_indices_from(covariance)] *= 1.0 + JITTER
    columns = np.concatenate([basis, np.zeros((len(beside), basis.shape[1]))])
    weighted = cho_solve(cho_factor(covariance), columns)
    return np.asarray(np.linalg.solve(columns.T @ weighted, weighted.T))


def _clusters(pieces: Sequence[tuple[slice]], band: Band) -> Iterator[tuple[list[slice], slice]]:
    """Yield pieces of samples that reach common rows of the band, with these rows.

    Of a long piece the ends alone, as its inner rows hold nothing else: these come without any
    piece.
    """
    half = len(band.taps) // 2 + 1
    group: list[slice] = []
    first = 0
    for (piece,) in pieces:
        if group and band.reached(piece).start >= (stop := band.reached(group[-1]).stop):
            yield group, slice(first, stop)
            group = []
        first = first if group else max(first, band.reached(piece).start)
        if piece.stop - piece.start > 4 * half:
            inner = band.reached(slice(piece.start + half, piece.stop - half))
            yield [*group, slice(piece.start, piece.start + half)], slice(first, inner.start)
            yield [], inner
            group = [slice(piece.stop - half, piece.stop)]
            first = inner.stop
        else:
            group.append(piece)
    if group:
        yield group, slice(first, band.reached(group[-1]).stop)


def _polynomials(length: int, first: int, piece: slice, step: float, band: Band) -> Array:
    """Return Legendre polynomials (length, m) of samples from `first` on over a piece, null
    outside.

    They are as many as the rows resolve: polynomials of this degree follow any wave up to half the
    kept rate.
    """
    count = piece.stop - piece.start
    degree = min(count - 1, 2 + int(0.5 * np.pi * band.kept_rate * count * step))
    out = np.zeros((length, degree + 1))
    inside = slice(piece.start - first, piece.stop - first)
    out[inside] = legvander(np.linspace(-1.0, 1.0, count), degree) if count > 1 else 1.0
    return out
