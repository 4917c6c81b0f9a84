"""What a better model buys: the prototype under feed-forward of each identified model, and where its tool goes.

The feed-forward inverts an elastic model on a periodic motion q_d: the first row of (1) asks for the drive's
deflection delta = theta - q from K delta + D delta' = M q'' + S theta'' + c + c1 + g, which a Fourier transform solves
line by line; S theta'' makes it implicit, so it is repeated until it stands. The second row then is the torque. A weak
controller on the motor side keeps the arm near theta_d.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from elastic_arm.dynamics import Model
from elastic_arm.paper.prototype import Prototype, Run
from elastic_arm.robot.description import Robot

ROUNDS = 6


@dataclass(frozen=True)
class Command:
    """One period on a grid of half steps: motor motion and torque at the harmonic-drive output, each (M, n)."""

    theta: np.ndarray
    dtheta: np.ndarray
    tau_m: np.ndarray


@dataclass(frozen=True)
class Tracking:
    """How well the prototype followed: tool error in mm, joint error in mrad, rms and largest."""

    feedforward: str
    r_tot: float
    tool_rms: float
    tool_max: float
    joint_rms: float
    feedback_rms: float


def invert(model: Model, Psi: np.ndarray, q: tuple[np.ndarray, np.ndarray, np.ndarray], period: float) -> Command:
    """Return the command that drives a model's link along one period of q, dq, ddq (M, n)."""
    n, names = model.n, [parameter.name.rpartition(".")[2] for parameter in model.parameters]
    K, D = (Psi[[k for k, name in enumerate(names) if name == letter]] for letter in ("K", "D"))
    loose = np.where([name in ("K", "D") for name in names], 0.0, Psi)
    omega = 2.0 * np.pi * np.fft.rfftfreq(len(q[0]), period / len(q[0]))[:, None]
    delta = [np.zeros_like(q[0]) for _ in range(3)]
    for _ in range(ROUNDS):
        x, dx, ddx = (np.hstack([link, link + turn]) for link, turn in zip(q, delta, strict=True))
        forces = model.inverse_dynamics(x, dx, ddx, Psi=loose)
        line = np.fft.rfft(forces[:, :n], axis=0) / (K + 1j * omega * D)
        delta = [np.fft.irfft(line * (1j * omega) ** k, len(q[0]), axis=0) for k in range(3)]
    return Command(q[0] + delta[0], q[1] + delta[1], forces[:, n:] + K * delta[0] + D * delta[1])


def nothing(q: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Command:
    """Return the command without a model: the motor is told the link's motion, feedback does the rest."""
    return Command(q[0], q[1], np.zeros_like(q[0]))


def gains(model: Model, frequency: float, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return proportional and derivative gains (n,) for a natural frequency (rad/s) and damping ratio 0.7."""
    n = model.n
    mass = np.diag(model.mass_matrix(np.concatenate([at, at])[None])[0])
    inertia = mass[:n] + mass[n:]
    return inertia * frequency**2, 1.4 * inertia * frequency


def track(
    robot: Robot, command: Command, feedback: tuple[np.ndarray, np.ndarray], duration: float, *, step: float
) -> Run:
    """Drive the prototype with a command (grid of half steps) and the feedback gains."""
    stiffness, damping = feedback
    period = len(command.theta)

    def torque(half: int, theta: np.ndarray, dtheta: np.ndarray) -> np.ndarray:
        k = half % period
        lag, slip = command.theta[k] - theta, command.dtheta[k] - dtheta
        return command.tau_m[k] + stiffness * lag + damping * slip

    return Prototype(robot).actuate(torque, (command.theta[0], command.dtheta[0]), duration, step=step)


def score(
    name: str, r_tot: float, robot: Robot, run: Run, reference: Any, command: Command, settle: float, step: float
) -> Tracking:
    """Compare a run with the reference motion after `settle` seconds."""
    kept = run.t >= settle
    q = reference.evaluate(run.t[kept])[0]
    away = 1e3 * np.linalg.norm(run.tool[kept] - Prototype(robot).tool(q), axis=1)
    joint = 1e3 * (run.q[kept] - q)
    half = np.rint(2.0 * run.t[kept] / step).astype(int) % len(command.tau_m)
    added = run.tau_m[kept] - command.tau_m[half]
    return Tracking(
        name,
        r_tot,
        tool_rms=float(np.sqrt((away**2).mean())),
        tool_max=float(away.max()),
        joint_rms=float(np.sqrt((joint**2).mean())),
        feedback_rms=float(np.sqrt((added**2).mean())),
    )
