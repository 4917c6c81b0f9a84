"""Recordings that nothing is wrong with, of rigid arms with ordinary friction and ordinary sensors:
cheap and many."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics import Model, build_model
from elastic_arm.recording import Recording
from elastic_arm.recording.sides import Side
from elastic_arm.robot import Robot
from elastic_arm.robot.description import Limits
from elastic_arm.studies.blind_challenge.hidden_arms.motion import random_motion, random_points
from tests.helpers.random_arms import random_arm

RATES = (100.0, 125.0, 200.0, 250.0, 500.0)  # samples a second of drives
SERVO_RATES = (30.0, 50.0, 100.0)  # of a bus of servos
SECONDS = 20.0
ARMS = 4  # that recordings are drawn of: each is compiled once
TICK = 2 * np.pi / 4096  # rad, of an encoder of 12 bits

Motion = tuple[Array, Array, Array]  # angles, rates, second rates, each (N, n)


@dataclass(frozen=True)
class CleanArm:
    """A rigid arm of six joints with its friction and motors."""

    robot: Robot
    model: Model
    dry: Array  # (n,) Nm
    viscous: Array  # (n,) Nm s/rad
    armature: Array  # (n,) kg m²

    def torques(self, motion: Motion, sharpness: float) -> Array:
        """Return the motors' torques (N, n), Nm; friction turns over within `sharpness`, rad/s."""
        q, dq, ddq = motion
        friction = self.dry * np.tanh(dq / sharpness) + self.viscous * dq
        return np.asarray(self.model.inverse_dynamics(q, dq, ddq) + friction + self.armature * ddq)


@cache
def clean_arm(seed: int) -> CleanArm:
    """Draw an arm; its first axis is vertical, as that of most."""
    rng = np.random.default_rng([seed, 77])
    robot = random_arm(6, rng, elastic=False)
    limits = Limits(position_min=-3.1, position_max=3.1, velocity=3.5, torque=600.0)
    first = robot.joints[0]
    turned = np.eye(4)
    robot = robot.with_(base_placement=np.eye(4)).with_joint(
        first.name, before=turned, after=turned
    )
    for joint in robot.joints:
        robot = robot.with_joint(joint.name, limits=limits)
    size = np.array([1.0, 1.0, 0.6, 0.2, 0.15, 0.07])
    dry, viscous, armature = (
        size * rng.uniform(8.0, 20.0, 6),
        size * rng.uniform(8.0, 25.0, 6),
        size * 3.0,
    )
    return CleanArm(robot, build_model(robot, "mod3", engine="numpy"), dry, viscous, armature)


def sines(rng: np.random.Generator, t: Array) -> Motion:
    """Return an excitation by sums of sines."""
    return random_motion(rng, 6, SECONDS).evaluate(t)


def points(rng: np.random.Generator, t: Array) -> Motion:
    """Return motion from point to point, at rest between."""
    return random_points(rng, 6, SECONDS).evaluate(t)


def creeping(rng: np.random.Generator, t: Array) -> Motion:
    """Return an excitation at a tenth of the speed, of which joints turn round slowly."""
    motion = random_motion(rng, 6, SECONDS).evaluate(0.1 * t + 0.3 * SECONDS)
    return motion[0], 0.1 * motion[1], 0.01 * motion[2]


def one_by_one(rng: np.random.Generator, t: Array) -> Motion:
    """Return motion of one joint after the other, to and fro, while the others stand."""
    q, dq, ddq = (np.zeros((len(t), 6)) for _ in range(3))
    lasting, pose = SECONDS / 6.0, rng.uniform(-1.0, 1.0, 6)
    for j in range(6):
        u = np.clip((t - j * lasting) / lasting, 0.0, 1.0)
        size, rate = rng.uniform(0.2, 0.7), 2 * np.pi / lasting
        # size (1 - cos 2 pi u)² begins and ends without acceleration
        wave, slope = 1.0 - np.cos(2 * np.pi * u), rate * np.sin(2 * np.pi * u)
        q[:, j] = pose[j] + 0.5 * size * wave**2
        dq[:, j] = size * wave * slope
        ddq[:, j] = (
            size * (slope**2 + wave * rate**2 * np.cos(2 * np.pi * u)) * ((u > 0.0) & (u < 1.0))
        )
    return q, dq, ddq


