"""Laws without a form: smooth functions of speed, angle, load or time at one place."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.codegen.parallel import share_out
from elastic_arm.equations.formless import GeneralLaw, general_laws
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.priors import FORMLESS, ODDS, SIZES
from elastic_arm.evidence.terms.term import Coefficients, Term


@dataclass(frozen=True, eq=False)
class LawTerm(Term):
    """A law without a form; its size is one of :data:`.priors.SIZES`, averaged over."""

    law: Any = None  # GeneralLaw

    kind = "law"
    says_cause = False

    def doubt(self, is_usual: bool) -> float:
        """Return -ln of its prior odds: the catalogue has what arms mostly have."""
        return -float(np.log(ODDS * FORMLESS))

    def at_size(self, size: float) -> Self:
        """Return it at one of the sizes that it may have, Nm."""
        std = np.full(self.count, size)
        ident = (self.kind, *self.key, self.count, size)
        return replace(self, std=std, grid=float(np.log(len(SIZES))), ident=ident)

    def again(
        self, linear: Linearisation, fit: Coefficients, others: Sequence[Term]
    ) -> Sequence[Term]:
        """Return it at another linearisation."""
        return [replace(self, columns=linear.data.whiten(self.law.plain(linear.data)))]

    def plain(self, linear: Linearisation, fit: Coefficients, along: Array) -> list[Array]:
        """Return its columns (N', R, k) of each stretch, Nm."""
        found: list[Array] = self.law.plain(linear.data)
        return found


def law_terms(linear: Linearisation) -> list[LawTerm]:
    """Return the laws without a form, their size open."""
    data = linear.data
    joints = linear.problem.robot.joints
    laws = [
        law
        for j, joint in enumerate(joints)
        for law in general_laws((data,), j, joint.transmission)
    ]

    def made(law: GeneralLaw) -> LawTerm:
        X = data.whiten(law.plain(data))
        key = "law", str(law.joint), (law.side, law.argument, law.smoothness)
        return LawTerm(key, X, np.ones(X.shape[1]), law=law)

    return share_out(made, laws)
