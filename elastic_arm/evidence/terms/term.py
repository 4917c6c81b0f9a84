"""One thing that may be in the data, whatever its kind."""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from elastic_arm.arrays import Array, Mask
from elastic_arm.evidence.keys import Ident, Key
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.priors import ODDS, SCALES
from elastic_arm.evidence.tails import Tail


class Coefficients(Protocol):
    """What a term needs of the fit of a set that holds it."""

    @property
    def terms(self) -> tuple[Term, ...]:
        """The terms of the set."""

    def beta(self, term: Term) -> Array:
        """Return the coefficients (k,) of a term; its mean over fitted recordings."""

    def raw(self, term: Term) -> Array:
        """Return the coefficients (k,) of a term's columns."""

    def covariance(self, term: Term) -> Array:
        """Return the covariance (k, k) of the coefficients of a term."""

    @property
    def deviations(self) -> Array:
        """Where (K,) the numbers are, in deviations from the description."""

    @property
    def number_covariance(self) -> Array:
        """The covariance (K, K) of the numbers."""


def odds_among(keys: Iterable[Key], usual: Set[Key] = frozenset()) -> dict[Key, float]:
    """Return the odds of terms by their keys: each effect is as likely, and each of its places;
    what is usual is at each of them."""
    places: dict[str, set[Key]] = {}
    for key in keys:
        places.setdefault(key[0], set()).add(key)
    return {
        key: 0.0 if key in usual else float(np.log(len(places)) + np.log(len(own)))
        for own in places.values()
        for key in own
    }


@dataclass(frozen=True, eq=False)
class Term:
    """One thing that may be in the data: columns, and the prior of their coefficients."""

    # effect, joint and choices; two terms of one key are the same thing at other nonlinear numbers
    key: Key
    columns: Array  # (rows, k) whitened
    std: Array  # (k,) of the Gaussian prior of the coefficients
    odds: float = 0.0  # ln of the number of terms among which it is chosen, nats
    grid: float = 0.0  # -ln of the prior probability of these nonlinear numbers among those tried
    # (k,) of that prior, which is truncated
    mean: Array = None  # type: ignore[assignment]
    low: Array = None  # type: ignore[assignment]
    high: Array = None  # type: ignore[assignment]
    offset: Array | None = None  # (rows,) what it adds whatever the coefficients; None for nothing
    feature: Any = None  # the effect as which it is reported; None for what is no cause
    scale: float = 1.0  # factor on the range of the size, whose prior it is
    is_scaled: bool = False  # whether the scale was chosen among others
    ident: Ident = ()

    kind: ClassVar[str] = ""  # distinguishes kinds of one key
    says_cause: ClassVar[bool] = True  # whether a report may name it as a cause

    def __post_init__(self) -> None:
        k = self.columns.shape[1]
        for name, value in (("mean", 0.0), ("low", -np.inf), ("high", np.inf)):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.full(k, value))
        if not self.ident:
            scale = (self.scale,) if self.is_scaled else ()
            object.__setattr__(self, "ident", (self.kind, *self.key, *self._details, k, *scale))

    @property
    def _details(self) -> tuple[Any, ...]:
        """What distinguishes terms of one kind and key."""
        return ()

    @property
    def parts(self) -> list[Array]:
        """What it adds whatever the coefficients, (rows, 1), where it does, and its columns."""
        return [self.columns] if self.offset is None else [self.offset[:, None], self.columns]

    @property
    def made_of(self) -> tuple[Array, Array | None]:
        """Columns (rows, m) of which its parts, side by side, are combinations (m, k); None where
        they are these."""
        return (self.columns if self.offset is None else np.hstack(self.parts)), None

    def without_rows(self) -> Self:
        """Return it without the memory of its columns, for what else there is of it."""
        offset = None if self.offset is None else np.empty(0)
        return replace(self, columns=np.empty((0, self.count)), offset=offset)

    def with_rows(self, made_of: Tail) -> Self:
        """Return it with what it is made of (:attr:`made_of`)."""
        whole = made_of.whole
        if self.offset is None:
            return replace(self, columns=whole)
        return replace(self, offset=whole[:, 0], columns=whole[:, 1:])

    @property
    def count(self) -> int:
        """Number of coefficients."""
        return self.columns.shape[1]

    @property
    def linear(self) -> int:
        """Number of coefficients of the law itself, without those of its nonlinear numbers."""
        return self.count

    @property
    def price(self) -> float:
        """-ln of the prior probability that it is this one of those that could be, nats."""
        return self.odds + self.grid

    def doubt(self, is_usual: bool) -> float:
        """Return -ln of the prior odds that one of its kind is there, nats.

        is_usual: whether every real drive has it.
        """
        return -float(np.log(ODDS))

    def at_size(self, size: float) -> Self:
        """Return it with the size that its screen found best."""
        return self.scaled(size)

    def scaled(self, scale: float) -> Self:
        """Return it with another scale of its size."""
        std = self.std * np.where(np.arange(self.count) < self.linear, scale / self.scale, 1.0)
        grid = self.grid + (0.0 if self.is_scaled else float(np.log(len(SCALES))))
        ident = self.ident[:-1] if self.is_scaled else self.ident
        return replace(self, std=std, scale=scale, grid=grid, is_scaled=True, ident=(*ident, scale))

    def among(self, rows: Mask) -> Self:
        """Return it at some of the rows (rows,)."""
        offset = None if self.offset is None else self.offset[rows]
        return replace(self, columns=self.columns[rows], offset=offset)

    def changes(self, key: Key) -> bool:
        """Whether it is the change between recordings of the term of a key."""
        return False

    def again(
        self, linear: Linearisation, fit: Coefficients, others: Sequence[Term]
    ) -> Sequence[Term]:
        """Return it at another linearisation, none where it adds nothing there.

        fit: a set that holds it, with sizes and nonlinear numbers; others: terms that are there.
        """
        raise NotImplementedError

    def plain(self, linear: Linearisation, fit: Coefficients, along: Array) -> list[Array]:
        """Return its columns (N', R, k) of each stretch of a linearisation, Nm.

        along: what a standard deviation of each number changes (K,), in columns.
        """
        raise NotImplementedError

    def added(self, linear: Linearisation, fit: Coefficients, along: Array) -> list[Array]:
        """Return what it adds to the residuals (N', R) of each stretch of a linearisation, Nm."""
        beta = self.coefficients(fit)
        return [X @ beta for X in self.plain(linear, fit, along)]

    def coefficients(self, fit: Coefficients) -> Array:
        """Return the coefficients of its law by a fit that holds it."""
        return fit.beta(self)
