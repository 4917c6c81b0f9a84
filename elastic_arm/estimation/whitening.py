"""The noise of the residuals, and residuals and columns of regressors whitened by it.

Whitened rows have white noise of variance one, whatever the noise of the channels and however the
equations share it. Half their sum of squares is therefore a negative log-likelihood, and its excess
over the number of rows measures the lack of fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid
from scipy.linalg import block_diag

from elastic_arm.arrays import Array, Indices, Mask
from elastic_arm.dynamics import Model
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.band import Band, LowPass
from elastic_arm.estimation.convolution import (
    CircularGains,
    Harmonics,
    circular_gains,
    filtered_circularly,
    frequencies,
)
from elastic_arm.estimation.effect_columns import Feature, starting_state
from elastic_arm.estimation.equation_sets import EquationSet
from elastic_arm.estimation.known_torques import (
    ActingEffect,
    inertia_of,
    known_torques,
    loads_of,
    true_load,
)
from elastic_arm.estimation.motion import drive_constants, wound_by_load
from elastic_arm.estimation.observation import Observation
from elastic_arm.estimation.regressors import Entries, Signals
from elastic_arm.estimation.residuals import (
    SLOWEST,
    FreeTorques,
    Stretch,
    residuals,
    standing_speed,
)
from elastic_arm.recording.inspection.stuck_channels import STILL

EDGE = 10  # rows at the ends of a stretch that the whitening, being circular, spoils
NOISE_FREQUENCIES = 400
# Part of its noise that each equation is given on its own. Otherwise differences of equations would
# be exact where shared noise cancels (a torque sensor's; an encoder's at a drive's resonance), and
# rounding would look like physics.
FLOOR = 0.1
LEAST = 1e-8  # Nm², of a row without noise; numerical
COLUMNS_KEPT = 400  # of features that follow from the motion alone, of a stretch; memory
# speed within which a sign is uncertain, over the standard deviation of the velocity's noise
OF_SIGN = np.sqrt(np.pi / 2)


@dataclass(frozen=True)
class NoiseModel:
    """Joint noise of all usable rows over frequency, from the noise of the channels.

    The noise of tau_J is common to the three equations (+, +, -), that of an encoder to those it
    enters.
    """

    f: Array  # (F,) Hz, equally spaced from 0 to half the kept rate
    # (F, R, R) complex, Nm²; white noise of 1 Nm a sample is the identity
    covariance: NDArray[np.complex128]
    rate: float  # samples per second of the recording
    # (R, R) combinations of the rows that are made independent, in their order
    # (:attr:`.EquationSet.apart`)
    apart: Array
    # (F, n) of the load that the model predicts for the quiet motion, Nm², in units as `covariance`
    load: Array | None = None
    measure: Array | None = None  # (F,) ln of the determinant of the sensors' part of it
    _whiteners: dict[bytes, NDArray[np.complex128]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _gains: dict[int, CircularGains] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @cached_property
    def density(self) -> Array:
        """Ln of the determinant of the sensors' noise over that of all noise, (F,): how much the
        floors, which are given in Nm, add at these numbers of the arm."""
        assert self.measure is not None
        return np.asarray(self.measure - np.linalg.slogdet(self.covariance)[1])

    def autocovariance(self, band: Band) -> Array:
        """Return that of the rows (lags, R), Nm², at the band's kept rate.

        Beyond the band it is as at its edge.
        """
        power = np.real(np.einsum("frr->fr", self.covariance)).copy()  # else it is a view
        edge = int(np.searchsorted(self.f, band.cutoff))
        power[edge:] = power[edge - 1]
        return np.fft.irfft(power, axis=0)[: len(power)]

    def std(self, low_pass: LowPass) -> Array:
        """Return the standard deviation (R,) of each residual behind a low pass."""
        power = np.real(np.einsum("frr->fr", self.covariance))
        density = power * low_pass.gain(self.f)[:, None] ** 2
        return np.sqrt(trapezoid(density, self.f, axis=0) * 2.0 / self.rate)

    def whitener(self, f: NDArray[Any]) -> NDArray[np.complex128]:
        """Return W (F', R, R) with W covariance W^H = 1 at f (F',) Hz.

        The frequencies are within the band. The result for each f is kept.
        """
        key = f.tobytes()
        if key not in self._whiteners:
            nearest = np.rint(f / (self.f[1] - self.f[0])).astype(int)
            covariance = self.covariance[np.clip(nearest, 0, len(self.f) - 1)]
            factor = np.linalg.cholesky(self.apart @ covariance @ self.apart.T)
            whitener = np.tril(np.linalg.inv(factor)) @ self.apart
            self._whiteners[key] = np.asarray(whitener, dtype=np.complex128)
        return self._whiteners[key]

    def whitening_gains(self, count: int, band: Band) -> CircularGains:
        """Return the gains by which :func:`filtered_circularly` whitens rows.

        They are kept.
        """
        if count not in self._gains:
            f = np.fft.rfftfreq(count, 1 / band.kept_rate)
            gains = self.whitener(f[f <= band.cutoff]) * np.sqrt(band.step)
            self._gains[count] = circular_gains(gains, count, EDGE)
        return self._gains[count]


def noise_models(
    model: Model,
    observation: Observation,
    equations: EquationSet,
    band: Band,
    floors: Sequence[float],
    acting: Sequence[ActingEffect] = (),
    described: Model | None = None,
) -> list[NoiseModel]:
    """Propagate the channels' noise into the usable residuals, for several floors.

    The residuals are linear in the recorded values z = [tau_J, tau_m, q, theta], whose noise has
    the spectra s. The part of accelerations depends on the pose::

        r = (A + w² I) z        C = mean over poses of (A + w² I) diag(s) (A + w² I)^H

    Where arms are compared, A and I are those of the arm as far as the noise is in the quiet
    motion, whose response is H, and beyond it those of the described arm (:func:`.motion_noise`)::

        A = H A_arm + (1 - H) A_described,   I likewise

    equations, band: usable equations, and where they are looked at; floors: shares of the torque
    noise that each equation gets besides, 0 for the noise itself; acting: effects of which loads
    have inertia, too; described: None where nothing is compared.
    """
    n = equations.n
    f = np.linspace(0.0, band.kept_rate / 2, NOISE_FREQUENCIES)
    speed2 = (2 * np.pi * f[:, None, None]) ** 2
    spectrum, made = _channels(observation, f, n)
    arms: list[tuple[Model, Sequence[ActingEffect], Array]] = [(model, acting, np.ones_like(f))]
    if described is not None:
        quiet = observation.quiet_gain(f)
        arms = [(model, acting, quiet), (described, (), 1.0 - quiet)]
    way = np.zeros((len(f), equations.rows, 4 * n), np.complex128)
    inertial = []
    poses = []
    for arm, effects, share in arms:
        own = equations.transform @ _torques_and_springs(arm, observation, f) @ made
        way += share[:, None, None] * own
        poses.append(_inertias(arm, _poses(observation), effects))
        inertial.append((share, equations.transform @ _accelerations(poses[-1]) @ made))
    covariance = _covariance(way, inertial, spectrum, speed2)
    level = _torque_levels(spectrum[:, : 2 * n].mean(axis=0).reshape(2, n).max(axis=0))
    accelerations = (2 * np.pi * f[:, None]) ** 4 * observation.quiet_link_spectrum(f)
    load = accelerations @ np.mean([M**2 for M, _, _ in poses[0]], axis=0)
    measure = np.linalg.slogdet(covariance + LEAST * np.eye(equations.rows))[1]
    found = []
    for floor in floors:
        own = covariance * (1.0 + floor**2 * np.eye(equations.rows))
        own += np.diag(np.tile(floor**2 * level + LEAST, equations.rows // n))
        found.append(NoiseModel(f, own, observation.rate, equations.apart, load, measure))
    return found


def _torques_and_springs(
    model: Model, observation: Observation, f: Array
) -> NDArray[np.complex128]:
    """Return the part A (F, 3 n, 4 n) of the residuals that is the same at all poses.

    Rows are those of link, drive and motor; columns tau_J, tau_m, q and theta.
    """
    n = model.n
    K, D = drive_constants(model)
    drive = np.tile(K + 2j * np.pi * f[:, None] * D, 4)
    impedance = np.tile(observation.impedance(f, n), 4)
    one = np.eye(n)
    zero = np.zeros((n, n))
    none = np.zeros((n, 2 * n))
    torques = np.block([[one, zero, none], [one, zero, none], [-one, one, none]])
    wound = np.block([[none, none], [none, one, -one], [none, none]])
    # A torque that a controller makes has the noise of the angle that it follows.
    fed_back = np.block([[none, zero, zero], [none, zero, zero], [none, zero, -one]])
    return torques + drive[:, None, :] * wound + impedance[:, None, :] * fed_back


def _accelerations(poses: Sequence[tuple[Array, Array, Array]]) -> Array:
    """Return the part I (poses, 3 n, 4 n) of the residuals, by M, S and B at each pose."""
    zero = np.zeros_like(poses[0][0])
    none = np.hstack([zero, zero])
    found = []
    for M, S, B in poses:
        found.append(np.block([[none, M, S], [none, zero, zero], [none, S.T, B]]))
    return np.array(found)


def _covariance(
    way: NDArray[np.complex128],
    inertial: Sequence[tuple[Array, Array]],
    spectrum: Array,
    speed2: Array,
) -> NDArray[np.complex128]:
    """Return the covariance (F, R, R) of the residuals, the mean over poses.

    inertial: shares (F,), and the parts I (poses, R, 4 n) of which they are.
    """
    weighted = way * spectrum[:, None, :]
    covariance = weighted @ way.conj().transpose(0, 2, 1)
    for share, part in inertial:
        mixed = share[:, None, None] * speed2 * (weighted @ part.mean(axis=0).T)
        covariance += mixed + mixed.conj().transpose(0, 2, 1)
    for (share, part), (other_share, other) in product(inertial, repeat=2):
        squares = np.einsum("prc,psc->crs", part, other) / len(part)
        both = (share * other_share)[:, None, None] * speed2**2
        covariance += both * np.tensordot(spectrum, squares, 1)
    return covariance


def _torque_levels(noise: Array) -> Array:
    """Return the noise (n,) of torques in octaves below the largest.

    Joint by joint, as wrists have finer sensors; by octaves, as sensors of a kind count as equal.
    """
    largest = max(float(noise.max()), 1e-12)
    return np.asarray(largest * 2.0 ** np.ceil(np.log2(np.maximum(noise / largest, 1e-9))))


def _poses(observation: Observation) -> Array:
    """Return 12 poses (12, n) along the motion, at which the noise of accelerations is averaged."""
    motion = max(observation.pieces, key=len)
    position = motion.q if motion.q is not None else motion.theta
    assert position is not None
    return position[:: max(1, len(motion) // 12)]


def _inertias(
    model: Model, poses: Array, acting: Sequence[ActingEffect] = ()
) -> list[tuple[Array, Array, Array]]:
    """Return M, S, B at poses (P, n): the way of the encoders' noise changes with the pose."""
    n = model.n
    more = inertia_of(model, poses, acting)
    if not model.robot.elastic:
        none = np.zeros((n, n))
        return [(M, none, none) for M in model.mass_matrix(poses) + more]
    whole = model.mass_matrix(np.hstack([poses, poses]))
    return [(m[:n, :n] + M, m[:n, n:], m[n:, n:]) for m, M in zip(whole, more, strict=True)]


