"""Nonparametric laws: smooth functions of speed, angle, load or time at one place."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any, Self

import numpy as np

from elastic_arm.arrays import Array, Mask
from elastic_arm.codegen.parallel import ahead
from elastic_arm.equations.formless import GeneralLaw, general_laws
from elastic_arm.evidence.keys import Key
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.priors import FORMLESS, ODDS, SIZES
from elastic_arm.evidence.tails import Tail
from elastic_arm.evidence.terms.term import Coefficients, Term, odds_among


@dataclass(frozen=True, eq=False)
class LawTerm(Term):
    """A nonparametric law; its size is one of :data:`.priors.SIZES`, averaged over."""

    law: Any = None  # GeneralLaw
    # Whitened shapes (rows, m) of which its columns are combinations: these are made when they are
    # needed. None where it has columns.
    shapes: Tail | None = None

    kind = "law"
    says_cause = False

    @property
    def place(self) -> tuple[int, str]:
        """Index of the joint and side at which it acts."""
        return self.law.joint, self.law.side

    def doubt(self, is_usual: bool) -> float:
        """Return -ln of its prior odds: the catalogue has what arms mostly have."""
        return -float(np.log(ODDS * FORMLESS))

    @property
    def parts(self) -> list[Array]:
        """Its columns, (rows, k)."""
        if self.shapes is None:
            return [self.columns]
        return [(self.law.mixed.T @ self.shapes.whole.T).T]

    @property
    def made_of(self) -> tuple[Array, Array | None]:
        """Shapes (rows, m) of which its columns are combinations (m, k); None where they are
        these."""
        return super().made_of if self.shapes is None else (self.shapes.whole, self.law.mixed)

    def without_rows(self) -> Self:
        """Return it without the memory of its shapes."""
        return replace(super().without_rows(), shapes=None)

    def with_rows(self, made_of: Tail) -> Self:
        """Return it with its shapes."""
        return super().with_rows(made_of) if self.law is None else replace(self, shapes=made_of)

    def among(self, rows: Mask) -> Self:
        """Return it at some of the rows (rows,)."""
        return replace(self, columns=self.parts[0][rows], shapes=None)

    def at_size(self, size: float) -> Self:
        """Return it at one of the sizes that it may have, Nm."""
        std = np.full(self.count, size)
        ident = (self.kind, *self.key, self.count, size)
        return replace(self, std=std, grid=float(np.log(len(SIZES))), ident=ident)

    def again(
        self, linear: Linearisation, fit: Coefficients, others: Sequence[Term]
    ) -> Sequence[Term]:
        """Return it at another linearisation."""
        columns = linear.data.whiten(self.law.plain(linear.data))
        return [replace(self, columns=columns, shapes=None)]

    def plain(self, linear: Linearisation, fit: Coefficients, along: Array) -> list[Array]:
        """Return its columns (N', R, k) of each stretch, Nm."""
        return self.law.plain(linear.data)


def law_terms(linear: Linearisation) -> Iterator[LawTerm]:
    """Yield the nonparametric laws, their size open, one after the other: together they are
    large."""
    data = linear.data
    joints = linear.problem.robot.joints
    laws = [
        law
        for j, joint in enumerate(joints)
        for law in general_laws((data,), j, joint.transmission)
    ]
    odds = odds_among(law_key(law) for law in laws)
    alike = [list(own) for _, own in groupby(laws, key=lambda law: id(law.shapes))]

    def made(own: list[GeneralLaw]) -> list[LawTerm]:
        shapes = Tail(0, data.whiten(own[0].plain_shapes(data)))
        return [
            LawTerm(
                law_key(law),
                np.empty((0, law.mixed.shape[1])),
                np.ones(law.mixed.shape[1]),
                odds=odds[law_key(law)],
                law=law,
                shapes=shapes,
            )
            for law in own
        ]

    for terms in ahead(made, alike):
        yield from terms


def law_key(law: GeneralLaw) -> Key:
    """Return the key of a nonparametric law."""
    return "law", str(law.joint), (law.side, law.argument, law.smoothness)
