"""How often a history tells of a change, or of an event, that is none. ``python -m
benchmarks.bench_history``.

Each history is of another arm, up to 15 % from its description, with dry friction on every joint,
and of recordings of 8 s of a motion each. In every second one the friction of one joint differs
from some recording on, by 10 to 60 %.
"""

import argparse
import time
from dataclasses import dataclass, replace

import numpy as np

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.history import courses
from elastic_arm.dynamics import build_model
from elastic_arm.effects import Catalogue, parse
from elastic_arm.effects.text import known_effects
from elastic_arm.excitation import MotionLimits, Shape, random_trajectories
from elastic_arm.robot import load_robot
from elastic_arm.sensors import Sensors
from elastic_arm.simulation import SimulationSettings, simulate
from examples.known_arm import varied

LAW = "coulomb_friction"


@dataclass(frozen=True)
class Outcome:
    """What was told of one history."""

    false: int  # changes of what did not change
    events: int
    there: bool  # whether something changed
    right: bool  # whether that was told, at the joint and the recording where it was


def outcome(recordings: int, seed: int) -> Outcome:
    """Simulate a history and ask what changed."""
    rng = np.random.default_rng(seed)
    robot = load_robot(None)
    true = varied(robot, rng)
    names = robot.joint_names
    sizes = np.tile(rng.uniform(3.0, 9.0, robot.n), (recordings, 1))
    joint = int(rng.integers(robot.n))
    first = int(rng.integers(1, recordings))
    if there := bool(seed % 2):
        sizes[first:, joint] *= 1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.6)
    motions = random_trajectories(
        build_model(robot), MotionLimits.of(robot), recordings, rng=rng, shape=Shape(5, 6.0, 1.0)
    )
    runs = []
    for motion, size in zip(motions, sizes, strict=True):
        effects = [parse(f"{LAW}:{j}:torque={s}", robot) for j, s in zip(names, size, strict=True)]
        settings = SimulationSettings(nominal=robot, effects=effects, sensors=Sensors.real())
        runs.append(replace(simulate(true, motion, settings, rng=rng), source=f"run_{len(runs)}"))
    found = diagnose(
        runs, Question(robot, refit=True, given=known_effects([LAW], robot, Catalogue.default()))
    )
    told = [one for one in courses(found) if one.step is not None]
    own = [
        one for one in told if there and one.sized.effect == LAW and one.sized.joint == names[joint]
    ]
    right = any(one.step is not None and one.step.after == first - 1 for one in own)
    return Outcome(len(told) - len(own), len(found.events), there, right)


def main() -> None:
    """Count false alarms over histories, with a line for each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--histories", type=int, default=16)
    parser.add_argument("--recordings", type=int, default=4, help="of each")
    parser.add_argument("--first-seed", type=int, default=50000)
    options = parser.parse_args()
    all_of = []
    for seed in range(options.first_seed, options.first_seed + options.histories):
        began = time.process_time()
        one = outcome(options.recordings, seed)
        all_of.append(one)
        print(f"{seed}: {one}, {time.process_time() - began:.0f} s of processor", flush=True)
    changed = [one for one in all_of if one.there]
    print(
        f"{len(all_of) * options.recordings} recordings: {sum(one.false for one in all_of)} false"
        f" changes, {sum(one.events for one in all_of)} false events;"
        f" {sum(one.right for one in changed)} of {len(changed)} changes told"
    )


if __name__ == "__main__":
    main()
