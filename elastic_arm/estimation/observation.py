"""The smoothed motion of a recording, and the noise of every channel.

:func:`observe` places the samples on a regular grid, estimates the noise of the encoders (cutoff
w_c of the motion, standard deviations of angles and rates) and passes every channel through the
smoother

    H(w) = 1 / (1 + (w / w_s)^(2 STEEP))

Grid, noise and smoother are those of the identification; only H differs. The residuals are
nonlinear in the smoothed motion, so H must not attenuate their band: an attenuated motion gives
other torques than attenuated torques. The cutoff w_s is 2.2 times that band at high rates. At low
rates it is a third of the sample rate, and a steeper H keeps the images of the sampled response out
of the band. The band itself (:mod:`.band`) is applied afterwards, to every term alike. The *quiet*
motion, from which columns are computed, has w_s = min(w_s, w_c): above w_c the second derivative of
an angle is noise, the same noise as in the residuals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from elastic_arm.arrays import Array, Mask
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.motion import (
    Motion,
    moved_in_time,
    rates_of,
    with_filtered_deflection,
)
from elastic_arm.estimation.noise import (
    SideNoise,
    Telegraph,
    encoder_steps,
    estimate_noise,
)
from elastic_arm.estimation.resampling import Clock, Grid, extended
from elastic_arm.estimation.smoother import Smoother, left_out
from elastic_arm.estimation.torque_noise import NARROWEST_BAND, Readings, torque_level
from elastic_arm.recording import Recording, Samples
from elastic_arm.recording.inspection.torque_spectrum import TorqueSpectrum, torque_spectra
from elastic_arm.recording.sides import Lacking
from elastic_arm.robot import JointController, Robot
from elastic_arm.robot.parts import CONTROLLED

# What each channel that may be late consists of.
CHANNELS = {
    "link_encoder": ("q", "dq", "ddq"),
    "joint_torque": ("tau_J",),
    "motor_torque": ("tau_m",),
    "command": ("r",),
}

SHORTEST = 2.0  # s
# s without samples, up to which the motion is bridged: laws with a memory go on, and no row within
# is looked at.
BRIDGED = 0.5
# Smoother's cutoff over the band of the residuals: at the band's edge 0.2 % is taken of every term.
CUTOFF_OVER_BAND = 2.2
HIGHEST_BAND = 40.0  # Hz; the drives' resonances and what rotors excite lie below
# Sample intervals between two parts of a recording up to which its motion counts as going on.
UNBROKEN = 5.0


@dataclass(frozen=True)
class ChannelNoise:
    """Standard deviations (n,) of the channels' white noise; None where not recorded."""

    q: Array | None  # rad
    dq: Array | None  # rad/s
    theta: Array | None  # rad
    dtheta: Array | None  # rad/s
    tau_J: Array | None  # Nm
    tau_m: Array | None  # Nm