def _channels(observation: Observation, f: Array, n: int) -> tuple[Array, Array]:
    """Return the spectra (F, 4 n) of the noise of tau_J, tau_m, q and theta, and of which recorded
    channels (4 n, 4 n) each is made: what a joint lacks is made of its other encoder, with whose
    noise."""
    torque = [observation.torque_spectrum(channel, f, n) for channel in ("tau_J", "tau_m")]
    position = [observation.position_spectrum(side, f) for side in ("link", "motor")]
    return np.hstack([*torque, *position]), block_diag(
        np.eye(2 * n), observation.pieces[0].encoders
    )


def noise_at(
    poses: Array,
    model: Model,
    observation: Observation,
    equations: EquationSet,
    noise: NoiseModel,
    cutoff: float,
) -> Array:
    """Return the power (P, R) of the whitened noise at poses (P, n), 1 in the mean of the motion.

        1 + mean over f <= cutoff of w⁴ (|I(pose)|² - mean |I|²) s / C

    The noise of accelerations is that of encoders times the inertia, which is many times larger for
    an arm that is stretched out. s, I and C are those of :func:`noise_models`.
    """
    f = noise.f[noise.f <= cutoff]
    spectrum, made = _channels(observation, f, model.n)
    variance = np.real(np.einsum("frr->fr", noise.covariance[: len(f)]))
    accelerations = (2 * np.pi * f[:, None]) ** 4 * spectrum
    weight = np.einsum("fc,fr->rc", accelerations, 1.0 / variance) / len(f)

    def squares(at: Array) -> Array:
        return (equations.transform @ _accelerations(_inertias(model, at)) @ made) ** 2

    more = squares(poses) - squares(_poses(observation)).mean(axis=0)
    return 1.0 + np.einsum("prc,rc->pr", more, weight)


