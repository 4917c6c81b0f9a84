"""From a recording to smoothed motion and the noise of every channel.

The derivative stage is identification's: grid, noise and smoother are the same, only the smoother's
cutoff is set wide here, because the gap's own band (:mod:`.band`) follows it and takes the same
share from every term.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from elastic_arm.arrays import Array
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.motion import Motion, rates_of, with_filtered_deflection
from elastic_arm.estimation.noise import (
    HIGHEST_CUTOFF,
    ORDER,
    Telegraph,
    encoder_steps,
    estimate_noise,
)
from elastic_arm.estimation.resampling import Clock, Grid, extended, read_at
from elastic_arm.estimation.smoother import Smoother, left_out
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
NARROWEST_BAND = 1.0  # Hz; the motion of an arm is slower than that nowhere
# Of a torque's rms: noise of one that was low-passed, within its band, and of a drive by which a
# torque is made, where nothing shows it; convention.
ORDINARY_NOISE = 0.005


@dataclass(frozen=True)
class ChannelNoise:
    """White noise of the channels, standard deviations per sample, (n,) each; None where not
    recorded."""

    # q, theta: rad
    q: Array | None
    # dq, dtheta: rad/s
    dq: Array | None
    theta: Array | None
    dtheta: Array | None
    # tau_J, tau_m: Nm
    tau_J: Array | None
    tau_m: Array | None


@dataclass(frozen=True)
class Observation:
    """The motion that one recording shows."""

    # smoothed motion of each stretch without holes; within `margin` of its ends only roughly right
    pieces: tuple[Motion, ...]
    quiet: tuple[
        Motion, ...
    ]  # the same, smoothed as far as the encoders' noise requires: what columns are made of
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
    gains: Mapping[str, Array] = field(
        default_factory=dict
    )  # "tau_J", "tau_m" -> (n,), by which torques were divided
    # (n,) rad/s within which dry friction turns over; as sharply as the velocity's noise lets it be
    # seen when None
    turning: Array | None = None
    # index of a joint -> controller that made its motor torque, which has the noise of its encoder:
    # as described, and at present
    made_by: Mapping[int, JointController] = field(default_factory=dict)
    driven_by: Mapping[int, JointController] = field(default_factory=dict)
    holes: Array = field(
        default_factory=lambda: np.empty((0, 2))
    )  # s, from when to when nothing was recorded
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
        """Return it with late channels moved back to the time at which they were true, and torques
        without gain.

        lags: channel ("link_encoder", "joint_torque", "motor_torque", "command") -> (n,) s; gains:
        "tau_J", "tau_m" -> (n,), recorded / true. Commands are moved to when the drives had them.
        Torques that were made of them are those of the robot's controllers, within the limits that
        they were made with.
        """
        now = {
            i: replace(
                own if robot is None else robot.joints[i].controller or own, torque=own.torque
            )
            for i, own in self.made_by.items()
        }

        def moved(motion: Motion) -> Motion:
            changed: dict[str, Any] = {
                "before": None if motion.before is None else moved(motion.before)
            }
            for channel, lag in lags.items():
                sign = -1.0 if channel == "command" else 1.0
                for name in CHANNELS[channel]:
                    if getattr(motion, name) is not None and np.any(lag):
                        changed[name] = np.stack(
                            [
                                spline(np.clip(motion.t + sign * late, motion.t[0], motion.t[-1]))
                                for spline, late in zip(
                                    self._splines_of(motion, name), lag, strict=True
                                )
                            ],
                            axis=1,
                        )
            if motion.r is not None and motion.tau_m is not None:
                later = replace(motion, r=changed.get("r", motion.r))
                changed["tau_m"] = np.array(changed.get("tau_m", motion.tau_m))
                for i, controller in self.made_by.items():
                    changed["tau_m"][:, i] += _followed(now[i], later, i) - _followed(
                        controller, motion, i
                    )
            for name, gain in gains.items():
                torque = changed.get(name, getattr(motion, name))
                changed[name] = None if torque is None else torque / gain
            return replace(motion, **changed)

        noise = {
            name: std / gain
            for name, gain in gains.items()
            if (std := getattr(self.noise, name)) is not None
        }
        pieces, quiet = (tuple(map(moved, motions)) for motions in (self.pieces, self.quiet))
        found = replace(self, pieces=pieces, quiet=quiet, gains=gains, driven_by=now)
        if (made := noise.get("tau_m", self.noise.tau_m)) is not None:
            noise["tau_m"] = made * found.scale(len(made))
        return replace(found, noise=replace(self.noise, **noise))

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
        """Noise of the smoothed position of "link" or "motor" at f (F,) Hz: (F, n), 1 = white of 1
        rad a sample."""
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
        share = np.where(
            np.isinf(crossover), 1.0, crossover**2 / (np.minimum(crossover, 1e9) ** 2 + w**2)
        )
        rest = np.where(np.isinf(crossover), 0.0, w / (np.minimum(crossover, 1e9) ** 2 + w**2))
        return gain * ((share * position) ** 2 + (rest * velocity) ** 2)

    def angle_spectra(self, f: Array) -> list[Array]:
        """Noise of the angles of links and of motors, (F, n), by whichever encoder: see
        :meth:`position_spectrum`."""
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
        """Return kp + s kd (F, n) of the controllers that made motor torques, by the angle that
        they are made of.

        The gains are those at present, but kd in its described ratio to kp: what a joint's friction
        makes of the noise of its angle is no part of the noise either, and kd would explain what
        friction does.
        """
        found = np.zeros((len(f), n), np.complex128)
        for i, controller in self.made_by.items():
            kp, kd, _ = controller.gains
            found[:, i] = kp + 2j * np.pi * f * kd
        return found * self.scale(n)

    def scale(self, n: int) -> Array:
        """Return the present gains (n,) of controllers over the described ones, of the error of the
        angle if any."""
        found = np.ones(n)
        for i, controller in self.made_by.items():
            now, stated = (
                next((gain for gain in one.gains if gain), 1.0)
                for one in (self.driven_by[i], controller)
            )
            found[i] = now / stated
        return found

    def made(self, motion: Motion) -> dict[str, Array]:
        """Return "kp" and "kd" of the controllers that made motor torques, and what else they make,
        "fed", (N, n)."""
        if motion.r is None or motion.tau_m is None:
            return {}
        kp, kd, fed = np.zeros((3, *motion.r.shape))
        for i, controller in self.driven_by.items():
            kp[:, i], kd[:, i], _ = controller.gains
            fed[:, i] = motion.tau_m[:, i] - _followed(replace(controller, torque=None), motion, i)
        return {"kp": kp, "kd": kd, "fed": fed}

    def torque_variances(self, n: int) -> dict[str, Array]:
        """Return the variances (n,) of a sample's white noise of tau_J and tau_m, Nm²."""
        return {
            channel: self.torque_spectrum(channel, np.zeros(1), n)[0]
            for channel in ("tau_J", "tau_m")
        }

    def gain(self, f: Array) -> Array:
        """Response of the smoother at f (F,) Hz."""
        return 1.0 / (1.0 + (2 * np.pi * f / self.smoother.cutoff) ** (2 * ORDER))

    def with_filtered_deflection(self, quiet: Motion) -> Motion:
        """Return quiet motion without the noise of the encoders in the deflections."""
        f = self._quiet_frequencies
        link, motor = self.position_spectrum("link", f), self.position_spectrum("motor", f)
        both = link.any(axis=0) & motor.any(axis=0)
        noise = np.where(both, link + motor, 0.0) * self.quiet_gain(f)[:, None] ** 2
        return with_filtered_deflection(quiet, self.rate, f, noise, self._finer_motors)

    def quiet_link_spectrum(self, f: Array) -> Array:
        """Noise of the quiet motion's link angles at f (F,) Hz: (F, n), that of the finer encoder
        of a joint's two."""
        link, motor = self.angle_spectra(f)
        return np.where(self._finer_motors, motor, link) * self.quiet_gain(f)[:, None] ** 2

    @cached_property
    def _finer_motors(self) -> NDArray[np.bool_]:
        """Whether the motor's encoder is finer than the link's, where a joint (n,) has both."""
        link, motor = (
            self.position_spectrum(side, self._quiet_frequencies) for side in ("link", "motor")
        )
        return motor.any(axis=0) & (motor.mean(axis=0) < link.mean(axis=0))

    @property
    def _quiet_frequencies(self) -> Array:
        """Hz (F,), as far as the quiet motion reaches."""
        return np.linspace(
            0.0, self._quiet_cutoff, 400
        )  # at which the noise of the encoders is known

    def quiet_gain(self, f: Array) -> Array:
        """Response of the further smoothing of the quiet motion at f (F,) Hz."""
        return 1.0 / (1.0 + (f / self._quiet_cutoff) ** (2 * ORDER)) / self.gain(f)

    @property
    def _quiet_cutoff(self) -> float:
        """Hz up to which the quiet motion reaches."""
        return min(self.cutoff, self.smoother.cutoff / (2 * np.pi))