@dataclass(frozen=True)
class Observation:
    """The motion that one recording shows."""

    # smoothed motion of each stretch without holes; within `margin` of its ends only roughly right
    pieces: tuple[Motion, ...]
    # the same, smoothed as far as the encoders' noise requires: what columns are made of
    quiet: tuple[Motion, ...]
    rate: float  # samples per second
    smoother: Smoother  # what all channels passed
    noise: ChannelNoise  # of the channels, before the smoother
    cutoff: float  # Hz up to which accelerations are motion rather than noise
    # source, notes: where it came from, and what had to be assumed
    source: str = ""
    notes: tuple[str, ...] = ()
    # "link", "motor" -> (n,) rad, steps of the encoders; zero where they are finer than their noise
    steps: Mapping[str, Array] = field(
        default_factory=lambda: {"link": np.zeros(1), "motor": np.zeros(1)}
    )
    # "link", "motor" -> noise of coarse encoders that stand; none where empty
    telegraphs: Mapping[str, Telegraph] = field(default_factory=dict)
    # Hz, from which on torques were low-passed before they were recorded; infinite where none was
    torque_band: float = np.inf
    read: Array | None = None  # s at which torques were read, where they are held between
    # "tau_J", "tau_m" -> (n,), by which torques were divided
    gains: Mapping[str, Array] = field(default_factory=dict)
    # (n,) rad/s within which dry friction turns over; as sharply as the velocity's noise lets it be
    # seen when None
    turning: Array | None = None
    # index of a joint -> controller that made its motor torque, which has the noise of its encoder:
    # as described, and at present
    made_by: Mapping[int, JointController] = field(default_factory=dict)
    driven_by: Mapping[int, JointController] = field(default_factory=dict)
    # s, from when to when nothing was recorded
    holes: Array = field(default_factory=lambda: np.empty((0, 2)))
    # equation (LINK, DRIVE or MOTOR), joint, and from when to when (s) a torque acts there that is
    # none of the arm's
    events: tuple[tuple[int, int, float, float], ...] = ()
    _splines: dict[tuple[int, str], list[CubicSpline]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def margin(self) -> float:
        """Seconds at both ends of a piece in which the smoother has seen too little."""
        return self.smoother.lag / self.rate

    @property
    def duration(self) -> float:
        """Seconds of usable motion."""
        return sum(len(piece) for piece in self.pieces) / self.rate

    def corrected(
        self, lags: Mapping[str, Array], gains: Mapping[str, Array], robot: Robot | None = None
    ) -> Observation:
        """Return it with delays of channels and gains of torques removed.

        lags: channel ("link_encoder", "joint_torque", "motor_torque", "command") -> (n,) s; gains:
        "tau_J", "tau_m" -> (n,), recorded / true. Commands are moved to when the drives had them.
        Torques that were made of them are those of the robot's controllers, within the limits that
        they were made with.
        """
        now: dict[int, JointController] = {}
        for i, own in self.made_by.items():
            stated = own if robot is None else robot.joints[i].controller or own
            now[i] = replace(stated.with_firmware_gain(own.firmware_gain), torque=own.torque)
        both = list(zip(self.pieces, self.quiet, strict=True))
        pieces = tuple(self._moved(piece, still, lags, gains, now) for piece, still in both)
        quiet = tuple(self._moved(still, still, lags, gains, now) for _, still in both)
        found = replace(self, pieces=pieces, quiet=quiet, gains=gains, driven_by=now)
        noise: dict[str, Array] = {}
        for name, gain in gains.items():
            std = getattr(self.noise, name)
            if std is not None:
                noise[name] = std / gain
        made = noise.get("tau_m", self.noise.tau_m)
        if made is not None:
            noise["tau_m"] = made * found.scale(len(made))
        return replace(found, noise=replace(self.noise, **noise))

    def _moved(
        self,
        motion: Motion,
        quiet: Motion,
        lags: Mapping[str, Array],
        gains: Mapping[str, Array],
        now: Mapping[int, JointController],
    ) -> Motion:
        """Return a motion whose channels were moved by lags and divided by gains.

        quiet: the quiet motion of the same samples; now: the controllers that make motor torques,
        by joint, in the place of `made_by`.
        """
        changed: dict[str, Any] = {}
        if motion.before is not None:
            before = motion.before if quiet.before is None else quiet.before
            changed["before"] = self._moved(motion.before, before, lags, gains, now)
        for channel, lag in lags.items():
            sign = -1.0 if channel == "command" else 1.0
            for name in CHANNELS[channel]:
                if getattr(motion, name) is not None and np.any(lag):
                    changed[name] = self._at_other_times(motion, name, sign * lag)
        if motion.r is not None and motion.tau_m is not None:
            later = replace(motion, r=changed.get("r", motion.r))
            torque = np.array(changed.get("tau_m", motion.tau_m))
            for i, controller in self.made_by.items():
                made = _followed(now[i], later, i, stated=controller, quiet=quiet)
                torque[:, i] += made - _followed(controller, motion, i)
            changed["tau_m"] = torque
        for name, gain in gains.items():
            torque = changed.get(name, getattr(motion, name))
            changed[name] = None if torque is None else torque / gain
        return replace(motion, **changed)

    def _at_other_times(self, motion: Motion, name: str, later: Array) -> Array:
        """Return a channel (N, n) that each joint had `later` (n,) s after each sample."""
        each = zip(self._splines_of(motion, name), later.tolist(), strict=True)
        return np.stack([moved_in_time(spline, by) for spline, by in each], axis=1)

    def _splines_of(self, motion: Motion, name: str) -> list[CubicSpline]:
        """Return a spline through each joint's samples of a channel; a calibration moves the same
        ones many times."""
        key = (id(motion), name)
        if key not in self._splines:
            self._splines[key] = [
                CubicSpline(motion.t, column) for column in getattr(motion, name).T
            ]
        return self._splines[key]

    def position_spectrum(self, side: str, f: Array) -> Array:
        """Return the noise of smoothed positions of a side at f (F,) Hz: (F, n).

        1 is white noise of 1 rad a sample; side: "link" or "motor".
        """
        position, velocity, crossover = {
            "link": (self.noise.q, self.noise.dq, self.smoother.link_crossover),
            "motor": (self.noise.theta, self.noise.dtheta, self.smoother.motor_crossover),
        }[side]
        if position is None:
            return np.zeros((len(f), len(crossover)))
        gain = self.gain(f)[:, None] ** 2
        w = 2 * np.pi * f[:, None]
        if side in self.telegraphs:
            position = position * np.sqrt(self.telegraphs[side].power(f))
        if velocity is None:
            return gain * position**2
        # Position weighs w_x² / (w_x² + w²), the integral of the velocity the rest.
        alone = np.isinf(crossover)
        both = np.minimum(crossover, 1e9) ** 2 + w**2
        share = np.where(alone, 1.0, crossover**2 / both)
        rest = np.where(alone, 0.0, w / both)
        return gain * ((share * position) ** 2 + (rest * velocity) ** 2)

    def angle_spectra(self, f: Array) -> list[Array]:
        """Return the noise (F, n) of the angles of links and of motors.

        It is that of the encoders that they come from: see :meth:`position_spectrum`.
        """
        spectra = np.hstack([self.position_spectrum(side, f) for side in ("link", "motor")])
        return np.split(spectra @ self.pieces[0].encoders.T, 2, axis=1)

    def torque_spectrum(self, channel: str, f: Array, n: int) -> Array:
        """Noise of a smoothed torque channel at f (F,): (F, n), 1 = white of 1 Nm a sample.

        channel: "tau_J" or "tau_m"; without noise where it was not recorded; f, n: (F,) Hz, and
        number of joints.
        """
        std = {"tau_J": self.noise.tau_J, "tau_m": self.noise.tau_m}[channel]
        return self.gain(f)[:, None] ** 2 * (np.zeros(n) if std is None else std**2)

    def impedance(self, f: Array, n: int) -> NDArray[np.complex128]:
        """Return kp + s kd (F, n) of the controllers that made motor torques.

        The gains are the present ones, but kd keeps its described ratio to kp: otherwise the noise
        model would separate kd from viscous friction.
        """
        found = np.zeros((len(f), n), np.complex128)
        for i, controller in self.made_by.items():
            kp, kd, _ = controller.gains
            found[:, i] = controller.follows_angle * kp + 2j * np.pi * f * kd
        return found * self.scale(n)

    def scale(self, n: int) -> Array:
        """Return present gains over described gains (n,) of controllers.

        Gains of the error of the angle are compared where there are such.
        """
        found = np.ones(n)
        for i, controller in self.made_by.items():
            found[i] = _first_gain(self.driven_by[i]) / _first_gain(controller)
        return found

    def made(self, motion: Motion) -> dict[str, Array]:
        """Return "kp", "kd", the other torque "fed" and that of full duty, "stall", of controllers,
        (N, n) each."""
        if motion.r is None or motion.tau_m is None:
            return {}
        kp, kd, fed, stall = np.zeros((4, *motion.r.shape))
        for i, controller in self.driven_by.items():
            kp[:, i], kd[:, i], _ = controller.gains
            stall[:, i] = controller.stall or 0.0
            fed[:, i] = motion.tau_m[:, i] - _followed(replace(controller, torque=None), motion, i)
        return {"kp": kp, "kd": kd, "fed": fed, "stall": stall}

    def torque_variances(self, n: int) -> dict[str, Array]:
        """Return the variances (n,) of a sample's white noise of tau_J and tau_m, Nm²."""
        still = np.zeros(1)  # Hz
        return {name: self.torque_spectrum(name, still, n)[0] for name in ("tau_J", "tau_m")}

    def gain(self, f: Array) -> Array:
        """Response of the smoother at f (F,) Hz."""
        return 1.0 / (1.0 + (2 * np.pi * f / self.smoother.cutoff) ** (2 * self.smoother.order))

    def with_filtered_deflection(self, quiet: Motion) -> Motion:
        """Return quiet motion without the noise of the encoders in the deflections."""
        f = self._quiet_frequencies
        link = self.position_spectrum("link", f)
        motor = self.position_spectrum("motor", f)
        both = link.any(axis=0) & motor.any(axis=0)
        noise = np.where(both, link + motor, 0.0) * self.quiet_gain(f)[:, None] ** 2
        return with_filtered_deflection(quiet, self.rate, f, noise, self._finer_motors)

    def quiet_link_spectrum(self, f: Array) -> Array:
        """Return the noise (F, n) of the quiet motion's link angles at f (F,) Hz.

        It is that of the finer of a joint's two encoders.
        """
        link, motor = self.angle_spectra(f)
        return np.where(self._finer_motors, motor, link) * self.quiet_gain(f)[:, None] ** 2

    @cached_property
    def _finer_motors(self) -> Mask:
        """Whether the motor's encoder is finer than the link's, where a joint (n,) has both."""
        link = self.position_spectrum("link", self._quiet_frequencies)
        motor = self.position_spectrum("motor", self._quiet_frequencies)
        return motor.any(axis=0) & (motor.mean(axis=0) < link.mean(axis=0))

    @property
    def _quiet_frequencies(self) -> Array:
        """Hz (F,), as far as the quiet motion reaches."""
        # at which the noise of the encoders is known
        return np.linspace(0.0, self._quiet_cutoff, 400)

    def quiet_gain(self, f: Array) -> Array:
        """Response of the further smoothing of the quiet motion at f (F,) Hz."""
        return 1.0 / (1.0 + (f / self._quiet_cutoff) ** (2 * self.smoother.order)) / self.gain(f)

    @property
    def _quiet_cutoff(self) -> float:
        """Hz up to which the quiet motion reaches."""
        return min(self.cutoff, self.smoother.cutoff / (2 * np.pi))


def _first_gain(controller: JointController) -> float:
    """Return the first gain that is not zero; 1 where all are."""
    return next((gain for gain in controller.gains if gain), 1.0)


def _followed(
    controller: JointController,
    motion: Motion,
    i: int,
    *,
    stated: JointController | None = None,
    quiet: Motion | None = None,
) -> Array:
    """Return the torque (N,) Nm that the controller of joint i makes of errors of angle and rate,
    within its limit.

    stated, quiet: the described controller, and the quiet motion of the same samples: what kd
    deviates from its described ratio to kp is applied to the quiet motion. Friction that is
    proportional to the speed acts alike, and of the noise of the speed the two would be told apart
    by it (:meth:`Observation.impedance`).
    """
    angle, rate = _of_motor(motion)
    assert motion.r is not None
    kp, kd, _ = controller.gains
    limit = np.inf if controller.torque is None else controller.torque
    r = motion.r[:, i]
    wanted = controller.follows_rate * rates_of(motion.t, r)
    error = r - controller.follows_angle * angle[:, i]
    felt = error - np.clip(error, -controller.dead_band, controller.dead_band)
    in_ratio = kd
    if stated is not None:
        in_ratio = stated.gains[1] * _first_gain(controller) / _first_gain(stated)
    made = controller.supplied(kp * felt) + in_ratio * (wanted - rate[:, i])
    if quiet is not None:
        _, quiet_rate = _of_motor(quiet)
        made = made + (kd - in_ratio) * (wanted - quiet_rate[:, i])
    return np.clip(made, -limit, limit)


def _of_motor(motion: Motion) -> tuple[Array, Array]:
    """Return angles and rates (N, n) that controllers follow: the motors', the links' without
    these."""
    angle, rate = (motion.q, motion.dq) if motion.theta is None else (motion.theta, motion.dtheta)
    assert angle is not None and rate is not None
    return angle, rate


def _bridged(samples: Samples, clock: Clock) -> tuple[list[Grid], Array]:
    """Return samples on a grid across holes, and from when to when (k, 2) s are those in which an
    arm may do much."""
    placed = clock.place(samples, max(clock.longest_hole, int(BRIDGED * clock.rate)))
    apart = np.diff(samples.t)
    hole = apart * clock.rate > clock.longest_hole + 1.5
    bridged = apart < BRIDGED + 2.0 / clock.rate
    unknown = np.flatnonzero(hole & bridged)
    return placed, np.stack([samples.t[unknown], samples.t[unknown + 1]], axis=1)


def _longest(grids: Sequence[Grid], where: str) -> Grid:
    """Return the longest piece, which has to hold motion."""
    if not grids:
        raise DiagnosisError(
            f"{where} is too short: it has no interval of {SHORTEST:g} s without a gap of"
            f" {BRIDGED:g} s",
            "Record at least 10 s of motion",
        )
    longest = max(grids, key=len)
    if longest.theta is None and longest.q is None:
        raise DiagnosisError(
            f"{where} contains no positions", "Record /motor_states or /joint_states with positions"
        )
    if not longest.moves():
        raise DiagnosisError(
            f"{where} contains no motion", "Record an excitation from `elastic-arm excite`"
        )
    return longest


def observe(recording: Recording, band: float | None = None) -> Observation:
    """Bring a recording on a grid, estimate the noise of its channels and smooth it.

    band: Hz up to which the residuals will be looked at; the widest sensible one when None.

    Raises a DiagnosisError if the recording is too short, stands still, or holds no torque.
    """
    samples = recording.samples()
    where = recording.source or "the recording"
    if samples.tau_J is None and samples.tau_m is None:
        raise DiagnosisError(
            f"{where} contains no torque",
            f"Record the effort of /motor_states, of /joint_states, or both; {CONTROLLED}",
        )
    clock = Clock.of(samples, where)
    placed, holes = _bridged(samples, clock)
    grids = [grid for grid in placed if len(grid) > SHORTEST * grid.rate]
    longest = _longest(grids, where)
    link = _encoder_noise(longest.q, longest.dq, longest.rate)
    motor = _encoder_noise(longest.theta, longest.dtheta, longest.rate)
    designed = Smoother.from_noise(clock.rate, link, motor, recording.n)
    cutoff = designed.cutoff / (2 * np.pi)
    readings = None if samples.read is None else Readings.of(samples.read, clock.rate)
    # Readings that do not follow the motion are compared singly.
    singly = readings is not None and widest_band(readings.rate) < cutoff

    wide = _wide_smoother(designed, recording.n, band or widest_band(clock.rate))
    calm = replace(wide, cutoff=min(wide.cutoff, designed.cutoff))
    # Smoothed less, the motion would fold into the band of the readings.
    smoother = calm if singly else wide
    # Of a part that is shorter the smoother sees too little; without any other it says so.
    least = max(smoother.lag, calm.lag)
    grids = [grid for grid in grids if len(grid) > least] or grids
    span = (0.0, float(samples.t[-1]))
    pieces = _smoothed(grids, smoother, span)
    if singly:
        pieces = _with_recorded_torques(pieces, grids)
    quiet = pieces if calm.cutoff == smoother.cutoff else _smoothed(grids, calm, span)

    spectra = torque_spectra(recording)
    made_by = {recording.joints.index(name): own for name, own in recording.made_by.items()}
    # The noise of a recorded duty is its own.
    made = np.zeros(recording.n, dtype=bool)
    made[[i for i, own in made_by.items() if own.mode != "duty"]] = True
    torques = {
        "tau_J": torque_level(
            grids, "tau_J", spectra.get("link"), readings, singly, made=np.zeros_like(made)
        ),
        "tau_m": torque_level(grids, "tau_m", spectra.get("motor"), readings, singly, made=made),
    }
    noise = _channel_noise(link, motor, torques, samples.lacking)
    steps = {
        "link": encoder_steps(samples.q, noise.q),
        "motor": encoder_steps(samples.theta, noise.theta),
    }
    found = Observation(
        pieces=pieces,
        quiet=quiet,
        rate=clock.rate,
        smoother=smoother,
        noise=noise,
        cutoff=cutoff,
        source=recording.source,
        notes=(*recording.notes, *samples.notes, *_notes(where, clock, placed, grids, holes)),
        steps=steps,
        telegraphs=_telegraphs(longest, link, motor, steps),
        torque_band=_torque_band(spectra, readings),
        read=samples.read if singly else None,
        made_by=made_by,
        driven_by=made_by,
        holes=holes,
    )
    return replace(found, quiet=tuple(found.with_filtered_deflection(piece) for piece in quiet))


def _with_recorded_torques(pieces: Sequence[Motion], grids: Sequence[Grid]) -> tuple[Motion, ...]:
    """Return smoothed motion with the torques as they were recorded."""
    pairs = zip(pieces, grids, strict=True)
    return tuple(replace(piece, tau_J=grid.tau_J, tau_m=grid.tau_m) for piece, grid in pairs)


def _encoder_noise(position: Array | None, rate: Array | None, samples: float) -> SideNoise | None:
    """Return the noise of one side's encoders; None without any. samples: per second."""
    return None if position is None else estimate_noise(position, rate, samples)


def _channel_noise(
    link: SideNoise | None,
    motor: SideNoise | None,
    torques: Mapping[str, Array | None],
    lacking: Lacking,
) -> ChannelNoise:
    """Return the noise of every channel, none at joints that lack it.

    What stands at such a joint is another channel.
    """
    levels = dict(torques)
    levels["q"] = None if link is None else link.position_std
    levels["dq"] = None if link is None else link.velocity_std
    levels["theta"] = None if motor is None else motor.position_std
    levels["dtheta"] = None if motor is None else motor.velocity_std
    for name, level in levels.items():
        if level is not None and lacking:
            there = [(name.removeprefix("d"), joint) not in lacking for joint in range(len(level))]
            levels[name] = np.where(there, level, 0.0)
    return ChannelNoise(**levels)


def _telegraphs(
    longest: Grid, link: SideNoise | None, motor: SideNoise | None, steps: Mapping[str, Array]
) -> dict[str, Telegraph]:
    """Return the noise of coarse encoders that stand, by side."""
    found = {}
    if link is not None and longest.q is not None:
        found["link"] = Telegraph.of(longest.q, steps["link"], link, longest.rate)
    if motor is not None and longest.theta is not None:
        found["motor"] = Telegraph.of(longest.theta, steps["motor"], motor, longest.rate)
    return found


def _wide_smoother(designed: Smoother, n: int, band: float) -> Smoother:
    """Return the smoother for residuals up to `band`, Hz.

    Its crossovers are those of its own cutoff: a noise that is negligible in the narrow band of the
    designed smoother is not in this one.
    """
    steep = designed.steeper(2 * np.pi * CUTOFF_OVER_BAND * band)
    link = designed.link_noise and replace(designed.link_noise, cutoff=steep.cutoff)
    motor = designed.motor_noise and replace(designed.motor_noise, cutoff=steep.cutoff)
    wide = Smoother.from_noise(designed.rate, link, motor, n)
    return replace(wide, cutoff=steep.cutoff, order=steep.order, link_noise=None, motor_noise=None)


def _smoothed(
    grids: Sequence[Grid], smoother: Smoother, span: tuple[float, float]
) -> tuple[Motion, ...]:
    """Smooth each piece. span: begin and end of the recording, s."""
    return tuple(replace(smoother(extended(grid, smoother.lag)), span=span) for grid in grids)


def _torque_band(spectra: Mapping[str, TorqueSpectrum], readings: Readings | None) -> float:
    """Return the Hz up to which all torques were recorded; infinite where nothing limits them."""
    low_passed = min((one.band for one in spectra.values()), default=np.inf)
    read = np.inf if readings is None else widest_band(readings.rate)
    return min(read, max(NARROWEST_BAND, low_passed))


def _notes(
    where: str, clock: Clock, placed: Sequence[Grid], grids: Sequence[Grid], holes: Array
) -> list[str]:
    """Say what had to be assumed of the times of a recording."""
    said = [clock.note] if clock.note else []
    said += left_out(placed, grids)
    if len(holes):
        longest = 1e3 * float(np.ptp(holes, axis=1).max())
        said.append(
            f"gaps of up to {longest:.0f} ms are bridged but give no equations: {len(holes)}"
        )
    return [f"{where}: {words}" for words in said]


def continued(
    first: Observation, rest: Observation, offset: float
) -> tuple[Observation, Observation]:
    """Return the two parts of a recording as one motion that goes on.

    offset: s from the first sample of `first` to that of `rest`.
    """
    end = offset + max(piece.span[1] for piece in rest.pieces if piece.span)
    apart = offset - first.quiet[-1].t[-1] + rest.quiet[0].t[0]
    unbroken = apart < UNBROKEN / rest.rate

    def placed(motion: Motion, begin: float, before: Motion | None = None) -> Motion:
        return replace(motion, span=(-begin, end - begin), before=before)

    def parts(motions: Sequence[Motion]) -> tuple[Motion, ...]:
        head = placed(motions[0], offset, placed(first.quiet[-1], 0.0) if unbroken else None)
        return (head, *(placed(motion, offset) for motion in motions[1:]))

    whole = replace(
        first,
        pieces=tuple(placed(piece, 0.0) for piece in first.pieces),
        quiet=tuple(placed(piece, 0.0) for piece in first.quiet),
    )
    return whole, replace(rest, pieces=parts(rest.pieces), quiet=parts(rest.quiet))


def widest_band(rate: float) -> float:
    """Return the widest band (Hz) that a recording at `rate` allows."""
    return min(HIGHEST_BAND, 0.2 * rate)
