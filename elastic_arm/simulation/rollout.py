"""A whole run of a simulated arm as a recording."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.errors import SimulationError, require_kind
from elastic_arm.recording import Recording, Side
from elastic_arm.robot import Robot, require_robot, to_urdf
from elastic_arm.simulation.settings import USUAL, SimulationSettings
from elastic_arm.simulation.simulator import Simulator

# Nearly three hours at 1 kHz; a run is in memory as a whole, some 250 bytes a sample and joint.
MOST_SAMPLES = 10_000_000


class Trajectory(Protocol):
    """A reference motion."""

    @property
    def duration(self) -> float:
        """Length, s."""

    def evaluate(self, t: Array) -> tuple[Array, Array, Array]:
        """Return q, dq, ddq, each (N, n), at times t (N,)."""


def simulate(
    robot: Robot,
    trajectory: Trajectory,
    settings: SimulationSettings = USUAL,
    *,
    duration: float | None = None,
    rng: np.random.Generator | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Recording:
    """Simulate an arm that follows a trajectory, and record it.

    The arm starts with the position and velocity of the trajectory, with its drives deflected by
    gravity. The recording contains the sensor readings, the reference and the description of the
    nominal arm, but no true values.

    Parameters
    ----------
    robot
        The true arm; controller and recording use `nominal` of the settings instead, if given.
    trajectory
        Reference of the motor side, from `load_trajectory` or `excitation.random_trajectories`.
    settings
        Model, effects, sensors, controller, sample rate.
    duration
        s; that of the trajectory when None.
    rng
        Source of all noise.
    progress
        Called with the number of completed samples and their total, about every second of motion.

    Raises
    ------
    SimulationError
        If the simulation diverges, or the settings are invalid.
    EffectError
        If an effect cannot act on this arm.
    RobotError
        If `robot` has another type.
    """
    require_robot(robot)
    if not hasattr(trajectory, "evaluate"):
        kind = type(trajectory).__name__
        raise SimulationError(
            f"trajectory is of type {kind}, which is not a motion",
            "Give the result of load_trajectory.",
        )
    require_kind(
        settings, SimulationSettings, "settings", SimulationError, "Give SimulationSettings(…)."
    )
    seconds = trajectory.duration if duration is None else duration
    if not (np.isfinite(seconds) and seconds > 0):
        raise SimulationError(
            f"the duration is {seconds!r} s", "Give a positive number of seconds."
        )
    rate = settings.rate
    if not (np.isfinite(rate) and rate > 0):
        raise SimulationError(f"the sample rate is {rate!r} Hz", "Give a positive number.")
    if seconds * rate > MOST_SAMPLES:
        raise SimulationError(
            f"{seconds:g} s at {rate:g} Hz are more than {MOST_SAMPLES} samples",
            "Simulate a shorter motion, or fewer samples per second.",
        )
    t = np.arange(round(seconds * rate) + 1) / rate
    q, dq, ddq = trajectory.evaluate(t)
    simulator = Simulator(robot, settings, rng=rng, q0=q[0], dq0=dq[0], duration=seconds)
    block = max(1, round(rate))
    parts = []
    for first in range(0, len(t), block):
        rows = slice(first, first + block)
        parts.append(simulator.follow(q[rows], dq[rows], ddq[rows])[1])
        if progress is not None:
            progress(min(first + block, len(t)), len(t))
    measured = {}
    for name in parts[0]:
        measured[name] = np.concatenate([part[name] for part in parts])
    return record(simulator, t, measured, reference=(q, dq, ddq))


def record(
    simulator: Simulator,
    t: Array,
    measured: dict[str, Array],
    reference: tuple[Array, Array, Array] | None = None,
) -> Recording:
    """Put channels (N, n) at times t (N,), s, into a recording with the sensors' stamps.

    The reference is its q, dq, ddq (N, n); none is recorded when None.
    """
    true_ns = np.round(t * 1e9).astype(np.int64)
    jittered_ns = true_ns + np.round(simulator.sensors.jitter(len(t)) * 1e9).astype(np.int64)
    stamp_ns = np.maximum(jittered_ns, 0)  # a bag has no stamps before zero
    q, dq, tau_J, theta, dtheta, tau_m = measured.values()
    robot = simulator.nominal
    return Recording(
        joints=robot.joint_names,
        link=Side(stamp_ns, position=q, velocity=dq, effort=tau_J if robot.elastic else None),
        motor=Side(stamp_ns, position=theta, velocity=dtheta, effort=tau_m),
        reference=None
        if reference is None
        else Side(true_ns, position=reference[0], velocity=reference[1], acceleration=reference[2]),
        robot_description=to_urdf(robot),
        source="simulation",
    )
