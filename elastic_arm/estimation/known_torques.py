"""The best estimate of the load of each joint, on which the filter of a torque channel acts.

The model predicts the load from accelerations, whose noise grows with the square of the frequency;
the deflection of the drive measures it with the same noise at all frequencies. Below some 10 Hz the
model is more accurate, above it the deflection.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics import Model
from elastic_arm.effects.library.torque_filters import CLEAR, VISIBLE, low_pass_error
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.motion import CompletedMotion, Loads, drive_constants
from elastic_arm.estimation.noise import reduced_to, wiener_filter
from elastic_arm.estimation.observation import Observation
from elastic_arm.estimation.regressors import Signals
from elastic_arm.estimation.residuals import predicted_torques
from elastic_arm.estimation.turnover import FrictionPlace, turned_over

TINY = 1e-300  # numerical


@dataclass(frozen=True, eq=False)
class ActingEffect:
    """An effect that adds to the torques which a model predicts."""

    # feature, searched: what, and its searched parameters
    feature: Feature
    searched: tuple[float, ...]
    coefficients: Array  # (count,) of its columns
    known: bool = True  # whether it acts in every set of terms that is compared
    turned: Array | None = None  # (K,) shares of dry friction that turn over late; None for none

    def torques(self, signals: Signals) -> tuple[Array, Array, Array, Array]:
        """Return what it adds to torques of joint, motor and spring, Nm.

        The last entry is beside the deflection that is read.
        """
        entries = self.feature.entries(self._late(signals), self.searched)
        link, drive, motor = np.split(entries.weighted(self.coefficients), 3, axis=1)
        return link, link + motor, link if self.feature.effect.twist else link - drive, drive

    def _late(self, signals: Signals) -> Signals:
        """Return signals with the sign of the velocity as this friction has it."""
        if self.turned is None:
            return signals
        j = self.feature.equations.robot.joint_names.index(str(self.feature.joint))
        late = {}
        for side in self.feature.sides:
            place = FrictionPlace(str(self.feature.joint), side)
            sign = signals.values[f"sign_{side}"].copy()
            sign[:, j] = turned_over(signals, place, j, self.turned)
            late[f"sign_{side}"] = sign
        return replace(signals, values={**signals.values, **late})


@dataclass(frozen=True)
class KnownTorques:
    """What a model and the effects that act predict along a motion."""

    motion: CompletedMotion  # the quiet motion
    # of that motion, with these torques in the place of the measured ones where laws take the
    # predicted ones
    signals: Signals
    # load, drive: (N, n) Nm, tau_J and tau_m
    load: Array
    drive: Array
    # (N, n) Nm, what the drives carry beside their springs, at the deflection as the encoders read
    # it
    laws: Array
    shares: tuple[
        tuple[Array, Array], ...
    ] = ()  # (N, n) Nm, what each effect adds to tau_J and tau_m


def known_torques(
    model: Model,
    motion: CompletedMotion,
    acting: Sequence[ActingEffect],
    signals_of: Callable[[CompletedMotion], Signals],
    *,
    predicted: bool,
) -> KnownTorques:
    """Return what a model and the effects that act predict along a motion.

    acting: effects that are part of the predicted torques; predicted: whether laws take the torques
    that the model predicts instead of the measured ones.
    """
    load, drive = predicted_torques(model, motion)
    spring = load
    laws = np.zeros_like(load)
    shares = list[tuple[Array, Array]]()
    signals = signals_of(replace(motion, tau_J=load, tau_m=drive) if predicted else motion)
    if acting:
        for effect in acting:
            link, motor, wound, own = effect.torques(signals)
            load = load + link
            drive = drive + motor
            laws = laws + own
            shares.append((link.copy(), motor))  # without the rest of what it is a view of
            # A law that follows the load takes its part of what the drive carries by itself.
            spring = spring + (link if effect.feature.follows_load else wound)
        signals = signals.with_torques(load, drive)
    if predicted and model.robot.elastic:
        signals = signals.wound_by(wound_under(spring, signals.t, model))
    return KnownTorques(motion, signals, load, drive, laws, tuple(shares))


def loads_of(
    model: Model, acting: Sequence[ActingEffect], standstill: tuple[Array, Array]
) -> Loads | None:
    """Return the effects that load the drives beside the model's torques, or None.

    standstill: speeds (n,) below which velocities of links and motors have no sign, rad/s.
    """
    # A regressor of its own, or states, take the motion as a whole; laws of the drive's own are not
    # its load.
    laws = [e for e in acting if e.feature.effect.regressor is None and not e.feature.effect.states]
    laws = [e for e in laws if "link" in e.feature.sides and not e.feature.effect.twist]
    if not laws or not model.robot.elastic:
        return None

    def loads(motion: CompletedMotion) -> Array:
        signals = Signals.of_samples(motion, standstill, elastic=True)
        return np.asarray(sum(effect.torques(signals)[0] for effect in laws))

    return loads


def inertia_of(model: Model, poses: Array, acting: Sequence[ActingEffect]) -> Array:
    """Return what effects that act add to the links' mass matrix (P, n, n) at poses (P, n)."""
    n = model.n
    # A regressor of its own, or states, take the motion as a whole.
    laws = [e for e in acting if e.feature.effect.regressor is None and not e.feature.effect.states]
    laws = [e for e in laws if not e.feature.effect.friction]  # these poses are no path
    if not laws:
        return np.zeros((len(poses), n, n))
    q = np.repeat(poses, n + 1, axis=0)
    ddq = np.tile(np.vstack([np.zeros(n), np.eye(n)]), (len(poses), 1))
    zero = np.zeros_like(q)
    samples = CompletedMotion(
        np.arange(len(q), dtype=float),
        q=q,
        dq=zero,
        ddq=ddq,
        theta=q,
        dtheta=zero,
        ddtheta=ddq,
        tau_J=zero,
        tau_m=zero,
    )
    signals = Signals.of_samples(samples, (np.ones(n), np.ones(n)), elastic=model.robot.elastic)
    load = np.sum([effect.torques(signals)[0] for effect in laws], axis=0)
    own = load.reshape(len(poses), n + 1, n)
    return (own[:, 1:] - own[:, :1]).transpose(0, 2, 1)