@dataclass(frozen=True)
class Part:
    """One stretch, what makes columns for it, and the number of its recording.

    The shares are what each effect that acts adds to tau_J and tau_m, (N, n) Nm.
    """

    stretch: Stretch
    signals: Signals
    noise: NoiseModel
    gains: Mapping[str, Array]
    recording: int = 0
    shares: tuple[tuple[Array, Array], ...] = ()

    def gain(self, feature: Feature) -> float:
        """Return the gain of the torque channel to which an effect adds; otherwise 1."""
        channel = feature.read_torque
        if channel is None or channel not in self.gains:
            return 1.0
        joint = feature.equations.robot.joint_names.index(str(feature.joint))
        return float(self.gains[channel][joint])

    def thinned(self, entries: Entries) -> Entries:
        """Return entries in the band, at the kept rate."""
        return replace(entries, values=self.stretch.in_band(entries.values))


class NearStretch(NamedTuple):
    """What a stretch has in common with itself beside other numbers of the arm."""

    part: Part | None  # None where only the free torques are known
    free: FreeTorques
    of_motion: dict[object, Entries]  # columns that follow from the motion alone

    def without_noise(self) -> NearStretch:
        """Return it without what follows from the noise: estimates of free torques."""
        return self._replace(free=replace(self.free, estimates={}))

    def without_motion(self) -> NearStretch:
        """Return it with no more than what free torques can be: the rest is large."""
        return NearStretch(None, FreeTorques(bases=self.free.bases), {})