def _followed(controller: JointController, motion: Motion, i: int) -> Array:
    """Return the torque (N,) Nm that the controller of joint i makes of errors of angle and rate,
    within its limit."""
    angle, rate = (motion.q, motion.dq) if motion.theta is None else (motion.theta, motion.dtheta)
    assert motion.r is not None and angle is not None and rate is not None
    (kp, kd, _), r, limit = (
        controller.gains,
        motion.r[:, i],
        np.inf if controller.torque is None else controller.torque,
    )
    of_rate, error = controller.follows_rate * rates_of(motion.t, r) - rate[:, i], r - angle[:, i]
    felt = error - np.clip(error, -controller.dead_band, controller.dead_band)
    return np.asarray(np.clip(kp * felt + kd * of_rate, -limit, limit))


def _bridged(samples: Samples, clock: Clock) -> tuple[list[Grid], Array]:
    """Return samples on a grid across holes, and from when to when (k, 2) s are those in which an
    arm may do much."""
    placed = clock.place(samples, max(clock.longest_hole, int(BRIDGED * clock.rate)))
    apart = np.diff(samples.t)
    unknown = np.flatnonzero(
        (apart * clock.rate > clock.longest_hole + 1.5) & (apart < BRIDGED + 2.0 / clock.rate)
    )
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
    band = band or widest_band(clock.rate)
    link = None if longest.q is None else estimate_noise(longest.q, longest.dq, longest.rate)
    motor = (
        None
        if longest.theta is None
        else estimate_noise(longest.theta, longest.dtheta, longest.rate)
    )
    # 2.2 is the smoother's cutoff over the band: 0.2 % of a term is taken at the band's edge, from
    # all alike
    cutoff = min(2 * np.pi * 2.2 * band, HIGHEST_CUTOFF * clock.rate)
    designed = Smoother.from_noise(clock.rate, link, motor, recording.n)
    # The crossovers are those of the wide band: what is negligible in a narrow one is not in this
    # one.
    wide_link, wide_motor = (
        None if side is None else replace(side, cutoff=cutoff) for side in (link, motor)
    )
    crossing = Smoother.from_noise(clock.rate, wide_link, wide_motor, recording.n)
    every = 1.0 if samples.read is None else float(np.median(np.diff(samples.read))) * clock.rate
    read_band = np.inf if samples.read is None else widest_band(clock.rate / every)
    # Readings that do not follow the motion are compared singly; smoothed less, it would fold into
    # their band.
    read = samples.read if read_band < designed.cutoff / (2 * np.pi) else None
    smoother = Smoother(clock.rate, cutoff, crossing.link_crossover, crossing.motor_crossover)
    smoother = smoother if read is None else replace(smoother, cutoff=min(cutoff, designed.cutoff))
    spectra = torque_spectra(recording)
    made_by = {
        recording.joints.index(name): controller for name, controller in recording.made_by.items()
    }
    levels = {
        "q": link.position_std if link else None,
        "dq": link.velocity_std if link else None,
        "theta": motor.position_std if motor else None,
        "dtheta": motor.velocity_std if motor else None,
        "tau_J": _with_low_pass(
            torque_noise(grids, "tau_J"), longest.tau_J, spectra.get("link"), clock.rate
        ),
        "tau_m": _with_low_pass(
            torque_noise(grids, "tau_m"), longest.tau_m, spectra.get("motor"), clock.rate
        ),
    }
    if made_by and longest.tau_m is not None:
        # What the encoders' noise makes of it is known by the controllers: the rest is the drive's.
        levels["tau_m"] = ORDINARY_NOISE * np.std(longest.tau_m, axis=0)
    pieces = tuple(smoother(extended(grid, smoother.lag)) for grid in grids)
    torque_band = min(
        read_band, max(NARROWEST_BAND, min((one.band for one in spectra.values()), default=np.inf))
    )
    for name in [
        name for name in ("tau_J", "tau_m") if samples.read is not None and levels[name] is not None
    ]:
        level = ORDINARY_NOISE * np.std(getattr(longest, name), axis=0)
        if read is None:  # they reach above the motion
            level = torque_noise([grid[read_at(grid.t, samples.read)] for grid in grids], name)
        levels[name] = level * every**0.5
    if read is not None:
        pieces = tuple(
            replace(p, tau_J=g.tau_J, tau_m=g.tau_m) for p, g in zip(pieces, grids, strict=True)
        )
    noise = ChannelNoise(
        **{name: _of_recorded(level, name, samples.lacking) for name, level in levels.items()}
    )
    # Above the frequency where noise outweighs motion, accelerations are noise, and the same that
    # the residuals hold: a column made of it would be correlated with them.
    calm = replace(smoother, cutoff=min(smoother.cutoff, designed.cutoff))
    quiet = pieces if calm == smoother else tuple(calm(extended(grid, calm.lag)) for grid in grids)
    said = [*([clock.note] if clock.note else []), *left_out(placed, grids)]
    if len(holes):
        longest_hole = 1e3 * float(np.ptp(holes, axis=1).max())
        said.append(
            f"gaps of up to {longest_hole:.0f} ms are bridged but give no equations: {len(holes)}"
        )
    notes = (*recording.notes, *samples.notes, *(f"{where}: {words}" for words in said))
    span = (0.0, float(samples.t[-1]))
    pieces, quiet = (tuple(replace(piece, span=span) for piece in some) for some in (pieces, quiet))
    steps = {
        "link": encoder_steps(samples.q, noise.q),
        "motor": encoder_steps(samples.theta, noise.theta),
    }
    telegraphs = {
        name: Telegraph.of(position, steps[name], side, clock.rate)
        for name, side, position in (("link", link, longest.q), ("motor", motor, longest.theta))
        if side is not None and position is not None
    }
    cutoff, source = designed.cutoff / (2 * np.pi), recording.source
    found = Observation(
        pieces,
        quiet,
        clock.rate,
        smoother,
        noise,
        cutoff,
        source,
        notes,
        steps,
        telegraphs,
        torque_band=torque_band,
        read=read,
        made_by=made_by,
        driven_by=made_by,
        holes=holes,
    )
    return replace(found, quiet=tuple(found.with_filtered_deflection(piece) for piece in quiet))


