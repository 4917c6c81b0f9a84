"""Stretches in which the drives of an arm ignore their commands: torque is switched off, an
emergency stop, an overload.

Torques m that controllers make of commands act only in drives that are on. The motion needs tau,
the torque of the described arm. In blocks of the recording, at each joint:

    tau = a m + e      the drive follows its commands
    tau = e            it ignores them

    a    median over the blocks of what m explains of tau: gains and masses are not as described,
         and what most of the blocks do is ordinary
    e    what the description lacks, of one size s in both cases

A block counts as one independent value of each joint, with an unknown variance about s² (Student's
t with one degree of freedom), so that a block of an arm has the evidence

    ln p(ignores) - ln p(follows) = sum over joints of ln[(s² + mean (tau - a m)²)
                                                         / (s² + mean tau²)]

A stretch is a run of blocks, at the odds of an event. All joints count together: a single joint
that does not follow may be blocked or too weak, which is an event or an effect.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from elastic_arm.arrays import Array, median_step
from elastic_arm.estimation.motion import Motion
from elastic_arm.estimation.observation import observe
from elastic_arm.evidence.priors import EVENT
from elastic_arm.evidence.runs import Runs, most_probable_runs
from elastic_arm.identification.batch.mounting import described_torques
from elastic_arm.recording import Recording
from elastic_arm.recording.standstill import within
from elastic_arm.robot import Robot

BLOCK = 0.3  # s: drives are not switched off for less
TINY = 1e-12  # Nm², numerical


@dataclass(frozen=True)
class IgnoredCommands:
    """A stretch in which no drive follows its commands."""

    # begin, end: s from the recording's first sample
    begin: float
    end: float
    # joint -> root mean square of the torque made of commands less the one that the motion needs,
    # Nm
    sizes: Mapping[str, float]

    @property
    def words(self) -> str:
        """What is said of it."""
        return (
            f"no joint follows its commands from {self.begin:.1f} to {self.end:.1f} s, as with the"
            " torque switched off; this part is excluded"
        )


def without_ignored_commands(
    recording: Recording, robot: Robot, model: str
) -> tuple[Recording, tuple[IgnoredCommands, ...]]:
    """Return a recording without the stretches in which its drives ignore their commands, and
    these.

    A recording whose torques were measured, or made of the duty, is returned as it is.
    """
    if all(own.mode == "duty" for own in recording.made_by.values()):
        return recording, ()
    pieces = observe(recording).pieces
    found = [blocks for piece in pieces if (blocks := _blocks(piece, robot, model)) is not None]
    if not found:
        return recording, ()
    t, needed, made = (np.concatenate(values) for values in zip(*found, strict=True))
    runs = ignoring(needed, made)
    if not runs:
        return recording, ()
    stretches = []
    for i, j in runs:
        sizes = np.sqrt(np.mean((needed - made)[i:j] ** 2, axis=(0, 1)))
        by_joint = dict(zip(recording.joints, sizes.tolist(), strict=True))
        stretches.append(IgnoredCommands(float(t[i, 0]), float(t[j - 1, 1]), by_joint))
    spans = [(one.begin, one.end) for one in stretches]
    return without(recording, spans), tuple(stretches)


def without(recording: Recording, spans: Sequence[tuple[float, float]]) -> Recording:
    """Return a recording without some stretches, s from its first sample, in order and apart.

    A block before and after is left out, too, as a stretch begins and ends within one.
    """
    limits = np.iinfo(np.int64)
    wider = np.array(spans) + np.array([-BLOCK, BLOCK])
    edges = np.round(1e9 * wider).astype(np.int64).ravel() + recording.start_ns
    kept = np.concatenate([[limits.min], edges, [limits.max]]).reshape(-1, 2)
    return within(recording, kept)


def ignoring(needed: Array, made: Array) -> Runs:
    """Return the most probable runs of blocks, first and the one after the last, whose commands are
    ignored.

    needed, made: (M, samples, n) torques that the motion needs, and that controllers make.
    """
    products = np.sum(needed * made, axis=1)
    powers = np.maximum(np.sum(made**2, axis=1), TINY)
    gain = np.median(products / powers, axis=0)
    follows = np.mean((needed - gain * made) ** 2, axis=1)
    ignores = np.mean(needed**2, axis=1)
    size = np.maximum(np.median(np.minimum(follows, ignores), axis=0), TINY)
    more = np.sum(np.log((size + follows) / (size + ignores)), axis=1)
    count = len(more)
    price = float(-np.log(EVENT) + np.log(count * (count + 1) / 2))
    sums = np.concatenate([[0.0], np.cumsum(more)])
    return most_probable_runs(np.zeros(count), lambda j: sums[j] - sums[:j] - price)


def _blocks(motion: Motion, robot: Robot, model: str) -> tuple[Array, Array, Array] | None:
    """Return when blocks of a motion begin and end (M, 2) s, and the torques (M, samples, n) that
    it needs and that were made; None where it lacks channels or is shorter than a block."""
    torques = described_torques(robot, model, motion)
    length = max(1, round(BLOCK / median_step(motion.t)))
    count = len(motion) // length
    if torques is None or not count:
        return None
    made, moved, pull = torques
    needed = moved + pull @ np.asarray(robot.gravity, dtype=float)
    whole = count * length
    t = motion.t[:whole].reshape(count, length)
    shape = (count, length, robot.n)
    return t[:, [0, -1]], needed[:whole].reshape(shape), made[:whole].reshape(shape)
