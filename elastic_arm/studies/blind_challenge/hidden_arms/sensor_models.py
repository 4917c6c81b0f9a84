"""Sensor models of the hidden arms: noise, resolution, jitter, and effects of the sensors themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from elastic_arm.recording import Recording, Side
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import SENSOR_EFFECTS, Fault
from elastic_arm.studies.blind_challenge.hidden_arms.true_channels import TrueChannels


@dataclass(frozen=True)
class SensorModel:
    """Quality of the sensors.

    Parameters
    ----------
    torque_noise
        Standard deviation, Nm, white.
    encoder_noise
        rad, white, both encoders.
    encoder_step
        Resolution, rad; 0 for none.
    velocity_noise
        rad/s, white, both velocity channels.
    jitter
        Standard deviation of the instants at which samples are taken, s; stamps are these instants.
    """

    torque_noise: float = 0.26
    encoder_noise: float = 0.0
    encoder_step: float = 0.0
    velocity_noise: float = 1e-4
    jitter: float = 0.0


def measure(
    course: TrueChannels,
    joints: Sequence[str],
    faults: Sequence[Fault],
    instruments: SensorModel,
    rng: np.random.Generator,
) -> Recording:
    """Return the recording that the sensors make of a course.

    Parameters
    ----------
    course
        The true motion and torques.
    joints
        Names.
    faults
        Effects of the arm; those of its sensors act here.
    instruments
        Quality of the sensors.
    rng
        Of the noise.
    """
    t = course.t
    late = np.clip(instruments.jitter * rng.standard_normal(len(t)), -0.3e-3, 0.3e-3)
    taken = t + late
    sensors = [fault for fault in faults if fault.effect in SENSOR_EFFECTS]
    shape = course.q.shape

    def sampled(values: np.ndarray, channel: str) -> np.ndarray:
        delays = _delays(sensors, channel, shape[1])
        spline = CubicSpline(t, values)
        if not instruments.jitter and not delays.any():
            return values.copy()
        columns = [spline(np.maximum(taken - delay, t[0]))[:, j] for j, delay in enumerate(delays)]
        return np.stack(columns, axis=1)

    q, dq = sampled(course.q, "link_encoder"), sampled(course.dq, "link_encoder")
    theta, dtheta = sampled(course.theta, ""), sampled(course.dtheta, "")
    tau_J, tau_m = sampled(course.tau_J, "joint_torque"), sampled(course.tau_m, "motor_torque")
    for fault in sensors:
        j, p = fault.joint, fault.parameters
        if fault.effect == "motor_torque_gain":
            tau_m[:, j] *= p["gain"]
        elif fault.effect == "joint_torque_gain":
            tau_J[:, j] *= p["gain"]
        elif fault.effect == "motor_torque_offset":
            tau_m[:, j] += p["offset"]
        elif fault.effect == "joint_torque_offset":
            tau_J[:, j] += p["offset"]
        elif fault.effect == "encoder_offset":
            q[:, j] += p["offset"]
        elif fault.effect == "encoder_eccentricity":
            angle = q[:, j] + p["phase"]
            dq[:, j] *= 1.0 + p["amplitude"] * np.cos(angle)
            q[:, j] += p["amplitude"] * np.sin(angle)
    stamps = np.round(taken * 1e9).astype(np.int64) + 1_700_000_000_000_000_000
    noise = instruments
    link = Side(
        stamps,
        _encoder(q, noise, rng),
        dq + noise.velocity_noise * rng.standard_normal(shape),
        tau_J + noise.torque_noise * rng.standard_normal(shape),
    )
    motor = Side(
        stamps,
        _encoder(theta, noise, rng),
        dtheta + noise.velocity_noise * rng.standard_normal(shape),
        tau_m + noise.torque_noise * rng.standard_normal(shape),
    )
    return Recording(tuple(joints), link=link, motor=motor, source="challenge")


def _delays(sensors: Sequence[Fault], channel: str, n: int) -> np.ndarray:
    delays = np.zeros(n)
    for fault in sensors:
        if fault.effect == "time_delay" and channel in fault.channels:
            delays[slice(None) if fault.joint is None else fault.joint] += fault.parameters["delay"]
    return delays


def _encoder(angle: np.ndarray, instruments: SensorModel, rng: np.random.Generator) -> np.ndarray:
    angle = angle + instruments.encoder_noise * rng.standard_normal(angle.shape)
    step = instruments.encoder_step
    return np.round(angle / step) * step if step else angle