def _with_low_pass(
    level: Array | None, torque: Array | None, spectrum: TorqueSpectrum | None, rate: float
) -> Array | None:
    """Return the noise (n,) of a torque channel: of what was low-passed, that of an ordinary sensor
    within its band.

    level: (n,) Nm a sample, from frequencies at which a torque that was low-passed holds nothing;
    torque: (N, n) Nm; spectrum: of the channel, if it is long enough to have one.
    """
    if level is None or torque is None or spectrum is None or not spectrum.low_passed.any():
        return level
    knee = np.minimum(np.maximum(spectrum.knee, NARROWEST_BAND), rate / 2)
    ordinary = ORDINARY_NOISE * np.sqrt(np.mean(torque**2, axis=0)) * np.sqrt(0.5 * rate / knee)
    return np.where(spectrum.low_passed, np.maximum(level, ordinary), level)


def _of_recorded(level: Array | None, name: str, lacking: Lacking) -> Array | None:
    """Return noise (n,) of a channel, none where its joint lacks it: what stands there is another
    channel."""
    if level is None or not lacking:
        return level
    there = [(name.removeprefix("d"), joint) not in lacking for joint in range(len(level))]
    return np.where(there, level, 0.0)


def continued(
    first: Observation, rest: Observation, offset: float
) -> tuple[Observation, Observation]:
    """Return the parts of a recording that was cut in two as what they are: one motion that goes
    on.

    offset: s from the first sample of `first` to that of `rest`.
    """
    end = offset + max(piece.span[1] for piece in rest.pieces if piece.span)
    # 5.0 sample intervals between two parts of a recording up to which its motion counts as going
    # on
    unbroken = offset - first.quiet[-1].t[-1] + rest.quiet[0].t[0] < 5.0 / rest.rate

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
    # 0.2 of the sample rate
    return min(40.0, 0.2 * rate)  # 40.0 Hz; the drives' resonances and what rotors excite lie below


def torque_noise(grids: Sequence[Grid], channel: str) -> Array | None:
    """Standard deviation (n,) of a torque channel's white noise, from its spectrum above the
    motion.

    The median over frequency leaves single lines (ripple, mains) aside.
    """
    if getattr(grids[0], channel) is None:
        return None
    levels = []
    for grid in grids:
        values = getattr(grid, channel)
        taper = np.hanning(len(values) - 4)[:, None]
        # Fourth differences keep the motion's spectrum from leaking upward; their response is
        # divided out.
        spectrum = np.abs(np.fft.rfft(np.diff(values, 4, axis=0) * taper, axis=0)) ** 2 / np.sum(
            taper**2
        )
        f = np.fft.rfftfreq(len(taper))
        above = f > 0.2  # of the sample rate; above, torque channels hold noise alone
        flat = spectrum[above] / np.abs(2 * np.sin(np.pi * f[above]))[:, None] ** 8
        levels.append(np.median(flat, axis=0) / np.log(2.0))
    weights = [len(grid) for grid in grids]
    return np.sqrt(np.average(levels, axis=0, weights=weights))
