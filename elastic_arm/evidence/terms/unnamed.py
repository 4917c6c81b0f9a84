"""Numbers far from their description that no cause of the catalogue names.

A gain whose effect is not in the catalogue is to the search what a nonparametric law is: without
it, the effect of the catalogue that is most like it would be named instead.
"""

from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.equations.numbers import Number
from elastic_arm.evidence.priors import FORMLESS, ODDS
from elastic_arm.evidence.terms.number import NumberTerm


@dataclass(frozen=True, eq=False)
class UnnamedTerm(NumberTerm):
    """A number that is far off and that no report can name as a cause."""

    kind = "unnamed"
    says_cause = False

    @property
    def place(self) -> tuple[int, str]:
        """Index of the joint and side at which it acts."""
        feature = self.feature
        return feature.equations.robot.joint_names.index(feature.joint), feature.sides[0]

    def doubt(self, is_usual: bool) -> float:
        """Return -ln of its prior odds: the catalogue has what arms mostly have."""
        return -float(np.log(ODDS * FORMLESS))


def unnamed_terms(parameters: Sequence[Number], N: Array, far: Set[str]) -> list[UnnamedTerm]:
    """Return the terms of numbers of the arm and its sensors whose effect is not in the catalogue.

    N: (rows, k) whitened columns for one standard deviation each; far: effects of the catalogue.
    """
    found = []
    unit = np.eye(len(parameters))
    for k, parameter in enumerate(parameters):
        cause = parameter.cause
        if cause is None or cause.effect.id in far:
            continue
        key = "unnamed", parameter.joint, (cause.effect.id,)
        found.append(UnnamedTerm.of(parameter, N, key, unit[:, [k]]))
    return found
