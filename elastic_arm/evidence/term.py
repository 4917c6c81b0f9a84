"""What may be in the data: y = N nu + sum over terms of (offset + X beta) + e, beta ~ N(mean, std²)
within bounds.

A law of the catalogue, a number of the arm or a sensor that is far off, and a law without a form
are the same thing with another prior and another word in the report.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_arm.arrays import Array
from elastic_arm.evidence.priors import SCALES

Key = tuple[str, str | None, tuple[Any, ...]]  # effect, joint, choices
Ident = tuple[Any, ...]


@dataclass(frozen=True, eq=False)
class Term:
    """One thing that may be in the data."""

    # effect, joint and choices; two terms of one key are the same thing at other nonlinear numbers
    key: Key
    kind: str  # "effect", "number" (of the arm or a sensor, far off) or "law" (without a form)
    columns: Array  # (rows, k) whitened
    # std, mean, low, high: (k,) of the prior of the coefficients: Gaussian, truncated
    std: Array
    odds: float = 0.0  # ln of the number of terms among which it is chosen, nats
    grid: float = 0.0  # -ln of the prior probability of these nonlinear numbers among those tried
    mean: Array = None  # type: ignore[assignment]
    low: Array = None  # type: ignore[assignment]
    high: Array = None  # type: ignore[assignment]
    offset: Array | None = None  # (rows,) what it adds whatever the coefficients; None for nothing
    # feature, theta: effect at its place, and its nonlinear numbers
    feature: Any = None
    theta: tuple[float, ...] = ()
    tangents: tuple[
        int, ...
    ] = ()  # which components of `theta` the last columns are derivatives by
    size: float = 1.0  # coefficient of the law at which its tangents were taken
    scale: float = 1.0  # factor on the range of the size, whose prior it is
    is_scaled: bool = False  # whether it was chosen among others
    # whether the trust in the description scales its prior: of what the description states
    trusted: bool = False
    stated: Array | None = None  # (k,) sizes that the description states
    # of a law without a form: the law. Of numbers: (K, k) how nu moves with the coefficients.
    what: Any = None
    fitted: int = 0  # of a change between recordings: how many are fitted, which come first
    ident: Ident = ()

    def __post_init__(self) -> None:
        k = self.columns.shape[1]
        for name, value in (("mean", 0.0), ("low", -np.inf), ("high", np.inf)):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.full(k, value))
        if not self.ident:
            size = self.size if self.tangents else 1.0
            object.__setattr__(
                self, "ident", (self.kind, *self.key, self.theta, self.tangents, size, k)
            )

    @property
    def parts(self) -> list[Array]:
        """What it adds whatever the coefficients, (rows, 1), where it does, and its columns."""
        return [self.columns] if self.offset is None else [self.offset[:, None], self.columns]

    @property
    def count(self) -> int:
        """Number of coefficients."""
        return self.columns.shape[1]

    @property
    def linear(self) -> int:
        """Number of coefficients of the law itself, without those of its nonlinear numbers."""
        return self.count - len(self.tangents)

    @property
    def price(self) -> float:
        """-ln of the prior probability that it is this one of those that could be, nats."""
        return self.odds + self.grid

    def scaled(self, scale: float) -> Term:
        """Return an effect or number of another scale of its size."""
        std = self.std * np.where(np.arange(self.count) < self.linear, scale / self.scale, 1.0)
        grid = self.grid + (0.0 if self.is_scaled else float(np.log(len(SCALES))))
        ident = self.ident[:-1] if self.is_scaled else self.ident
        return replace(self, std=std, scale=scale, grid=grid, is_scaled=True, ident=(*ident, scale))

    def among(self, rows: NDArray[np.bool_]) -> Term:
        """Return it at some of the rows (rows,)."""
        offset = None if self.offset is None else self.offset[rows]
        return replace(self, columns=self.columns[rows], offset=offset)

    def with_odds(self, odds: float) -> Term:
        """Return it with other prior odds."""
        return replace(self, odds=odds)
