"""How often the intervals of `identify` hold the truth. ``python -m benchmarks.bench_coverage``.

Each recording is of another random motion and another arm, whose masses, inertias, springs and
dampers differ from the description by up to 15 %. Counted is, parameter by parameter, how often the
true value lies within 1.96 standard deviations of the estimate: over all recordings, and over those
in which the parameter is called "well" determined.
"""

import argparse
import math
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.stats import binom

from elastic_arm.dynamics import build_model
from elastic_arm.errors import IdentificationError
from elastic_arm.excitation import MotionLimits, Shape, random_trajectories
from elastic_arm.identification import IdentificationSettings, identify
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot, load_robot
from elastic_arm.sensors import Encoder, Sensors
from elastic_arm.simulation import SimulationSettings, simulate
from examples.known_arm import true_values, varied

SECONDS = (5.0, 9.0, 20.0, 60.0)
NOISES = (0.0, 1e-6, 1e-5, 1e-4)
# A velocity channel's noise over that of its encoder, 1/s.
VELOCITY_NOISE = 100.0
INTERVAL = 1.96
WANTED = 0.93
# A share so far below what is wanted is no accident of so few recordings.
CHANCE = 0.01
FEWEST = 20


@dataclass(frozen=True)
class Outcome:
    """One recording: errors over standard deviations (B,), and which parameters are called "well"
    (B,)."""

    names: tuple[str, ...]
    z: np.ndarray
    well: np.ndarray


def record(robot: Robot, seconds: float, noise: float, seed: int) -> tuple[Recording, Robot]:
    """Record an arm that differs from the description along a random motion; return it with the
    true arm.

    Parameters
    ----------
    robot
        The description.
    seconds
        Of motion.
    noise
        Of the encoders, rad.
    seed
        Of arm, motion and sensors: the same for all noises.
    """
    rng = np.random.default_rng(seed)
    true = varied(robot, rng)
    shape = Shape(period=min(10.0, seconds), periods=math.ceil(seconds / 10.0))
    motion = random_trajectories(
        build_model(robot), MotionLimits.of(robot), 1, rng=rng, shape=shape
    )[0]
    encoder = Encoder(noise=noise, velocity_noise=VELOCITY_NOISE * noise)
    sensors = Sensors(link_encoder=encoder, motor_encoder=encoder)
    recorded = simulate(
        true,
        motion,
        SimulationSettings(nominal=robot, sensors=sensors, substeps=4),
        duration=seconds,
        rng=rng,
    )
    return recorded, true


def outcome(seconds: float, noise: float, seed: int) -> Outcome | None:
    """Identify one recording and compare it with the truth; None where it is refused."""
    robot = load_robot(None)
    recorded, true = record(robot, seconds, noise, seed)
    try:
        result = identify(recorded, robot, IdentificationSettings(consistent=False))
    except IdentificationError as error:
        print(f"  seed {seed} is refused: {error}", flush=True)
        return None
    z = (result.Psi_base - true_values(result, true)) / np.maximum(result.std, 1e-300)
    well = np.array([estimate.verdict == "well" for estimate in result.estimates])
    return Outcome(tuple(e.name for e in result.estimates), z, well)


def share(hits: np.ndarray) -> float:
    """Return the share of hits; NaN where there is nothing."""
    return float(hits.mean()) if hits.size else math.nan


def report(seconds: float, noise: float, outcomes: Sequence[Outcome]) -> None:
    """Print one line, and a line for each parameter whose intervals hold the truth too seldom."""
    z = np.array([each.z for each in outcomes])
    well = np.array([each.well for each in outcomes])
    held = np.abs(z) < INTERVAL
    of_well = [
        share(held[well[:, k], k]) if well[:, k].sum() >= FEWEST else math.nan
        for k in range(z.shape[1])
    ]
    least = float(np.nanmin(of_well)) if np.isfinite(of_well).any() else math.nan
    print(
        f"  {seconds:4.0f} s, {noise:6.0e} rad: all {share(held):.3f}; called well"
        f" {share(held[well]):.3f} ({100 * well.mean():3.0f} % are), least of one parameter"
        f" {least:.3f}, largest error {np.abs(z[well]).max(initial=0.0):.1f} std",
        flush=True,
    )
    for k, name in enumerate(outcomes[0].names):
        count = int(well[:, k].sum())
        if count >= FEWEST and of_well[k] < WANTED:
            chance = binom.cdf(round(of_well[k] * count), count, WANTED)
            mark = "too few" if chance < CHANCE else "within chance"
            mean = z[well[:, k], k].mean()
            spread = z[well[:, k], k].std()
            print(
                f"      {name}: {of_well[k]:.3f} of {count} ({mark}); mean {mean:+.2f}, spread"
                f" {spread:.2f}",
                flush=True,
            )


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--seconds", type=float, nargs="*", default=list(SECONDS))
    parser.add_argument(
        "--noise", type=float, nargs="*", default=list(NOISES), help="of the encoders, rad"
    )
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--save", help="npz file for errors and verdicts, to look into")
    arguments = parser.parse_args()
    print(
        f"{arguments.recordings} recordings each; shares of 95 % intervals that hold the truth"
        f" (wanted {WANTED})"
    )
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.recordings)
    started = time.perf_counter()
    kept = {}
    with ProcessPoolExecutor(arguments.workers) as pool:
        for seconds in arguments.seconds:
            for noise in arguments.noise:
                tried = pool.map(partial(outcome, seconds, noise), seeds)
                outcomes = [each for each in tried if each is not None]
                report(seconds, noise, outcomes)
                kept[f"z_{seconds:g}_{noise:g}"] = np.array([each.z for each in outcomes])
                kept[f"well_{seconds:g}_{noise:g}"] = np.array([each.well for each in outcomes])
    print(f"{time.perf_counter() - started:.0f} s")
    if arguments.save:
        np.savez(arguments.save, names=np.array(outcomes[0].names), **kept)


if __name__ == "__main__":
    main()