class WhitenedData:
    """All stretches of one or several recordings.

    layout, band: usable equations, and where they are looked at; predicted: whether the laws of
    effects take the torques that the model predicts instead of the measured ones; sticking_removed:
    whether what a joint's friction may be while it sticks is removed; acting: effects that are part
    of the predicted torques; described: the arm whose noise the residuals have, for all arms that
    are compared, and that noise by observation and stretch (:func:`.motion_noise`); None where
    nothing is compared; near: the same stretches beside other numbers of the arm; whole: all
    recordings of which these are a part: the same rows of a part count as sticking.
    """

    def __init__(
        self,
        model: Model,
        observations: Sequence[Observation],
        layout: EquationSet,
        band: Band,
        *,
        predicted: bool = False,
        sticking_removed: bool = False,
        acting: Sequence[ActingEffect] = (),
        described: tuple[Model, Sequence[Sequence[Array]]] | None = None,
        near: Sequence[NearStretch] = (),
        whole: Sequence[Observation] = (),
    ) -> None:
        self.layout = layout
        self.band = band
        self.sticking_removed = sticking_removed
        self.predicted = predicted
        self.acting = tuple(acting)
        self.parts: list[Part] = []
        self.pure: list[NoiseModel] = []
        self._free: list[FreeTorques] = []
        others = iter(one.free for one in near)
        signals_before = iter(None if one.part is None else one.part.signals for one in near)
        moves, fastest = _moving(whole or observations)
        for number, observation in enumerate(observations):
            in_band = band.at(observation.rate)
            first = of_motion = None
            if described is not None:
                first, left = described
                of_motion = left[number]
            noise, pure = noise_models(
                model, observation, layout, in_band, (FLOOR, 0.0), acting, first
            )
            untold = _velocity_noise(observation, noise.f, model.n)
            standstill = _standstill(observation, untold)
            standing = np.where(moves, standing_speed(fastest, untold[1]), 0.0)
            steps = {side: np.where(moves, step, 0.0) for side, step in observation.steps.items()}
            loads = loads_of(model, acting, standstill)
            for stretch in residuals(model, observation, layout, in_band, loads, of_motion):
                signals_of = partial(
                    Signals.of,
                    standstill=standstill,
                    elastic=model.robot.elastic,
                    cutoff=observation.cutoff,
                    predicted=predicted,
                    smoother=observation.smoother,
                    made=observation.made(stretch.quiet),
                    near=next(signals_before, None),
                )
                motion = stretch.quiet
                if layout.reads_torque_by_deflection:
                    motion = wound_by_load(model, motion, loads)
                known = known_torques(model, motion, acting, signals_of, predicted=predicted)
                load, clear = true_load(model, observation, known, noise.f, noise.load)
                drive = load + known.drive - known.load
                signals = known.signals.with_model_torques(
                    load, drive, clear, observation.torque_variances(model.n)
                )
                part = Part(stretch, signals, noise, observation.gains, number, known.shares)
                self.parts.append(part)
                self.pure.append(pure)
                free = FreeTorques.of(
                    stretch,
                    in_band,
                    layout,
                    steps,
                    observation.holes,
                    observation.events,
                    friction=sticking_removed,
                    standing=standing,
                    near=next(others, None),
                    noise=noise.autocovariance(in_band),
                )
                self._free.append(free)
        if not self.parts:
            sources = ", ".join(one.source or "the recording" for one in observations)
            raise DiagnosisError(
                f"too little motion of {sources} remains after filtering",
                "Record longer without gaps",
            )
        # columns of each stretch that follow from the motion alone
        self._of_motion: list[dict[object, Entries]] = [{} for _ in self.parts]
        self._take_columns_of(near)
        self.y = self.weighted([part.stretch.values for part in self.parts])
        self.white = self.whiten([y[:, :, None] for y in self.y])[:, 0]

    def weighted(self, columns: Sequence[Array], *, in_place: bool = False) -> list[Array]:
        """Return columns (N', R, …) without torques that no law states.

        The result may be written into the same arrays.
        """
        return [
            free.remove(values, in_place=in_place)
            for values, free in zip(columns, self._free, strict=True)
        ]

    def shares(self) -> list[Array]:
        """Return the share (N', R) of noise power that is left of each stretch."""
        each = zip(self.parts, self._free, self.y, strict=True)
        return [free.shares(len(y), y.shape[1], part.stretch.band) for part, free, y in each]

    @property
    def seconds(self) -> float:
        """Duration of the rows."""
        return sum(len(part.stretch.t) / part.stretch.band.kept_rate for part in self.parts)

    @property
    def stretches(self) -> list[NearStretch]:
        """What data beside other numbers may take from each stretch."""
        each = zip(self.parts, self._free, self._of_motion, strict=True)
        return [NearStretch(*one) for one in each]

    def _take_columns_of(self, near: Sequence[NearStretch]) -> None:
        """Take the columns of stretches that have the same motion and the same free torques, in the
        same memory."""
        each = zip(self.parts, self._free, near, strict=False)
        for k, (part, free, other) in enumerate(each):
            if other.part is None or not free.is_same_as(other.free):
                continue
            if part.signals.shares_motion(other.part.signals):
                self._of_motion[k] = other.of_motion

    def plain(self, feature: Feature, searched: Sequence[float] = ()) -> list[Array]:
        """Return a feature's columns (N', R, count) in the band, one array a stretch.

        What follows from the motion alone is made once for all numbers of the arm.
        """
        return self.plain_at(feature, [searched])

    def plain_at(self, feature: Feature, points: Sequence[Sequence[float]]) -> list[Array]:
        """Return a feature's columns (N', R, points x count) at several points of its nonlinear
        numbers, side by side: what treats them all at once is faster."""
        return [self._plain_of(k, feature, points) for k in range(len(self.parts))]

    def _plain_of(self, k: int, feature: Feature, points: Sequence[Sequence[float]]) -> Array:
        """Return a feature's columns of stretch k without torques that no law states."""
        made = self._of_motion[k]
        keys = [(type(feature), feature.key, tuple(point)) for point in points]
        new = [key for key in keys if key not in made]
        if not new:
            return np.concatenate([made[key].dense() for key in keys], axis=2)
        if len(new) < len(keys):
            each = [self._plain_of(k, feature, [point]) for point in points]
            return np.concatenate(each, axis=2)
        columns = self._in_band_of(k, feature, points)
        columns = self._free[k].remove(columns, in_place=True)
        if feature.of_motion and len(made) < COLUMNS_KEPT:
            each = np.split(columns, len(keys), axis=2)
            made.update(zip(keys, map(Entries.of, each), strict=True))
        return columns

    def _in_band_of(self, k: int, feature: Feature, points: Sequence[Sequence[float]]) -> Array:
        """Return a feature's columns in stretch k."""
        part = self.parts[k]
        starts = [self._start(k, feature, point) for point in points]
        columns = self.in_band(part, feature.entries_at(part.signals, points, starts))
        gain = part.gain(feature)
        return columns if gain == 1.0 else columns / gain

    def _start(self, k: int, feature: Feature, searched: Sequence[float]) -> float:
        """Return where the internal states of an effect begin in stretch k, where the motion before
        is not known."""
        part = self.parts[k]
        if not feature.effect.states or part.signals.before is not None:
            return 0.0
        size = 1.0 if feature.fixed else None
        columns = lambda at: self.in_band(part, feature.entries(part.signals, searched, at))  # noqa: E731
        return starting_state(self.y[k], columns, size)

    def in_band(self, part: Part, columns: Array | Entries) -> Array:
        """Filter columns (N, 3 n, k) to the usable equations in the band, (N', R, k)."""
        entries = columns if isinstance(columns, Entries) else Entries.of(columns)
        # Fewer samples first: filter and combination commute.
        return part.thinned(entries).combined(self.layout.transform)

    def whiten(self, columns: Sequence[Array]) -> Array:
        """Whiten columns (N', R, k) of all stretches into rows (rows, k).

        All rows of the first residual come first, slow ones first.

        Rows are harmonics. Equations are made independent in their order: null before the first in
        which it shows.
        """
        gains = [
            part.noise.whitening_gains(len(values), part.stretch.band)
            for values, part in zip(columns, self.parts, strict=True)
        ]
        if len(columns) == 1:
            together = filtered_circularly(columns[0], gains[0])
        else:
            _, rows, count = columns[0].shape
            together = np.empty((count, rows, len(self._order)))
            for values, own, places in zip(columns, gains, self._places, strict=True):
                together[:, :, places] = filtered_circularly(values, own)
        return together.reshape(len(together), -1).T  # each column stands in memory as a whole

    @cached_property
    def _of_each(self) -> list[Array]:
        """Frequencies of the rows of one residual, of each stretch, Hz."""
        each = zip(self.parts, self.harmonics, strict=True)
        return [np.repeat(frequencies(own, part.stretch.band.kept_rate), 2) for part, own in each]

    @cached_property
    def _order(self) -> Indices:
        return np.argsort(np.concatenate(self._of_each), kind="stable")

    @cached_property
    def _places(self) -> list[Indices]:
        """Where the rows of one residual of each stretch are among those of all."""
        ends = np.cumsum([len(own) for own in self._of_each])[:-1]
        return np.split(np.argsort(self._order), ends)

    @property
    def frequencies(self) -> Array:
        """Frequencies of the whitened rows of one residual, Hz; they ascend."""
        return np.concatenate(self._of_each)[self._order]

    def of_stretches(self, values: Sequence[Any] | Array) -> NDArray[Any]:
        """Return a value of each stretch at the whitened rows of one residual."""
        return np.repeat(values, [len(own) for own in self._of_each])[self._order]

    @property
    def density(self) -> float:
        """Ln of the density of the recorded values, in the noise of the sensors, over that of the
        rows.

        Through the floors of the noise it depends on the linearisation.
        """
        found = 0.0
        for part, own in zip(self.parts, self.harmonics, strict=True):
            f = frequencies(own, part.stretch.band.kept_rate)
            found += float(np.interp(f, part.noise.f, part.noise.density).sum())
        return found

    @property
    def harmonics(self) -> list[Harmonics]:
        """As which whitened rows stand, of each stretch."""
        stretches = ((part.noise, part.stretch) for part in self.parts)
        return [noise.whitening_gains(len(own.t), own.band).harmonics for noise, own in stretches]


