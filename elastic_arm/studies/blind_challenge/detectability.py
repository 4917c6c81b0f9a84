"""How large an effect must be for theory to allow its detection, on an item's own motion and with its own sensors.

The hidden arm is simulated with and without the effect, and both motions are looked at as the diagnosis does, through
exact sensors. The whitened distance of the two sets of residuals is the effect's size over its Cramér-Rao bound, all
other numbers known: with white noise of variance one, a size s that moves the residuals by r can be known to s / |r|.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS
from elastic_arm.errors import EffectError, SimulationError
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.equations import EquationSet
from elastic_arm.estimation.observation import observe, widest_band
from elastic_arm.estimation.resampling import Clock
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.robot import Robot
from elastic_arm.studies.blind_challenge.effect_sampling import SampledEffect
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from elastic_arm.studies.blind_challenge.hidden_arms.motion import MultiSine
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel, measure
from elastic_arm.studies.blind_challenge.hidden_arms.true_channels import TrueChannels
from elastic_arm.studies.blind_challenge.simulated_arm import Arm, arm_maker

Array = NDArray[np.float64]

EXACT = SensorModel(torque_noise=0.0, velocity_noise=0.0)
ROUNDS = 4  # corrections of a size whose law is not linear
NEAR = 0.03  # of the wanted distance


@dataclass(frozen=True)
class EffectSignal:
    """What an effect does to the residuals.

    Parameters
    ----------
    distance
        Norm of the whitened change: the size over its bound.
    excess
        Mean square of the change, summed over all residuals, Nm².
    """

    distance: float
    excess: float


class Detectability:
    """Distances of hidden arms from the plain one on one motion.

    Parameters
    ----------
    robot, motion
        The plain arm, and what all arms do.
    instruments
        Their noise counts, not their values.
    rng
        Of the noise that the sensors' quality is estimated from.
    arm_of
        Makes an arm with faults; the independent engine's when None.
    """

    def __init__(
        self,
        robot: Robot,
        motion: MultiSine,
        instruments: SensorModel,
        rng: np.random.Generator,
        arm_of: Callable[[Sequence[Fault]], Arm] | None = None,
    ) -> None:
        self._robot, self._motion = robot, motion
        self._arm_of = arm_maker(robot, (), EFFECTS) if arm_of is None else arm_of
        course = self._arm_of(()).run(motion)
        self._observation = observe(measure(course, robot.joint_names, (), instruments, rng))
        rate = self._observation.rate
        self._layout = EquationSet.direct(self._observation.pieces[0].recorded, robot.n, elastic=robot.elastic)
        self._band = Band(widest_band(rate), rate)
        self._plain = self._residuals(course, (), "mod3")

    def signal(self, faults: Sequence[Fault], model: str = "mod3") -> EffectSignal:
        """Simulate an arm with these effects and return how far it is from a plain one that the model describes.

        Raises
        ------
        SimulationError
            When the arm does not survive them.
        """
        course = self._arm_of(faults).run(self._motion)
        white, excess = self._residuals(course, faults, model)
        if model == "mod3":
            # What the smoother leaves of any motion is no effect.
            white, excess = white - self._plain[0], [a - b for a, b in zip(excess, self._plain[1], strict=True)]
        square = np.concatenate(excess) ** 2
        return EffectSignal(float(np.linalg.norm(white)), float(square.mean(axis=0).sum()))

    def _residuals(self, course: TrueChannels, faults: Sequence[Fault], model: str) -> tuple[Array, list[Array]]:
        exact = measure(course, self._robot.joint_names, faults, EXACT, np.random.default_rng(0)).samples()
        pieces = tuple(self._observation.smoother(grid) for grid in Clock.of(exact).place(exact))
        seen = replace(self._observation, pieces=pieces, quiet=pieces)
        whitened = WhitenedData(build_model(self._robot, model), [seen], self._layout, self._band)
        return whitened.white, whitened.y


def sized(draft: SampledEffect, wanted: float, detectability: Detectability) -> tuple[float, EffectSignal]:
    """Return the amount of an effect whose distance is the wanted one, within the plausible range, and its signal.

    Parameters
    ----------
    draft
        The effect without its size.
    wanted
        Whitened distance: size over its Cramér-Rao bound.
    detectability
        Measures distances on the arm's own motion.
    """
    low, high = draft.limits()
    amount = float(np.clip(draft.typical(), low, high))
    for _ in range(ROUNDS):
        try:
            signal = detectability.signal([draft.sized(amount)])
        except SimulationError:
            high = amount = 0.5 * amount
            continue
        better = float(np.clip(amount * wanted / max(signal.distance, 1e-9), low, high))
        if abs(better / amount - 1.0) < NEAR:
            break
        amount = better
    else:
        signal = detectability.signal([draft.sized(amount)])
    if signal.distance == 0.0:
        raise EffectError(
            f"{draft.fault.effect} does not act in the motion that was drawn, at {amount:g} either",
            "Widen the plausible range of its parameters, or leave it out (--effect).",
        )
    return amount, signal