def wound_under(torque: Array, t: Array, model: Model) -> Array:
    """Return deflections (N, n) rad of drives under torques (N, n) Nm at times t (N,) s.

    The damper lets a deflection lag behind its torque by D / K. A law of the deflection that
    neglects it, as that of a nonlinear stiffness, would take a part of the damping with it.

    torque: (N, n) Nm; t: (N,) s.
    """
    found = torque.copy()
    for j, (K, D) in enumerate(zip(*drive_constants(model), strict=True)):
        if K > 0.0 and D > 0.0:
            found[:, [j]] += low_pass_error(t, torque[:, [j]], K / (2.0 * np.pi * D))
    return found / drive_constants(model)[0]


def true_load(
    model: Model, observation: Observation, known: KnownTorques, f: Array, noise: Array | None
) -> tuple[Array, Array]:
    """Return each joint's load (N, n) Nm twice: with the least noise, and clear.

    The second one has only the frequencies at which it is far above its noise. That noise is in the
    residuals, too, where torque sensors with more of it do not show it: a law over the load that
    may do what it likes would follow it.

    known: what model and effects predict along the quiet motion, its deflections without the noise
    that shows in their spectra; f, noise: (F,) Hz, and the noise (F, n) of that with angles of the
    finer encoder of each joint, Nm²; 1 is white noise of 1 Nm a sample.
    """
    assert noise is not None
    motion = known.motion
    load = known.load
    K, D = drive_constants(model)
    gain = observation.quiet_gain(f)[:, None] ** 2
    link = observation.position_spectrum("link", f) * gain
    motor = observation.position_spectrum("motor", f) * gain
    measured = K**2 * (link + motor)
    wound = K * (motion.theta - motion.q) + D * (motion.dtheta - motion.dq) + known.laws
    # As far as the deflection shows, the link's angles have the noise of their own encoder, be the
    # motor's the finer.
    predicted = noise * np.maximum(link / np.maximum(observation.quiet_link_spectrum(f), TINY), 1.0)
    both = (K > 0.0) & link.any(axis=0) & motor.any(axis=0)
    share = np.where(both, measured / np.maximum(measured + predicted, TINY), 1.0)
    left = np.where(both, share * predicted, noise)
    found = np.empty_like(load)
    clear = np.empty_like(load)
    for j in range(model.n):
        best = load[:, j]
        if both[j]:
            best = wound[:, j] + reduced_to(
                load[:, j] - wound[:, j], observation.rate, f, share[:, j]
            )
        filtered = wiener_filter(best, observation.rate, f, left[:, j])
        found[:, j] = filtered(VISIBLE)
        clear[:, j] = filtered(CLEAR)
    return found, clear