MOTIONS: tuple[Callable[[np.random.Generator, Array], Motion], ...] = (
    sines,
    points,
    creeping,
    one_by_one,
)


def driven(rng: np.random.Generator, name: str) -> tuple[Robot, Recording]:
    """Draw a recording of angles, mostly velocities, and motor torques."""
    arm, rate = clean_arm(int(rng.integers(ARMS))), float(rng.choice(RATES))
    t = np.arange(round(SECONDS * rate)) / rate
    motion = MOTIONS[rng.integers(len(MOTIONS))]
    exact = motion(rng, t)
    effort = arm.torques(exact, float(rng.choice([1e-3, 5e-3, 2e-2])))
    # A drive reports the torque of an instant, or the mean of a cycle.
    if rng.random() < 0.3:
        effort[1:-1] = 0.25 * effort[:-2] + 0.5 * effort[1:-1] + 0.25 * effort[2:]
    largest = np.abs(effort).max(axis=0)
    effort += largest * rng.choice([2e-4, 2e-3, 1e-2]) * rng.normal(size=effort.shape)
    step = float(rng.choice([0.001, 0.01, 0.1]))
    effort = np.round(effort / step) * step
    # A brake, or a drive without a load, reports nothing at rest.
    position, velocity = exact[0], exact[1] + 1e-3 * rng.normal(size=exact[1].shape)
    tick = 2 * np.pi / 2.0 ** rng.choice([13, 17, 20])
    position = np.round(position / tick) * tick
    stamps = np.round(1e9 * t).astype(np.int64) + 1_700_000_000_000_000_000
    speeds = velocity if rng.random() < 0.8 else None
    link, motor = Side(stamps, position, speeds), Side(stamps, effort=effort)
    return arm.robot, Recording(
        arm.robot.joint_names, link, motor, source=f"{motion.__name__} {name}"
    )


def told(rng: np.random.Generator, t: Array) -> Array:
    """Return what a servo arm is told, (N, 4) rad: steps, sums of sines, or a hand that moves and
    rests."""
    kind = rng.integers(3)
    if kind == 0:
        whole = random_motion(rng, 4, SECONDS)
        return np.asarray(whole.evaluate(t)[0])
    ways = random_points(rng, 4, SECONDS)
    if kind == 1:
        return np.asarray(
            ways.points[
                np.clip(np.searchsorted(ways.begins, t, side="right"), 0, len(ways.points) - 1)
            ]
        )
    return np.asarray(ways.evaluate(t)[0])


def servo(rng: np.random.Generator, name: str) -> tuple[None, Recording]:
    """Draw a recording of commands and positions of 12 bits; some within a turn, commands alike."""
    rate = float(rng.choice(SERVO_RATES))
    fine = np.arange(round(SECONDS * 1000.0)) / 1000.0
    command = np.round(told(rng, fine) / TICK) * TICK
    band, lag = rng.choice([0.0, 2.0, 5.0]) * TICK, float(rng.uniform(0.03, 0.08))
    q = command[0].copy()
    rate_of, track = np.zeros_like(q), np.empty_like(command)
    for k, goal in enumerate(command):
        apart = goal - q
        pull = np.where(np.abs(apart) > band, apart, 0.0)
        rate_of += 1e-3 * (pull / lag**2 - 2.0 * rate_of / lag)
        rate_of = np.clip(rate_of, -6.0, 6.0)
        # Gears with friction stand where the controller is content.
        rate_of = np.where((pull == 0.0) & (np.abs(rate_of) < 0.05), 0.0, rate_of)
        q = q + 1e-3 * rate_of
        track[k] = q
    every = round(1000.0 / rate)
    position, given = np.round(track[::every] / TICK) * TICK, command[::every]
    if rng.random() < 0.4:
        turned = float(rng.uniform(2.0, 4.0))
        position, given = (np.mod(one + turned, 2 * np.pi) for one in (position, given))
    stamps = np.round(1e9 * fine[::every]).astype(np.int64)
    names = tuple(f"servo_{j + 1}" for j in range(4))
    return None, Recording(
        names, Side(stamps, position), reference=Side(stamps, given), source=f"servo {name}"
    )


def clean_recordings(count: int, seed: int = 0) -> Iterator[tuple[Robot | None, Recording]]:
    """Yield recordings, and their arm where it is known; two of three hold torques."""
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        yield (driven if k % 3 else servo)(rng, f"{seed}/{k}")
