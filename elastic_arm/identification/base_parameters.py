"""Base parameters: the combinations of parameters that the equations can determine.

    Phi Psi = Phi[:, columns] T Psi = Phi[:, columns] Psi_base

Columns of the regressor that are combinations of others are found by orthogonalising the columns in
an order of preference (a rank-revealing QR whose pivoting prefers readable columns). Each base
parameter is the parameter of its column plus the contributions of the dependent columns (M. Gautier
and W. Khalil, IEEE Trans. Robotics and Automation 6 (1990) 368).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from elastic_arm.arrays import Array, Indices

# A column counts as new when it leaves this share of its length beside the columns before it.
INDEPENDENT = 1e-8
# A placement with cos(pi/2) = 6e-17 makes columns of this size out of nothing.
ABSOLUTE_FLOOR = 1e-10
# Coefficients smaller than this are rounding: beside the largest column, and as they stand.
COEFFICIENT_FLOOR = 1e-9
ROUNDING = 5e-13
# What comes first is kept, what comes last is expressed by it.
PREFERENCE = (
    "K",
    "D",
    "K_b",
    "D_b",
    "armature",
    "Izz",
    "Ixx",
    "Ixy",
    "Ixz",
    "Iyz",
    "mx",
    "my",
    "mz",
    "Iyy",
    "m",
)


@dataclass(frozen=True)
class BaseParameters:
    """The map from all parameters to those that the equations can determine."""

    columns: Indices  # (B,) indices of the base columns among all parameters
    T: Array  # (B, P): Psi_base = T Psi, and Phi Psi = Phi[:, columns] Psi_base
    names: tuple[str, ...]  # readable combinations
    units: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.columns)


def find_base(Phi: Array, names: Sequence[str], units: Sequence[str]) -> BaseParameters:
    """Find the base parameters from a regressor at random states."""
    order = _preferred(names)
    columns, coefficients = _independent(Phi, order)
    T = np.zeros((len(columns), len(names)))
    T[np.arange(len(columns)), columns] = 1.0
    for dependent, beta in coefficients.items():
        T[:, dependent] = beta
    by_column = np.argsort(columns)
    columns = columns[by_column]
    T = T[by_column]
    texts = tuple(_name(row, c, names) for row, c in zip(T, columns, strict=True))
    return BaseParameters(columns, T, texts, tuple(units[c] for c in columns))


def _preferred(names: Sequence[str]) -> list[int]:
    """Order columns: springs, links outward, components (spline, rotor, wave generator), laws
    beyond the model."""
    bodies = list(dict.fromkeys(name.rpartition(".")[0] for name in names))

    def rank(k: int) -> tuple[int, int, int, int]:
        body, _, kind = names[k].rpartition(".")
        if kind not in PREFERENCE:
            return (9, 0, 0, k)
        component = next(
            (i for i, what in enumerate((".spline", ".rotor", ".wave_generator")) if what in body),
            -1,
        )
        return (component, bodies.index(body), PREFERENCE.index(kind), k)

    return sorted(range(len(names)), key=rank)


def _independent(Phi: Array, order: list[int]) -> tuple[Indices, dict[int, Array]]:
    """Orthogonalise the columns one after another; return the new ones and the others as
    combinations of them."""
    basis = np.zeros((len(Phi), 0))
    chosen: list[int] = []
    dependent: list[int] = []
    largest = np.max(np.linalg.norm(Phi, axis=0))
    for k in order:
        column = Phi[:, k]
        size = np.linalg.norm(column)
        if size <= ABSOLUTE_FLOOR * max(largest, 1.0):
            continue
        left = column - basis @ (basis.T @ column)
        left -= basis @ (basis.T @ left)
        if np.linalg.norm(left) > INDEPENDENT * size:
            chosen.append(k)
            basis = np.column_stack([basis, left / np.linalg.norm(left)])
        else:
            dependent.append(k)
    columns = np.array(chosen, dtype=np.intp)
    scale = np.linalg.norm(Phi[:, columns], axis=0)
    found = (
        np.linalg.lstsq(Phi[:, columns] / scale, Phi[:, dependent], rcond=None)[0] / scale[:, None]
    )
    found = np.where(np.abs(found) * scale[:, None] < COEFFICIENT_FLOOR * largest, 0.0, found)
    # What is but rounding is zero: coefficients are products of the lengths and ratios of the
    # description.
    found = np.where(np.abs(found) <= ROUNDING, 0.0, found)
    return columns, dict(zip(dependent, found.T, strict=True))


def _name(row: Array, column: int, names: Sequence[str]) -> str:
    """Return the combination as text, its own column first."""
    words = names[column]
    for k in np.flatnonzero(row).tolist():
        if k != column:
            size = abs(row[k])
            factor = "" if abs(size - 1) < 1e-9 else f"{_number(size)} "
            words += f" {'-' if row[k] < 0 else '+'} {factor}{names[k]}"
    return words


def _number(value: float) -> str:
    """Return a short number that represents the value to five digits."""
    nice = Fraction(value).limit_denominator(1000)
    short = nice.denominator < 64 and abs(float(nice) - value) < 1e-9 * abs(value)
    return f"{float(nice):g}" if short else f"{value:.5g}"
