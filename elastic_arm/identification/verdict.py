"""What a recording determines: before any fit, from the motion alone, and after it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from elastic_arm.identification.equations import Equations
from elastic_arm.identification.least_squares import BlockFactors, factor

Array = NDArray[np.float64]

# A parameter is determined well below the first, poorly below the second relative standard deviation, else not at all.
WELL = 0.05
POORLY = 0.5
# Condition numbers of the equilibrated columns from which an excitation is called poor.
POOR_CONDITION = 1000.0
# Share of parameters that a good excitation may leave poorly determined or worse.
POOR_SHARE = 0.5
# Torque noise taken for granted before a fit, Nm (torque sensors of this class; a fit estimates its own).
TORQUE_NOISE = 0.26
# A parameter takes part in an undetermined direction from this share on.
TAKES_PART = 0.3


@dataclass(frozen=True)
class Excitation:
    """What the motion of a recording can determine, said before any fit.

    Parameters
    ----------
    condition
        Condition number of the equilibrated columns.
    relative_std
        (B,) expected standard deviation over natural scale, for white torque noise of 0.26 Nm.
    weakest
        Base parameters that take part in the least determined direction.
    poor
        Whether parameters from this recording should not be trusted beyond its own kind of motion.
    reasons
        Why, in words.
    """

    condition: float
    relative_std: Array
    weakest: tuple[str, ...]
    poor: bool
    reasons: tuple[str, ...]


def natural_scales(equations: Equations) -> Array:
    """Return the size that each base parameter can be expected to have, (B,).

    The nominal value, or, where that happens to be small, what is usual for its body: its largest first moment or
    moment of inertia. Laws beyond the model have none (NaN).
    """
    own = np.abs(equations.nominal)
    sizes = own.copy()
    groups: dict[tuple[str, str], list[int]] = {}
    for k, name in enumerate(equations.names):
        body, _, kind = name.rpartition(".")
        groups.setdefault((body, kind[0] if kind[0] in "mI" and kind != "m" else kind), []).append(k)
    for members in groups.values():
        sizes[members] = np.max(own[members])
    base = equations.base
    scale = np.maximum(np.abs(base.T @ equations.nominal), sizes[base.columns])
    return np.where(scale > 0, scale, np.nan)


def excitation(blocks: BlockFactors, equations: Equations, torque_noise: float = TORQUE_NOISE) -> Excitation:
    """Judge the motion of a recording; the torques are not looked at."""
    r = blocks.total()[..., :-1]
    whole = factor(r.reshape(1, -1, r.shape[-1]) / torque_noise)[0]
    size = np.linalg.norm(whole, axis=0)
    _, s, vt = np.linalg.svd(whole / np.where(size > 0, size, 1.0), full_matrices=False)
    condition = float(s[0] / s[-1]) if s[-1] > 0 else float("inf")
    spread = np.sqrt(np.sum((vt / np.maximum(s, 1e-300)[:, None]) ** 2, axis=0))
    with np.errstate(divide="ignore"):
        relative = np.where(size > 0, spread / size, np.inf) / natural_scales(equations)
    names = equations.base.names
    weakest = tuple(names[k] for k in np.flatnonzero(np.abs(vt[-1]) > TAKES_PART).tolist())
    judged = np.isfinite(natural_scales(equations))
    bad = judged & ~(relative <= POORLY)
    reasons = []
    if condition > POOR_CONDITION:
        reasons.append(
            f"the condition number of the regressor is {condition:.3g} (below {POOR_CONDITION:g} is wanted): "
            f"some parameters act alike on this motion"
        )
    if judged.any() and bad.sum() > POOR_SHARE * judged.sum():
        reasons.append(f"{bad.sum()} of {judged.sum()} base parameters stay within their expected errors")
    return Excitation(condition, relative, weakest, bool(reasons), tuple(reasons))


def verdicts(relative_std: Array) -> tuple[str, ...]:
    """Say "well", "poorly" or "not" for each relative standard deviation."""
    return tuple("well" if s <= WELL else "poorly" if s <= POORLY else "not" for s in relative_std)


def relative_std(equations: Equations, Psi_base: Array, std: Array) -> Array:
    """Return the standard deviations over natural scale, over the estimate itself for laws beyond the model."""
    scale = natural_scales(equations)
    scale = np.where(np.isfinite(scale), scale, np.maximum(np.abs(Psi_base), 1e-300))
    return std / scale


def directions(undetermined: Array, names: Sequence[str]) -> tuple[str, ...]:
    """Name the combinations of base parameters that the data leave open."""
    said = []
    for direction in undetermined:
        parts = [f"{direction[k]:+.2f} ({names[k]})" for k in np.flatnonzero(np.abs(direction) > TAKES_PART).tolist()]
        said.append(" ".join(parts))
    return tuple(said)
