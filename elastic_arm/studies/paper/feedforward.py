"""The benefit of a better model: the tool error of the prototype with the feed-forward of each
identified model.

The feed-forward inverts an elastic model on a periodic motion q_d. The first row of (1) requires
the deflection delta = theta - q of the drive, K delta + D delta' = M q'' + S theta'' + c + c1 + g,
which a Fourier transform solves for each harmonic; S theta'' makes it implicit, so it is iterated
until it converges. The second row is then the torque. A weak controller on the motor side keeps the
arm near theta_d.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np

from elastic_arm.arrays import Array, rms
from elastic_arm.dynamics import Model, build_model
from elastic_arm.excitation import FourierTrajectory
from elastic_arm.robot.description import Robot
from elastic_arm.studies.paper.virtual_prototype.prototype import Prototype, dividing_step

ROUNDS = 6


@dataclass(frozen=True)
class Command:
    """One period on a grid of half steps: motor motion and torque, each (M, n).

    At the harmonic-drive output.
    """

    theta: Array
    dtheta: Array
    tau_m: Array


@dataclass(frozen=True)
class FeedforwardLaw:
    """A feed-forward: its name, the ratio it is for, a model and its parameters.

    No torque at all where Psi is None.
    """

    name: str
    r_tot: float
    model: str
    Psi: Array | None


@dataclass(frozen=True)
class Tracking:
    """How well the prototype followed.

    `tool_rms` and `tool_max` are the tool's error, mm; `joints_rms` the part of it that the links'
    angles q make, without the bearings' tilt, mm; `angle_rms` the error of q, mrad; `feedback_rms`
    what the feedback added, Nm. `each` are tool_rms and joints_rms of the motions that were put
    together.
    """

    feedforward: str
    r_tot: float
    tool_rms: float
    tool_max: float
    joints_rms: float
    angle_rms: float
    feedback_rms: float
    each: tuple[tuple[float, float], ...] = ()


def together(runs: Sequence[Tracking]) -> Tracking:
    """Put the same law's runs along several motions together: rms over all, largest of all."""
    values = np.array([astuple(run)[2:-1] for run in runs])
    whole = rms(values)
    whole[1] = values[:, 1].max()
    each = tuple((run.tool_rms, run.joints_rms) for run in runs)
    tool, largest, joints, angle, feedback = map(float, whole)
    return Tracking(
        runs[0].feedforward, runs[0].r_tot, tool, largest, joints, angle, feedback, each
    )


def invert(model: Model, Psi: Array, q: tuple[Array, Array, Array], period: float) -> Command:
    """Return the command that drives a model's link along one period of q, dq, ddq (M, n)."""
    n = model.n
    names = [parameter.name.rpartition(".")[2] for parameter in model.parameters]
    K = Psi[[k for k, name in enumerate(names) if name == "K"]]
    D = Psi[[k for k, name in enumerate(names) if name == "D"]]
    loose = np.where([name in ("K", "D") for name in names], 0.0, Psi)
    omega = 2.0 * np.pi * np.fft.rfftfreq(len(q[0]), period / len(q[0]))[:, None]
    delta = [np.zeros_like(q[0]) for _ in range(3)]
    for _ in range(ROUNDS):
        x, dx, ddx = (np.hstack([link, link + turn]) for link, turn in zip(q, delta, strict=True))
        forces = model.inverse_dynamics(x, dx, ddx, Psi=loose)
        line = np.fft.rfft(forces[:, :n], axis=0) / (K + 1j * omega * D)
        delta = [np.fft.irfft(line * (1j * omega) ** k, len(q[0]), axis=0) for k in range(3)]
    return Command(q[0] + delta[0], q[1] + delta[1], forces[:, n:] + K * delta[0] + D * delta[1])


def gains(model: Model, frequency: float, at: Array) -> tuple[Array, Array]:
    """Return gains kp and kd (n,) for a natural frequency (rad/s) and damping ratio 0.7."""
    n = model.n
    mass = np.diag(model.mass_matrix(np.concatenate([at, at])[None])[0])
    inertia = mass[:n] + mass[n:]
    return inertia * frequency**2, 1.4 * inertia * frequency


def reference(
    n: int, period: float, duration: float, rng: np.random.Generator
) -> FourierTrajectory:
    """Make a motion that no identification saw.

    Three harmonics, at most 0.4 rad from zero per joint and 0.8 rad/s.
    """
    harmonics = 3
    a, b = rng.standard_normal((2, n, harmonics))
    frequency = 2.0 * np.pi / period * np.arange(1, harmonics + 1)
    size = np.hypot(a, b)
    scale = np.minimum(0.8 / size.sum(axis=1), 0.4 / (size / frequency).sum(axis=1))[:, None]
    return FourierTrajectory(
        2.0 * np.pi / period, a * scale, b * scale, np.zeros(n), duration + period
    )


def assess(
    robot: Robot,
    law: FeedforwardLaw,
    reference: FourierTrajectory,
    *,
    frequency: float,
    settle: float,
    step: float,
) -> Tracking:
    """Drive the prototype along a reference under a feed-forward law and compare."""
    period = reference.period
    step = dividing_step(step)
    steps = round(period / step)
    grid = np.linspace(0.0, period, 2 * steps, endpoint=False)
    command = _command(robot, law, reference.evaluate(grid), period)
    stiffness, damping = gains(build_model(robot, "mod3"), frequency, reference.q0)

    def torque(half: int, theta: Array, dtheta: Array) -> Array:
        k = half % len(grid)
        lag = command.theta[k] - theta
        slip = command.dtheta[k] - dtheta
        return command.tau_m[k] + stiffness * lag + damping * slip

    prototype = Prototype(robot)
    start = command.theta[0], command.dtheta[0]
    run = prototype.actuate(torque, start, reference.duration - period, step=step)
    kept = run.t >= settle
    wanted = reference.evaluate(run.t[kept])[0]
    place = prototype.tool(wanted)
    rigid = prototype.tool(run.q[kept])
    sent = command.tau_m[np.rint(run.t[kept] / period * len(grid)).astype(int) % len(grid)]
    away = np.linalg.norm(run.tool[kept] - place, axis=1)
    return Tracking(
        law.name,
        law.r_tot,
        tool_rms=1e3 * float(rms(away, None)),
        tool_max=1e3 * float(away.max()),
        joints_rms=1e3 * float(rms(np.linalg.norm(rigid - place, axis=1), None)),
        angle_rms=1e3 * float(rms(run.q[kept] - wanted, None)),
        feedback_rms=float(rms(run.tau_m[kept] - sent, None)),
    )


def _command(
    robot: Robot, law: FeedforwardLaw, q: tuple[Array, Array, Array], period: float
) -> Command:
    """Invert the law's model along one period; without one, command the link's motion to the motor
    and no torque."""
    if law.Psi is None:
        return Command(q[0], q[1], np.zeros_like(q[0]))
    return invert(build_model(robot, law.model), law.Psi, q, period)