def _moving(observations: Sequence[Observation]) -> tuple[Mask, Array]:
    """Return which joints (n,) move anywhere, and their highest speeds (n,) rad/s, by the motors
    where there are such.

    All that is known of the torque of one that does not is what it is at rest.
    """
    quiet = [piece for one in observations for piece in one.quiet]
    sides = [(p.theta, p.dtheta) if p.theta is not None else (p.q, p.dq) for p in quiet]
    found = [
        (a.min(axis=0), a.max(axis=0), np.abs(v).max(axis=0))
        for a, v in sides
        if a is not None and v is not None
    ]
    low, high, fastest = (np.array(column) for column in zip(*found, strict=True))
    return high.max(axis=0) - low.min(axis=0) >= STILL, fastest.max(axis=0)


def _velocity_noise(observation: Observation, f: Array, n: int) -> tuple[Array, Array]:
    """Return the standard deviations (n,) of the noise of links' and motors' velocities up to half
    the kept rate, rad/s."""
    speed2 = (2 * np.pi * f[:, None]) ** 2
    found = []
    for spectrum in observation.angle_spectra(f):
        power = (speed2 * spectrum).sum(axis=0) * (f[1] - f[0]) * 2 / observation.rate
        found.append(np.sqrt(power) * np.ones(n))
    return found[0], found[1]


def _standstill(observation: Observation, noise: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the speeds s (n,) of links and motors within which the sign of a velocity is
    uncertain, rad/s.

    noise: standard deviations (n,) of the velocities of links and motors in the compared band,
    rad/s. Those of the quiet motion are smaller; friction of real joints reverses less sharply than
    they would show.

    The mean sign of a velocity w with Gaussian noise sigma is erf(w / (sqrt(2) sigma)); tanh(w / s)
    has the same slope at zero where s = sqrt(pi / 2) sigma. A larger s underestimates the friction
    of slow motion, which then looks like Stribeck friction.
    """
    turning = SLOWEST if observation.turning is None else observation.turning
    link, motor = (np.maximum(np.maximum(OF_SIGN * std, SLOWEST), turning) for std in noise)
    return link, motor
