"""A recording of an elastic arm without an integrator: periodic motion that meets the equations to
rounding.

The link angles are a finite Fourier series; the motor angles follow from the first row of (1) by
fixed-point iteration with spectral derivatives, the torques from the second row and from the
drive's law.
"""

from collections.abc import Callable

import numpy as np

from elastic_arm.dynamics import Model
from elastic_arm.recording import Recording, Samples, Side
from elastic_arm.robot import Robot

RATE = 1000.0


def derivative(x: np.ndarray, order: int, rate: float) -> np.ndarray:
    """Spectral derivative of whole periods (N, n)."""
    w = 2j * np.pi * np.fft.rfftfreq(len(x), 1.0 / rate)[:, None]
    return np.fft.irfft(np.fft.rfft(x, axis=0) * w**order, len(x), axis=0)


def mean_over_sample(x: np.ndarray, rate: float) -> np.ndarray:
    """Means over the sample interval centred on each sample, of whole periods (N, n)."""
    f = np.fft.rfftfreq(len(x), 1.0 / rate)[:, None]
    return np.fft.irfft(np.fft.rfft(x, axis=0) * np.sinc(f / rate), len(x), axis=0)


def link_motion(
    n: int, t: np.ndarray, period: float, harmonics: int, rng: np.random.Generator
) -> np.ndarray:
    """Random Fourier series (N, n), about 0.5 rad a joint."""
    w = 2 * np.pi / period * np.arange(1, harmonics + 1)
    a, b = rng.standard_normal((2, harmonics, n)) * 0.35 / np.sqrt(harmonics)
    return rng.uniform(-0.5, 0.5, n) + np.sin(np.outer(t, w)) @ a + np.cos(np.outer(t, w)) @ b


def record(
    model: Model,
    rng: np.random.Generator,
    *,
    period: float = 10.0,
    periods: int = 2,
    harmonics: int = 10,
    torque_noise: float = 0.26,
    encoder_noise: float = 0.0,
    velocity_noise: float = 0.0,
    rate: float = RATE,
    Psi: np.ndarray | None = None,
    course: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Samples:
    """Record `periods` periods of a random motion of an elastic arm, with sensors' noise.

    At time t (N,) the motion is where it would else be at `course` (N,).
    """
    n = model.n
    t = np.arange(round(period * rate)) / rate
    q = link_motion(n, t if course is None else course(t), period, harmonics, rng)
    theta, dtheta = motor_motion(model, q, rate, Psi)
    x, dx, ddx = (np.hstack([derivative(q, k, rate), derivative(theta, k, rate)]) for k in range(3))
    tau = model.inverse_dynamics(x, dx, ddx, Psi)
    K, D = springs(model, Psi)
    dq = derivative(q, 1, rate)
    channels = {
        "q": (q, encoder_noise),
        "dq": (dq, velocity_noise),
        "tau_J": (mean_over_sample(K * (theta - q) + D * (dtheta - dq), rate), torque_noise),
        "theta": (theta, encoder_noise),
        "dtheta": (dtheta, velocity_noise),
        "tau_m": (mean_over_sample(tau[:, n:], rate), torque_noise),
    }
    noisy = {
        name: np.tile(values, (periods, 1)) + std * rng.standard_normal((periods * len(t), n))
        for name, (values, std) in channels.items()
    }
    stamps = np.arange(periods * len(t)) / rate
    return Samples(t=stamps, stamp_ns=np.rint(stamps * 1e9).astype(np.int64), **noisy)


def springs(model: Model, Psi: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """K and D of all joints, (n,) each."""
    Psi = model.Psi if Psi is None else Psi
    named = {p.name: value for p, value in zip(model.parameters, Psi, strict=True)}
    joints = [joint.name for joint in model.robot.joints]
    return np.array([named[f"{j}.K"] for j in joints]), np.array([named[f"{j}.D"] for j in joints])


def motor_motion(
    model: Model, q: np.ndarray, rate: float, Psi: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Motor angles and velocities (N, n) that the first row of (1) asks for."""
    n = model.n
    K, _ = springs(model, Psi)
    dq, ddq = derivative(q, 1, rate), derivative(q, 2, rate)
    theta = q.copy()
    for _ in range(12):
        dtheta, ddtheta = derivative(theta, 1, rate), derivative(theta, 2, rate)
        x, dx, ddx = np.hstack([q, theta]), np.hstack([dq, dtheta]), np.hstack([ddq, ddtheta])
        theta = theta + below(40.0, model.inverse_dynamics(x, dx, ddx, Psi)[:, :n] / K, rate)
    return theta, derivative(theta, 1, rate)


def below(frequency: float, x: np.ndarray, rate: float) -> np.ndarray:
    """Whole periods (N, n) without what is faster: there the iteration would blow up rounding, and
    no motion is."""
    spectrum = np.fft.rfft(x, axis=0)
    spectrum[np.fft.rfftfreq(len(x), 1.0 / rate) > frequency] = 0.0
    return np.fft.irfft(spectrum, len(x), axis=0)


def recording_of(
    samples: Samples, robot: Robot, source: str = "test", **changes: Side | None
) -> Recording:
    """Return samples as a recording of an arm, with some of its sides changed."""
    link = Side(samples.stamp_ns, samples.q, samples.dq, samples.tau_J)
    motor = Side(samples.stamp_ns, samples.theta, samples.dtheta, samples.tau_m)
    return Recording(
        robot.joint_names, **{"link": link, "motor": motor, "source": source, **changes}
    )
