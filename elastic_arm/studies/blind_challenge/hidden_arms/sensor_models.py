"""Sensor models of the hidden arms: noise, resolution, jitter, and effects of the sensors
themselves."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import bilinear, lfilter, lfilter_zi

from elastic_arm.arrays import Array
from elastic_arm.recording import Recording, Side
from elastic_arm.recording.sides import Stamps
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import SENSOR_EFFECTS, Fault
from elastic_arm.studies.blind_challenge.hidden_arms.motion import TrueChannels


@dataclass(frozen=True)
class SensorModel:
    """Quality of the sensors."""

    torque_noise: float = 0.26  # standard deviation, Nm, white
    encoder_noise: float = 0.0  # rad, white, both encoders
    encoder_step: float = 0.0  # resolution, rad; 0 for none
    velocity_noise: float = 1e-4  # rad/s, white, both velocity channels
    # standard deviation of the instants at which samples are taken, s; stamps are these instants
    jitter: float = 0.0
    apart: bool = False  # whether motor sides are sampled at instants of their own


def measure(
    course: TrueChannels,
    joints: Sequence[str],
    faults: Sequence[Fault],
    instruments: SensorModel,
    rng: np.random.Generator,
) -> Recording:
    """Return the recording that the sensors make of a course."""
    t = course.t
    taken = _instants(t, instruments.jitter, rng)
    taken_of_motor = _instants(t, instruments.jitter, rng) if instruments.apart else taken
    sensors = [fault for fault in faults if fault.effect in SENSOR_EFFECTS]
    shape = course.q.shape

    def sampled(values: Array, channel: str, taken: Array) -> Array:
        delays = _delays(sensors, channel, shape[1])
        spline = CubicSpline(t, values)
        if not instruments.jitter and not delays.any():
            return values.copy()
        columns = [spline(np.maximum(taken - delay, t[0]))[:, j] for j, delay in enumerate(delays)]
        return np.stack(columns, axis=1)

    q = sampled(course.q, "link_encoder", taken)
    dq = sampled(course.dq, "link_encoder", taken)
    theta = sampled(course.theta, "", taken_of_motor)
    dtheta = sampled(course.dtheta, "", taken_of_motor)
    tau_J = sampled(course.tau_J, "joint_torque", taken)
    tau_m = sampled(course.tau_m, "motor_torque", taken_of_motor)
    torques = {"joint_torque": tau_J, "motor_torque": tau_m}
    for fault in sensors:
        if fault.effect == "gravity_compensation" and course.gravity is not None:
            own = slice(None) if fault.joint is None else fault.joint
            for channel in fault.channels:
                torques[channel][:, own] -= fault.parameters["share"] * course.gravity[:, own]
    _distort(torques, sensors, t)
    for fault in sensors:
        j = fault.joint
        p = fault.parameters
        if fault.effect in ("encoder_offset", "joint_zero"):
            q[:, j] += p["offset"]
            theta[:, j] += p["offset"] if fault.effect == "joint_zero" else 0.0
        elif fault.effect == "encoder_eccentricity":
            angle = q[:, j] + p["phase"]
            dq[:, j] *= 1.0 + p["amplitude"] * np.cos(angle)
            q[:, j] += p["amplitude"] * np.sin(angle)
    noise = instruments
    link = Side(
        _stamps(taken),
        _encoder(q, noise, rng),
        dq + noise.velocity_noise * rng.standard_normal(shape),
        tau_J + noise.torque_noise * rng.standard_normal(shape),
    )
    motor = Side(
        _stamps(taken_of_motor),
        _encoder(theta, noise, rng),
        dtheta + noise.velocity_noise * rng.standard_normal(shape),
        tau_m + noise.torque_noise * rng.standard_normal(shape),
    )
    return Recording(tuple(joints), link=link, motor=motor, source="challenge")


def _instants(t: Array, jitter: float, rng: np.random.Generator) -> Array:
    return t + np.clip(jitter * rng.standard_normal(len(t)), -0.3e-3, 0.3e-3)


def _stamps(taken: Array) -> Stamps:
    return np.round(taken * 1e9).astype(np.int64) + 1_700_000_000_000_000_000


def _distort(torques: dict[str, Array], sensors: Sequence[Fault], t: Array) -> None:
    """Give torque sensors their gains, let them filter, read another load and wander, and give them
    zeros, in place.

    Recorded is gain * true + offset: a gain scales neither the zero of its sensor nor how that
    wanders.
    """
    for fault in sensors:
        channel, _, what = fault.effect.rpartition("_")
        if what == "gain":
            torques[channel][:, fault.joint] *= fault.parameters["gain"]
    for fault in sensors:
        _distort_in_time(torques, fault, t)
    for fault in sensors:
        channel, _, what = fault.effect.rpartition("_")
        if what == "offset" and channel in torques:
            torques[channel][:, fault.joint] += fault.parameters["offset"]


def _distort_in_time(torques: dict[str, Array], fault: Fault, t: Array) -> None:
    """Let a torque channel pass a low-pass, read another joint's load, or wander, in place."""
    p = fault.parameters
    joints = slice(None) if fault.joint is None else slice(fault.joint, fault.joint + 1)
    if fault.effect == "torque_lowpass":
        # The bilinear transform of 1 / (s / w + 1), which is late by 1 / w without half a sample
        # more or less.
        numerator, denominator = bilinear(
            [1.0], [1.0 / (2 * np.pi * p["cutoff"]), 1.0], 1.0 / (t[1] - t[0])
        )
        settled = lfilter_zi(numerator, denominator)
        for values in (torques[channel] for channel in fault.channels):
            before = settled[:, None] * values[0, joints]
            values[:, joints] = lfilter(
                numerator, denominator, values[:, joints], axis=0, zi=before
            )[0]
    elif fault.effect == "torque_drift":
        length = t[-1] - t[0]
        wander = t - t[0] + 0.15 * length * np.sin(2 * np.pi * (t - t[0]) / length)
        torques[str(fault.choices["channel"])][:, joints] += p["rate"] * wander[:, None]
    elif fault.effect == "sensor_crosstalk" and fault.joint is not None:
        other = fault.joint + (1 if fault.joint + 1 < torques["joint_torque"].shape[1] else -1)
        torques["joint_torque"][:, fault.joint] += p["share"] * torques["joint_torque"][:, other]


def _delays(sensors: Sequence[Fault], channel: str, n: int) -> Array:
    delays = np.zeros(n)
    for fault in sensors:
        if fault.effect == "time_delay" and channel in fault.channels:
            delays[slice(None) if fault.joint is None else fault.joint] += fault.parameters["delay"]
    return delays


def _encoder(angle: Array, instruments: SensorModel, rng: np.random.Generator) -> Array:
    angle = angle + instruments.encoder_noise * rng.standard_normal(angle.shape)
    step = instruments.encoder_step
    return np.round(angle / step) * step if step else angle
