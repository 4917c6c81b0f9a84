"""Every effect of a catalogue at every place of an arm where it could show, and where a search for it starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.settings import CandidateSettings
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.effects.model import Effect, EffectInstance
from elastic_arm.effects.parameters import Parameter
from elastic_arm.effects.regressor import Regressor
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.regressors import Signals

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OwnRegressor(Feature):
    """An effect whose file computes its regressor: at each value of its parameters the size is known."""

    @property
    def scalable(self) -> bool:
        """False: its size follows from its parameters."""
        return False

    @cached_property
    def _regressor(self) -> Regressor:
        assert self.effect.regressor is not None
        return self.effect.regressor(self.equations)

    @property
    def acts(self) -> bool:
        """Whether the arm has what the effect acts in."""
        return self._regressor.acts

    def whole(self) -> Feature:
        """Return itself: its column is the effect at given values of all its parameters already."""
        return self

    def columns(self, signals: Signals, searched: Sequence[float] = (), start: float = 0.0) -> Array:
        """Return what the effect adds to the residuals, (N, 3 n, 1).

        Parameters
        ----------
        signals
            Of the motion.
        searched
            Values of the searched parameters.
        start
            Not used: it has no internal states.
        """
        return self._regressor.residuals(signals, self.parameters((), searched))[:, :, None]


def features(equations: ArmEquations, effects: Sequence[Effect]) -> list[Feature]:
    """Return every effect at every place where it adds something to this model's residuals."""
    found = [feature_of(instance, equations) for effect in effects for instance in effect.candidates(equations.robot)]
    return [feature for feature in found if _possible(feature) and feature.acts]


def _possible(feature: Feature) -> bool:
    """Whether the arm has what the effect acts in: without transmissions there is no drive."""
    if feature.equations.robot.elastic:
        return True
    sides = set(feature.sides)
    return ("link" in sides or sides == {"motor"}) and "link_encoder" not in feature.choices.get("channels", ())


def feature_of(instance: EffectInstance, equations: ArmEquations) -> Feature:
    """Return the feature of an effect on an arm."""
    effect = instance.effect
    chosen = {c.name: instance.parameters[c.name] for c in effect.choices}
    kind = Feature if effect.regressor is None else OwnRegressor
    return kind(effect, instance.joint, chosen, equations)


def starting_points(feature: Feature, settings: CandidateSettings) -> list[tuple[float, ...] | None]:
    """Return values of the searched parameters from which a search may start."""
    if not feature.searched:
        return [()]
    if any(p.size > 1 for p in feature.searched):
        return [None]
    points = settings.grid if len(feature.searched) == 1 else settings.coarse_grid
    return list(product(*(_tried(parameter, points, settings.orders) for parameter in feature.searched)))


def _tried(parameter: Parameter, points: int, orders: int) -> list[float]:
    """Return values of one searched parameter, spread over its range."""
    low, high = parameter.low, parameter.high
    if parameter.integer:
        first = int(np.ceil(low))
        return [float(k) for k in range(first, min(first + orders - 1, int(high)) + 1)]
    spread = np.geomspace if parameter.logarithmic else np.linspace
    return [float(v) for v in spread(low, high, points)]
